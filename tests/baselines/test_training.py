"""Training runs with Stable-Baselines3: configurations, export, checkpoints, interrupts and the
folder of a run."""

import csv
import json
import pickle
import shutil
import signal
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from stable_baselines3 import PPO

from cablebot_baselines.learned import training
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.recipe import (
    find_config,
    make_training_envs,
    trained_policy,
)
from cablebot_baselines.learned.training import TrainingRun
from cablebot_baselines.learned.wrappers.steered import ACTIONS
from cablebot_gym import ENV_IDS
from cablebot_gym.cli import app as cli

PLANAR = "CableBot-Planar-v0"
QUICK = {"control_frequency": 100, "payload_max": 1.0, "resolution": 0.5}
"""Conditions of a short evaluation."""

TINY = """
  n_envs: 32
  n_steps: 4
  batch_size: 64
  n_epochs: 2
  policy_kwargs: dict(net_arch=[8], activation_fn=nn.ReLU)
  n_timesteps: 256
  policy: MlpPolicy
  learning_rate: lin_1e-3
  normalize: true
  env_kwargs: {control_frequency: 100, trajectory: paper-planar, max_episode_steps: 100, terminate_on_violation: true}
  env_wrapper:
    - cablebot_baselines.learned.wrappers.PayloadCurriculum: {heaviest: 3, power: 0.6, start: 1, window: 5}
    - cablebot_baselines.learned.wrappers.Steered:
        base: {law: fl, gains: [900, 60]}
        steering: {kind: shift, action_period: 0.04, degree: 2}
        features: [time_since_start, actions, error, model_payload]
"""


def write_config(folder, **changes):
    """File of a configuration that trains in a second, with changes."""
    path = folder / "ppo.yaml"
    path.write_text(yaml.safe_dump({"default": yaml.safe_load(TINY) | changes}))
    return path


def run(out, changes=None, **options):
    """A training with a tiny configuration, which is written next to its folder."""
    config = write_config(out.parent, **(changes or {}))
    defaults = {"evaluation": QUICK, "eval_every": 128}
    return training.train(PLANAR, out=out, config=config, **(defaults | options))


def weights(path):
    network = Bundle.load(path).network
    return np.concatenate([array.ravel() for array in (*network.weights, *network.biases)])


