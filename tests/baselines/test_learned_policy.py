"""Learned policies without training: spline, memory, features, network and bundle."""

from __future__ import annotations

import dataclasses
import json
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest

from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.bundle import FORMAT, Bundle
from cablebot_baselines.learned.features import RBF_COUNT, TIME_CONSTANTS
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.steering import (
    DERIVATIVES,
    Residual,
    Shift,
    Steering,
)
from cablebot_gym.benchmark.cells import PolicyCell
from cablebot_gym.benchmark.suites import find_policies
from cablebot_gym.envs import PAPER_ENV_IDS, env_robot
from cablebot_gym.envs.observation import PREVIEWS, observation_layout, preview_name
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, find_robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import find_trajectory
from cablebot_gym.utils import code_hash

PLANAR_ID, SPATIAL_ID, FLEX_PLANAR_ID, FLEX_SPATIAL_ID = PAPER_ENV_IDS
DWELL = {"name": "dwell-planar", "duration": 0.05}
PERIOD = 1 / 500
FEATURES = (
    "pose",
    "shift",
    "shift_velocity",
    "actions",
    "error",
    "time_since_start",
    "rbf_progress",
    "model_payload",
)
RESIDUAL_FEATURES = (
    "pose",
    "velocity",
    "actions",
    "error",
    "time_since_start",
    "reference_acceleration",
)

CASES = {
    "planar shift": (PLANAR_ID, Base(gains=(2000.0, 90.0)), Shift(action_period=0.02), FEATURES),
    "preview": (
        SPATIAL_ID,
        Base(estimates_payload=True, allocates=True),
        Shift(action_period=0.014, degree=4, preview=0.1, fraction=0.5),
        FEATURES,
    ),
    "residual": (SPATIAL_ID, Base(), Residual(action_period=0.006), RESIDUAL_FEATURES),
    "springs": (
        FLEX_SPATIAL_ID,
        Base(law="composite", estimates_payload=True),
        Residual(),
        RESIDUAL_FEATURES,
    ),
}
"""Environment, base law, action mapping and features."""

each_case = pytest.mark.parametrize("case", CASES)


def steering_of(env_id=PLANAR_ID, base=None, action_mapping=None, features=FEATURES):
    robot = find_robot(env_robot(env_id))
    return Steering(robot, base=base or Base(), action_mapping=action_mapping or Shift(), features=features)


def network_of(steering, *, scale=1.0, hidden=(8,), seed=1):
    """A random network; with a scale of 0 its output is zero."""
    draw = np.random.default_rng(seed)
    sizes = (steering.inputs, *hidden, steering.actions)
    pairs = list(pairwise(sizes))
    return Network(
        mean=draw.normal(size=steering.inputs),
        scale=draw.uniform(0.5, 2.0, steering.inputs),
        weights=tuple(scale * draw.normal(size=(after, before)) for before, after in pairs),
        biases=tuple(scale * draw.normal(size=after) for _, after in pairs),
    )


def bundle_of(case="planar shift", **network):
    env_id, base, action_mapping, features = CASES[case]
    trained_network = network_of(steering_of(env_id, base, action_mapping, features), **network)
    contents = {"base": base, "action_mapping": action_mapping, "features": features, "network": trained_network}
    return Bundle(env_id=env_id, card={"seed": 1, "note": "é"}, **contents)


@pytest.fixture
def saved(tmp_path):
    """File of the planar bundle."""
    path = tmp_path / "bundle.zip"
    bundle_of().save(path)
    return path


def observations(env_id, steps, envs=4):
    """Observations (steps, envs, size) of a classical law with different payloads, and the tasks."""
    env = gym.make_vec(env_id, num_envs=envs)
    observation, _ = env.reset(seed=3, options={"payload": np.linspace(0.0, 1.5, envs)})
    policy = load_policy("motor-pd" if "Flex" in env_id else "fl", find_robot(env_robot(env_id)))
    rows = []
    for _ in range(steps):
        rows.append(observation.copy())
        observation, *_ = env.step(policy.predict(observation)[0])
    return np.array(rows), env.unwrapped.tasks


def tasks_of(env_id, **keywords):
    env = gym.make_vec(env_id, num_envs=2, **keywords)
    env.reset(seed=0)
    return env.unwrapped.tasks


