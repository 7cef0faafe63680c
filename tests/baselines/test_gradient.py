"""Analytic policy gradient: its motion is that of the law, its constraints are those of the plant,
and its runs."""

import json
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
import yaml
from numpy.testing import assert_array_equal
from steering import tasks_of

from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.gradient import GradientSettings, GradientTraining
from cablebot_baselines.learned.planner_run import VALIDATION, make_gradient_config, train_gradient
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.runs import (
    BEST,
    HYPERPARAMS,
    LAST,
    Interrupted,
    TrainingResult,
    read_yaml,
    shortest_dwell,
)
from cablebot_baselines.learned.steering import Shift, Steering
from cablebot_gym.cli import app as cli
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.observation import observed_reference
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.physics import textbook
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import (
    DWELL,
    FIRST_HELD_OUT_SEED,
    BetweenDwells,
    RandomLoop,
    find_trajectory,
)

pytestmark = pytest.mark.usefixtures("one_thread")

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"
FLEX = "CableBot-FlexSpatial-v0"
REFERENCE_FEATURES = read_yaml(SPATIAL, Path("gradient-loops"))["features"]


def made(env_id, action_mapping, *, features=("rbf_progress",), motions=None, **settings):
    robot = find_robot(env_robot(env_id))
    trajectories = [
        find_trajectory(name, robot.kind) for name in motions or [default_trajectory(robot)]
    ]
    return GradientTraining(
        robot=robot,
        trajectories=trajectories,
        action_mapping=action_mapping,
        features=features,
        settings=GradientSettings(**{"spread": 0.5, **settings}),
        minimum_tension=textbook.allocated_minimum(robot),
    )


def blocks_on_reference(robot, trajectory, time):
    """Blocks of an observation of an unloaded robot on its reference."""
    reference = observed_reference(trajectory, np.array([time]), to_snap=robot.flexible)
    blocks = {name: value[0] for name, value in reference.items()}
    return blocks | {
        "pose": blocks["reference_pose"],
        "velocity": blocks["reference_velocity"],
        "model_payload": np.zeros(1),
        "payload_known": np.ones(1),
        "motor_angle": np.zeros(robot.cables),
        "motor_speed": np.zeros(robot.cables),
    }


