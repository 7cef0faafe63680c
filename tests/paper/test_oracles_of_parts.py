"""Parts of the reproduction against what they must be: each test has an oracle of its own."""

from __future__ import annotations

import json
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from cablebot_baselines.paper import engine, linearised
from cablebot_baselines.paper.engine import RESULTS, reproduce
from cablebot_baselines.paper.exact import (
    exact_limit,
    exact_profile,
    state_space_limit,
    state_space_profile,
)
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.laws import FeedForward
from cablebot_baselines.paper.load_iteration import iterate_load
from cablebot_baselines.paper.part import Outcome, Part
from cablebot_baselines.paper.parts import laws, scan
from cablebot_gym.bounds import exact_payload
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_gym.trajectories import find_trajectory
from cablebot_gym.utils.workers import leaders_first

# --- largest payloads that U⁻ ends ------------------------------------------------------------------------------------


def bisected(profile, low, high):
    """The payload up to which no torque of a profile leaves its limits, which holds on one interval."""

    def kept(payload):
        found = profile(payload)
        return np.all((found.torques <= found.upper) & (found.torques >= found.lower))

    assert kept(low)
    assert not kept(high)
    while high - low > 1e-7:
        middle = (low + high) / 2
        low, high = (middle, high) if kept(middle) else (low, middle)
    return low


def assert_lower_line_ends_it(profile, limit):
    room = profile.torques - profile.lower
    k, motor = np.unravel_index(room.argmin(), room.shape)
    assert room[k, motor] == pytest.approx(0.0, abs=1e-6)
    assert np.all(profile.upper - profile.torques > 0.1)
    assert (motor + 1, profile.times[k]) == (limit.motor, pytest.approx(limit.time, abs=1e-6))


def test_lower_line_can_end_the_payload_of_the_state_space():
    interpretation = Interpretation(line="reversed")
    robot = interpretation.flexible("payload").replace(gravity=0.3)  # so light that the platform has to be pushed, too
    limit = state_space_limit(interpretation, robot)
    profile = partial(state_space_profile, interpretation, robot)
    assert limit.payload == pytest.approx(bisected(profile, 0.0, 20.0), abs=1e-6)
    assert_lower_line_ends_it(profile(limit.payload), limit)


def test_lower_line_can_end_the_payload_with_one_alpha_for_all_times(monkeypatch):
    error_bounds = textbook.torque_limits
    monkeypatch.setattr(
        textbook, "torque_limits", lambda robot, speed: tuple(line + 2.9 for line in error_bounds(robot, speed))
    )
    interpretation = Interpretation(line="reversed", alpha="constant")
    limit = exact_limit(interpretation, PLANAR)
    profile = partial(exact_profile, interpretation, PLANAR)
    assert limit.payload == pytest.approx(bisected(profile, -0.95, 0.5), abs=1e-6)
    assert_lower_line_ends_it(profile(limit.payload), limit)


# --- Eqs. 37-39 -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("robot", "name"), [(PLANAR, "paper-planar"), (SPATIAL, "paper-spatial")])
def test_corrected_iteration_ends_at_the_closed_form_under_any_line(robot, name):
    circle = find_trajectory(name, robot.coordinates)
    payloads = {}
    for speed in (1.0, 0.0, -1.0):
        run = iterate_load(robot, circle, guess=1.0, corrected=True, line_speed=speed)
        true = exact_payload(robot, circle, frequency=500.0, line_speed=speed)
        assert run.converged
        assert run.payload == pytest.approx(true.payload, abs=2e-6)
        assert (run.motor, run.time) == (true.motor, pytest.approx(true.time))
        payloads[speed] = run.payload
    assert min(abs(payloads[speed] - payloads[1.0]) for speed in (0.0, -1.0)) > 0.1


# --- the scan of geometries -------------------------------------------------------------------------------------------