def run(policy, rows, starts=None):
    """Actions of a policy for observations (steps, …, size); ``starts`` (steps, …) marks the starts of episodes."""
    state = None
    actions = []
    for step, observation in enumerate(rows):
        action, state = policy.predict(observation, state, None if starts is None else starts[step])
        actions.append(action)
    return np.array(actions)


def line(robot, start, speed, times):
    """Observations (steps, size) of a reference with constant velocity."""
    layout = observation_layout(robot)
    rows = np.zeros((len(times), layout.size))
    blocks = layout.split(rows)
    blocks["reference_pose"][:] = start + speed * np.asarray(times)[:, None]
    blocks["reference_velocity"][:] = speed
    for ahead in PREVIEWS:
        blocks[preview_name(ahead)][:] = speed * ahead
    return rows


def steer(steering, rows, actions):
    """Blocks that the base law gets, and observations of a learner, for actions (steps, size)."""
    law_blocks = []
    memory = None
    observed = []
    steering.law.respond = lambda blocks, *arguments: law_blocks.append(blocks) or (np.zeros(6), None)
    for observation, action in zip(rows, actions, strict=True):
        blocks = steering.split(observation)
        memory = steering.reset_memory(blocks, memory, None)
        observed.append(steering.observe(blocks, memory))
        _, memory = steering.respond(blocks, action, memory)
    return {name: np.array([blocks[name] for blocks in law_blocks]) for name in law_blocks[0]}, np.array(observed)


@pytest.mark.parametrize("degree", [2, 3, 4, 5])
def test_spline_is_a_smooth_partition_of_unity(degree):
    """Its derivatives equal difference quotients, and it is continuous at its knots up to order degree − 1."""
    action_period = 0.03
    step = 1e-6
    shift = Shift(degree=degree)
    times = np.linspace(0.002, 0.028, 7)
    before = shift.weights(times - step, action_period)
    now = shift.weights(times, action_period)
    after = shift.weights(times + step, action_period)
    np.testing.assert_allclose(now[:, 0].sum(axis=-1), 1.0, atol=1e-14)
    assert now[:, 0].min() >= 0
    for order in range(4):
        slope = (after[:, order] - before[:, order]) / (2 * step)
        bound = 1e-5 * max(np.abs(slope).max(), action_period**-order)
        np.testing.assert_allclose(now[:, order + 1], slope, atol=bound)
    at_start, at_end = shift.weights(np.array([0.0, action_period]), action_period)
    for order in range(min(degree, 5)):
        size = action_period**-order
        np.testing.assert_allclose(at_end[order, 1:], at_start[order, :-1], atol=1e-9 * size)
        np.testing.assert_allclose([at_end[order, 0], at_start[order, -1]], 0.0, atol=1e-9 * size)


@pytest.mark.parametrize("env_id", [PLANAR_ID, SPATIAL_ID])
def test_shift_stays_within_the_error_bounds(env_id):
    steering = steering_of(env_id, action_mapping=Shift(action_period=0.006, fraction=0.95))
    error_bounds = ErrorBounds(position=0.02, rotation=0.03)
    steering.reset(tasks_of(env_id, error_bounds=error_bounds))
    n = steering.robot.coordinates
    actions = 3 * np.sign(np.random.default_rng(0).normal(size=(600, n)))
    actions[300:] = 3.0  # all to one corner
    law_blocks, _ = steer(steering, np.zeros((600, observation_layout(steering.robot).size)), actions)
    shift = law_blocks["reference_pose"]
    away = np.linalg.norm(shift[:, :3], axis=1)
    assert away.max() <= 0.95 * 0.02 * (1 + 1e-12)
    assert away[-1] == pytest.approx(0.95 * 0.02)
    if n > 3:
        assert np.abs(shift[:, 3:]).max() == pytest.approx(0.95 * 0.03)