@pytest.mark.parametrize(
    ("env_id", "law", "action_mapping", "features"),
    [
        (PLANAR, "fl", Shift(action_period=0.02, degree=3), ("rbf_progress",)),
        (SPATIAL, "fl", Shift(action_period=0.02, degree=3), ("rbf_progress",)),
        (SPATIAL, "fl", Shift(action_period=0.01, degree=2, preview=0.05), REFERENCE_FEATURES),
        (FLEX, "motor-pd", Shift(action_period=0.04, degree=4), ("time_since_start",)),
    ],
)
def test_training_motion_equals_the_reference_of_the_law(env_id, law, action_mapping, features):
    """Excludes start poses, anchors, past control points, features or squashing that differ."""
    training = made(env_id, action_mapping, features=features, instants=2)
    robot = training.robot
    (trajectory,) = training.trajectories
    trained = training.motion().detach().numpy()[0]
    steering = Steering(robot, base=Base(law=law), action_mapping=action_mapping, features=features)
    steering.reset(tasks_of(env_id)[:1])
    law_blocks = {}
    respond = steering.law.respond
    steering.law.respond = lambda blocks, *arguments: (
        law_blocks.update(blocks) or respond(blocks, *arguments)
    )
    # The first instant lies a billionth of a decision after it: a spline's derivatives jump there.
    compared = {"pose": (0, 0.0, 1e-6), "velocity": (1, 0.0, 1e-6)}
    if robot.flexible:
        compared["snap"] = (4, 1e-5, 1e-3)
    memory = None
    for step in range(200):
        blocks = blocks_on_reference(robot, trajectory, step / 500)
        memory = steering.reset_memory(blocks, memory, False)
        action = training.network(steering.observe(blocks, memory))
        _, memory = steering.respond(blocks, action, memory, False)
        if step % steering.periods == 0:
            decision = trained[step // steering.periods, 0]
            for name, (order, relative, absolute) in compared.items():
                expected = pytest.approx(decision[order], rel=relative, abs=absolute)
                assert law_blocks[f"reference_{name}"] == expected
    assert np.abs(trained[:, :, 0] - training._motions.reference[0, :, :, 0].numpy()).max() > 1e-4


def test_violations_equal_the_inverse_dynamics():
    """Excludes demands of another mass, or a limit on one side only."""
    training = made(SPATIAL, Shift(action_period=0.04, degree=3), action_limit=0.5, tension=20.0)
    motion = training.motion().detach().numpy()[training._motions.inside.numpy()]
    actions, tensions = (value.detach().numpy() for value in training._violations())
    robot = training.robot
    masses = robot.mass + np.array([[0.0], [training.payloads[0]]])
    derivatives = [np.stack([motion[:, order]] * 2) for order in range(3)]
    required = inverse_dynamics(robot, masses, *derivatives)
    demands = normalised_action(robot, required.torques, required.speeds)
    assert actions == pytest.approx(np.maximum(np.abs(demands) - 0.5, 0).ravel(), abs=1e-9)
    assert tensions == pytest.approx(np.maximum(1 - required.tensions / 20, 0).ravel(), abs=1e-9)
    assert actions.max() > 0
    assert tensions.max() > 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: made(PLANAR, Shift(), features=("shift",)), "remove 'shift'"),
        (
            lambda: made(SPATIAL, Shift(), softness=(1.0,) * 5),
            "softness is for planar robots with three cables",
        ),
        (lambda: made(SPATIAL, Shift(), tension=0.5), "below the robot's 1 N"),
        (lambda: GradientSettings(softness=(1.0,)), "softness"),
        (lambda: configured(motions="circle"), "motions"),
        (lambda: configured(motions={"loops": VALIDATION[0] + 1}), "loops"),
        (lambda: configured(motions={"named": [HELD_OUT]}), "motions"),
        (lambda: configured(tensoin=3.0), "tensoin"),
        (lambda: configured(steering={"kind": "planning"}), "base"),
        (lambda: configured(steering={"kind": "nonsense"}), "planning"),
        (lambda: configured(features=["nonsense"]), "nonsense"),
    ],
)
def test_invalid_training_is_rejected(call, message):
    with pytest.raises(ValueError, match=message):
        call()


@pytest.mark.slow
def test_softness_continues_the_search_at_kinks_of_the_tensions():
    """Excludes the softness of another round, or of none."""
    loop = {"name": "loop-planar", "dwell": 0, "acceleration": [25.0]}
    carried = {}
    for softness in ((), (20.0, 3.0)):
        training = made(
            "CableBot-FlexPlanar-v0",
            Shift(action_period=0.02, fraction=0.9, degree=4),
            features=("reference_acceleration", "time_since_start"),
            motions=[loop | {"seed": seed} for seed in (0, 5)],
            spread=0.01,
            rounds=(30.0, 300.0),
            iterations=40,
            softness=softness,
        )
        used = []
        for index in range(2):
            training.round(
                index, lambda training=training, used=used: used.append(training._softness)
            )
        assert list(dict.fromkeys(used)) == list(softness or (0.0,))
        carried[softness] = training.payloads.mean()
    assert carried[20.0, 3.0] > carried[()]


def test_falling_faster_than_gravity_is_a_violation():
    """The distribution of tensions gives an answer for such a load too, with tensions below the
    minimum."""
    training = made(
        "CableBot-Point-v0", Shift(action_period=0.02, fraction=0.985, degree=3), spread=3.0
    )
    falling = training.motion()[training._motions.inside][:, 2, 2] > 9.81
    tensions = training._violations()[1].reshape(2, -1, training.robot.cables).amax(dim=(0, 2))
    assert falling.any()
    assert (tensions[falling] > 0).all()


SMALL = {
    "base": {"law": "fl", "gains": [2500, 100], "minimum_tension": 2.0},
    "steering": {"kind": "shift", "action_period": 0.02, "fraction": 0.98, "degree": 3},
    "features": ["rbf_progress"],
    "rounds": [30, 300],
    "iterations": 40,
}


HELD_OUT = {"name": "loop-planar", "seed": FIRST_HELD_OUT_SEED}


def configured(**changes):
    return make_gradient_config(PLANAR, SMALL | changes)


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    path = tmp_path_factory.mktemp("configs") / "small.yaml"
    path.write_text(yaml.safe_dump({PLANAR: SMALL}))
    return path


