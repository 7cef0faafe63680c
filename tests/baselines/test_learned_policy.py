"""A learned policy without its training: spline, memory, features, network, and the bundle that it is kept in."""

from __future__ import annotations

import dataclasses
import json
import shutil
import subprocess
import sys
import zipfile
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest

from cablebot_baselines.learned import load_bundle
from cablebot_baselines.learned.base import Base, find_base
from cablebot_baselines.learned.bundle import FORMAT, Bundle, is_bundle
from cablebot_baselines.learned.features import RBF_COUNT, TIME_CONSTANTS, check_features
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.steering import (
    DERIVATIVES,
    Residual,
    Shift,
    Steering,
    action_mapping_to_jsonable,
    find_action_mapping,
)
from cablebot_gym import ENV_IDS
from cablebot_gym.benchmark.cells import PolicyCell, compute
from cablebot_gym.benchmark.suites import find_policies
from cablebot_gym.cli import app as cli
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.observation import PREVIEWS, observation_layout, preview_name
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, find_robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils import code_hash

PLANAR_ID, SPATIAL_ID, FLEX_PLANAR_ID, FLEX_SPATIAL_ID = ENV_IDS
HANG = {"name": "dwell-planar", "duration": 0.05}
FREQUENCY, PERIOD = 500.0, 1 / 500
SHIFTED = (
    "pose",
    "shift",
    "shift_velocity",
    "actions",
    "error",
    "time_since_start",
    "time_to_go_decays",
    "rbf_time",
    "model_payload",
)
DIRECT = ("pose", "velocity", "actions", "error", "time_since_start", "reference_acceleration")

CASES = {
    "planar shift": (PLANAR_ID, Base(gains=(2000.0, 90.0)), Shift(action_period=0.02), SHIFTED),
    "preview": (
        SPATIAL_ID,
        Base(estimates_payload=True, allocates=True),
        Shift(action_period=0.014, degree=4, preview=0.1, fraction=0.5),
        SHIFTED,
    ),
    "springs": (FLEX_PLANAR_ID, Base(law="motor-pd"), Shift(action_period=0.01, degree=5), SHIFTED),
    "residual": (SPATIAL_ID, Base(), Residual(action_period=0.006), DIRECT),
    "residual, springs": (FLEX_SPATIAL_ID, Base(law="composite", estimates_payload=True), Residual(), DIRECT),
}
"""Environment, law, way to steer and features."""

each_case = pytest.mark.parametrize("case", CASES)
each_degree = pytest.mark.parametrize("degree", [2, 3, 4, 5])


def steering_of(env_id=PLANAR_ID, base=None, action_mapping=None, features=SHIFTED):
    robot = find_robot(env_robot(env_id))
    return Steering(robot, base=base or Base(), action_mapping=action_mapping or Shift(), features=features)


def network_of(steering, *, scale=1.0, hidden=(8,), seed=1):
    """Random, or with a scale of 0 one that says nothing."""
    draw, sizes = np.random.default_rng(seed), (steering.inputs, *hidden, steering.actions)
    pairs = list(pairwise(sizes))
    return Network(
        mean=draw.normal(size=steering.inputs),
        scale=draw.uniform(0.5, 2.0, steering.inputs),
        weights=tuple(scale * draw.normal(size=(after, before)) for before, after in pairs),
        biases=tuple(scale * draw.normal(size=after) for _, after in pairs),
    )


def bundle_of(case="planar shift", **network):
    env_id, base, action_mapping, features = CASES[case]
    steering = steering_of(env_id, base, action_mapping, features)
    made = network_of(steering, **network)
    return Bundle(
        env_id=env_id,
        base=base,
        action_mapping=action_mapping,
        features=features,
        network=made,
        card={"seed": 1, "note": "é"},
    )


@pytest.fixture
def saved(tmp_path):
    """The planar bundle in a file."""
    path = tmp_path / "bundle.zip"
    bundle_of().save(path)
    return path


def observations(env_id, steps, lanes=4):
    """Those of the law ``fl`` or ``motor-pd`` at work on different payloads, (steps, lanes, size), and the tasks."""
    env = gym.make_vec(env_id, num_envs=lanes)
    observation, _ = env.reset(seed=3, options={"payload": np.linspace(0.0, 1.5, lanes)})
    policy, seen = load_policy("motor-pd" if "Flex" in env_id else "fl", find_robot(env_robot(env_id))), []
    for _ in range(steps):
        seen.append(observation.copy())
        observation, *_ = env.step(policy.predict(observation)[0])
    return np.array(seen), env.unwrapped.tasks


def run(policy, seen, starts=None):
    """Commands of a policy that sees (steps, …, size); ``starts`` (steps, …) where episodes begin besides the first."""
    state, given = None, []
    for step, observation in enumerate(seen):
        command, state = policy.predict(observation, state, None if starts is None else starts[step])
        given.append(command)
    return np.array(given)


class Told:
    """In place of a law: keeps the blocks that it is given."""

    def __init__(self, steering):
        self.parts, self._law = [], steering.law
        steering.law = self

    def split(self, observation):
        return self._law.split(observation)

    def reset(self, tasks):
        self._law.reset(tasks)

    def respond(self, blocks, state=None, episode_start=None):
        self.parts.append(blocks)
        return np.zeros((*blocks["pose"].shape[:-1], 6)), None

    def given(self, name):
        """One block at each step, (steps, …, n)."""
        return np.array([blocks[name] for blocks in self.parts])


def line(robot, start, speed, times):
    """Observations (steps, size) of a reference that moves evenly."""
    layout = observation_layout(robot)
    seen = np.zeros((len(times), layout.size))
    blocks = layout.split(seen)
    blocks["reference_pose"][:] = start + speed * np.asarray(times)[:, None]
    blocks["reference_velocity"][:] = speed
    for ahead in PREVIEWS:
        blocks[preview_name(ahead)][:] = speed * ahead
    return seen


