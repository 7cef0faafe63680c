"""Training runs with Stable-Baselines3: configurations, export, checkpoints, interrupts and the
folder of a run."""

import csv
import hashlib
import json
import pickle
import shutil
import signal
import sys
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import yaml
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

from cablebot_baselines.learned import runs, training
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.config import make_config
from cablebot_baselines.learned.export import network_from_sb3
from cablebot_baselines.learned.recipe import trained_policy
from cablebot_baselines.learned.runs import TrainingResult, read_yaml
from cablebot_baselines.learned.vec_env import CableBotVecEnv
from cablebot_baselines.learned.wrappers import make_steered_vec
from cablebot_baselines.learned.wrappers.steered import ACTIONS
from cablebot_gym import ENV_IDS
from cablebot_gym.cli import app as cli

PLANAR = "CableBot-Planar-v0"
QUICK = {"control_frequency": 100, "payload_max": 1.0, "resolution": 0.5}
"""Conditions of a short evaluation."""

WRAPPERS = """
    - cablebot_baselines.learned.wrappers.PayloadCurriculum: {heaviest: 3, power: 0.6, start: 1, window: 5}
    - cablebot_baselines.learned.wrappers.Steered:
        base: {law: fl, gains: [900, 60]}
        steering: {kind: shift, action_period: 0.04, degree: 2}
        features: [time_since_start, actions, error, model_payload]
"""
TINY = """
  n_envs: 32
  n_steps: 4
  batch_size: 64
  n_epochs: 2
  policy_kwargs: {net_arch: [8]}
  n_timesteps: 256
  policy: MlpPolicy
  learning_rate: lin_1e-3
  normalize: true
  env_kwargs: {control_frequency: 100, trajectory: paper-planar, max_episode_steps: 100, terminate_on_violation: true}
"""


def plain(**changes):
    """Content of a configuration that trains in a second, with changes."""
    return yaml.safe_load(f"{TINY}  env_wrapper:{WRAPPERS}") | changes


def run(out, changes=None, **options):
    """A training with a tiny configuration, which is written next to its folder."""
    path = out.with_name("ppo.yaml")
    path.write_text(yaml.safe_dump({"default": plain(**(changes or {}))}))
    defaults = {"evaluation": QUICK, "eval_every": 128, "checkpoint_every": 64}
    return training.train(PLANAR, out=out, config=path, **(defaults | options))


def weights(path):
    network = Bundle.load(path).network
    return np.concatenate([array.ravel() for array in (*network.weights, *network.biases)])


