"""The network that plans accelerations, and its training by gradients through the motions."""

import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
import yaml
from driving import drive

from cablebot_baselines.classical.observer_law import ObserverLaw, observed_gains
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.network import zero_network
from cablebot_baselines.learned.planner import (
    Planning,
    PlanningPolicy,
    Preview,
    confined,
    input_count,
)
from cablebot_baselines.learned.planner_run import (
    VALIDATION,
    make_planner_config,
    train_planner,
)
from cablebot_baselines.learned.policy import make_policy
from cablebot_baselines.learned.runs import (
    LAST,
    Interrupted,
    TrainingResult,
    read_yaml,
    shortest_dwell,
)
from cablebot_gym.cli import app as cli
from cablebot_gym.envs.vector import CableBotVectorEnv
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import (
    DWELL,
    FIRST_HELD_OUT_SEED,
    RandomLoop,
    find_trajectory,
)

pytestmark = pytest.mark.usefixtures("one_thread")

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


def test_stored_planning_network_equals_itself(tmp_path):
    untrained = Bundle.of_planning(PLANAR_ID, Planning(wall=0.8))
    untrained.network.biases[0][:] = 0.3
    untrained.save(tmp_path / "planning.zip")
    policy = make_policy(Bundle.load(tmp_path / "planning.zip"), PLANAR)
    assert policy.planning == Planning(wall=0.8)
    assert np.array_equal(policy.network.biases[0], untrained.network.biases[0])


SMALL = {
    "motions": {"named": [{"name": "line-planar", "duration": 0.5}]},
    "rounds": 2,
    "iterations": 2,
    "batch": 2,
    "hidden": [4],
    "evaluation": {"control_frequency": 100, "resolution": 1.0, "payload_max": 1.0},
}
HELD_OUT = {"name": "loop-planar", "seed": FIRST_HELD_OUT_SEED}


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("configs") / "small.yaml"
    path.write_text(yaml.safe_dump({PLANAR_ID: SMALL}))
    return path


@pytest.fixture(scope="module")
def finished(tmp_path_factory, config):
    """A finished run."""
    return train_planner(PLANAR_ID, out=tmp_path_factory.mktemp("runs") / "run", config=config)


def test_run_writes_its_policy(finished):
    bundle = Bundle.load(finished.out / LAST)
    assert bundle.action_mapping == Planning()
    assert bundle.card["payload_by_equations_kg"] > 0
    assert bundle.card["dwell"] == DWELL
    assert len(bundle.network.biases[0]) == 4


def test_interrupted_run_resumes_to_the_same_weights(finished, tmp_path, config, monkeypatch):
    out = tmp_path / "run"
    signals = [signal.SIGTERM]

    def stop(done, total, text):
        if text.startswith("round 2") and signals:
            signal.raise_signal(signals.pop())

    with pytest.raises(Interrupted):
        train_planner(PLANAR_ID, out=out, config=config, progress=stop)
    assert not (out / LAST).exists()
    assert len(TrainingResult.load(out).evaluations) == 1
    command = ["cablebot", "train", PLANAR_ID, "--out", str(out), "--resume"]
    monkeypatch.setattr("sys.argv", command)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert not ended.value.code
    assert len(TrainingResult.load(out).evaluations) == 2
    resumed, expected = (Bundle.load(folder / LAST).network for folder in (out, finished.out))
    for weights, expected_weights in zip(resumed.weights, expected.weights, strict=True):
        assert np.array_equal(weights, expected_weights)


def test_damaged_checkpoint_is_rejected(finished, tmp_path):
    out = shutil.copytree(finished.out, tmp_path / "run")
    (TrainingResult.load(out).checkpoint / "training.npz").write_bytes(b"damaged")
    with pytest.raises(ValueError, match="no file was changed"):
        train_planner(PLANAR_ID, out=out, resume=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"motions": "circle"}, "motions"),
        ({"motions": {"loops": VALIDATION[0] + 1}}, "loops"),
        ({"motions": {"named": [HELD_OUT]}}, "reserved for evaluation"),
        ({"tensoin_margin": 3.0}, "tensoin_margin"),
        ({"planning": {"wal": 0.9}}, "wal"),
    ],
)
def test_invalid_configuration_is_rejected(changes, message):
    with pytest.raises(ValueError, match=message):
        make_planner_config(PLANAR_ID, SMALL | changes)


def test_validation_loops_differ_from_training_loops():
    line = {"name": "line-planar", "duration": 2.0}
    motions = {"loops": 2, "named": ["paper-planar", line]}
    config = make_planner_config(PLANAR_ID, SMALL | {"motions": motions})
    *training, paper, named = config.trajectories
    assert [loop.motion.seed for loop in training] == [0, 1]
    assert paper.name == "paper-planar"
    assert (named.name, named.motion.duration) == ("line-planar", 2.0)
    assert [loop.motion.seed for loop in config.validation] == list(VALIDATION)


@pytest.mark.parametrize("env_id", [PLANAR_ID, "CableBot-Spatial-v0"])
def test_shipped_configuration_uses_training_motions_only(env_id):
    config = make_planner_config(env_id, read_yaml(env_id, Path("planner")))
    assert shortest_dwell(config.trajectories) == DWELL
    motions = [trajectory.motion for trajectory in config.trajectories]
    seeds = {motion.seed for motion in motions if isinstance(motion, RandomLoop)}
    assert seeds == set(range(400))
    assert seeds.isdisjoint(VALIDATION)
    assert max(VALIDATION) < FIRST_HELD_OUT_SEED


def trained(**settings):
    from cablebot_baselines.learned.planner_training import PlannerSettings, PlannerTraining

    training = PlannerTraining(
        robot=PLANAR,
        trajectories=loops(6),
        planning=Planning(),
        settings=PlannerSettings(rounds=1, **settings),
    )
    training.round(0)
    return training


@pytest.mark.slow
def test_trained_network_carries_more_than_exact_tracking_on_random_robots():
    training = trained(iterations=250, batch=24, error_margin=0.18)
    motion = loops(1)[0]
    exact = trained(iterations=1, batch=1).payloads[0]
    policy = PlanningPolicy(PLANAR, training.network, Planning())
    payloads = np.repeat([0.0, 1.1 * exact], 8)
    assert training.payloads[0] > 1.1 * exact
    assert largest_errors(policy, motion, payloads, "hardware").max() < 1