MEASURES = {
    "half side": lambda corners: np.linalg.norm(corners[1] - corners[0]) / 2,
    "circumradius": lambda corners: np.linalg.norm(corners[0] - corners.mean(axis=0)),
    "inradius": lambda corners: np.linalg.norm((corners[0] + corners[1]) / 2 - corners.mean(axis=0)),
    "half altitude": lambda corners: np.linalg.norm((corners[0] + corners[1]) / 2 - corners[2]) / 2,
}
"""What "half of the triangle" can measure, on corners (3, 3)."""


@pytest.fixture
def narrow(monkeypatch):
    """A scan of few geometries."""

    def narrowed(*, base_turn=0.0, platform_turn=0.0, sizes=("half side",)):
        monkeypatch.setattr(scan, "BASE_TURNS", np.array([base_turn]))
        monkeypatch.setattr(scan, "PLATFORM_TURNS", np.array([platform_turn]))
        monkeypatch.setattr(scan, "SIZES", {size: scan.SIZES[size] for size in sizes})

    return narrowed


@pytest.mark.parametrize(("line", "payload"), [("physical", 1.802), ("flat", 2.345)])
def test_scan_has_the_robot_of_the_default_readings(narrow, line, payload):
    interpretation = Interpretation(line=line)
    narrow()
    (found,) = scan.geometries(interpretation=interpretation, base_size="half side")
    limit = exact_limit(interpretation, interpretation.spatial("payload"))
    assert found.payload == pytest.approx(limit.payload, abs=0.01)
    assert found.payload == pytest.approx(payload, abs=0.01)
    assert found.motor == limit.motor


@pytest.mark.parametrize("line", ["physical", "flat"])
def test_scan_has_the_robot_of_other_sizes_and_turns(narrow, line):
    interpretation = Interpretation(line=line, sides="circumradius", triangles="turned")
    narrow(base_turn=np.pi, sizes=("half side", "circumradius"))
    other, found = scan.geometries(interpretation=interpretation, base_size="circumradius")
    limit = exact_limit(interpretation, interpretation.spatial("payload"))
    assert found.payload == pytest.approx(limit.payload, abs=0.01)
    assert found.motor == limit.motor
    assert abs(other.payload - limit.payload) > 0.02


@pytest.mark.parametrize(("lowest", "payload"), [(0.5, -np.inf), (0.0, 1.0), (-10.0, 1.0)])
def test_platform_that_needs_ballast_carries_nothing_in_the_scan(narrow, monkeypatch, lowest, payload):
    narrow()
    limit = SimpleNamespace(payload=1.0, lowest=lowest, motor=3)
    monkeypatch.setattr(scan, "exact_payload", lambda *_, **__: limit)
    assert scan.geometries(interpretation=Interpretation(), base_size="half side") == [(payload, 3)]


@pytest.mark.parametrize("name", MEASURES)
def test_half_of_the_triangle_measures_as_published_whatever_it_is(name):
    for points, published in ((SPATIAL.base, 0.47), (SPATIAL.platform, 0.148)):
        corners = scan.SIZES[name] * np.unique(points.round(12), axis=0)
        assert corners.shape == (3, 3)
        assert MEASURES[name](corners) == pytest.approx(published)


def test_scan_measures_and_turns_each_triangle_by_itself(narrow, monkeypatch):
    seen = []

    def noted(robot, *_, **__):
        seen.append(robot)
        return SimpleNamespace(payload=1.0, lowest=0.0, motor=1)

    monkeypatch.setattr(scan, "exact_payload", noted)
    narrow(base_turn=0.2, platform_turn=0.1, sizes=MEASURES)
    for base_size in MEASURES:
        seen.clear()
        scan.geometries(interpretation=Interpretation(), base_size=base_size)
        assert len(seen) == len(MEASURES)
        for robot, platform_size in zip(seen, MEASURES, strict=True):
            for points, before, size, published, turn in (
                (robot.base, SPATIAL.base, base_size, 0.47, 0.2),
                (robot.platform, SPATIAL.platform, platform_size, 0.148, 0.3),
            ):
                assert MEASURES[size](points[::2]) == pytest.approx(published)
                angles = np.angle((points @ [1, 1j, 0]) / (before @ [1, 1j, 0]))
                assert angles == pytest.approx(turn)


