"""Training runs with Stable-Baselines3: configurations, export, checkpoints, interrupts and the folder of a run."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from cablebot_baselines.learned import runs, training
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.config import ALGORITHMS, algorithm_class, make_config
from cablebot_baselines.learned.export import network_from_sb3
from cablebot_baselines.learned.runs import TrainingResult, read_yaml
from cablebot_baselines.learned.vec_env import CableBotVecEnv
from cablebot_baselines.learned.wrappers import make_steered_vec
from cablebot_gym import ENV_IDS
from cablebot_gym.cli import app as cli

PLANAR = "CableBot-Planar-v0"
QUICK = {"control_frequency": 100, "payload_max": 1.0, "resolution": 0.5}
"""Conditions of a short evaluation."""

STEERED = "cablebot_baselines.learned.wrappers.Steered"
WRAPPERS = f"""
    - cablebot_baselines.learned.wrappers.WithinLimits: {{}}
    - cablebot_baselines.learned.wrappers.PayloadCurriculum: {{heaviest: 3, power: 0.6, start: 1, window: 5}}
    - {STEERED}:
        base: {{law: fl, gains: [900, 60]}}
        steering: {{kind: shift, action_period: 0.04, degree: 2}}
        features: [time_since_start, actions, error, model_payload]
"""
COMMON = """
  n_timesteps: 256
  policy: MlpPolicy
  learning_rate: lin_1e-3
  normalize: true
  env_kwargs: {control_frequency: 100, max_episode_steps: 100}