@pytest.mark.parametrize(("degree", "preview"), [(2, 0.02), (4, 0.1), (5, 0.2)])
def test_preview_delays_uniform_motion_by_half_the_spline(degree, preview):
    """Σⱼ j B(u − j) = u − (degree + 1)/2: the delay is (degree + 1)/2 action periods minus the preview."""
    action_period = 0.02
    steps = 120
    action_mapping = Shift(action_period=action_period, degree=degree, preview=preview)
    steering = steering_of(FLEX_SPATIAL_ID, base=Base(law="composite"), action_mapping=action_mapping)
    start = np.array([0.3, -0.2, 0.1, 0.05, -0.02, 0.01])
    speed = np.array([1.0, -2.0, 0.5, 0.1, 0.2, -0.3])
    times = np.arange(steps) * PERIOD
    law_blocks, _ = steer(steering, line(FLEX_SPATIAL, start, speed, times), np.zeros((steps, 6)))
    inside = slice(round(degree * action_period / PERIOD), None)
    expected = start + speed * (times[inside, None] + preview - (degree + 1) / 2 * action_period)
    np.testing.assert_allclose(law_blocks["reference_pose"][inside], expected, atol=1e-14)
    np.testing.assert_allclose(law_blocks["reference_velocity"][inside], np.tile(speed, (len(expected), 1)), atol=1e-12)
    for order, name in enumerate(DERIVATIVES[2:], start=2):
        np.testing.assert_allclose(law_blocks[f"reference_{name}"][inside], 0.0, atol=1e-12 / action_period**order)


