"""Entry points that Python computes at first: to the same bits, and when they are compiled."""

import math
from contextlib import nullcontext
from itertools import product

import gymnasium as gym
import numpy as np
import pytest
from oracles import plants
from oracles.bits import assert_same_bits, compare_ways
from oracles.plants import ELASTIC, each_of, loaded_plant, nightly, random_motion, random_states
from oracles.platforms import PLATFORMS

from cablebot_gym.envs import ENV_IDS, env_robot, outcome
from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.physics import kernel
from cablebot_gym.physics.compiling import code_cache, fused, python_first
from cablebot_gym.physics.compiling.fused import fma, is_exact, python_fma
from cablebot_gym.physics.compiling.inlining import inline
from cablebot_gym.physics.compiling.python_first import EntryPoint, compiled_at_once, entry_point
from cablebot_gym.physics.forward import forward_kinematics
from cablebot_gym.physics.inverse import demands, inverse_dynamics
from cablebot_gym.physics.kernel import rows
from cablebot_gym.physics.plant import FEW_ROBOTS, form_of
from cablebot_gym.physics.tensions import central_tensions, distribution, tension_problems
from cablebot_gym.robots import ROBOTS, find_robot

EVERYTHING = ELASTIC[-1]


@pytest.fixture
def empty_cache(monkeypatch, tmp_path):
    monkeypatch.setattr(code_cache, "code_folders", lambda: [tmp_path])


@pytest.fixture
def fresh(monkeypatch, empty_cache):
    """Makes entry points of a new process whose cache is empty, and forbids to compile them."""

    def compile_nothing(*arguments):
        raise AssertionError("it is compiled")

    def make_fresh(*entries):
        for entry in entries:
            monkeypatch.setattr(entry, "left", python_first.BUDGET)
            monkeypatch.setattr(entry, "present", entry._choose)
            monkeypatch.setattr(entry, "_compile", compile_nothing)

    return make_fresh


# --- bits ---------------------------------------------------------------------------------------------------------


def move(robot, count, cable):
    """Three control periods of robots with slack cables, clipped motors and wrenches."""
    state, actions = random_states(robot, count, seed=count, reach=0.3)
    plant = loaded_plant(robot, state, cable, robot.mass * np.linspace(1, 1.6, count))
    plant.set_wrench(np.arange(count), np.ones((count, robot.dimensions)), np.ones((count, 3)))
    references = np.random.default_rng(7).uniform(*robot.pose_bounds, (1, 25, robot.coordinates))
    for _ in range(3):
        plant.set_action(actions)
        plant.advance(references, np.array([4]), substeps=2, step=5e-4)
        assert np.all(np.isfinite(plant.record))
    return plant


@each_of(*ROBOTS.values(), EVERYTHING)
def test_python_moves_a_robot_to_the_bits_of_compiled_code(robot, monkeypatch):
    """Excludes a sum that Python rounds in another way, or an order of its own."""
    names = compare_ways(monkeypatch, kernel.compiled(form_of(robot), 1).advance)
    move(robot, 1, "unilateral")
    assert names == {"advance"}


@each_of(*nightly(*ELASTIC, *plants.KINDS, *PLATFORMS.values()))
@pytest.mark.parametrize("count", [FEW_ROBOTS, FEW_ROBOTS + 1])
def test_all_forms_have_the_same_bits(robot, count, monkeypatch):
    form = form_of(robot)
    rigid = form._replace(jointed=False, elastic=False, load_friction=False)
    entries = []
    for lanes, form_of_entry in product((1, rows.LANES), (form, rigid)):
        entries += kernel.compiled(form_of_entry, lanes)
    names = compare_ways(monkeypatch, *entries)
    for cable in ("unilateral", "bilateral"):
        move(robot, count, cable)
    mass, *motion = random_motion(robot, (count,), spread=0.3)
    demands(robot, mass, np.stack(motion))
    expected = {"advance", "demanded"}
    if robot.cables == robot.coordinates or robot.kind == "planar":
        inverse_dynamics(robot, mass, *motion)
        expected.add("required")
    if robot.cables >= robot.coordinates:
        lengths = cable_lengths(robot.base, robot.platform, motion[0], robot.swivel)
        forward_kinematics(robot, lengths, robot.home)
        expected.add("locate")
    assert names == expected


