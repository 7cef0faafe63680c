"""Steered control: the spline of the actions, its bounds, and the episodes of a training."""

from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import ROBOTS
from tasks import tasks_of

from cablebot_baselines.laws.observing import Observing
from cablebot_baselines.learned import steered
from cablebot_baselines.learned.steered import PayloadCurriculum, Steered
from cablebot_baselines.learned.steered_policy import SteeredPolicy
from cablebot_baselines.learned.steering import FRACTION, TIME_CONSTANTS, ShiftSpline, Steering
from cablebot_gym import ENV_IDS
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.task import ErrorBounds

PLANAR, SPATIAL = "CableBot-Planar-v0", "CableBot-Spatial-v0"


@pytest.mark.parametrize("degree", [3, 5])
def test_spline_is_a_smooth_partition_of_unity(degree):
    """Its derivatives equal difference quotients, and it is continuous at its knots up to order
    degree − 1. Beyond the next action, within the delay of the motors, it goes on smoothly."""
    action_period = 0.03
    step = 1e-6
    spline = ShiftSpline(degree, action_period)
    times = np.linspace(0.002, 0.034, 7)
    sizes = action_period ** -np.arange(5.0)[:, None]
    before, now, after = (spline.weights(times + d) / sizes for d in (-step, 0.0, step))
    assert_allclose(now[:, 0].sum(axis=-1), 1.0, atol=1e-13)
    assert now[:-1, 0].min() >= 0
    slope = (after - before) / (2 * step) * action_period
    assert_allclose(now[:, 1:], slope[:, :-1], atol=1e-5)
    start, end = spline.weights(np.array([0.0, action_period])) / sizes
    smooth = slice(min(degree, 5))
    assert_allclose(end[smooth, 1:], start[smooth, :-1], atol=1e-9)
    assert_allclose(end[smooth, 0], 0.0, atol=1e-9)
    assert_allclose(start[smooth, -1], 0.0, atol=1e-9)


@pytest.fixture
def shifts(monkeypatch):
    """``shifts(steering, tasks, actions)``: shifts of the reference's pose and velocity in the
    control steps of two episodes, and what a learner sees, without a law."""
    tasks_of_law = []

    def respond(self, blocks, state=None, episode_start=None):
        instant = SimpleNamespace(
            blocks=blocks,
            estimate=SimpleNamespace(delay=np.zeros(2)),
            time_to_go=np.array([task.trajectory.duration for task in tasks_of_law]),
        )
        reference, _ = self.reference(instant, None)
        return reference, state

    monkeypatch.setattr(Observing, "respond", respond)

    def run(steering, tasks, actions):
        tasks_of_law[:] = tasks
        steering.reset(tasks)
        memory = None
        found, seen = [], []
        blocks = steering.split(np.zeros((2, observation_layout(steering.robot).size)))
        for action in actions:
            memory = steering.started(memory, None, (2,))
            seen.append(steering.observe(blocks, memory))
            for _ in range(steering.periods):
                reference, memory = steering.steer(blocks, np.tile(action, (2, 1)), memory)
                found.append([reference["reference_pose"], reference["reference_velocity"]])
        start = tasks[0].trajectory(0.0)
        found = np.array(found)[:, :, 0]
        return found[:, 0] - start.position, found[:, 1] - start.velocity, np.array(seen)[:, 0]

    return run


def test_shift_goes_from_the_start_pose_to_the_actions_within_their_bounds(shifts):
    bounds = ErrorBounds(position=0.02, rotation=0.03)
    tasks = tasks_of(SPATIAL, error_bounds=bounds)
    actions = 3 * np.sign(np.random.default_rng(0).normal(size=(40, 6)))
    actions[20:] = 3.0  # all to one corner
    pose, velocity, _ = shifts(Steering(ROBOTS[SPATIAL]), tasks, actions)
    away = np.linalg.norm(pose[:, :3], axis=1)
    assert_allclose(pose[0], tasks[0].start_pose - tasks[0].trajectory(0.0).position, atol=1e-12)
    assert away.max() <= FRACTION * bounds.position * (1 + 1e-12)
    assert away[-1] == pytest.approx(FRACTION * bounds.position)
    assert np.abs(pose[:, 3:]).max() == pytest.approx(FRACTION * bounds.rotation)
    middle = (pose[2:] - pose[:-2]) * 250
    assert_allclose(velocity[1:-1], middle, atol=0.05 * np.abs(velocity).max())


