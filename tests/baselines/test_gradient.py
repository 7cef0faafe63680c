"""Training by gradients: it trains on the motion that is followed, its limits are the plant's, and runs go on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.features import REFERENCE_FEATURES
from cablebot_baselines.learned.gradient import GradientSettings, GradientTraining
from cablebot_baselines.learned.gradient_run import VALIDATION, make_gradient_config, train_gradient
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.runs import BEST, CHECKPOINT, EVALUATIONS, LAST, Interrupted
from cablebot_baselines.learned.steering import Shift, Steering
from cablebot_gym.cli import app as cli
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.observation import observed_reference
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED, find_trajectory

PLANAR, SPATIAL, FLEX = "CableBot-Planar-v0", "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"


def made(env_id, action_mapping, *, features=("rbf_time",), motions=None, **settings):
    robot = find_robot(env_robot(env_id))
    paper = "paper-planar" if robot.planar else "paper-spatial"
    trajectories = [find_trajectory(name, robot.coordinates) for name in motions or [paper]]
    return GradientTraining(
        robot=robot,
        trajectories=trajectories,
        action_mapping=action_mapping,
        features=features,
        settings=GradientSettings(**{"spread": 0.5, **settings}),
    )


@pytest.mark.parametrize(
    ("env_id", "law", "action_mapping", "features"),
    [
        (PLANAR, "fl", Shift(action_period=0.02, degree=3), ("rbf_time",)),
        (SPATIAL, "fl", Shift(action_period=0.01, degree=2, preview=0.05), REFERENCE_FEATURES),
        (FLEX, "motor-pd", Shift(action_period=0.04, degree=4, preview=0.02), ("time_since_start",)),
    ],
)
def test_what_is_trained_is_what_the_law_is_given(env_id, law, action_mapping, features):
    """Anchors, past control points, ramps, features or squashing that differ between training and use."""
    training = made(env_id, action_mapping, features=features, instants=2)
    trained, (trajectory,) = training.motion().detach().numpy()[0], training.trajectories
    steering = Steering(training.robot, base=Base(law=law), action_mapping=action_mapping, features=features)
    network, memory = training.network, None
    m = training.robot.cables
    worst = 0.0
    for step in range(200):
        time = np.array([step / 500])
        blocks = {
            name: value[0]
            for name, value in observed_reference(trajectory, time, to_snap=training.robot.flexible).items()
        }
        blocks |= {"pose": blocks["reference_pose"], "velocity": blocks["reference_velocity"]}
        blocks |= {"model_payload": np.zeros(1), "payload_known": np.ones(1)}
        blocks |= {"motor_angle": np.zeros(m), "motor_speed": np.zeros(m)}
        memory = steering.reset_memory(blocks, memory, False)
        action = network(steering.observe(blocks, memory))
        given = {}
        original = steering.law.respond
        steering.law.respond = lambda shifted, *rest, keep=given, call=original: (
            keep.update(shifted),
            call(shifted, *rest),
        )[1]
        _, memory = steering.respond(blocks, action, memory, False)
        steering.law.respond = original
        if step % steering.periods == 0:
            decision = trained[step // steering.periods, 0]
            # The first instant lies a billionth of a decision after it: a spline's derivatives jump there.
            for order, name in enumerate(("pose", "velocity")):
                worst = max(worst, np.abs(given[f"reference_{name}"] - decision[order]).max())
            if training.robot.flexible:
                assert given["reference_snap"] == pytest.approx(decision[4], rel=1e-5, abs=1e-3)
    assert worst < 1e-6
    assert np.abs(trained[:, :, 0] - training._motions.reference[0, :, :, 0].numpy()).max() > 1e-4, (
        "nothing was shifted"
    )


def test_limits_are_those_of_the_plant_with_the_payload_and_without():
    """Demands of another mass, or a limit that is looked at on one side alone."""
    training = made(SPATIAL, Shift(action_period=0.04, degree=3), action_limit=0.5, tension=20.0)
    motion = training.motion().detach().numpy()[training._motions.inside.numpy()]
    broken = [value.detach().numpy() for value in training._violations()]
    robot = training.robot
    demands, tensions = [], []
    for mass in (robot.mass, robot.mass + training.payloads[0]):
        needed = inverse_dynamics(robot, mass, *(motion[:, order] for order in range(3)))
        demands.append(normalised_action(robot, needed.torques, needed.speeds))
        tensions.append(needed.tensions)
    assert broken[0] == pytest.approx(np.maximum(np.abs(demands) - 0.5, 0).ravel(), abs=1e-9)
    assert broken[1] == pytest.approx(np.maximum(20.0 - np.array(tensions), 0).ravel() / 20.0, abs=1e-9)
    assert broken[0].max() > 0
    assert broken[1].max() > 0


def test_a_feature_of_what_the_policy_does_is_refused():
    with pytest.raises(ValueError, match="remove 'shift'"):
        made(PLANAR, Shift(), features=("rbf_time", "shift"))


def test_kinks_of_the_least_tensions_do_not_end_the_search():
    """On springs that have to follow them; a softness of another round, or of none."""
    carried = {}
    for softness in ((), (20.0, 3.0)):
        training = made(
            "CableBot-FlexPlanar-v0",
            Shift(action_period=0.02, fraction=0.9, degree=4),
            features=("reference_acceleration", "time_since_start"),
            motions=[{"name": "loop-planar", "seed": seed} for seed in (0, 5)],
            spread=0.01,
            rounds=(30.0, 300.0),
            iterations=40,
            softness=softness,
        )
        used = []
        training.run(lambda _, training=training, used=used: used.append(training._softness))
        assert list(dict.fromkeys(used)) == list(softness or (0.0,))
        carried[softness] = training.payloads.mean()
    assert carried[20.0, 3.0] > 1.2 * carried[()]


def test_softness_of_spatial_tensions_is_refused():
    with pytest.raises(ValueError, match="softness is for planar robots, but 'spatial' is spatial"):
        made(SPATIAL, Shift(), softness=(1.0,) * 5)


@pytest.mark.parametrize(
    "wrong",
    [
        *({"iterations": 0}, {"instants": 1}, {"action_limit": 0.0}, {"lighter": 1.0}, {"rounds": ()}),
        *({"softness": (1.0,)}, {"softness": (1.0, 1.0, 1.0, 1.0, -1.0)}),
    ],
)
def test_settings_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        GradientSettings(**wrong)


SMALL = {
    "base": {"law": "fl", "gains": [2500, 100], "minimum_tension": 2.0},
    "steering": {"kind": "shift", "action_period": 0.02, "fraction": 0.98, "degree": 3},
    "features": ["rbf_time"],
    "rounds": [30, 300],
    "iterations": 40,
}


@pytest.fixture
def config(tmp_path):
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump({PLANAR: SMALL}), encoding="utf-8")
    return path


def test_a_short_run_carries_far_more_than_its_base(tmp_path, config):
    out = tmp_path / "run"
    trained = train_gradient(PLANAR, out=out, config=config, seed=3)
    bundle = Bundle.load(out / BEST)
    robot = find_robot(env_robot(PLANAR))
    carried = evaluate_dlcc(LearnedPolicy(bundle, robot), PLANAR, criterion="task", resolution=0.05).payload
    assert carried == pytest.approx(trained.best.payload_kg)
    assert carried > 1.5 * trained.base_payload_kg > 1.0
    assert bundle.card["seed"] == 3
    assert bundle.card["planner_output_used"] is False
    assert bundle.card["payload_kg"] == trained.best.payload_kg
    assert len((out / EVALUATIONS).read_text(encoding="utf-8").splitlines()) == 3


def same(one, other):
    left, right = (Bundle.load(path / LAST).network.to_arrays() for path in (one, other))
    return all(np.array_equal(left[name], right[name]) for name in left)


def test_an_interrupted_run_goes_on_to_the_same_weights_and_another_seed_to_others(tmp_path, config, monkeypatch):
    train_gradient(PLANAR, out=tmp_path / "whole", config=config)
    train_gradient(PLANAR, out=tmp_path / "other", config=config, seed=1)
    calls = []

    def stop(text, done, total):
        calls.append(done)
        if text.startswith("round 2") and done > 45:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted):
        train_gradient(PLANAR, out=tmp_path / "cut", config=config, progress=stop)
    assert not (tmp_path / "cut" / LAST).exists()
    with pytest.raises(ValueError, match="--resume"):
        train_gradient(PLANAR, out=tmp_path / "cut", config=config)
    resumed = train_gradient(PLANAR, out=tmp_path / "cut", resume=True)
    assert len(resumed.evaluations) == 2
    commands = [Bundle.load(tmp_path / name / LAST).card["command"] for name in ("cut", "whole")]
    assert commands[0] == commands[1], "which configuration it was is not forgotten"
    assert same(tmp_path / "cut", tmp_path / "whole")
    assert not same(tmp_path / "other", tmp_path / "whole")


def test_a_damaged_checkpoint_and_another_configuration_are_refused_before_anything_changes(tmp_path, config):
    out = tmp_path / "run"
    train_gradient(PLANAR, out=out, config=config)
    kept = (out / BEST).read_bytes()
    for asked in ({"seed": 7}, {"config": Path("gradient")}):
        with pytest.raises(ValueError, match="another"):
            train_gradient(PLANAR, out=out, resume=True, **asked)
    data = (out / CHECKPOINT).read_bytes()
    (out / CHECKPOINT).write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match="no file was changed"):
        train_gradient(PLANAR, out=out, resume=True)
    assert (out / BEST).read_bytes() == kept


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"tensoin": 3.0}, "unknown key 'tensoin'"),
        ({"steering": {"kind": "residual"}}, "kind shift"),
        ({"motions": {"loops": 10_000}}, "from 1 to 9992, not 10000"),
        ({"motions": {"loops": 0}}, "from 1 to 9992, not 0"),
        ({"motions": "circle"}, "'paper', {loops: N}"),
        ({"motions": {"loop": 3}}, "'paper', {loops: N}"),
        ({"motions": {}}, "'paper', {loops: N}"),
        ({"motions": {"named": "paper-planar"}}, "such as"),
        ({"motions": {"named": ["paper-spatial"]}}, "not for 2 coordinates"),
        ({"motions": {"named": [{"name": "loop-planar", "seed": 10_000}]}}, "seed 10000 is reserved for evaluation"),
        ({"features": ["nonsense"]}, "unknown feature"),
    ],
)
def test_a_wrong_configuration_says_what_is_valid(change, words):
    with pytest.raises(ValueError, match=words):
        make_gradient_config(PLANAR, SMALL | change)


def test_motions_are_loops_and_named_ones_and_unseen_loops_judge():
    lines = {"name": "line-planar", "duration": 2.0}
    both = make_gradient_config(PLANAR, SMALL | {"motions": {"loops": 2, "named": ["paper-planar", lines]}})
    assert [one.name for one in both.trajectories] == ["loop-planar", "loop-planar", "paper-planar", "line-planar"]
    assert both.trajectories[-1].duration == 2.0
    assert [one.seed for one in both.validation] == list(VALIDATION)
    own = make_gradient_config(PLANAR, SMALL | {"motions": {"named": [lines]}})
    assert [one.name for one in own.trajectories] == [one.name for one in own.validation] == ["line-planar"]


@pytest.mark.parametrize("name", ["gradient", "gradient-margin", "gradient-loops"])
def test_shipped_configurations_keep_away_from_held_out_motions(name):
    from cablebot_baselines.learned.config import HYPERPARAMS

    for env_id, plain in yaml.safe_load((HYPERPARAMS / f"{name}.yaml").read_text(encoding="utf-8")).items():
        config = make_gradient_config(env_id, plain)
        seeds = {getattr(motion, "seed", 0) for motion in (*config.trajectories, *config.validation)}
        assert max(seeds) < FIRST_HELD_OUT_SEED
        trained = {getattr(motion, "seed", None) for motion in config.trajectories}
        assert not trained & set(VALIDATION)


def test_command_trains_and_refuses_options_of_other_algorithms(tmp_path, config, capsys, monkeypatch):
    def main(arguments):
        monkeypatch.setattr("sys.argv", ["cablebot", *arguments])
        cli.main()

    arguments = ["train", PLANAR, "--algo", "gradient", "--config", str(config), "--out", str(tmp_path / "run")]
    with pytest.raises(SystemExit) as stop:
        main([*arguments, "--timesteps", "5"])
    assert stop.value.code == 2
    assert "--timesteps is for ppo, sac and tqc" in capsys.readouterr().err
    with pytest.raises(SystemExit) as stop:
        main([*arguments, "--json"])
    assert stop.value.code in (0, None)
    said = json.loads(capsys.readouterr().out)
    assert said["evaluations"][-1]["payload_kg"] > said["base_payload_kg"]