"""
OFF_POLICY = COMMON + "  n_envs: 8\n  buffer_size: 400\n  learning_starts: 64\n  batch_size: 32\n  gradient_steps: 1\n"
TINY = {
    "ppo": f"  n_envs: 32\n  n_steps: 4\n  batch_size: 64\n  n_epochs: 2\n  policy_kwargs: {{net_arch: [8]}}\n{COMMON}",
    "sac": f"  policy_kwargs: {{net_arch: [16, 8]}}\n{OFF_POLICY}",
    "tqc": f"  policy_kwargs: dict(net_arch=[8])\n{OFF_POLICY}",
}


def plain(algorithm="ppo", **changes):
    """Content of a configuration that trains in a second, with changes; ``...`` removes a key."""
    data = yaml.safe_load(f"{TINY[algorithm]}  env_wrapper:{WRAPPERS}")
    return {name: value for name, value in (data | changes).items() if value is not ...}


def run(out, algorithm="ppo", changes=None, **options):
    """A training with a tiny configuration, which is written next to its folder."""
    path = out.with_name(f"{algorithm}.yaml")
    path.write_text(yaml.safe_dump({"default": plain(algorithm, **(changes or {}))}), encoding="utf-8")
    defaults = {"evaluation": QUICK, "eval_every": 128, "checkpoint_every": 64}
    return training.train(PLANAR, out=out, algorithm=algorithm, config=path, **(defaults | options))


def weights(path):
    network = Bundle.load(path).network
    return np.concatenate([array.ravel() for array in (*network.weights, *network.biases)])


def digests(folder):
    return {path: hashlib.sha256(path.read_bytes()).digest() for path in folder.rglob("*") if path.is_file()}


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def interrupt(at, number=signal.SIGINT):
    """A progress function that sends one signal during the training."""
    sent = []

    def step(done, total, text):
        if done >= at and not sent and text.startswith("training"):
            sent.append(done)
            signal.raise_signal(number)

    return step


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


# ------------------------------------------------------------------------------------------------------ configurations


def test_shipped_configurations_are_valid():
    for algorithm in ALGORITHMS:
        for env_id in ENV_IDS:
            made = make_config(read_yaml(env_id, runs.Path(algorithm)))
            assert [wrapper.__name__ for wrapper, _ in made.wrappers] == [
                "WithinLimits",
                "PayloadCurriculum",
                "Steered",
            ]
            assert made.model["policy_kwargs"]["net_arch"] == [64, 64]
            assert made.normalize["gamma"] == made.model["gamma"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"n_timesteps": ...}, "n_timesteps must be given"),
        ({"n_envs": 1.5}, "n_envs must be an integer"),
        ({"learning_rate": "1e-3"}, "learning_rate must be a number, not '1e-3': YAML reads"),
        ({"policy_kwargs": "__import__('os').getcwd()"}, "policy_kwargs must be a mapping or text such as"),
        ({"env_wrapper": ["no.such.Wrapper"]}, "No module named 'no'"),
    ],
)
def test_invalid_configuration_is_rejected(changes, message):
    with pytest.raises(ValueError, match=message):
        make_config(plain(**changes))


def test_texts_of_rl_zoo_are_converted():
    text = "dict(net_arch=dict(pi=[8, 4], vf=[16]), activation_fn=nn.ReLU, log_std_init=-2.0)"
    expected = {"net_arch": {"pi": [8, 4], "vf": [16]}, "activation_fn": nn.ReLU, "log_std_init": -2.0}
    model = make_config(plain(policy_kwargs=text, learning_rate="lin_2e-3")).model
    assert model["policy_kwargs"] == expected
    assert [model["learning_rate"](left) for left in (1.0, 0.5, 0.0)] == pytest.approx([2e-3, 1e-3, 0.0])


def test_file_without_configuration_is_rejected(tmp_path):
    for text, message in (("a: [", "cannot read"), ("- 1", "must map environments"), ("other: {}", "has no key")):
        (tmp_path / "file.yaml").write_text(text, encoding="utf-8")
        with pytest.raises(ValueError, match=message):
            read_yaml(PLANAR, tmp_path / "file.yaml")


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({"nsteps": 5}, {}, "ppo rejects the hyperparameters .*nsteps"),
        ({"policy_kwargs": "dict(activation_fn=nn.ELU)"}, {}, "only linear layers"),
        ({"normalize": "dict(clip_obs=5.0)"}, {}, "clip_obs=10"),
        ({"env_kwargs": {"mass": 2}}, {}, "mass"),
        ({"env_wrapper": [{STEERED: {"base": "fl", "steering": "shift"}}]}, {}, "features"),
        ({}, {"timesteps": 0}, "--timesteps must be an integer of at least 1"),
        ({}, {"evaluation": {"draw": 3}}, "draw"),
    ],
)
def test_invalid_values_leave_no_file(tmp_path, changes, options, message):
    with pytest.raises(ValueError, match=message):
        run(tmp_path / "run", changes=changes, **options)
    assert not (tmp_path / "run").exists()


# -------------------------------------------------------------------------------------------------------------- export


@pytest.mark.slow
@pytest.mark.parametrize(("algorithm", "activation"), [("ppo", "Tanh"), ("sac", "ReLU"), ("tqc", "Tanh")])
def test_exported_network_equals_the_model(algorithm, activation):
    config = make_config(plain(algorithm, policy_kwargs=f"dict(net_arch=[9, 5], activation_fn=nn.{activation})"))
    envs = make_steered_vec(PLANAR, config.n_envs, wrappers=config.wrappers, seed=0, **config.env_kwargs)
    normalize = VecNormalize(CableBotVecEnv(envs), **config.normalize)
    model = algorithm_class(algorithm)(env=normalize, seed=3, device="cpu", **config.model)
    with runs.torch_threads(1):
        model.learn(128)
    network = network_from_sb3(model)
    spread = 20 * np.sqrt(normalize.obs_rms.var)  # some inputs are clipped
    observed = normalize.obs_rms.mean + spread * np.random.default_rng(0).normal(size=(200, network.inputs))
    expected = model.predict(normalize.normalize_obs(observed), deterministic=True)[0]
    assert np.ptp(expected) > 1e-3
    assert np.max(np.abs(np.clip(network(observed), -1.0, 1.0) - expected)) < 1e-6


# ---------------------------------------------------------------------------------------------------------------- runs


def test_run_writes_policies_evaluations_and_card(trained):
    result = TrainingResult.load(trained)
    table, logged = rows(trained / "evaluations.csv"), rows(trained / "progress.csv")
    assert [float(row["timesteps"]) for row in table] == [128, 256] == [one.timesteps for one in result.evaluations]
    assert [row["payload_kg"] for row in table] == [str(one.payload_kg or "") for one in result.evaluations]
    assert [float(row["time/total_timesteps"]) for row in logged] == [128.0, 256.0]
    assert {"train/learning_rate", "rollout/payload_ceiling"} <= {*logged[-1]}
    card = Bundle.load(trained / "best.zip").card
    assert card["command"].startswith(f"cablebot train {PLANAR} --algo ppo --config ppo.yaml --seed 3 --timesteps 256")
    assert (card["seed"], card["config"]["n_steps"], card["planner_output_used"]) == (3, 4, False)
    assert card["timesteps"] == result.best.timesteps == card["curve"][-1]["timesteps"]
    assert {"python", "numpy", "torch", "stable-baselines3", "cablebot-gym"} <= {*card["versions"]}
    assert str(trained.parent) not in json.dumps(card)
    assert Bundle.load(trained / "last.zip").card["timesteps"] == 256


@pytest.mark.slow
def test_same_seed_gives_the_same_weights(trained, tmp_path):
    np.random.seed(9)  # noqa: NPY002 - SB3 draws from this generator
    run(tmp_path / "same", seed=3)
    run(tmp_path / "other", seed=4)
    expected = weights(trained / "last.zip")
    assert np.array_equal(weights(tmp_path / "same" / "last.zip"), expected)
    assert not np.array_equal(weights(tmp_path / "other" / "last.zip"), expected)


def test_resumed_run_continues_from_the_saved_model(copied, monkeypatch):
    """Without updates the weights stay, while normalisation, curriculum, evaluations and logs continue."""
    before, state = weights(copied / "last.zip"), json.loads((copied / "run.json").read_text(encoding="utf-8"))
    (copied / "run.json").write_text(json.dumps(state | {"payload_ceiling": 1.25}), encoding="utf-8")
    counts = [pickle.loads((copied / "checkpoint/256/vecnormalize.pkl").read_bytes()).obs_rms.count]
    monkeypatch.setattr(PPO, "train", lambda self: None)
    result = training.train(PLANAR, out=copied, resume=True, timesteps=384)
    assert np.array_equal(weights(copied / "last.zip"), before)
    counts.append(pickle.loads((copied / "checkpoint/384/vecnormalize.pkl").read_bytes()).obs_rms.count)
    assert counts[1] > counts[0]
    assert (result.timesteps, result.payload_ceiling) == (384, 1.25)
    assert [one.timesteps for one in result.evaluations] == [128, 256, 384]
    assert result.wall_s > state["wall_s"]
    assert [float(row["time/total_timesteps"]) for row in rows(copied / "progress_256.csv")] == [384.0]
    assert len(rows(copied / "progress.csv")) == 2


def test_finished_run_is_not_trained_further(copied):
    before, messages = digests(copied), []
    assert training.train(PLANAR, out=copied, resume=True, say=messages.append).timesteps == 256
    assert digests(copied) == before
    assert "nothing to do: 256 timesteps are done" in messages[0]


@pytest.mark.parametrize(
    ("algorithm", "number"),
    [
        ("ppo", signal.SIGINT),
        pytest.param("sac", signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param("tqc", signal.SIGINT, marks=pytest.mark.slow),
    ],
)
def test_interrupted_run_keeps_its_results_and_resumes(tmp_path, algorithm, number):
    out, handler = tmp_path / "run", signal.getsignal(number)
    with pytest.raises(runs.Interrupted):
        run(out, algorithm, progress=interrupt(136, number), timesteps=512)
    assert signal.getsignal(number) is handler
    stopped = TrainingResult.load(out)
    assert 128 < stopped.timesteps <= 256
    assert stopped.evaluations[0].timesteps == 128
    assert (out / "best.zip").is_file()
    if algorithm != "ppo":
        assert pickle.loads((stopped.checkpoint / "replay_buffer.pkl").read_bytes()).pos == stopped.timesteps // 8
    resumed = training.train(PLANAR, out=out, resume=True, timesteps=384)
    assert resumed.timesteps == 384
    assert resumed.evaluations[: len(stopped.evaluations)] == stopped.evaluations
    if algorithm != "ppo":
        assert pickle.loads((resumed.checkpoint / "replay_buffer.pkl").read_bytes()).pos == resumed.timesteps // 8


def test_second_interrupt_stops_immediately(tmp_path):
    steps = []

    def step(done, total, text):
        if text.startswith("training"):
            steps.append(done)
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt) as stopped:
        run(tmp_path / "run", progress=step)
    assert not isinstance(stopped.value, runs.Interrupted)
    assert len(steps) == 2
    assert TrainingResult.load(tmp_path / "run").timesteps == 0


def test_worse_policy_does_not_replace_the_best(tmp_path, monkeypatch):
    payloads, asked = iter([0.5, None, 3.0, 2.0, 3.0]), []

    class Result:
        def __init__(self):
            self.payload = next(payloads)

    monkeypatch.setattr(runs, "evaluate_dlcc", lambda policy, env_id, **given: asked.append(given) or Result())
    result = run(tmp_path / "run", timesteps=512)
    card = Bundle.load(tmp_path / "run" / "best.zip").card
    assert (card["timesteps"], card["payload_kg"], card["base_payload_kg"]) == (256, 3.0, 0.5)
    assert [item["payload_kg"] for item in card["curve"]] == [None, 3.0]
    assert result.best.timesteps == 256
    assert [row["payload_kg"] for row in rows(tmp_path / "run" / "evaluations.csv")] == ["", "3.0", "2.0", "3.0"]
    assert asked == [{"criterion": "task", **QUICK}] * 5


@pytest.mark.parametrize("name", ["run.json", "checkpoint/256/model.zip", "checkpoint/256/vecnormalize.pkl"])
def test_damaged_checkpoint_is_rejected_before_anything_changes(copied, name):
    data = (copied / name).read_bytes()
    (copied / name).write_bytes(data[: len(data) // 2])
    before = digests(copied)
    with pytest.raises(ValueError, match=r"checkpoint .* cannot be resumed .*no file was changed"):
        training.train(PLANAR, out=copied, resume=True, timesteps=384)
    assert digests(copied) == before


def test_existing_run_is_neither_overwritten_nor_resumed_with_other_settings(trained, tmp_path):
    before = digests(trained)
    with pytest.raises(ValueError, match="already contains a run: add --resume"):
        run(trained)
    other = {"algorithm": "sac", "seed": 4, "config": runs.HYPERPARAMS / "ppo.yaml", "evaluation": {}}
    for name, value in other.items():
        with pytest.raises(ValueError, match="was started with"):
            training.train(PLANAR, out=trained, resume=True, **{name: value})
    assert digests(trained) == before
    with pytest.raises(ValueError, match="there is no run to resume"):
        training.train(PLANAR, out=tmp_path / "none", resume=True)
    assert not (tmp_path / "none").exists()


# --------------------------------------------------------------------------------------------------------- the command


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupted_command_prints_how_to_resume(tmp_path, monkeypatch, capsys):
    out, path = tmp_path / "run", tmp_path / "ppo.yaml"
    path.write_text(yaml.safe_dump({PLANAR: plain()}), encoding="utf-8")
    options = ["--evaluation", json.dumps(QUICK), "--eval-every", 10**6, "--timesteps", 10**6, "--checkpoint-every", 64]
    arguments = ["train", PLANAR, "--config", path, "--out", out, *options]
    start = "import cablebot_gym.cli.app as cli; cli.main()"
    command = [sys.executable, "-c", start, *map(str, arguments)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 60
    while not (out / "run.json").exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    done = TrainingResult.load(out).timesteps
    assert f"stopped after {done} timesteps; to resume: cablebot train {PLANAR} --out {out} --resume" in errors
    arguments = ["cablebot", "train", PLANAR, "--out", out, "--resume", "--timesteps", done + 128, "--json"]
    monkeypatch.setattr(sys, "argv", [*map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
    assert json.loads(capsys.readouterr().out)["timesteps"] == done + 128


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--algo", "dqn"], "unknown algorithm 'dqn'; choose one of ppo, sac, tqc, gradient"),
        (["--evaluation", "[1]"], "--evaluation must be a JSON object"),
        (["--config", "none.yaml"], "--config: cannot read 'none.yaml'"),
        (["--algo", "gradient", "--timesteps", "5"], "--timesteps is for ppo, sac and tqc"),
    ],
)
def test_bad_input_of_the_command_leaves_no_file(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.setattr(sys, "argv", ["cablebot", "train", PLANAR, "--out", str(tmp_path / "run"), *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run").exists()