def test_learner_sees_its_actions_and_the_end_of_the_motion(shifts):
    actions = np.random.default_rng(1).uniform(-0.5, 0.5, (50, 2))
    _, _, seen = shifts(Steering(ROBOTS[PLANAR]), tasks_of(PLANAR), actions)
    past = seen[:, -12:-6]  # before error, mass and strengths
    assert_allclose(past[10], actions[7:10].ravel(), atol=1e-12)
    count = len(TIME_CONSTANTS)
    since = seen[:, :count]
    to_go = seen[:, count : 2 * count]
    assert_array_equal(since[0], 1.0)
    assert np.all(np.diff(to_go[:38], axis=0) > 0)
    assert to_go[38, -1] == pytest.approx(1.0, rel=0.1)


def test_tasks_of_a_batch_have_the_same_error_bounds():
    tasks = [*tasks_of(PLANAR), *tasks_of(PLANAR, error_bounds=ErrorBounds(position=0.02))]
    with pytest.raises(ValueError, match="same error bounds and control frequency"):
        Steering(ROBOTS[PLANAR]).reset(tasks)


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_every_environment_can_be_steered(env_id):
    """Nothing is compiled, because no environment is reset."""
    env = Steered(env_id, 2)
    assert env.action_space.shape == (2, ROBOTS[env_id].coordinates)
    assert env.observation_space.shape == (2, env.steering.inputs)


def test_ceiling_follows_the_fraction_of_successes_with_heavy_payloads():
    curriculum = PayloadCurriculum(window=4)
    start, step = curriculum.start, curriculum.step

    def play(*successes, payload=10.0):
        for success in successes:
            curriculum.count(payload, success)
        return (curriculum.ceiling - start) / step

    assert play(*[True] * 8, payload=0.5 * start) == 0  # light
    assert play(True, True, False, False, True) == 0  # three of five: a half to 0.7
    assert play(True, True) == pytest.approx(1)
    assert play(True, True, True) == pytest.approx(1)
    assert play(True) == pytest.approx(2)
    assert play(*[False] * 4) == pytest.approx(1)
    assert play(*[False] * 12) == 0


def random_actor(steering, path):
    """File of a policy with random weights."""
    draw = np.random.default_rng(0)
    size = steering.robot.coordinates
    shapes = [(8, steering.inputs), (8,), (size, 8), (size,)]
    with path.open("wb") as file:
        np.savez(file, *(0.2 * draw.normal(size=shape) for shape in shapes))
    return path


@pytest.mark.parametrize("env_id", [PLANAR, pytest.param(SPATIAL, marks=pytest.mark.landing)])
def test_policy_on_the_plain_environment_repeats_training(tmp_path, env_id):
    env = Steered(env_id, 1)
    observed, _ = env.reset(seed=3)
    base = env.unwrapped
    policy = SteeredPolicy(base.settings.robot, random_actor(env.steering, tmp_path / "policy.zip"))
    plain = gym.make(env_id, uncertainty="hardware", payload_known=False)
    payload = env._payload[0] * env.steering.exact_payloads[0]
    options = {"trajectory": base.tasks[0].trajectory, "payload": payload}
    plain.reset(seed=3)
    for _ in range(2):  # the training draws motions, and then payloads
        observation, _ = plain.reset(options=options)
    policy.reset([plain.unwrapped.task])
    state = None
    for _ in range(5):
        action = policy.act(observed)
        observed, total, terminated, *_ = env.step(action)
        assert not terminated
        rewards = []
        for _ in range(env.steering.periods):
            applied, state = policy.predict(observation, state)
            observation, reward, *_ = plain.step(applied)
            rewards.append(reward)
        effort = steered.EFFORT * np.mean(np.clip(action, -1, 1) ** 2)
        assert total.item() == pytest.approx(sum(rewards) - effort, rel=1e-5)
        assert_allclose(base.pose[0], plain.unwrapped.pose, rtol=0, atol=1e-8)  # float32


@pytest.mark.landing
def test_episodes_end_within_actions_and_start_again_alone(monkeypatch):
    """A season ends all episodes, and the next motions are others."""
    monkeypatch.setattr(steered, "SEASON", 60)
    env = Steered(PLANAR, 3)
    env.curriculum.ceiling = 6.0
    env.reset(seed=0)
    motions = env._motions
    draw = np.random.default_rng(0)
    ends_within = counted = 0
    for _ in range(60):
        _, _, terminated, truncated, info = env.step(draw.uniform(-1, 1, (3, 2)))
        ended = terminated | truncated
        periods = np.round(info["time"] / env.unwrapped.settings.period)
        ends_within += (periods[ended] % env.steering.periods != 0).sum()
        counted += ended.sum()
        if ended.any():
            with pytest.raises(ResetNeeded):
                env.step(np.zeros((3, 2)))
            _, info = env.reset(options={"reset_mask": ended})
            assert_array_equal(info["time"] == 0, ended)
        assert (env._motions is not motions) == ended.all()
        motions = env._motions
    assert ended.all()
    assert ends_within > 0
    assert counted > 6