# --- what the text claims ---------------------------------------------------------------------------------------------


def released(stiffness, damping):
    """What is recorded of a loop let go 1 mm beside a reference, on ë + K_D ė + K_P e = 0."""
    time = np.arange(5001) / 10_000
    decay, root = damping / 2, np.sqrt(complex(damping**2 / 4 - stiffness))
    error = 1e-3 * np.exp(-decay * time) * np.real(np.cosh(root * time) + decay / root * np.sinh(root * time))
    reference = np.broadcast_to([0.3, -0.2], (len(time), 2))
    pose = reference + np.stack([error, np.zeros_like(error)], axis=1)
    return SimpleNamespace(arrays={"time": time, "pose": pose, "reference_pose": reference})


@pytest.mark.parametrize("gains", [(2000.0, 10.0), (30.0, 20.0)])
def test_decay_error_is_zero_for_the_poles_alone(gains):
    stiffness, damping = gains
    assert laws.decay_error(released(stiffness, damping), gains) < 1e-9
    assert laws.decay_error(released(stiffness, 2 * damping), gains) > 0.05
    assert laws.decay_error(released(2 * stiffness, damping), gains) > 0.05


def test_only_a_minimum_tension_takes_torques_from_being_affine_in_the_mass():
    assert laws.affinity(robot=PLANAR, minimum_tension=5.0) > 0.01
    assert laws.affinity(robot=PLANAR, minimum_tension=0.0) < 1e-9
    assert laws.affinity(robot=SPATIAL, minimum_tension=5.0) < 1e-9


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL])
def test_open_loop_takes_from_the_robot_its_speed_alone(robot):
    rng = np.random.default_rng(3)
    n, mass = robot.coordinates, np.full(4, robot.mass + 0.3)
    reference = robot.home + 0.02 * rng.standard_normal((4, n))
    part = {
        "pose": reference,
        "velocity": 0.1 * rng.standard_normal((4, n)),
        "reference_pose": reference,
        "reference_velocity": 0.1 * rng.standard_normal((4, n)),
        "reference_acceleration": rng.standard_normal((4, n)),
    }
    law = FeedForward(robot, minimum_tension=2.0)
    state = [part[f"reference_{name}"] for name in ("pose", "velocity", "acceleration")]
    tensions = textbook.required_tensions(robot, mass, *state, minimum=2.0)
    needed = textbook.required_torques(robot, tensions, *state)
    moved = part | {"pose": part["pose"] + 0.01, "velocity": part["velocity"] - 0.2}
    for each in (part, moved):
        torques, speeds = law.torques(each, mass)
        assert torques == pytest.approx(needed, rel=1e-9)
        assert speeds == pytest.approx(textbook.pulley_speed(robot, each["pose"], each["velocity"]), rel=1e-9)
    assert not np.allclose(law.torques(part, mass)[1], law.torques(moved, mass)[1], rtol=1e-2)


# --- which states the motors reach ------------------------------------------------------------------------------------


def linear_plant(robot):
    """A and B of (X, Ẋ, β′, β̇′) about rest at home, from Eqs. 3 and 4 in numpy."""
    n, m = robot.coordinates, robot.cables
    rest = np.concatenate([robot.home, textbook.static_motor_angle(robot, robot.mass, robot.home)])

    def accelerations(place):
        pose, angle = place[:n], place[n:]
        structure = textbook.jacobian(robot, pose)
        twist = robot.stiffness * (angle - textbook.pulley_angle(robot, pose))
        pulleys = structure.T @ np.diag(robot.pulley_inertia / robot.pulley_radius**2) @ structure
        load = textbook.bias(robot, robot.mass, pose, np.zeros(n)) + structure.T @ (twist / robot.pulley_radius)
        platform = np.linalg.solve(textbook.mass_matrix(robot, robot.mass, pose) + pulleys, -load)
        return np.concatenate([platform, -twist / robot.motor_inertia])

    assert accelerations(rest)[:n] == pytest.approx(0.0, abs=1e-9)
    step = 1e-6 * np.eye(n + m)
    slope = np.stack([accelerations(rest + one) - accelerations(rest - one) for one in step], axis=1) / 2e-6
    zero, one = np.zeros((n + m, n + m)), np.eye(n + m)
    drive = np.concatenate([np.zeros((n + m + n, m)), np.diag(1 / robot.motor_inertia)])
    return np.block([[zero, one], [slope, zero]]), drive  # in the order (X, β′, Ẋ, β̇′)


