"""The network that plans accelerations, and its training by gradients through the motions."""

import numpy as np
import pytest
import yaml
from driving import drive

from cablebot_baselines.classical.observer_law import ObserverLaw, observed_gains
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.planner_run import train_gradient
from cablebot_baselines.learned.network import zero_network
from cablebot_baselines.learned.planner import (
    Planning,
    PlanningPolicy,
    Preview,
    confined,
    input_count,
)
from cablebot_baselines.learned.policy import make_policy
from cablebot_baselines.learned.runs import LAST
from cablebot_gym.envs.vector import CableBotVectorEnv
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import find_trajectory

PLANAR = find_robot("planar")
PLANAR_ID = "CableBot-Planar-v0"


def loops(count, robot=PLANAR):
    names = [{"name": f"loop-{robot.kind}", "seed": seed} for seed in range(count)]
    return [find_trajectory(name, robot.kind) for name in names]


def largest_errors(policy, trajectory, payloads, uncertainty=None):
    env = CableBotVectorEnv(
        robot=PLANAR,
        num_envs=len(payloads),
        trajectory=trajectory,
        uncertainty=uncertainty,
        payload_known=uncertainty is None,
    )
    start = {"seed": 7, "options": {"payload": payloads}}
    errors = [
        step.info["tracking_error_peak"]
        for step in drive(policy, env, env.tasks[0].steps - 1, **start)
    ]
    return np.max(errors, axis=0) / env.tasks[0].error_bounds.position


def test_zero_network_tracks_the_reference_as_closely_as_observing():
    network = zero_network(input_count(PLANAR), PLANAR.coordinates)
    planning = Planning(gains=observed_gains(PLANAR))
    policy = PlanningPolicy(PLANAR, network, planning)
    observing = ObserverLaw(policy.law, policy.expectation, payload_prior=planning.payload_prior)
    (motion,) = loops(1)
    payloads = np.array([0.0, 1.0])
    tracked = largest_errors(policy, motion, payloads)
    assert np.all(tracked < largest_errors(observing, motion, payloads) + 0.05)


def test_policy_tracks_the_reference_until_it_knows_a_task():
    network = zero_network(input_count(PLANAR), PLANAR.coordinates)
    env = CableBotVectorEnv(robot=PLANAR, num_envs=1)
    observation, _ = env.reset(seed=0)
    planning = Planning()
    policy = PlanningPolicy(PLANAR, network, planning)
    tracking = ObserverLaw(policy.law, policy.expectation, payload_prior=planning.payload_prior)
    actions, _ = policy.predict(observation)
    expected, _ = tracking.predict(observation)
    assert np.array_equal(actions, expected)


def test_each_episode_of_a_batch_reads_its_own_motion():
    network = zero_network(input_count(PLANAR), PLANAR.coordinates)
    policy = PlanningPolicy(PLANAR, network, Planning())
    first, second = loops(2)
    tasks = []
    for motion in (first, second):
        env = CableBotVectorEnv(robot=PLANAR, num_envs=1, trajectory=motion)
        env.reset(seed=0)
        tasks += env.tasks
    policy.reset(tasks)
    read = [(task.trajectory, rows.tolist()) for task, rows in policy._rows_by_motion(4)]
    assert read == [(first, [0, 2]), (second, [1, 3])]


def test_mean_accelerations_of_the_preview_lead_to_the_reference():
    (motion,) = loops(1)
    preview = Preview.of(motion, np.array([0.5]))
    mean = preview.inputs[0, -2:]  # until 0.19 s later
    reached = preview.position[0] + 0.19 * preview.velocity[0] + 0.19**2 / 2 * mean
    assert reached == pytest.approx(motion(0.69).position)


@pytest.mark.parametrize(
    ("robot", "inputs", "message"),
    [("flex-planar", 9, "needs a rigid robot"), ("planar", 9, "has inputs and outputs")],
)
def test_network_must_fit_the_robot(robot, inputs, message):
    with pytest.raises(ValueError, match=message):
        PlanningPolicy(find_robot(robot), zero_network(inputs, 2), Planning())