def test_python_and_compiled_tensions_have_the_same_bits(monkeypatch):
    """Excludes a power or a sum that Python rounds in another way. Half of the loads push, which no
    tensions hold."""
    rng = np.random.default_rng(3)
    structure = rng.normal(size=(60, 5, 3))
    load = -np.einsum("kmn,km->kn", structure, rng.uniform(2.0, 10.0, (60, 5)))
    load[::2] = rng.normal(size=(30, 3))
    structure[7] = 0.0
    entries = (
        tension_problems.solve_least_norm,
        tension_problems.solve_least_largest,
        tension_problems.solve_interval,
        central_tensions.solve_central,
    )
    names = compare_ways(monkeypatch, *entries)
    distribution.least_norm(structure, load, 1.0, 20.0)
    distribution.unchecked_least_largest_action(structure, load, 1.0, 0.5, 0.1, 20.0)
    distribution.largest_scale(structure, load, load[::-1], 1.0, 20.0, 10.0)
    distribution.unchecked_central(structure, load, 1.0, 0.05, 0.1)
    assert len(names) == len(entries)


@pytest.mark.parametrize("env_id", ["CableBot-Planar-v0", "CableBot-FlexSpatial-v0"])
@pytest.mark.parametrize("options", [{}, {"measurement": "winches"}])
def test_python_and_compiled_outcome_have_the_same_bits(env_id, options, monkeypatch):
    names = compare_ways(monkeypatch, outcome.outcome)
    env = gym.make(env_id, uncertainty="hardware", **options)
    env.reset(seed=3)
    for _ in range(3):
        env.step(env.action_space.sample())
    assert names == {"outcome"}


# --- numbers without a value in Python ----------------------------------------------------------------------------


SPECIAL = (math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -2.5, 5e-324, 1e308)


@inline
def clipped(value, low, high):
    return min(max(value, low), high)


def special_cases(values, numbers, results):
    """Operations whose meaning for NaN, zeros or integers could differ."""
    for i in range(len(values)):
        for j in range(len(values)):
            a = values[i]
            b = values[j]
            whole = numbers[i]
            other = numbers[j]
            results[i, j, 0] = min(a, b)
            results[i, j, 1] = max(a, b)
            results[i, j, 2] = clipped(a, -1.0, b)
            results[i, j, 3] = a if a > b else b
            results[i, j, 4] = (a >= b) & (a == a) | (not a < b)
            results[i, j, 5] = max(0, a) + whole * a
            results[i, j, 6] = whole // 2 + whole % 3 - (whole - 9) // 4 + (whole - 9) % 4
            results[i, j, 7] = whole / 4 + math.sqrt(abs(a)) + other
            results[i, j, 8] = fma(a, b, 1.0) if math.isfinite(a * b) else 0.0
            results[i, j, 9] = abs(a) - (a - b) * np.floor(b)
            results[i, j, 10] = math.copysign(1.0, a * b) + math.isfinite(a)


@pytest.mark.parametrize("flat", [False, True])
def test_nan_infinity_and_integers_have_the_same_bits(flat, monkeypatch):
    """Excludes a minimum of Python that keeps the other one of its arguments."""
    entry = EntryPoint(special_cases, lambda *_: 0.0, flat=flat)
    assert compare_ways(monkeypatch, entry) == set()
    count = len(SPECIAL)
    entry(np.array(SPECIAL), np.arange(count), np.empty((count, count, 11)))


FAILING = {
    "division": lambda x: 1.0 / (x - x),
    "overflow": lambda x: math.exp(1e4 * x),
    "root": lambda x: math.sqrt(-x),
}


@pytest.mark.parametrize("name", FAILING)
def test_compiled_code_computes_what_python_cannot(name):
    """Nothing of the call in Python is left."""
    fail = inline(FAILING[name])

    @entry_point(seconds=lambda *_: 0.0, flat=True)
    def count_and_fail(values):
        values[0] += 1.0
        values[1] = fail(values[2])

    values = np.array([0.0, 0.0, 1.0])
    with pytest.raises((ArithmeticError, ValueError)):
        count_and_fail.in_python(values)
    np.testing.assert_array_equal(values, [0.0, 0.0, 1.0])
    count_and_fail(values)
    expected = np.array([0.0, 0.0, 1.0])
    count_and_fail.compiled(expected)
    assert_same_bits(values, expected)