def unreached(transition, drive):
    """How many modes no input meets, by Popov, Belevitch and Hautus: [A − λ, B] has lost that much of its rank."""
    size = len(transition)
    lost = 0
    for value in np.linalg.eigvals(transition):
        rank = np.linalg.matrix_rank(np.hstack([transition - value * np.eye(size), drive]), rtol=1e-9)
        lost = max(lost, size - int(rank))
    return lost


@pytest.mark.parametrize("source", ["control", "payload"])
def test_motors_reach_all_states_of_the_robot_with_joint_springs(source):
    robot = Interpretation().flexible(source)
    transition, drive = linear_plant(robot)
    assert unreached(transition, drive) == 0
    assert unreached(transition, drive.sum(axis=1, keepdims=True)) > 0  # one command for all lifts it, and no more
    assert linearised.controllable_states(robot) == len(transition) == 24


@pytest.mark.parametrize("inputs", [5, 3])
def test_fewer_motors_of_their_own_reach_fewer_states_in_four_samples(monkeypatch, inputs):
    """Motors that obey some common commands alone: [B, AB, A²B, A³B] has four columns for each."""
    mixing = np.random.default_rng(1).standard_normal((6, inputs))
    common = mixing @ np.linalg.pinv(mixing)

    class Shared(linearised.Plant):
        def set_action(self, action):
            nominal = action.mean(axis=0)
            super().set_action(nominal + (action - nominal) @ common)

    monkeypatch.setattr(linearised, "Plant", Shared)
    assert linearised.controllable_states(Interpretation().flexible("control")) == 4 * inputs


# --- the engine -------------------------------------------------------------------------------------------------------


def one_cell(*, mark):
    return mark


def another_cell(*, env_id, mark):
    return mark


def small_part(name, mark):
    return Part(
        name=name,
        title=name,
        text="Words.",
        cells=lambda _: {"a": partial(one_cell, mark=mark)},
        outcome=lambda _, found: Outcome(numbers={"mark": found["a"]}),
    )


def test_results_of_other_versions_are_not_kept(tmp_path, monkeypatch):
    def interrupt(last, done, expected):
        if done == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(engine, "PARTS", (small_part("one", 1), small_part("two", 2)))
    reproduce(Interpretation(), tmp_path, workers=1)
    monkeypatch.setattr(engine, "versions", lambda: {"python": "other"})
    with pytest.raises(KeyboardInterrupt):
        reproduce(Interpretation(), tmp_path, workers=1, progress=interrupt)
    results = json.loads((tmp_path / RESULTS).read_text())
    assert results["versions"] == {"python": "other"}
    assert results["numbers"] == {"one.mark": 1}
    assert results["missing"] == ["two"]


def test_one_cell_of_each_kind_and_environment_comes_first_and_every_cell_once():
    cells = {f"one {mark}": partial(one_cell, mark=mark) for mark in range(3)}
    for mark in range(3):
        for env_id in ("planar", "spatial"):
            cells[f"{env_id} {mark}"] = partial(another_cell, env_id=env_id, mark=mark)
    order = leaders_first(cells, engine._kind)
    assert sorted(order) == sorted(cells)
    assert order[:3] == ["one 0", "planar 0", "spatial 0"]