def digests(folder):
    return {
        path: hashlib.sha256(path.read_bytes()).digest()
        for path in folder.rglob("*")
        if path.is_file()
    }


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Folder of a finished PPO run of two updates."""
    out = tmp_path_factory.mktemp("trained") / "run"
    run(out, seed=3)
    return out


@pytest.fixture
def copied(trained, tmp_path):
    """A copy of the finished run."""
    return shutil.copytree(trained, tmp_path / "run")


def test_shipped_configurations_are_valid():
    for env_id in ENV_IDS:
        config = make_config(read_yaml(env_id, runs.HYPERPARAMS))
        names = [wrapper.__name__ for wrapper, _ in config.wrappers]
        assert names == ["PayloadCurriculum", "Steered"]
        assert config.env_kwargs["terminate_on_violation"]
        assert config.normalize["gamma"] == config.model["gamma"]


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_default_settings_follow_from_the_robot(env_id):
    """Nothing is compiled, because no environment is reset."""
    default = make_config(read_yaml("a robot without a key", runs.HYPERPARAMS))
    env: Any = gym.make_vec(
        env_id, num_envs=2, autoreset_mode=AutoresetMode.DISABLED, **default.env_kwargs
    )
    plant = env.settings
    for wrapper, arguments in default.wrappers:
        env = wrapper.vector(env, **arguments)
    periods = plant.trajectory.duration * plant.control_frequency
    assert env.steering.periods * ACTIONS == pytest.approx(periods, rel=0.01)
    assert (env.steering.base.law == "motor-pd") == plant.robot.flexible
    assert 0 < env.env.ceiling < env.env._highest_ceiling


def test_model_of_other_environments_is_refused():
    with pytest.raises(ValueError, match="must have the environments that it was trained on"):
        trained_policy(PPO("MlpPolicy", "CartPole-v1", device="cpu"))


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({"learning_rate": "1e-3"}, {}, "learning_rate must be a number, not '1e-3': YAML reads"),
        (
            {"policy_kwargs": "__import__('os').getcwd()"},
            {},
            "policy_kwargs must be a mapping or text such as",
        ),
        ({"nsteps": 5}, {}, "PPO rejects the hyperparameters .*nsteps"),
        ({"policy_kwargs": "dict(activation_fn=nn.ELU)"}, {}, "only linear layers"),
        ({"normalize": "dict(clip_obs=5.0)"}, {}, "clip_obs=10"),
        ({}, {"evaluation": {"draw": 3}}, "draw"),
    ],
)
def test_invalid_values_leave_no_file(tmp_path, changes, options, message):
    with pytest.raises(ValueError, match=message):
        run(tmp_path / "run", changes=changes, **options)
    assert not (tmp_path / "run").exists()


@pytest.mark.landing
def test_whole_rollouts_are_announced(tmp_path, monkeypatch):
    """Before the work."""
    monkeypatch.setattr(training, "_learn", lambda *_: None)
    said = []
    run(tmp_path / "run", timesteps=200, say=said.append)
    assert said == ["trains 256 timesteps: whole rollouts of 128"]


@pytest.mark.nightly
@pytest.mark.parametrize("activation", ["Tanh", "ReLU"])
def test_exported_network_equals_the_model(activation):
    config = make_config(
        plain(policy_kwargs=f"dict(net_arch=[9, 5], activation_fn=nn.{activation})")
    )
    envs = make_steered_vec(
        PLANAR, config.n_envs, wrappers=config.wrappers, seed=0, **config.env_kwargs
    )
    normalize = VecNormalize(CableBotVecEnv(envs), **config.normalize)
    model = PPO(env=normalize, seed=3, device="cpu", **config.model)
    with runs.torch_threads(1):
        model.learn(128)
    network = network_from_sb3(model)
    spread = 20 * np.sqrt(normalize.obs_rms.var)  # some inputs are clipped
    observed = normalize.obs_rms.mean + spread * np.random.default_rng(0).normal(
        size=(200, network.inputs)
    )
    expected = model.predict(normalize.normalize_obs(observed), deterministic=True)[0]
    assert np.ptp(expected) > 1e-3
    assert np.max(np.abs(np.clip(network(observed), -1.0, 1.0) - expected)) < 1e-6


def test_run_writes_policies_evaluations_and_card(trained):
    result = TrainingResult.load(trained)
    table = rows(trained / "evaluations.csv")
    logged = rows(trained / "progress.csv")
    assert (
        [float(row["timesteps"]) for row in table]
        == [128, 256]
        == [evaluation.timesteps for evaluation in result.evaluations]
    )
    assert [float(row["time/total_timesteps"]) for row in logged] == [128.0, 256.0]
    assert {"train/learning_rate", "rollout/payload_ceiling", "rollout/success_rate"} <= {
        *logged[-1]
    }
    card = Bundle.load(trained / "best.zip").card
    assert card["command"].startswith(
        f"cablebot train {PLANAR} --config ppo.yaml --seed 3 --timesteps 256"
    )
    assert card["seed"] == 3
    assert card["config"]["n_steps"] == 4
    assert card["timesteps"] == result.best.timesteps == card["curve"][-1]["timesteps"]
    assert str(trained.parent) not in json.dumps(card)
    assert Bundle.load(trained / "last.zip").card["timesteps"] == 256


@pytest.mark.landing
def test_same_seed_gives_the_same_weights(trained, tmp_path):
    np.random.seed(9)  # noqa: NPY002 - SB3 draws from this generator
    for seed in (3, 4):
        run(tmp_path / str(seed), seed=seed)
        same = np.array_equal(
            weights(tmp_path / str(seed) / "last.zip"), weights(trained / "last.zip")
        )
        assert same == (seed == 3)


def test_resumed_run_continues_from_the_saved_model(copied, monkeypatch):
    """Without updates the weights stay, while normalisation, curriculum, evaluations and logs
    continue."""
    before = weights(copied / "last.zip")
    state = json.loads((copied / "run.json").read_text())
    (copied / "run.json").write_text(json.dumps(state | {"payload_ceiling": 1.25}))
    counts = [pickle.loads((copied / "checkpoint/256/vecnormalize.pkl").read_bytes()).obs_rms.count]
    monkeypatch.setattr(PPO, "train", lambda self: None)
    result = training.train(PLANAR, out=copied, resume=True, timesteps=384)
    assert np.array_equal(weights(copied / "last.zip"), before)
    counts.append(
        pickle.loads((copied / "checkpoint/384/vecnormalize.pkl").read_bytes()).obs_rms.count
    )
    assert counts[1] > counts[0]
    assert result.timesteps == 384
    assert result.payload_ceiling == 1.25
    assert [evaluation.timesteps for evaluation in result.evaluations] == [128, 256, 384]
    assert [float(row["time/total_timesteps"]) for row in rows(copied / "progress_256.csv")] == [
        384.0
    ]
    assert len(rows(copied / "progress.csv")) == 2


@pytest.mark.landing
def test_interrupted_command_keeps_its_results_and_resumes(tmp_path, monkeypatch, capsys):
    out = tmp_path / "run"
    path = tmp_path / "ppo.yaml"
    handler = signal.getsignal(signal.SIGTERM)
    path.write_text(yaml.safe_dump({PLANAR: plain()}))
    options = [
        "--evaluation",
        json.dumps(QUICK),
        "--eval-every",
        128,
        "--checkpoint-every",
        64,
        "--timesteps",
        640,
    ]
    signals = [signal.SIGTERM]
    train = PPO.train

    def interrupted(model):
        train(model)
        if model.num_timesteps == 256 and signals:
            signal.raise_signal(signals.pop())

    def command(*arguments):
        monkeypatch.setattr(
            sys, "argv", [*map(str, ("cablebot", "train", PLANAR, "--out", out, *arguments))]
        )
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return ended.value.code, capsys.readouterr()

    monkeypatch.setattr(PPO, "train", interrupted)
    code, printed = command("--config", path, *options)
    stopped = TrainingResult.load(out)
    again = f"stopped after {stopped.timesteps} timesteps; to resume: cablebot train {PLANAR} --out {out} --resume"
    assert code == 130
    assert again in " ".join(printed.err.split())
    assert signal.getsignal(signal.SIGTERM) is handler
    assert 256 <= stopped.timesteps < 640
    assert stopped.evaluations[0].timesteps == 128
    code, printed = command("--resume", "--timesteps", stopped.timesteps + 128)
    assert code == 0
    assert TrainingResult.load(out).timesteps == stopped.timesteps + 128
    assert TrainingResult.load(out).evaluations[: len(stopped.evaluations)] == stopped.evaluations


@pytest.mark.landing
@pytest.mark.parametrize("interrupted", [2, 3])
def test_signal_stops_an_evaluation_that_resuming_repeats(tmp_path, monkeypatch, interrupted):
    """The first evaluation is that of the base law, the third that of the last policy."""
    evaluations = []

    def evaluate(policy, env_id, progress, **conditions):
        evaluations.append(policy)
        if len(evaluations) == interrupted:
            signal.raise_signal(signal.SIGTERM)
        progress(1, 2)
        return SimpleNamespace(payload=1.0)

    monkeypatch.setattr(runs, "evaluate_dlcc", evaluate)
    out = tmp_path / "run"
    with pytest.raises(runs.Interrupted):
        run(out)
    stopped = TrainingResult.load(out)
    assert (stopped.timesteps, len(stopped.evaluations)) == (
        128 * (interrupted - 1),
        interrupted - 2,
    )
    result = training.train(PLANAR, out=out, resume=True)
    assert [evaluation.timesteps for evaluation in result.evaluations] == [128, 256]
    assert "no gain over the base law" in str(result)
    assert (out / "last.zip").exists()
    assert (out / "learning-curve.png").read_bytes().endswith(b"IEND\xaeB`\x82")


def test_second_interrupt_stops_immediately(tmp_path):
    def step(done, total, text):
        if text.startswith("training"):
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt) as stopped:
        run(tmp_path / "run", progress=step)
    assert not isinstance(stopped.value, runs.Interrupted)
    assert TrainingResult.load(tmp_path / "run").timesteps == 0


def test_best_policy_has_the_largest_evaluated_payload(tmp_path, monkeypatch):
    payloads = iter([0.5, None, 3.0, 2.0, 3.0])
    evaluations = []

    def evaluate(policy, env_id, **conditions):
        evaluations.append(conditions)
        return SimpleNamespace(payload=next(payloads))

    monkeypatch.setattr(runs, "evaluate_dlcc", evaluate)
    run(tmp_path / "run", timesteps=512)
    card = Bundle.load(tmp_path / "run" / "best.zip").card
    assert card["timesteps"] == 256
    assert card["payload_kg"] == 3.0
    assert card["base_payload_kg"] == 0.5
    assert [item["payload_kg"] for item in card["curve"]] == [None, 3.0]
    assert [row["payload_kg"] for row in rows(tmp_path / "run" / "evaluations.csv")] == [
        "",
        "3.0",
        "2.0",
        "3.0",
    ]
    for conditions in evaluations:
        del conditions["progress"]
    assert evaluations == [{"criterion": "task", **QUICK}] * 5


def test_run_is_resumed_only_with_its_settings(trained, tmp_path):
    before = digests(trained)
    with pytest.raises(ValueError, match="already contains a run: add --resume"):
        run(trained)
    for changes in (
        {"seed": 4},
        {"config": runs.HYPERPARAMS},
        {"evaluation": {}},
    ):
        with pytest.raises(ValueError, match="was started with"):
            training.train(PLANAR, out=trained, resume=True, **changes)
    assert training.train(PLANAR, out=trained, resume=True).timesteps == 256  # nothing to do
    assert digests(trained) == before
    with pytest.raises(ValueError, match="there is no run to resume"):
        training.train(PLANAR, out=tmp_path / "none", resume=True)