def logged(folder, name):
    """Column of SB3's log."""
    with (folder / "progress.csv").open(newline="", encoding="utf-8") as file:
        return [float(row[name]) for row in csv.DictReader(file) if row[name]]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Folder of a finished PPO run of two updates."""
    out = tmp_path_factory.mktemp("trained") / "run"
    run(out, seed=3)
    return out


def test_shipped_configurations_are_valid():
    for env_id in ENV_IDS:
        config = find_config(env_id)
        names = [wrapper.__name__ for wrapper, _ in config.wrappers]
        assert names == ["PayloadCurriculum", "Steered"]
        assert config.env_kwargs["terminate_on_violation"]
        assert config.normalize["gamma"] == config.model["gamma"]


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_default_settings_follow_from_the_robot(env_id):
    """Nothing is compiled, because no environment is reset."""
    config = find_config("a robot without a key")
    env = make_training_envs(env_id, 2, config=config).unwrapped.env
    settings = env.unwrapped.settings
    periods = settings.trajectory.duration * settings.control_frequency
    assert env.steering.periods * ACTIONS == pytest.approx(periods, rel=0.01)
    assert (env.steering.base.law == "motor-pd") == settings.robot.flexible
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
        ({"env_wrapper": None}, {}, "env_wrapper must be a list of"),
        ({"nsteps": 5}, {}, "PPO rejects the hyperparameters .*nsteps"),
        ({"policy_kwargs": "dict(activation_fn=nn.ELU)"}, {}, "only linear layers"),
        ({"normalize": "dict(clip_obs=5.0)"}, {}, "clip_obs=10"),
        ({}, {"evaluation": {"draw": 3}}, "draw"),
        ({}, {"eval_every": 0}, "eval_every must be an integer"),
    ],
)
def test_invalid_values_leave_no_file(tmp_path, changes, options, message):
    with pytest.raises(ValueError, match=message):
        run(tmp_path / "run", changes=changes, **options)
    assert not (tmp_path / "run").exists()


def test_exported_network_equals_the_model(trained):
    """Some inputs are clipped."""
    model = PPO.load(trained / "checkpoints" / "rl_model_256_steps.zip", device="cpu")
    statistics = trained / "checkpoints" / "rl_model_vecnormalize_256_steps.pkl"
    normalize = pickle.loads(statistics.read_bytes())
    network = Bundle.load(trained / "last.zip").network
    spread = 20 * np.sqrt(normalize.obs_rms.var)
    draws = np.random.default_rng(0).normal(size=(200, network.inputs))
    observed = normalize.obs_rms.mean + spread * draws
    expected, _ = model.predict(normalize.normalize_obs(observed), deterministic=True)
    assert np.ptp(expected) > 1e-3
    assert np.max(np.abs(np.clip(network(observed), -1.0, 1.0) - expected)) < 1e-6


def test_run_writes_policies_log_and_card(trained):
    evaluated = TrainingRun.load(trained)
    assert [evaluation.timesteps for evaluation in evaluated.evaluations] == [128, 256]
    assert logged(trained / "log", "time/total_timesteps") == [128, 128, 256, 256]
    for name in ("train/learning_rate", "rollout/payload_ceiling", "rollout/success_rate"):
        assert logged(trained / "log", name)
    card = Bundle.load(trained / "best.zip").card
    assert card["seed"] == 3
    assert card["config"]["n_steps"] == 4
    assert card["done"] == evaluated.best.timesteps
    assert str(trained.parent) not in json.dumps(card)
    assert Bundle.load(trained / "last.zip").card["done"] == 256


@pytest.mark.landing
def test_same_seed_gives_the_same_weights(trained, tmp_path):
    """Also with the configuration in the folder of the run."""
    np.random.seed(9)  # noqa: NPY002 - SB3 draws from this generator
    for seed in (3, 4):
        out = tmp_path / str(seed)
        training.train(PLANAR, out=out, config=trained / "config.yaml", seed=seed, evaluation=QUICK)
        same = np.array_equal(weights(out / "last.zip"), weights(trained / "last.zip"))
        assert same == (seed == 3)


def test_resumed_run_continues_from_the_saved_model(trained, tmp_path, monkeypatch):
    """Without updates the weights stay, while normalisation, curriculum, evaluations and log
    continue."""
    copied = shutil.copytree(trained, tmp_path / "run")
    before = weights(copied / "last.zip")
    state = json.loads((copied / "run.json").read_text())
    (copied / "run.json").write_text(json.dumps(state | {"payload_ceiling": 1.25}))
    monkeypatch.setattr(PPO, "train", lambda self: None)
    result = training.resume_training(PLANAR, out=copied, timesteps=384)
    assert np.array_equal(weights(copied / "last.zip"), before)
    files = (copied / f"checkpoints/rl_model_vecnormalize_{n}_steps.pkl" for n in (256, 384))
    counts = [pickle.loads(file.read_bytes()).obs_rms.count for file in files]
    assert counts[1] > counts[0]
    assert result.done == 384
    assert result.payload_ceiling == 1.25
    assert [evaluation.timesteps for evaluation in result.evaluations] == [128, 256, 384]
    assert logged(copied / "log_256", "time/total_timesteps") == [384, 384]


@pytest.fixture
def command(tmp_path, monkeypatch, capsys):
    """Runs ``cablebot train`` and returns its exit status and standard error in one line."""

    def run(*arguments):
        line = ("cablebot", "train", PLANAR, "--out", tmp_path / "run", *arguments)
        monkeypatch.setattr(sys, "argv", [*map(str, line)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return ended.value.code, " ".join(capsys.readouterr().err.split())

    return run


@pytest.mark.landing
def test_interrupted_command_keeps_its_results_and_resumes(command, tmp_path, monkeypatch):
    out = tmp_path / "run"
    handler = signal.getsignal(signal.SIGTERM)
    signals = [signal.SIGTERM]
    train = PPO.train

    def interrupted(model):
        train(model)
        if model.num_timesteps == 256 and signals:
            signal.raise_signal(signals.pop())

    monkeypatch.setattr(PPO, "train", interrupted)
    options = ("--evaluation", json.dumps(QUICK), "--eval-every", 128, "--timesteps", 640)
    code, printed = command("--config", write_config(tmp_path), *options)
    stopped = TrainingRun.load(out)
    again = f"cablebot train {PLANAR} --out {out} --resume"
    assert code == 130
    assert f"stopped after 256 timesteps; to resume: {again}" in printed
    assert signal.getsignal(signal.SIGTERM) is handler
    assert (stopped.done, stopped.evaluated) == (256, 128)
    code, printed = command("--resume", "--seed", 3)
    assert (code, "leave out --seed" in printed) == (2, True)
    assert command("--resume", "--timesteps", 384)[0] == 0
    resumed = TrainingRun.load(out)
    assert [evaluation.timesteps for evaluation in resumed.evaluations] == [128, 256, 384]
    assert resumed.evaluations[0] == stopped.evaluations[0]


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

    monkeypatch.setattr(training, "evaluate_dlcc", evaluate)
    out = tmp_path / "run"
    with pytest.raises(training.Interrupted):
        run(out)
    stopped = TrainingRun.load(out)
    assert stopped.done == 128 * (interrupted - 1)
    assert len(stopped.evaluations) == interrupted - 2
    result = training.resume_training(PLANAR, out=out)
    assert [evaluation.timesteps for evaluation in result.evaluations] == [128, 256]
    assert "no gain over the base law" in str(result)
    assert (out / "last.zip").exists()


def test_second_interrupt_stops_immediately(tmp_path):
    def step(done, total, text):
        if text.startswith("training"):
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt) as stopped:
        run(tmp_path / "run", progress=step)
    assert not isinstance(stopped.value, training.Interrupted)
    assert not (tmp_path / "run" / "run.json").exists()


def test_best_policy_has_the_largest_evaluated_payload(tmp_path, monkeypatch):
    payloads = iter([0.5, None, 3.0, 2.0, 3.0])
    evaluations = []

    def evaluate(policy, env_id, **conditions):
        evaluations.append(conditions)
        return SimpleNamespace(payload=next(payloads))

    monkeypatch.setattr(training, "evaluate_dlcc", evaluate)
    run(tmp_path / "run", timesteps=512)
    card = Bundle.load(tmp_path / "run" / "best.zip").card
    assert card["done"] == 256
    assert card["base"]["payload_kg"] == 0.5
    assert [item["payload_kg"] for item in card["evaluations"]] == [None, 3.0]
    assert logged(tmp_path / "run" / "log", "eval/payload_kg") == [-1.0, 3.0, 2.0, 3.0]
    for conditions in evaluations:
        del conditions["progress"]
    assert evaluations == [{"criterion": "task", **QUICK}] * 5


def test_folder_of_a_run_is_not_overwritten(trained, tmp_path):
    before = (trained / "last.zip").read_bytes()
    with pytest.raises(ValueError, match="already contains a run: add --resume"):
        run(trained)
    with pytest.raises(ValueError, match="was started with CableBot-Planar-v0"):
        training.resume_training("CableBot-Spatial-v0", out=trained)
    assert training.resume_training(PLANAR, out=trained).done == 256  # nothing to do
    assert (trained / "last.zip").read_bytes() == before
    with pytest.raises(ValueError, match="there is no run to resume"):
        training.resume_training(PLANAR, out=tmp_path / "none")