def test_ctrl_c_leaves_the_arrays_as_before():
    @entry_point(seconds=lambda *_: 0.0)
    def interrupted(values):
        values[:] = 1.0
        raise KeyboardInterrupt

    values = np.zeros(3)
    with pytest.raises(KeyboardInterrupt):
        interrupted(values)
    np.testing.assert_array_equal(values, np.zeros(3))


# --- when code is compiled ----------------------------------------------------------------------------------------


def double(values):
    for i in range(len(values)):
        values[i] *= 2.0


@pytest.fixture
def doubling(monkeypatch, empty_cache):
    """A new entry point, which estimates one second for each value, and an empty cache."""
    monkeypatch.setattr(python_first, "LONGEST_CALL", 1.5)
    return lambda: EntryPoint(double, len)


def test_code_is_compiled_when_the_estimate_is_spent(doubling, caplog):
    """A message says so; from then on, nothing stands between the caller and compiled code."""
    code_cache._say_once.cache_clear()
    entry = doubling()
    values = np.ones(1)
    entry(values)
    entry(values)
    assert not caplog.records
    kept = entry.present
    kept(values)
    assert entry.present is entry.compiled
    assert ["compiling" in record.message for record in caplog.records] == [True]
    kept(values)
    entry(values)
    assert values[0] == 32.0
    assert len(entry.compiled.signatures) == 1


@pytest.mark.parametrize("count", [1, 2])
def test_long_call_is_compiled_at_once_and_stored_code_is_used_at_once(doubling, count):
    """So is a short one where later ones must be short: in the loop that drives a real robot."""
    first = doubling()
    with compiled_at_once() if count == 1 else nullcontext():
        first(np.ones(count))
    assert first.present is first.compiled
    entry = doubling()
    entry(np.ones(1))
    assert sum(entry.compiled.stats.cache_hits.values()) == 1
    other = doubling()
    other(np.ones(1, np.float32))  # stored for other types only
    assert other.present is not other.compiled


@each_of(*ROBOTS.values())
def test_large_batch_is_compiled_at_once(robot, fresh):
    entry = kernel.compiled(form_of(robot), rows.LANES).advance
    fresh(entry, outcome.outcome)
    plant = loaded_plant(robot, random_states(robot, 1024)[0])
    with pytest.raises(AssertionError, match="it is compiled"):
        plant.advance(*plants.no_reference(robot), substeps=2, step=1e-3)
    with pytest.raises(AssertionError, match="it is compiled"):
        outcome.outcome(False, np.arange(1024), (), (), ())


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_first_steps_run_in_python(env_id, fresh):
    """Excludes seconds of compilation before the first step, also of the distribution of
    tensions."""
    form = form_of(find_robot(env_robot(env_id)))
    fresh(outcome.outcome, tension_problems.solve_least_largest, *kernel.compiled(form, 1))
    single = gym.make(env_id)
    vector = gym.make_vec(env_id, num_envs=FEW_ROBOTS)
    for env in (single, vector):
        for payload in (0.0, 1.0):
            env.reset(seed=0, options={"payload": payload})
            env.step(env.action_space.sample())


# --- fused multiply-add -------------------------------------------------------------------------------------------


def test_only_a_function_that_rounds_once_is_exact():
    assert is_exact(python_fma())

    def flushing(a, b, c):
        result = python_fma()(a, b, c)
        return result if abs(result) >= 2.3e-308 else 0.0

    def overflowing(a, b, c):
        return python_fma()(a, b, c) if math.isfinite(a * b) else a * b

    for inexact in (lambda a, b, c: a * b + c, flushing, overflowing):
        assert not is_exact(inexact)


def test_inexact_multiply_add_lets_code_compile_at_once(monkeypatch):
    """Excludes wrong bits with a C library that rounds twice."""
    monkeypatch.setattr(fused, "_candidates", lambda: [lambda a, b, c: a * b + c])
    python_fma.cache_clear()

    @entry_point(seconds=lambda *_: 0.0)
    def fuse(values):
        values[0] = fma(values[0], values[1], values[2])

    fuse(np.ones(3))
    python_fma.cache_clear()
    assert fuse.present is fuse.compiled