def test_flexible_law_gets_derivatives_up_to_snap():
    action_mapping = Shift(action_period=0.01, degree=5)
    steps = 40
    steering = steering_of(FLEX_PLANAR_ID, base=Base(law="motor-pd"), action_mapping=action_mapping)
    actions = np.random.default_rng(0).uniform(-0.6, 0.6, (steps, 2))
    rows = line(FLEX_PLANAR, np.zeros(2), np.zeros(2), np.arange(steps))
    observation_layout(FLEX_PLANAR).split(rows)["reference_snap"][:] = 7.0
    law_blocks, _ = steer(steering, rows, actions)
    points = np.concatenate([np.zeros((5, 2)), actions[::5]]) * action_mapping.bounds(ErrorBounds(), PLANAR)
    for step in range(steps):
        weights = action_mapping.weights(np.array(step % 5 * PERIOD), 0.01)
        expected = weights @ points[step // 5 : step // 5 + 6] + np.array([0.0, 0.0, 0.0, 0.0, 7.0])[:, None]
        for order, name in enumerate(DERIVATIVES):
            result = law_blocks[f"reference_{name}"][step]
            np.testing.assert_allclose(result, expected[order], rtol=1e-9, atol=1e-9 / 0.01**order)


def test_action_period_is_rounded_to_control_periods():
    for action_period, frequency, periods in (
        (0.04, 500.0, 20),
        (0.04, 120.0, 5),
        (0.001, 500.0, 1),
    ):
        steering = steering_of(action_mapping=Shift(action_period=action_period))
        steering.reset(tasks_of(PLANAR_ID, control_frequency=frequency))
        assert steering.periods == periods


def test_residual_adds_the_clipped_action_of_the_last_decision():
    action_mapping = Residual(action_period=0.006, fraction=0.25)
    steering = steering_of(SPATIAL_ID, action_mapping=action_mapping, features=RESIDUAL_FEATURES)
    rows, _ = observations(SPATIAL_ID, 9, envs=1)
    law = Base().make(SPATIAL)
    memory = None
    actions = np.random.default_rng(0).uniform(-2, 2, (9, 6))
    for step, observation in enumerate(rows[:, 0]):
        blocks = steering.split(observation)
        memory = steering.reset_memory(blocks, memory, None)
        command, memory = steering.respond(blocks, actions[step], memory)
        added = command - law.predict(observation)[0]
        np.testing.assert_allclose(added, 0.25 * np.clip(actions[step // 3 * 3], -1, 1), atol=1e-12)


@pytest.mark.parametrize(("degree", "preview"), [(2, 0.0), (5, 0.0), (3, 0.05)])
def test_learner_and_law_get_the_shift_of_the_present_instant(degree, preview):
    """Rigid robots' laws get the mean acceleration of each control period."""
    action_mapping = Shift(action_period=0.01, degree=degree, preview=preview)
    steps = 60
    features = ("error", "shift", "actions", "shift_velocity")
    steering = steering_of(SPATIAL_ID, action_mapping=action_mapping, features=features)
    actions = np.random.default_rng(degree).uniform(-0.5, 0.5, (steps, 6))
    rows = line(SPATIAL, np.full(6, 0.1), np.linspace(-1, 1, 6), np.arange(steps) * PERIOD)
    layout = observation_layout(SPATIAL)
    layout.split(rows)["pose"][:] = np.random.default_rng(0).normal(size=(steps, 6))
    law_blocks, learner = steer(steering, rows, actions)
    error, shift, past, rate = np.split(learner, [6, 12, 12 + 6 * degree], axis=1)
    bounds = action_mapping.bounds(ErrorBounds(), SPATIAL)
    blocks = layout.split(rows)
    expected = law_blocks["reference_pose"] - blocks["reference_pose"]
    np.testing.assert_allclose(shift * bounds, expected, atol=1e-13)
    expected = law_blocks["reference_velocity"] - blocks["reference_velocity"]
    np.testing.assert_allclose(rate * bounds / 0.01, expected, atol=1e-11)
    np.testing.assert_allclose(error, law_blocks["reference_pose"] - blocks["pose"], atol=1e-13)
    mean = np.diff(law_blocks["reference_velocity"], axis=0) / PERIOD
    np.testing.assert_allclose(law_blocks["reference_acceleration"][:-1], mean, atol=1e-9)
    decisions = actions[::5].copy()
    decisions[:, :3] /= np.maximum(np.linalg.norm(decisions[:, :3], axis=1, keepdims=True), 1)
    points = np.concatenate([np.zeros((degree, 6)), decisions])
    for decision in range(steps // 5):
        expected = points[decision : decision + degree].ravel()
        np.testing.assert_allclose(past[5 * decision], expected, atol=1e-15)


@pytest.mark.parametrize("preview", [0.0, 0.05])
def test_shifted_motion_starts_at_rest_at_the_start_pose(preview):
    """In a batch with a motion that starts on its reference, and again in the next episode."""
    steering = steering_of(SPATIAL_ID, action_mapping=Shift(preview=preview), features=("error", "shift"))
    (task,) = tasks_of(SPATIAL_ID)[:1]
    tasks = [task, dataclasses.replace(task, trajectory=find_trajectory("paper-spatial", 6))]
    steering.reset(tasks)
    poses = [single_task.trajectory(0.0).position for single_task in tasks]
    rows = np.zeros((2, observation_layout(SPATIAL).size))
    blocks = steering.split(rows)
    blocks["reference_pose"][:], blocks["pose"][:] = poses, [single_task.start_pose for single_task in tasks]
    references = []
    memory = None
    steering.law.respond = lambda blocks, *arguments: references.append(blocks) or (np.zeros((2, 6)), None)
    for _ in range(2):
        memory = steering.reset_memory(blocks, memory, np.ones(2, bool))
        np.testing.assert_allclose(steering.observe(blocks, memory)[:, :6], 0.0, atol=1e-15)
        _, memory = steering.respond(blocks, np.ones((2, 6)), memory)
    for reference in references:
        np.testing.assert_allclose(reference["reference_pose"], blocks["pose"], rtol=0, atol=1e-15)
        np.testing.assert_allclose(reference["reference_velocity"], 0.0, atol=1e-13)
    assert tasks[0].start_pose[2] > poses[0][2] + 1e-3


def test_motion_of_a_base_alone_is_the_task_soon():
    bundle = dataclasses.replace(bundle_of("preview"), base=Base())  # an estimator would remember the start
    alone = LearnedPolicy(bundle.base_alone, SPATIAL)
    robot = bundle.base.make(SPATIAL)
    rows, tasks = observations(SPATIAL_ID, 300)
    alone.reset(tasks)
    robot.reset(tasks)
    np.testing.assert_allclose(run(alone, rows)[-50:], run(robot, rows)[-50:], rtol=0, atol=1e-9)


def test_progress_features_span_the_motion():
    steering = steering_of(features=("rbf_progress",))
    rows = np.zeros((RBF_COUNT, observation_layout(PLANAR).size))
    observation_layout(PLANAR).split(rows)["time_to_go"][::-1, 0] = np.arange(len(rows)) * PERIOD
    _, learner = steer(steering, rows, np.zeros((len(rows), 2)))
    assert np.argmax(learner, axis=1).tolist() == list(range(RBF_COUNT))
    np.testing.assert_allclose(np.diagonal(learner), 1.0)


def test_time_features_start_with_the_episode():
    steering = steering_of(features=("time_since_start", "time_to_go_decays"))
    assert steering.inputs == 2 * len(TIME_CONSTANTS)
    rows = np.zeros((30, observation_layout(PLANAR).size))
    observation_layout(PLANAR).split(rows)["time_to_go"][:, 0] = 1.0 - np.arange(30) * PERIOD
    _, learner = steer(steering, rows, np.zeros((30, 2)))
    times = np.arange(30)[:, None] * PERIOD
    np.testing.assert_allclose(learner[:, : len(TIME_CONSTANTS)], np.exp(-times / TIME_CONSTANTS), rtol=1e-12)
    np.testing.assert_allclose(learner[:, -len(TIME_CONSTANTS) :], np.exp(-(1.0 - times) / TIME_CONSTANTS), rtol=1e-12)


@each_case
def test_episodes_of_a_batch_are_independent(case):
    bundle = bundle_of(case)
    steps = 50
    envs = 4
    rows, tasks = observations(bundle.env_id, steps, envs)
    starts = np.zeros((steps, envs), bool)
    for index, begun in enumerate((0, 7, 23, 38)):
        starts[begun, index] = True
    policy = LearnedPolicy(bundle, find_robot(env_robot(bundle.env_id)))
    policy.reset(tasks)
    together = run(policy, rows, starts)
    for index, begun in enumerate((0, 7, 23, 38)):
        fresh = run(policy, rows[begun:, index])
        np.testing.assert_allclose(together[begun:, index], fresh, rtol=0, atol=1e-9 * np.abs(together).max())
    assert np.ptp(together, axis=1).max() > 0.01


@pytest.mark.parametrize("case", [case for case in CASES if not getattr(CASES[case][2], "preview", 0)])
def test_zero_network_equals_the_base_law(case):
    bundle = bundle_of(case, scale=0.0)
    robot = find_robot(env_robot(bundle.env_id))
    rows, tasks = observations(bundle.env_id, 30)
    policy = LearnedPolicy(bundle, robot)
    law = bundle.base.make(robot)
    policy.reset(tasks)
    law.reset(tasks)
    np.testing.assert_array_equal(run(policy, rows), run(law, rows))
    assert np.any(run(LearnedPolicy(bundle_of(case), robot), rows) != run(law, rows))


def test_tasks_of_a_batch_have_the_same_error_bounds():
    policy = LearnedPolicy(bundle_of(), PLANAR)
    tasks = [*tasks_of(PLANAR_ID), *tasks_of(PLANAR_ID, error_bounds=ErrorBounds(position=0.02))]
    with pytest.raises(ValueError, match="same error bounds and control frequency"):
        policy.reset(tasks)


@pytest.mark.parametrize("case", ["preview", "springs"])
def test_saved_bundle_equals_the_bundle(case, tmp_path):
    bundle = bundle_of(case)
    path = tmp_path / "made" / "bundle.zip"
    bundle.save(path)
    loaded = Bundle.load(path)
    for name in ("env_id", "base", "action_mapping", "features", "card"):
        assert getattr(loaded, name) == getattr(bundle, name)
    loaded.save(tmp_path / "again.zip")
    assert (tmp_path / "again.zip").read_bytes() == path.read_bytes()


def test_policy_of_a_file_has_the_given_robot(saved):
    heavier = PLANAR.replace(mass=1.2, name="heavier")
    policy = load_policy(str(saved), heavier)
    assert policy.robot is heavier
    with pytest.raises(ValueError, match="evaluate it on the environment that it was trained on"):
        load_policy(str(saved), SPATIAL)


def test_invalid_bundle_is_rejected(saved):
    """Also one whose arrays would be unpickled, which could execute code."""
    content = saved.read_bytes()
    with np.load(saved) as file:
        arrays = {name: file[name] for name in file.files}
    data = json.loads(str(arrays["bundle"]))
    cases = (
        (
            {"bundle": np.array(json.dumps(data | {"format": FORMAT + 1}))},
            "is newer than 1: upgrade",
        ),
        (
            {"bundle": np.array(json.dumps(data | {"observation": data["observation"][1:]}))},
            "but its environment has",
        ),
        ({"weight0": np.full_like(arrays["weight0"], np.nan)}, "numbers must be finite"),
        ({"mean": np.array([print], object)}, "allow_pickle=False"),
    )
    for changes, message in cases:
        with saved.open("wb") as file:
            np.savez_compressed(file, **(arrays | changes))
        with pytest.raises(ValueError, match=f"policy bundle '.*' cannot be used: .*{message}"):
            Bundle.load(saved)
    saved.write_bytes(content[: len(content) // 2])
    with pytest.raises(ValueError, match="policy "):
        load_policy(str(saved), PLANAR)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Shift(action_period=0),
        lambda: Shift(preview=0.03),
        lambda: Base(gains=(1, -1)),
        lambda: Base(allocates=True),
        lambda: Base(law="composite").make(PLANAR),
        lambda: steering_of(features=("motor_angle",)),
        lambda: steering_of(features=("shift",), action_mapping=Residual()),
    ],
)
def test_invalid_parameters_are_rejected(make):
    with pytest.raises(ValueError, match=r"must|unknown|has no|requires|needs|missing|given"):
        make()


@pytest.mark.parametrize(
    ("env_id", "base", "changes"),
    [
        (FLEX_PLANAR_ID, Base(law="motor-pd", frequency=50.0), {"frequency": 400.0}),
        (SPATIAL_ID, Base(), {"gains": (7.0, 3.0)}),
        (SPATIAL_ID, Base(estimates_payload=True), {"estimator_prior_weight": 1e3}),
        (PLANAR_ID, Base(), {"minimum_tension": 2.0}),
    ],
)
def test_parameters_of_a_base_reach_the_law(env_id, base, changes):
    robot = find_robot(env_robot(env_id))
    rows, _ = observations(env_id, 20, envs=2)
    changed = dataclasses.replace(base, **changes)
    assert np.any(run(base.make(robot), rows) != run(changed.make(robot), rows))


@pytest.mark.parametrize(
    "changes",
    [{"biases": (np.zeros(3),)}, {"mean": np.zeros(3)}, {"scale": np.zeros(2)}, {"squash": "soft"}],
)
def test_inconsistent_network_is_rejected(changes):
    weights = (np.zeros((4, 2)),)
    network = Network(mean=np.zeros(2), scale=np.ones(2), weights=weights, biases=(np.zeros(4),))
    with pytest.raises(ValueError, match=r"inconsistent|above 0|unknown squash"):
        dataclasses.replace(network, **changes)


def test_network_equals_its_layers():
    draw = np.random.default_rng(0)
    hidden_weights = draw.normal(size=(3, 2))
    output_weights = draw.normal(size=(4, 3))
    x = np.array([3.0, 1.0])
    normalisation = {"mean": np.array([1.0, 2.0]), "scale": np.array([2.0, 1e-9])}
    biases = (np.full(3, 0.1), np.full(4, -0.2))
    values = output_weights @ np.tanh(hidden_weights @ np.array([1.0, -10.0]) + 0.1) - 0.2
    for squash, expected in (("none", values), ("tanh", np.tanh(values))):
        network = Network(weights=(hidden_weights, output_weights), biases=biases, squash=squash, **normalisation)
        np.testing.assert_allclose(network(x), expected, rtol=1e-12)


def test_bundle_is_evaluated_by_the_name_of_its_file(tmp_path):
    path = tmp_path / "zero.zip"
    bundle = bundle_of(scale=0.0)
    bundle.save(path)
    law = bundle.base.make(PLANAR)
    expected = evaluate_dlcc(law, PLANAR_ID, trajectory=DWELL, resolution=0.1).payload
    assert evaluate_dlcc(str(path), PLANAR_ID, trajectory=DWELL, resolution=0.1).payload == expected > 0
    assert find_policies([str(path)], [PLANAR_ID]) == {PLANAR_ID: (str(path),)}


def test_stored_result_depends_on_the_code_of_a_bundle(saved, monkeypatch):
    names = set()
    parsed = code_hash._parsed.__wrapped__
    monkeypatch.setattr(code_hash, "_parsed", lambda path, name: names.add(name) or parsed(path, name))
    code_hash.source_hash.cache_clear()
    assert PolicyCell(env_id=PLANAR_ID, trajectory=DWELL, policy=str(saved)).source
    assert "cablebot_baselines.learned.steering" in names
    assert "cablebot_baselines.classical.adaptive" in names
    assert "cablebot_baselines.learned.vec_env" not in names