@pytest.mark.parametrize("wild", [3.0, 300.0])
def test_error_stays_in_the_tube_whatever_the_network_says(wild):
    """Excludes a wall without the motion across it, and one for a part of the coordinates."""
    draw = np.random.default_rng(0)
    is_position = np.array([1.0, 1.0, 1.0, 0.0, 0.0])
    error, rate = np.zeros((2, 20, 5))
    step = 1e-3
    lengths = []
    for index in range(3000):
        if index % 40 == 0:
            pushed = wild * draw.normal(size=error.shape) / 0.01
        acceleration = confined(error, rate, pushed, 0.9, is_position)
        error = error + step * rate + step**2 / 2 * acceleration
        rate = rate + step * acceleration
        lengths.append([np.linalg.norm(error[:, :3], axis=1), np.abs(error[:, 3:]).max(axis=1)])
    largest = np.max(lengths, axis=(0, 2))
    assert np.all(largest > 0.8)
    assert np.all(largest < 0.95)


def test_acceleration_far_from_the_wall_is_that_of_the_network():
    error, rate, acceleration = np.full((3, 1, 3), 0.1)
    assert np.array_equal(
        confined(error, rate, acceleration, 0.9, np.array([1.0, 1.0, 0.0])), acceleration
    )


def test_stored_planning_network_acts_as_before(tmp_path):
    untrained = Bundle.of_planning(PLANAR_ID, Planning(wall=0.8))
    untrained.network.biases[0][:] = 0.3
    untrained.save(tmp_path / "planning.zip")
    stored = Bundle.load(tmp_path / "planning.zip")
    env = CableBotVectorEnv(robot=PLANAR, num_envs=2)
    observation, _ = env.reset(seed=0)
    actions = []
    for bundle in (untrained, stored):
        policy = make_policy(bundle, PLANAR)
        policy.reset(env.tasks)
        actions.append(policy.predict(observation)[0])
    assert np.array_equal(*actions)
    with pytest.raises(ValueError, match="evaluate it on the environment"):
        make_policy(stored, find_robot("spatial"))


def test_run_of_a_planning_network_writes_its_policy(tmp_path):
    plain = {
        "motions": {"named": ["circle-planar"]},
        "steering": {"kind": "planning"},
        "rounds": 1,
        "iterations": 2,
        "batch": 2,
        "hidden": [4],
        "evaluation": {"resolution": 1.0, "payload_max": 2.0},
    }
    config = tmp_path / "small.yaml"
    config.write_text(yaml.safe_dump({PLANAR_ID: plain}))
    result = train_gradient(PLANAR_ID, out=tmp_path / "run", config=config)
    bundle = Bundle.load(result.out / LAST)
    assert bundle.action_mapping == Planning()
    assert bundle.card["payload_by_equations_kg"] > 0
    assert len(bundle.network.biases[0]) == 4


def trained(rounds, *, resumed_after=None, **settings):
    from cablebot_baselines.learned.planner_training import PlannerSettings, PlannerTraining

    def make():
        return PlannerTraining(
            robot=PLANAR,
            trajectories=loops(6),
            planning=Planning(),
            settings=PlannerSettings(rounds=rounds, **settings),
        )

    training = make()
    for index in range(rounds):
        training.round(index)
        if index == resumed_after:
            arrays = {name: np.array(values) for name, values in training.state().items()}
            training = make()
            training.restore(arrays)
    return training


def test_training_that_was_resumed_gives_the_same_network():
    settings = {"iterations": 3, "batch": 4, "hidden": (8,)}
    whole = trained(2, **settings).network
    resumed = trained(2, resumed_after=0, **settings).network
    for expected, found in zip(whole.weights, resumed.weights, strict=True):
        assert np.array_equal(expected, found)


@pytest.mark.slow
def test_trained_network_carries_more_than_exact_tracking_on_random_robots():
    training = trained(1, iterations=250, batch=24, error_margin=0.18)
    motion = loops(1)[0]
    exact = trained(1, iterations=1, batch=1).payloads[0]
    policy = PlanningPolicy(PLANAR, training.network, Planning())
    payloads = np.repeat([0.0, 1.1 * exact], 8)
    assert training.payloads[0] > 1.1 * exact
    assert largest_errors(policy, motion, payloads, "hardware").max() < 1