def driven(steering, seen, actions):
    """What the law is told, and what a learner sees at each step, while actions (steps, size) are taken."""
    told, memory, learner = Told(steering), None, []
    for observation, action in zip(seen, actions, strict=True):
        blocks = steering.split(observation)
        memory = steering.reset_memory(blocks, memory, None)
        learner.append(steering.observe(blocks, memory))
        _, memory = steering.respond(blocks, action, memory)
    return told, np.array(learner)


# --- the spline -------------------------------------------------------------------------------------------------------


def test_pieces_of_the_spline_are_not_in_another_order_than_oldest_first():
    u = np.linspace(0.0, 1.0, 11)
    cubic = [(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]
    square = [(1 - u) ** 2, -2 * u**2 + 2 * u + 1, u**2]
    for shift, factor, expected in ((Shift(), 6, cubic), (Shift(degree=2), 2, square)):
        weights = shift.weights(0.04 * u, 0.04)
        assert weights.shape == (11, 5, shift.degree + 1)
        np.testing.assert_allclose(weights[:, 0], np.transpose(expected) / factor, atol=1e-14)


@each_degree
def test_weights_are_nowhere_without_a_sum_of_one(degree):
    weights = Shift(degree=degree).weights(np.linspace(0.0, 0.03, 31), 0.03)
    np.testing.assert_allclose(weights[:, 0].sum(axis=-1), 1.0, atol=1e-14)
    assert weights[:, 0].min() >= 0
    size = np.abs(weights[:, 1:]).max(axis=(0, 2))[:, None]
    assert (np.abs(weights[:, 1:].sum(axis=-1)).T / np.maximum(size, 1.0)).max() <= 1e-12


@each_degree
def test_derivatives_are_not_scaled_by_another_power_of_the_hold(degree):
    action_period, step = 0.03, 1e-6
    shift, times = Shift(degree=degree), np.linspace(0.002, 0.028, 7)
    before, now, after = (shift.weights(times + change, action_period) for change in (-step, 0.0, step))
    for order in range(4):
        slope = (after[:, order] - before[:, order]) / (2 * step)
        np.testing.assert_allclose(
            now[:, order + 1], slope, atol=1e-5 * max(np.abs(slope).max(), action_period**-order)
        )
    assert np.any(now[:, min(degree, 4)] != 0)
    assert not np.any(now[:, degree + 1 :])


@each_degree
def test_spline_does_not_jump_at_its_knots(degree):
    shift, action_period = Shift(degree=degree), 0.03
    first, last = shift.weights(np.array([0.0, action_period]), action_period)
    for order in range(min(degree, 5)):
        size = action_period**-order
        np.testing.assert_allclose(last[order, 1:], first[order, :-1], atol=1e-9 * size)
        np.testing.assert_allclose([last[order, 0], first[order, -1]], 0.0, atol=1e-9 * size)


@pytest.mark.parametrize("env_id", [PLANAR_ID, SPATIAL_ID])
def test_no_actions_lead_out_of_the_tube(env_id):
    steering = steering_of(env_id, action_mapping=Shift(action_period=0.006, fraction=0.95))
    error_bounds = ErrorBounds(position=0.02, rotation=0.03)
    steering.reset(tasks_of(env_id, error_bounds=error_bounds))
    n = steering.robot.coordinates
    actions = 3 * np.sign(np.random.default_rng(0).normal(size=(600, n)))
    actions[300:] = 3.0  # all to one corner
    told, _ = driven(steering, np.zeros((600, observation_layout(steering.robot).size)), actions)
    shift = told.given("reference_pose")
    away = np.linalg.norm(shift[:, :3], axis=1)
    assert away.max() <= 0.95 * 0.02 * (1 + 1e-12)
    assert away[-1] == pytest.approx(0.95 * 0.02)
    if n > 3:
        assert np.abs(shift[:, 3:]).max() == pytest.approx(0.95 * 0.03)


def tasks_of(env_id, **keywords):
    env = gym.make_vec(env_id, num_envs=2, **keywords)
    env.reset(seed=0)
    return env.unwrapped.tasks


@pytest.mark.parametrize(("degree", "preview"), [(2, 0.02), (3, 0.05), (4, 0.1), (5, 0.2), (3, 0.2)])
def test_reference_that_rests_is_not_moved_by_a_lead(degree, preview):
    steering = steering_of(SPATIAL_ID, action_mapping=Shift(action_period=0.02, degree=degree, preview=preview))
    start = np.array([0.3, -0.2, 0.1, 0.05, -0.02, 0.01])
    seen = line(SPATIAL, start, np.zeros(6), np.arange(90) * PERIOD)
    told, _ = driven(steering, seen, np.zeros((90, 6)))
    np.testing.assert_allclose(told.given("reference_pose"), np.tile(start, (90, 1)), atol=1e-15)
    np.testing.assert_allclose(told.given("reference_velocity"), 0.0, atol=1e-13)
    np.testing.assert_allclose(told.given("reference_acceleration"), 0.0, atol=1e-10)


@pytest.mark.parametrize(("degree", "preview"), [(2, 0.02), (3, 0.05), (4, 0.1), (5, 0.2), (4, 0.05)])
def test_even_motion_comes_out_of_a_lead_later_by_no_more_than_the_spline_takes(degree, preview):
    """Σⱼ j B(u − j) = u − (degree + 1)/2: a sample counts (degree + 1)/2 holds after it was taken, lead ahead."""
    action_period, steps = 0.02, 120
    steering = steering_of(
        FLEX_SPATIAL_ID,
        base=Base(law="composite"),
        action_mapping=Shift(action_period=action_period, degree=degree, preview=preview),
    )
    start, speed = np.array([0.3, -0.2, 0.1, 0.05, -0.02, 0.01]), np.array([1.0, -2.0, 0.5, 0.1, 0.2, -0.3])
    times = np.arange(steps) * PERIOD
    told, _ = driven(steering, line(FLEX_SPATIAL, start, speed, times), np.zeros((steps, 6)))
    inside = slice(round(degree * action_period / PERIOD), None)
    expected = start + speed * (times[inside, None] + preview - (degree + 1) / 2 * action_period)
    np.testing.assert_allclose(told.given("reference_pose")[inside], expected, atol=1e-14)
    np.testing.assert_allclose(told.given("reference_velocity")[inside], np.tile(speed, (len(expected), 1)), atol=1e-12)
    for order, name in enumerate(DERIVATIVES[2:], start=2):
        np.testing.assert_allclose(told.given(f"reference_{name}")[inside], 0.0, atol=1e-12 / action_period**order)


@pytest.mark.parametrize("preview", [0.0, 0.05])
@each_degree
def test_acceleration_is_not_another_than_what_the_velocity_does_within_a_period(degree, preview):
    steering, steps = (
        steering_of(SPATIAL_ID, action_mapping=Shift(action_period=0.01, degree=degree, preview=preview)),
        60,
    )
    actions = np.random.default_rng(degree).uniform(-1, 1, (steps, 6))
    rest = line(SPATIAL, np.zeros(6), np.zeros(6), np.arange(steps))
    told, _ = driven(steering, rest, actions)
    velocity = told.given("reference_velocity")
    mean = np.diff(velocity, axis=0) / PERIOD
    np.testing.assert_allclose(told.given("reference_acceleration")[:-1], mean, atol=1e-9)
    assert np.abs(mean).max() > 1


def test_springs_are_told_the_acceleration_of_the_instant_to_snap():
    action_mapping, steps = Shift(action_period=0.01, degree=5), 40
    steering = steering_of(FLEX_PLANAR_ID, base=Base(law="motor-pd"), action_mapping=action_mapping)
    actions = np.random.default_rng(0).uniform(-0.6, 0.6, (steps, 2))
    seen = line(FLEX_PLANAR, np.zeros(2), np.zeros(2), np.arange(steps))
    observation_layout(FLEX_PLANAR).split(seen)["reference_snap"][:] = 7.0
    told, _ = driven(steering, seen, actions)
    points = np.concatenate([np.zeros((5, 2)), actions[::5]]) * action_mapping.bounds(ErrorBounds(), 2)
    expected = [
        action_mapping.weights(np.array(step % 5 * PERIOD), 0.01) @ points[step // 5 : step // 5 + 6]
        for step in range(steps)
    ]
    for order, name in enumerate(DERIVATIVES):
        own = 7.0 if name == "snap" else 0.0
        np.testing.assert_allclose(
            told.given(f"reference_{name}"), np.array(expected)[:, order] + own, rtol=1e-9, atol=1e-9 / 0.01**order
        )


def test_action_does_not_count_between_decisions():
    steering, steps = steering_of(action_mapping=Shift(action_period=0.01)), 30
    actions = np.random.default_rng(0).uniform(-0.5, 0.5, (steps, 2))
    other = actions + 0.3
    other[::5] = actions[::5]
    seen = np.zeros((steps, 21))
    one, _ = driven(steering_of(action_mapping=Shift(action_period=0.01)), seen, actions)
    two, _ = driven(steering, seen, other)
    assert steering.periods == 5
    np.testing.assert_array_equal(one.given("reference_pose"), two.given("reference_pose"))


@pytest.mark.parametrize(
    ("action_period", "frequency", "periods"), [(0.04, 500.0, 20), (0.04, 120.0, 5), (0.001, 500.0, 1)]
)
def test_hold_is_not_counted_in_periods_of_another_frequency(action_period, frequency, periods):
    steering = steering_of(action_mapping=Shift(action_period=action_period))
    steering.reset(tasks_of(PLANAR_ID, control_frequency=frequency))
    assert steering.periods == periods


def test_residual_is_not_added_beyond_its_share_nor_from_another_action():
    action_mapping = Residual(action_period=0.006, fraction=0.25)
    steering = steering_of(SPATIAL_ID, action_mapping=action_mapping, features=DIRECT)
    seen, _ = observations(SPATIAL_ID, 9, lanes=1)
    law, memory = Base().make(SPATIAL), None
    actions = np.random.default_rng(0).uniform(-2, 2, (9, 6))
    for step, observation in enumerate(seen[:, 0]):
        blocks = steering.split(observation)
        memory = steering.reset_memory(blocks, memory, None)
        command, memory = steering.respond(blocks, actions[step], memory)
        added = command - law.predict(observation)[0]
        np.testing.assert_allclose(added, 0.25 * np.clip(actions[step // 3 * 3], -1, 1), atol=1e-12)


# --- what a learner sees ----------------------------------------------------------------------------------------------


def column(steering, name):
    """Where a feature stands in what is seen of this steering."""
    before = [steering_of_features(steering, steering.features[:place]) for place in range(len(steering.features) + 1)]
    place = steering.features.index(name)
    return slice(before[place], before[place + 1])


def steering_of_features(steering, features):
    if not features:
        return 0
    return Steering(
        steering.robot, base=steering.base, action_mapping=steering.action_mapping, features=features
    ).inputs


@pytest.mark.parametrize("preview", [0.0, 0.05])
@each_degree
def test_shift_that_is_seen_is_not_that_of_another_instant(degree, preview):
    action_mapping, steps = Shift(action_period=0.01, degree=degree, preview=preview), 60
    steering = steering_of(
        SPATIAL_ID, action_mapping=action_mapping, features=("error", "shift", "actions", "shift_velocity")
    )
    actions = np.random.default_rng(degree).uniform(-0.5, 0.5, (steps, 6))
    seen = line(SPATIAL, np.full(6, 0.1), np.linspace(-1, 1, 6), np.arange(steps) * PERIOD)
    layout = observation_layout(SPATIAL)
    layout.split(seen)["pose"][:] = np.random.default_rng(0).normal(size=(steps, 6))
    told, learner = driven(steering, seen, actions)
    bounds, blocks = action_mapping.bounds(ErrorBounds(), 6), layout.split(seen)
    shift = told.given("reference_pose") - blocks["reference_pose"]
    rate = told.given("reference_velocity") - blocks["reference_velocity"]
    np.testing.assert_allclose(learner[:, column(steering, "shift")] * bounds, shift, atol=1e-13)
    np.testing.assert_allclose(learner[:, column(steering, "shift_velocity")] * bounds / 0.01, rate, atol=1e-11)
    error = told.given("reference_pose") - blocks["pose"]
    np.testing.assert_allclose(learner[:, column(steering, "error")], error, atol=1e-13)
    taken = actions[::5].copy()
    taken[:, :3] /= np.maximum(np.linalg.norm(taken[:, :3], axis=1, keepdims=True), 1)
    points = np.concatenate([np.zeros((degree, 6)), taken])
    for decision in range(steps // 5):
        expected = points[decision : decision + degree].ravel()
        np.testing.assert_allclose(learner[5 * decision, column(steering, "actions")], expected, atol=1e-15)


def test_clocks_do_not_start_at_another_time_than_the_episode():
    steering = steering_of(
        features=("time_since_start", "rbf_time", "time_to_go_decays"), action_mapping=Shift(action_period=0.02)
    )
    assert steering.inputs == 2 * len(TIME_CONSTANTS) + RBF_COUNT
    seen = np.zeros((30, 21))
    observation_layout(PLANAR).split(seen)["time_to_go"][:, 0] = 1.0 - np.arange(30) * PERIOD
    _, learner = driven(steering, seen, np.zeros((30, 2)))
    times = np.arange(30)[:, None] * PERIOD
    np.testing.assert_allclose(learner[:, : len(TIME_CONSTANTS)], np.exp(-times / TIME_CONSTANTS), rtol=1e-12)
    np.testing.assert_allclose(learner[:, -len(TIME_CONSTANTS) :], np.exp(-(1.0 - times) / TIME_CONSTANTS), rtol=1e-12)
    assert np.argmax(learner[0, len(TIME_CONSTANTS) : -len(TIME_CONSTANTS)]) == 0


# --- the policy -------------------------------------------------------------------------------------------------------


@each_case
def test_lanes_of_a_batch_do_not_know_of_each_other(case):
    bundle, steps, lanes = bundle_of(case), 50, 4
    seen, tasks = observations(bundle.env_id, steps, lanes)
    starts = np.zeros((steps, lanes), bool)
    for lane, begun in enumerate((0, 7, 23, 38)):
        starts[begun, lane] = True
    policy = LearnedPolicy(bundle, find_robot(env_robot(bundle.env_id)))
    policy.reset(tasks)
    together = run(policy, seen, starts)
    alone = np.stack([run(policy, seen[:, lane], starts[:, lane]) for lane in range(lanes)], axis=1)
    np.testing.assert_allclose(together, alone, rtol=0, atol=1e-9 * np.abs(alone).max())
    for lane, begun in enumerate((0, 7, 23, 38)):
        fresh = run(policy, seen[begun:, lane])
        np.testing.assert_allclose(together[begun:, lane], fresh, rtol=0, atol=1e-9 * np.abs(alone).max())
    assert np.ptp(together, axis=1).max() > 0.01


@each_case
def test_prediction_depends_neither_on_chance_nor_on_the_order_of_the_batch(case):
    bundle = bundle_of(case)
    seen, tasks = observations(bundle.env_id, 40)
    policy = LearnedPolicy(bundle, find_robot(env_robot(bundle.env_id)))
    policy.reset(tasks)
    first = run(policy, seen)
    np.testing.assert_array_equal(run(policy, seen), first)
    order = [2, 0, 3, 3, 1, 0, 2]
    np.testing.assert_allclose(run(policy, seen[:, order]), first[:, order], rtol=0, atol=1e-9 * np.abs(first).max())


@pytest.mark.parametrize("case", [case for case in CASES if not getattr(CASES[case][2], "preview", 0)])
def test_network_that_says_nothing_leaves_the_law_as_it_is(case):
    bundle = bundle_of(case, scale=0.0)
    robot = find_robot(env_robot(bundle.env_id))
    seen, tasks = observations(bundle.env_id, 30)
    policy, law = LearnedPolicy(bundle, robot), bundle.base.make(robot)
    policy.reset(tasks)
    law.reset(tasks)
    np.testing.assert_array_equal(run(policy, seen), run(law, seen))
    assert np.any(run(LearnedPolicy(bundle_of(case), robot), seen) != run(law, seen))


def test_policy_does_not_claim_that_its_commands_are_not_clipped():
    assert LearnedPolicy(bundle_of("residual"), SPATIAL).unsaturated_actions is False


def test_episodes_under_different_conditions_are_not_run_at_once():
    policy = LearnedPolicy(bundle_of(), PLANAR)
    tasks = [*tasks_of(PLANAR_ID), *tasks_of(PLANAR_ID, error_bounds=ErrorBounds(position=0.02))]
    with pytest.raises(ValueError, match="same error bounds and control frequency"):
        policy.reset(tasks)


def test_episodes_of_another_robot_are_not_begun():
    policy = LearnedPolicy(bundle_of(), PLANAR)
    policy.reset(tasks_of(PLANAR_ID, robot=PLANAR.replace(mass=1.1, name="heavier")))
    wide = PLANAR.replace(base_anchors=1.01 * PLANAR.base, name="wide")
    with pytest.raises(ValueError, match=r"'wide' has other anchors. Build the law from the task's robot"):
        policy.reset(tasks_of(PLANAR_ID, robot=wide))


# --- the file ---------------------------------------------------------------------------------------------------------


@each_case
def test_nothing_is_lost_in_a_file(case, tmp_path):
    bundle, path = bundle_of(case), tmp_path / "made" / "bundle.zip"
    bundle.save(path)
    loaded = Bundle.load(path)
    for name in ("env_id", "base", "action_mapping", "features", "card"):
        assert getattr(loaded, name) == getattr(bundle, name)
    robot = find_robot(env_robot(bundle.env_id))
    seen, _ = observations(bundle.env_id, 20)
    np.testing.assert_array_equal(
        run(LearnedPolicy(loaded, robot), seen), run(LearnedPolicy(bundle, robot), seen), strict=True
    )
    loaded.save(tmp_path / "again.zip")
    assert (tmp_path / "again.zip").read_bytes() == path.read_bytes()


def test_weights_of_single_precision_are_not_rounded_in_a_file(tmp_path):
    bundle = bundle_of()
    network = bundle.network
    single = dataclasses.replace(
        network,
        weights=tuple(values.astype(np.float32) for values in network.weights),
        biases=tuple(values.astype(np.float32) for values in network.biases),
    )
    path = tmp_path / "bundle.zip"
    dataclasses.replace(bundle, network=single).save(path)
    for one, other in zip(Bundle.load(path).network.weights, single.weights, strict=True):
        np.testing.assert_array_equal(one, other)


def test_name_of_a_bundle_is_a_policy_of_its_own_robot(saved):
    policy = load_policy(str(saved), PLANAR)
    assert isinstance(policy, LearnedPolicy)
    assert policy.robot is PLANAR
    other = PLANAR.replace(mass=1.2, name="heavier")
    assert load_policy(str(saved), other).robot is other


def test_file_of_another_kind_is_no_bundle(tmp_path):
    path = tmp_path / "other.zip"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("data", "{}")
    assert not is_bundle(path)
    assert load_bundle(path, PLANAR) is None
    assert not is_bundle(tmp_path / "missing.zip")
    path.write_bytes(b"no zip")
    assert not is_bundle(path)


def test_bundle_does_not_need_what_trained_it(saved):
    code = f"""
import sys
sys.modules["torch"] = sys.modules["stable_baselines3"] = sys.modules["sb3_contrib"] = None
import gymnasium as gym
import cablebot_gym
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import PLANAR
policy = load_policy({str(saved)!r}, PLANAR)
observation, _ = gym.make("CableBot-Planar-v0").reset(seed=0)
print(*policy.predict(observation)[0])
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr
    observation, _ = gym.make(PLANAR_ID).reset(seed=0)
    expected = load_policy(str(saved), PLANAR).predict(observation)[0]
    np.testing.assert_array_equal([float(word) for word in ended.stdout.split()], expected)


@pytest.mark.parametrize("env_id", [SPATIAL_ID, FLEX_PLANAR_ID])
def test_robot_of_another_layout_is_not_refused_without_both(saved, env_id):
    robot = find_robot(env_robot(env_id))
    with pytest.raises(ValueError, match="evaluate it on the environment that it was trained on") as caught:
        load_policy(str(saved), robot)
    text = str(caught.value)
    assert "\n" not in text
    assert f"trained on {PLANAR_ID} with observation (pose 2, velocity 2, time_to_go 1, " in text
    assert f"robot {robot.name!r} has (pose {robot.coordinates}, velocity {robot.coordinates}, " in text


def test_observation_that_has_changed_since_is_not_taken_for_the_one_trained_on(saved):
    def older(data):
        data["observation"] = [block for block in data["observation"] if block[0] != "time_to_go"]

    rewrite(saved, change=older)
    with pytest.raises(
        ValueError, match=r"with observation \(pose 2, velocity 2, reference_pose 2, .* but its environment has"
    ):
        Bundle.load(saved)


# --- damage -----------------------------------------------------------------------------------------------------------


def rewrite(path, *, change=lambda data: None, arrays=lambda arrays: None, save=np.savez_compressed):
    """Changes the description, the arrays or both of a bundle in place."""
    with np.load(path) as file:
        content = {name: file[name] for name in file.files}
    data = json.loads(str(content["bundle"]))
    change(data)
    content["bundle"] = np.array(json.dumps(data))
    arrays(content)
    with path.open("wb") as file:
        save(file, **content)


def put(**items):
    return lambda data: data.update(items)


def inside(name, **items):
    return lambda data: data[name].update(items)


def drop(name):
    return lambda data: data.pop(name)


def nan(content):
    content["weight0"][0, 0] = np.nan


def hidden(content):
    content["weight1"] = content["weight1"][:, :-1]


def pickled(content):
    content["mean"] = np.array([print, 1], dtype=object)


def narrow(content):
    content["weight0"], content["mean"] = content["weight0"][:, :-2], content["mean"][:-2]
    content["scale"] = content["scale"][:-2]


def short(content):
    content["weight1"], content["bias1"] = content["weight1"][:-1], content["bias1"][:-1]


DESCRIPTIONS = {
    "no env_id": (drop("env_id"), "'env_id' is missing"),
    "no base": (drop("base"), "'base' is missing"),
    "no format": (drop("format"), "'format' is missing"),
    "newer": (put(format=FORMAT + 1), f"format {FORMAT + 1} is newer than {FORMAT}: upgrade"),
    "format of text": (put(format="1"), "its format must be a whole number from 1 to 1, not '1'"),
    "other id": (put(env_id="CableBot-Cubic-v0"), "choose one of CableBot-Planar-v0, "),
    "id of a list": (put(env_id=["CableBot-Planar-v0"]), "env_id must be the id of an environment"),
    "observation of text": (put(observation="all"), "its observation must be a list of pairs"),
    "unknown law": (inside("base", law="lqr"), "unknown base law 'lqr'; choose one of fl, "),
    "law of a list": (put(base=["fl"]), "base must be one of fl, "),
    "law of springs": (inside("base", law="composite"), "needs joint springs, but robot 'planar' has none. Use fl"),
    "gains of text": (inside("base", gains="ab"), "gains must be two positive numbers"),
    "key of a law": (inside("base", gain=1), "base: unknown key 'gain'; it takes law, gains"),
    "kind of steering": (inside("steering", kind="push"), "unknown kind 'push'; choose one of shift, residual"),
    "hold of text": (
        inside("steering", action_period="0.04"),
        "action_period must be above 0 s and at most 10 s, not '0.04'",
    ),
    "endless hold": (inside("steering", action_period=1e300), "action_period must be above 0 s and at most 10 s"),
    "degree": (inside("steering", degree=3.0), "degree must be 2, 3, 4 or 5, not 3.0"),
    "unknown feature": (put(features=["payload"]), "unknown feature 'payload'; choose from pose, "),
    "features of text": (put(features="pose"), "features must be a list of names"),
    "no features": (put(features=[]), "features must be a list of names"),
    "other features": (put(features=["pose"]), "inputs, but its features have 2"),
    "card of text": (put(card="mine"), "the card must be a dict"),
}
"""What is wrong with the JSON, and what is said."""

ARRAYS = {
    "NaN": (nan, "numbers must be finite"),
    "hidden layer": (hidden, "shapes of the network's layers are inconsistent"),
    "pickled": (pickled, "Object arrays cannot be loaded when allow_pickle=False"),
    "complex": (lambda content: content.update(mean=content["mean"] + 1j), "'mean' is not an array of numbers"),
    "no scale": (drop("scale"), "'scale' is missing"),
    "no weights": (lambda content: [content.pop(name) for name in ("weight0", "weight1")], "'weight0' is missing"),
    "inputs": (narrow, " inputs, but its features have "),
    "outputs": (short, f"the network has 1 outputs, but an action on {PLANAR_ID} has 2"),
    "no JSON": (put(bundle=np.array("{")), "cannot be used: Expecting property name"),
    "list for JSON": (put(bundle=np.array("[]")), "its member 'bundle' is not a JSON object"),
    "one number": (put(mean=np.array(0.0)), "it is damaged (TypeError: len() of unsized object)"),
}


def truncated(path):
    path.write_bytes(path.read_bytes()[:-300])


def flipped(path):
    content = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as file:
        info = file.getinfo("weight0.npy")
    content[info.header_offset + 80] ^= 0xFF
    path.write_bytes(content)


BYTES = {
    "truncated": (truncated, "is not a zip file, or it is damaged"),
    "flipped": (flipped, "damaged"),
    "empty": (lambda path: path.write_bytes(b""), "is not a zip file, or it is damaged"),
    "text": (lambda path: path.write_text("fl"), "is not a zip file, or it is damaged"),
}

DAMAGE = {
    **{name: (lambda path, do=do: rewrite(path, change=do), says) for name, (do, says) in DESCRIPTIONS.items()},
    **{name: (lambda path, do=do: rewrite(path, arrays=do), says) for name, (do, says) in ARRAYS.items()},
    **BYTES,
}


@pytest.fixture
def cablebot(monkeypatch, capsys):
    """Runs the command in this process: exit status, output, errors."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["cablebot", *map(str, arguments)])
        status = 0
        try:
            cli.main()
        except SystemExit as ended:
            status = ended.code or 0
        out, err = capsys.readouterr()
        return status, out, err

    return run


@pytest.mark.parametrize("name", DAMAGE)
def test_damage_is_neither_a_traceback_nor_loaded(cablebot, saved, name):
    spoil, says = DAMAGE[name]
    spoil(saved)
    status, out, err = cablebot("dlcc", PLANAR_ID, "--policy", saved)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    assert err.startswith(f"cablebot: policy {'file' if name in BYTES else 'bundle'} '{saved}' ")
    assert says in err


def test_no_flipped_byte_is_an_obscure_error_or_another_policy(saved, tmp_path):
    whole, path = saved.read_bytes(), tmp_path / "flipped.zip"
    observation, _ = gym.make(PLANAR_ID).reset(seed=0)
    expected, refusals = load_policy(str(saved), PLANAR).predict(observation)[0], []
    places = range(0, len(whole), 61)
    for place in places:
        content = bytearray(whole)
        content[place] ^= 0xFF
        path.write_bytes(content)
        try:
            policy = load_policy(str(path), PLANAR)
        except ValueError as error:
            refusals.append(str(error))
        else:
            np.testing.assert_array_equal(policy.predict(observation)[0], expected)
    assert len(refusals) > 0.8 * len(places)
    assert all(text.startswith("policy ") and "\n" not in text for text in refusals)


def test_bundle_itself_does_not_leave_damage_to_its_caller(saved):
    for spoil in (truncated, flipped):
        shutil.copy(saved, copy := saved.with_name("copy.zip"))
        spoil(copy)
        with pytest.raises(ValueError, match=r"policy bundle '.*copy\.zip' cannot be used: "):
            Bundle.load(copy)
    with pytest.raises(ValueError, match="does not exist"):
        Bundle.load(saved.with_name("missing.zip"))


def test_array_that_is_read_in_part_is_not_taken_for_whole(saved):
    rewrite(saved, save=np.savez)
    content = saved.read_bytes()
    start = content.index(b"bias0.npy")
    saved.write_bytes(content[:start] + content[start:].replace(b"'<f8'", b"'<f4'", 1))
    with pytest.raises(ValueError, match=r"cannot be used: its member 'bias0\.npy' is damaged"):
        Bundle.load(saved)


def test_failed_save_does_not_leave_half_a_bundle(saved, monkeypatch):
    before = saved.read_bytes()
    monkeypatch.setattr("os.replace", lambda *paths: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError, match="full"):
        bundle_of(seed=2).save(saved)
    assert saved.read_bytes() == before
    assert list(saved.parent.iterdir()) == [saved]


# --- parameters -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "keywords", "message"),
    [
        *[
            (kind, {"action_period": action_period}, "action_period must be")
            for kind in (Shift, Residual)
            for action_period in (0, -1.0, np.inf, True, "1")
        ],
        *[(kind, {"action_period": np.nan}, "action_period must be") for kind in (Shift, Residual)],
        *[
            (kind, {"fraction": fraction}, "fraction must be")
            for kind in (Shift, Residual)
            for fraction in (0, 1.01, np.nan, None)
        ],
        *[(Shift, {"degree": degree}, "degree must be 2, 3, 4 or 5") for degree in (1, 6, 2.5, 3.0, "3", None)],
        *[(Shift, {"preview": preview}, "preview must be one of 0") for preview in (0.03, -0.05, False, "0.05", None)],
        (Base, {"law": "lqr"}, "unknown base law 'lqr'; choose one of fl, composite, motor-pd, fl4"),
        (Base, {"law": None}, "unknown base law None"),
        *[(Base, {"gains": gains}, "gains must be two") for gains in ((1.0,), (1, -1), (1, np.inf), 3, "ab", (1, "2"))],
        (Base, {"law": "fl4", "gains": (1.0, 1.0)}, "base law 'fl4' has no gains: leave it out, or choose fl or compo"),
        (Base, {"frequency": 100.0}, "base law 'fl' has no frequency: leave it out, or choose motor-pd"),
        *[(Base, {"law": "motor-pd", "frequency": value}, "frequency must be") for value in (0, -1, np.nan, "200")],
        *[(Base, {"minimum_tension": value}, "minimum_tension must be") for value in (-1, np.nan, "5", None)],
        *[
            (Base, {"estimator_prior_weight": value}, "estimator_prior_weight must be")
            for value in (0, -1, np.inf, "1", None)
        ],
        (Base, {"estimates_payload": "no"}, "estimates_payload must be True or False, not 'no'"),
        (Base, {"estimates_payload": True, "allocates": 1}, "allocates must be True or False, not 1"),
        (Base, {"allocates": True}, "allocates requires estimates_payload"),
    ],
)
def test_bad_number_is_not_an_obscure_error_later(kind, keywords, message):
    with pytest.raises(ValueError, match=message):
        kind(**keywords)


@pytest.mark.parametrize(
    ("find", "value", "message"),
    [
        (find_action_mapping, "push", "unknown kind 'push'; choose one of shift, residual"),
        (find_action_mapping, {"action_period": 0.1}, "unknown kind None"),
        (find_action_mapping, {"kind": ["shift"]}, r"unknown kind \['shift'\]"),
        (
            find_action_mapping,
            {"kind": "residual", "degree": 3},
            "unknown key 'degree'; residual takes action_period, fraction",
        ),
        (find_action_mapping, 3, "steering must be shift or residual, or a dict"),
        (find_base, {"law": "fl", "gain": 3}, "base: unknown key 'gain'; it takes law, gains, "),
        (find_base, None, "base must be one of fl, composite, motor-pd, fl4, or a dict"),
    ],
)
def test_description_is_not_refused_without_what_is_valid(find, value, message):
    with pytest.raises(ValueError, match=message):
        find(value)


def test_descriptions_do_not_lose_anything():
    for action_mapping in (Shift(action_period=0.1, degree=4, preview=0.05, fraction=0.3), Residual(fraction=0.1)):
        assert find_action_mapping(json.loads(json.dumps(action_mapping_to_jsonable(action_mapping)))) == action_mapping
    assert find_action_mapping("shift") == Shift()
    assert find_base("fl4") == Base(law="fl4")
    base = Base(
        law="composite", gains=[200, np.float32(28)], estimates_payload=True, estimator_prior_weight=np.int64(1)
    )
    assert find_base(json.loads(json.dumps(dataclasses.asdict(base)))) == base
    assert json.dumps(action_mapping_to_jsonable(Shift(degree=np.int64(4), action_period=np.float32(0.5))))


@pytest.mark.parametrize("names", [(), "pose", None, 3])
def test_features_are_not_left_out(names):
    with pytest.raises(ValueError, match="features must be a list of names from pose, velocity"):
        check_features(names, PLANAR)


def test_feature_that_robot_or_steering_has_not_is_not_found_out_at_work():
    with pytest.raises(ValueError, match="unknown feature 'motor_angle'; choose from pose"):
        steering_of(features=("pose", "motor_angle"))
    with pytest.raises(ValueError, match="feature 'shift' requires steering of kind shift"):
        steering_of(action_mapping=Residual(), features=("pose", "shift"))


@pytest.mark.parametrize(("law", "robot"), [("composite", PLANAR), ("motor-pd", SPATIAL), ("fl4", FLEX_PLANAR)])
def test_law_for_another_kind_of_robot_is_not_made(law, robot):
    with pytest.raises(ValueError, match=r"springs|as many cables"):
        Base(law=law).make(robot)


def test_numbers_of_a_base_reach_the_law():
    law = Base(gains=(7.0, 3.0), minimum_tension=2.0).make(PLANAR)
    assert (law.outer.gains, law.minimum_tension) == ((7.0, 3.0), 2.0)
    seen, _ = observations(FLEX_PLANAR_ID, 20, lanes=2)
    soft, hard = (run(Base(law="motor-pd", frequency=value).make(FLEX_PLANAR), seen) for value in (50.0, 400.0))
    assert np.any(soft != hard)
    seen, _ = observations(SPATIAL_ID, 20, lanes=2)
    light, heavy = (
        run(Base(estimates_payload=True, estimator_prior_weight=estimator_prior_weight).make(SPATIAL), seen)
        for estimator_prior_weight in (1e-3, 1e3)
    )
    assert np.any(light != heavy)
    assert np.any(run(Base().make(SPATIAL), seen) != light)
    assert Base(estimates_payload=True).make(SPATIAL).unsaturated_actions
    assert not Base(estimates_payload=True, allocates=True).make(SPATIAL).unsaturated_actions


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"weights": ()}, "inconsistent"),
        ({"biases": (np.zeros(3),)}, "inconsistent"),
        ({"mean": np.zeros(3)}, "inconsistent"),
        ({"scale": np.array([1.0, 0.0])}, "scale of its inputs must be above 0"),
        ({"biases": (np.array([0.0, np.inf, 0.0, 0.0]),)}, "must be finite"),
        ({"squash": "soft"}, "squash must be one of none, tanh"),
    ],
)
def test_network_is_not_made_of_parts_that_do_not_fit(changes, message):
    parts = {"mean": np.zeros(2), "scale": np.ones(2), "weights": (np.zeros((4, 2)),), "biases": (np.zeros(4),)}
    with pytest.raises(ValueError, match=message):
        Network(**(parts | changes))


def test_network_is_what_its_layers_say():
    draw = np.random.default_rng(0)
    first, last = draw.normal(size=(3, 2)), draw.normal(size=(4, 3))
    network = Network(
        mean=np.array([1.0, 2.0]),
        scale=np.array([2.0, 1e-9]),
        weights=(first, last),
        biases=(np.full(3, 0.1), np.full(4, -0.2)),
        squash="none",
    )
    values = last @ np.tanh(first @ np.array([1.0, -10.0]) + 0.1) - 0.2
    np.testing.assert_allclose(network(np.array([3.0, 1.0])), values, rtol=1e-12)
    squashed = dataclasses.replace(network, squash="tanh")
    np.testing.assert_allclose(squashed(np.array([3.0, 1.0])), np.tanh(values), rtol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"env_id": "CableBot"}, "unknown environment 'CableBot'; choose one of"),
        ({"features": ("pose",)}, r"the network has \d+ inputs, but its features have 2"),
        ({"action_mapping": Residual(), "features": DIRECT}, r"the network has \d+ inputs, but its features have 17"),
        ({"base": Base(law="fl4")}, "FourthOrder needs joint springs"),
        ({"card": {"path": object()}}, "the card must be JSON-able"),
    ],
)
def test_bundle_is_not_made_of_parts_that_do_not_fit(changes, message):
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(bundle_of(), **changes)