@pytest.fixture(scope="module")
def trained(tmp_path_factory, config):
    """A finished run."""
    return train_gradient(
        PLANAR, out=tmp_path_factory.mktemp("trained") / "run", config=config, seed=3
    )


@pytest.mark.parametrize(
    ("env_id", "softness"), [(PLANAR, ()), ("CableBot-FlexPlanar-v0", (20.0,))]
)
def test_round_raises_the_payload(env_id, softness):
    mapping = Shift(action_period=0.02, fraction=0.98, degree=4)
    training = made(env_id, mapping, spread=0.01, rounds=(30.0,), iterations=10, softness=softness)
    before = training.payloads.mean()
    training.round(0)
    assert training.payloads.mean() > before


@pytest.mark.slow
def test_short_run_carries_far_more_than_its_base(trained):
    bundle = Bundle.load(trained.out / BEST)
    policy = LearnedPolicy(bundle, find_robot(env_robot(PLANAR)))
    payload = evaluate_dlcc(policy, PLANAR, criterion="task", resolution=0.05).payload
    assert payload == bundle.card["payload_kg"] == trained.best.payload_kg
    assert payload > 1.5 * trained.base_payload_kg > 1.0


@pytest.mark.slow
def test_interrupted_run_resumes_to_the_same_weights(
    trained, tmp_path, config, capsys, monkeypatch
):
    out = tmp_path / "run"
    signals = [signal.SIGTERM]

    def stop(done, total, text):
        if text.startswith("round 2") and signals:
            signal.raise_signal(signals.pop())

    with pytest.raises(Interrupted):
        train_gradient(PLANAR, out=out, config=config, seed=3, progress=stop)
    assert not (out / LAST).exists()
    assert len(TrainingResult.load(out).evaluations) == 1
    command = ["cablebot", "train", PLANAR, "--out", str(out), "--resume", "--json"]
    monkeypatch.setattr("sys.argv", command)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert not ended.value.code
    result = json.loads(capsys.readouterr().out)
    assert result["evaluations"][-1]["payload_kg"] == trained.evaluations[-1].payload_kg
    resumed, expected = (Bundle.load(folder / LAST).network for folder in (out, trained.out))
    for weights, expected_weights in zip(resumed.weights, expected.weights, strict=True):
        assert_array_equal(weights, expected_weights)


@pytest.mark.slow
def test_damaged_checkpoint_is_rejected(trained, tmp_path):
    out = shutil.copytree(trained.out, tmp_path / "run")
    (TrainingResult.load(out).checkpoint / "training.npz").write_bytes(b"damaged")
    with pytest.raises(ValueError, match="no file was changed"):
        train_gradient(PLANAR, out=out, resume=True)


def test_validation_loops_differ_from_training_loops():
    line = {"name": "line-planar", "duration": 2.0}
    config = configured(motions={"loops": 2, "named": ["paper-planar", line]})
    *loops, paper, named = config.trajectories
    assert [loop.motion.seed for loop in loops] == [0, 1]
    assert paper.name == "paper-planar"
    assert (named.name, named.motion.duration) == ("line-planar", 2.0)
    assert [loop.motion.seed for loop in config.validation] == list(VALIDATION)


def loop_seeds(trajectories):
    """Seeds of the random loops among trajectories."""
    motions = [
        trajectory.motion for trajectory in trajectories if isinstance(trajectory, BetweenDwells)
    ]
    return {motion.seed for motion in motions if isinstance(motion, RandomLoop)}


@pytest.mark.parametrize(
    "name", ["gradient", "planner", pytest.param("gradient-loops", marks=pytest.mark.slow)]
)
def test_shipped_configurations_use_training_motions_only(name):
    configs = yaml.safe_load((HYPERPARAMS / f"{name}.yaml").read_text())
    for env_id, plain in configs.items():
        config = make_gradient_config(env_id, plain)
        assert shortest_dwell(config.trajectories) == DWELL
        trained = loop_seeds(config.trajectories)
        validation = loop_seeds(config.validation)
        assert max(trained | validation, default=0) < FIRST_HELD_OUT_SEED
        assert trained.isdisjoint(VALIDATION)
        assert bool(trained) == bool(validation) == (name != "gradient")