# --- in an evaluation -------------------------------------------------------------------------------------------------


def test_bundle_is_not_judged_otherwise_than_its_law_by_name_command_or_cell(cablebot, tmp_path):
    path = tmp_path / "nothing.zip"
    base = Base()
    steering = steering_of(base=base)
    network = network_of(steering, scale=0.0)
    Bundle(env_id=PLANAR_ID, base=base, action_mapping=Shift(), features=SHIFTED, network=network).save(path)
    keywords = {"trajectory": HANG, "resolution": 0.1}
    expected = evaluate_dlcc("fl", PLANAR_ID, **keywords).payload
    assert expected > 0
    assert evaluate_dlcc(str(path), PLANAR_ID, **keywords).payload == expected
    arguments = ("--trajectory", json.dumps(HANG), "--resolution", "0.1", "--json")
    status, out, _ = cablebot("dlcc", PLANAR_ID, "--policy", path, *arguments)
    (result,) = json.loads(out)
    assert (status, result["criterion"], result["payload"]) == (0, "task", expected)
    assert find_policies([str(path)], [PLANAR_ID]) == {PLANAR_ID: (str(path),)}
    cell = PolicyCell(env_id=PLANAR_ID, trajectory=HANG, policy=str(path), resolution=0.1)
    assert compute(cell).result["payload"] == expected
    record = compute(dataclasses.replace(cell, env_id=SPATIAL_ID, trajectory={"name": "dwell-spatial"}))
    assert "evaluate it on the environment that it was trained on" in record.error


def test_result_does_not_outlive_the_bundle_or_the_code_that_runs_it(saved, monkeypatch):
    cell = PolicyCell(env_id=PLANAR_ID, trajectory=HANG, policy=str(saved))
    before = cell.source
    code_hash.source_hash.cache_clear()
    assert cell.source == before
    bundle_of(seed=2).save(saved)
    code_hash.source_hash.cache_clear()
    assert cell.source != before
    read, real = set(), code_hash._parsed.__wrapped__

    def meaning(path, name):
        read.add(name)
        return real(path, name)

    monkeypatch.setattr(code_hash, "_parsed", meaning)
    code_hash.source_hash.cache_clear()
    assert cell.source
    monkeypatch.undo()
    code_hash.source_hash.cache_clear()
    assert {
        f"cablebot_baselines.learned.{name}" for name in ("bundle", "policy", "steering", "features", "network")
    } <= read
    assert {"cablebot_baselines.classical.law", "cablebot_baselines.classical.adaptive"} <= read
    assert not read & {"cablebot_baselines.learned.vec_env", "cablebot_baselines.learned.differentiable"}
