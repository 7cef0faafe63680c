"""Training runs: configurations, export, checkpoints that go on to the bit, and what a folder of a run holds."""

from __future__ import annotations

import csv
import hashlib
import json
import os
import pickle
import signal
import subprocess
import sys
import time
import zipfile

import gymnasium as gym
import numpy as np
import pytest
import torch
import yaml
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

import cablebot_baselines.learned.training as training
from cablebot_baselines.learned import checkpoint
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.config import (
    ALGORITHMS,
    HYPERPARAMS,
    STEERED,
    algorithm_class,
    make_config,
    read_config,
)
from cablebot_baselines.learned.export import network_from_sb3
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.vec_env import CableBotVecEnv
from cablebot_baselines.learned.wrappers import make_steered_vec
from cablebot_gym import ENV_IDS
from cablebot_gym.cli import app as cli
from cablebot_gym.physics import kernel
from cablebot_gym.robots import PLANAR as PLANAR_ROBOT

PLANAR = "CableBot-Planar-v0"
QUICK = {"control_frequency": 100, "payload_max": 1.0, "resolution": 0.5}
"""Conditions of an evaluation that takes no time."""

WRAPPERS = """
    - cablebot_baselines.learned.wrappers.WithinLimits: {}
    - cablebot_baselines.learned.wrappers.PayloadCurriculum: {heaviest: 3, power: 0.6, start: 1, window: 5}
    - cablebot_baselines.learned.wrappers.Steered:
        base: {law: fl, gains: [900, 60]}
        steering: {kind: shift, action_period: 0.04, degree: 2}
        features: [time_since_start, actions, error, model_payload]
"""
COMMON = """
  n_timesteps: 640
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


@pytest.fixture(autouse=True)
def _one_thread():
    """Threads of torch that wait for each other on busy cores would take most of the time."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def config(tmp_path):
    """A file for each algorithm that trains in no time."""
    folder = tmp_path / "configs"
    folder.mkdir()
    for algorithm, text in TINY.items():
        whole = f"default:\n{text}  env_wrapper:{WRAPPERS}"
        (folder / f"{algorithm}.yaml").write_text(whole, encoding="utf-8")
    return lambda algorithm: folder / f"{algorithm}.yaml"


def plain(algorithm="ppo", **changes):
    """What a valid file says, changed."""
    data = yaml.safe_load(f"{TINY[algorithm]}  env_wrapper:{WRAPPERS}")
    return {name: value for name, value in (data | changes).items() if value is not ...}


def weights(path):
    """Arrays of a policy's network by name."""
    return Bundle.load(path).network.to_arrays()


def same(one, other):
    """Whether two policies are the same to the bit."""
    first, second = weights(one), weights(other)
    return first.keys() == second.keys() and all(np.array_equal(first[name], second[name]) for name in first)


def contents(folder):
    """A digest of every file."""
    return {path.name: hashlib.sha256(path.read_bytes()).digest() for path in folder.iterdir() if path.is_file()}


def rows(path):
    """Of a CSV file."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# ------------------------------------------------------------------------------------------------------ configurations


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("env_id", ENV_IDS)
def test_no_configuration_that_ships_is_invalid(env_id, algorithm):
    made = make_config(env_id, algorithm, read_config(env_id, algorithm))
    assert [wrapper.__name__ for wrapper, _ in made.wrappers] == ["WithinLimits", "PayloadCurriculum", "Steered"]
    assert made.action_mapping.action_period == 0.04
    assert (HYPERPARAMS / f"{algorithm}.yaml").is_file()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nsteps": 5}, "unknown key 'nsteps'; it takes n_timesteps, n_envs, .*gae_lambda"),
        ({"frame_stack": 2}, "unknown key 'frame_stack'"),
        ({"seed": 2}, "unknown key 'seed'"),
        ({"n_timesteps": "many"}, "n_timesteps must be a whole number of at least 1"),
        ({"n_timesteps": ...}, "n_timesteps must be a whole number"),
        ({"n_envs": 1.5}, "n_envs must be a whole number"),
        ({"policy": "CnnPolicy"}, "policy must be 'MlpPolicy'"),
        ({"learning_rate": "1e-3"}, "learning_rate must be a number above 0, such as 1.0e-3, or a linear schedule"),
        ({"learning_rate": "lin_fast"}, "'lin_1e-3', not 'lin_fast'"),
        ({"clip_range": -0.2}, "clip_range must be a number above 0"),
        ({"gamma": "9e-1"}, "gamma must be a number, not the text '9e-1'"),
        ({"n_epochs": [2]}, r"n_epochs must be a number, not \[2\]"),
        ({"normalize": False}, "normalize must be true"),
        ({"normalize": {"norm_obs": False}}, "normalize must be true, or a mapping with norm_obs: true"),
        ({"normalize": {"clip_obs": 5.0}}, "clip_obs is 10 in an exported network"),
        ({"normalize": "dict(norm_rewards=True)"}, "unknown key 'norm_rewards'; it takes norm_obs, norm_reward"),
        ({"policy_kwargs": "dict(net_arch=[64], features_extractor_class=1)"}, "cannot be exported to a bundle"),
        ({"policy_kwargs": "__import__('os').getcwd()"}, "policy_kwargs must be a mapping or text such as"),
        ({"policy_kwargs": "dict(net_arch=[2] * 3)"}, "policy_kwargs must be a mapping or text such as"),
        ({"policy_kwargs": "dict(activation_fn=nn.GELU)"}, "policy_kwargs must be a mapping or text such as"),
        ({"policy_kwargs": {"activation_fn": "relu"}}, "activation_fn must be nn.Tanh or nn.ReLU"),
        ({"policy_kwargs": [64, 64]}, "policy_kwargs must be a mapping"),
        ({"env_wrapper": ...}, f"env_wrapper must contain {STEERED} exactly once"),
        ({"env_wrapper": [{STEERED: {"base": "fl", "steering": "shift"}}]}, "features must be given explicitly"),
        (
            {"env_wrapper": [{STEERED: {"base": "fl", "steering": "push", "features": ["error"]}}]},
            "unknown kind 'push'",
        ),
        ({"env_wrapper": [{STEERED: {"base": "fl", "steering": "shift", "features": ["eror"]}}]}, "feature 'eror'"),
        ({"env_wrapper": [{STEERED: {}, "other": {}}]}, "env_wrapper must be a list of 'package.module.Class"),
        ({"env_wrapper": ["no.such.Wrapper", *plain()["env_wrapper"]]}, "cannot import 'no.such.Wrapper'"),
    ],
)
def test_invalid_configuration_is_not_trained_with(changes, message):
    with pytest.raises(ValueError, match=message):
        make_config(PLANAR, "ppo", plain(**changes))


def test_unknown_algorithm_or_environment_is_not_trained():
    with pytest.raises(ValueError, match="unknown algorithm 'dqn'; choose one of ppo, sac, tqc"):
        read_config(PLANAR, "dqn")
    with pytest.raises(ValueError, match="unknown environment 'CartPole-v1'; choose one of CableBot"):
        make_config("CartPole-v1", "ppo", plain())
    with pytest.raises(
        ValueError, match=r"ppo.yaml has no key CartPole-v1 and no key default; it has CableBot-Planar-v0"
    ):
        read_config("CartPole-v1", "ppo")


@pytest.mark.parametrize(
    ("text", "message"),
    [(None, "cannot read"), ("a: [", "not valid YAML"), ("- 1", "must map environments"), ("other: {}", "has no key")],
)
def test_file_that_is_no_configuration_is_not_read(tmp_path, text, message):
    path = tmp_path / "file.yaml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        read_config(PLANAR, "ppo", path)


def test_schedule_does_not_fall_to_anything_but_0():
    model = make_config(PLANAR, "ppo", plain(learning_rate="lin_2e-3", clip_range=0.1, clip_range_vf=None)).model
    assert isinstance(model["learning_rate"], LinearSchedule)
    assert [model["learning_rate"](left) for left in (1.0, 0.5, 0.0)] == pytest.approx([2e-3, 1e-3, 0.0])
    assert (model["clip_range"], model["clip_range_vf"]) == (0.1, None)


def test_policy_keywords_as_text_do_not_differ_from_a_mapping():
    text = "dict(net_arch=dict(pi=[8, 4], vf=[16]), activation_fn=nn.ReLU, log_std_init=-2.0, ortho_init=False)"
    kwargs = make_config(PLANAR, "ppo", plain(policy_kwargs=text)).model["policy_kwargs"]
    mapping = {"net_arch": {"pi": [8, 4], "vf": [16]}, "log_std_init": -2.0, "ortho_init": False}
    assert kwargs == mapping | {"activation_fn": nn.ReLU}
    assert make_config(PLANAR, "ppo", plain(policy_kwargs=mapping)).model["policy_kwargs"] == mapping


def test_normalisation_does_not_lack_the_discount():
    made = make_config(PLANAR, "ppo", plain(gamma=0.9, normalize="dict(norm_reward=False, epsilon=1e-6)"))
    assert made.normalize == {"norm_reward": False, "epsilon": 1e-6, "gamma": 0.9}


# -------------------------------------------------------------------------------------------------------------- export


@pytest.mark.parametrize("activation", ["Tanh", "ReLU"])
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_exported_network_does_not_differ_from_the_model(algorithm, activation):
    config = make_config(
        PLANAR, algorithm, plain(algorithm, policy_kwargs=f"dict(net_arch=[9, 5], activation_fn=nn.{activation})")
    )
    envs = make_steered_vec(PLANAR, config.n_envs, wrappers=config.wrappers, seed=0, **config.env_kwargs)
    normalize = VecNormalize(CableBotVecEnv(envs), **config.normalize)
    model = algorithm_class(algorithm)("MlpPolicy", normalize, seed=3, device="cpu", **config.model)
    model.learn(256)
    network = network_from_sb3(model, normalize)
    generator = np.random.default_rng(0)
    spread = 20 * np.sqrt(normalize.obs_rms.var)  # enough that some are cut
    seen = normalize.obs_rms.mean + spread * generator.normal(size=(200, network.inputs))
    wanted = model.predict(normalize.normalize_obs(seen), deterministic=True)[0]
    assert np.ptp(wanted) > 1e-3
    assert np.max(np.abs(np.clip(network(seen), -1.0, 1.0) - wanted)) < 1e-6
    normalize.close()


def test_what_a_network_cannot_be_is_not_exported():
    config = make_config(PLANAR, "ppo", plain())
    envs = make_steered_vec(PLANAR, 2, wrappers=config.wrappers, seed=0, **config.env_kwargs)
    normalize = VecNormalize(CableBotVecEnv(envs))
    made = algorithm_class("ppo")
    keywords = {"n_steps": 8, "batch_size": 16, "device": "cpu"}
    with pytest.raises(ValueError, match="only linear layers"):
        network_from_sb3(made("MlpPolicy", normalize, policy_kwargs={"activation_fn": nn.ELU}, **keywords), normalize)
    model = made("MlpPolicy", normalize, **keywords)
    normalize.clip_obs = 5.0
    with pytest.raises(ValueError, match="clip_obs=10"):
        network_from_sb3(model, normalize)
    normalize.close()


# ---------------------------------------------------------------------------------------------------------------- runs


def run(config, out, algorithm="ppo", **keywords):
    """A tiny run."""
    defaults = {"algorithm": algorithm, "config": config(algorithm), "evaluation": QUICK}
    defaults |= {"eval_every": 320, "checkpoint_every": 128}
    return training.train(PLANAR, out=out, **(defaults | keywords))


def stopping(at):
    """A progress that sends SIGINT once, on the way."""
    sent = []

    def step(text, done, total):
        if done >= at and not sent and text.startswith("training"):
            sent.append(done)
            signal.raise_signal(signal.SIGINT)

    return step


def test_same_seed_does_not_give_other_weights(config, tmp_path):
    torch.manual_seed(5)
    first = run(config, tmp_path / "a", seed=1)
    state = torch.get_num_threads()
    np.random.seed(9)  # noqa: NPY002 - what SB3 draws from must not matter
    run(config, tmp_path / "b", seed=1)
    run(config, tmp_path / "c", seed=2)
    assert same(tmp_path / "a" / "last.zip", tmp_path / "b" / "last.zip")
    assert not same(tmp_path / "a" / "last.zip", tmp_path / "c" / "last.zip")
    assert torch.get_num_threads() == state
    assert (first.timesteps, [item.timesteps for item in first.evaluations]) == (640, [384, 640])


def test_folder_of_a_run_does_not_lack_anything(config, tmp_path):
    out = tmp_path / "run"
    trained = run(config, out, seed=3)
    assert {"best.zip", "last.zip", "checkpoint.zip", "evaluations.csv", "progress.csv"} <= {*contents(out)}
    table = rows(out / "evaluations.csv")
    assert [float(row["timesteps"]) for row in table] == [384, 640]
    assert 0 < float(table[0]["wall_s"]) < float(table[1]["wall_s"]) <= trained.wall_s
    assert [row["payload_kg"] for row in table] == [
        "" if item.payload_kg is None else str(item.payload_kg) for item in trained.evaluations
    ]
    logged = rows(out / "progress.csv")
    assert [float(row["time/total_timesteps"]) for row in logged] == [128.0 * count for count in range(1, 6)]
    assert {"train/learning_rate", "rollout/ep_rew_mean", "rollout/payload_ceiling"} <= {*logged[-1]}
    bundle = Bundle.load(out / "best.zip")
    card = bundle.card
    words = "cablebot train CableBot-Planar-v0 --algo ppo --config ppo.yaml --seed 3 --timesteps 640"
    assert card["command"].startswith(words)
    assert (card["seed"], card["algorithm"], card["env_id"]) == (3, "ppo", PLANAR)
    assert card["config"]["n_steps"] == 4
    assert card["planner_output_used"] is False
    assert card["base_payload_kg"] == trained.base_payload_kg
    assert {"python", "numpy", "torch", "stable-baselines3", "cablebot-gym"} <= {*card["versions"]}
    assert card["timesteps"] == trained.best.timesteps == card["curve"][-1]["timesteps"]
    assert str(tmp_path) not in json.dumps(card)
    env = gym.make(PLANAR)
    action = LearnedPolicy(bundle, PLANAR_ROBOT).predict(env.reset(seed=0)[0])[0]
    assert action.shape == (3,)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_interrupted_run_does_not_end_with_other_weights(config, tmp_path, algorithm):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    expected = run(config, whole, algorithm)
    with pytest.raises(training.Interrupted):
        run(config, parts, algorithm, progress=stopping(200))
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with pytest.raises(training.Interrupted):
        training.train(PLANAR, out=parts, resume=True, progress=stopping(400))
    torch.manual_seed(17)
    np.random.seed(17)  # noqa: NPY002
    trained = training.train(PLANAR, out=parts, resume=True)
    assert same(whole / "last.zip", parts / "last.zip")
    assert [item.payload_kg for item in trained.evaluations] == [item.payload_kg for item in expected.evaluations]
    assert trained.wall_s > 0
    steps = [[row["time/total_timesteps"] for row in rows(folder / "progress.csv")] for folder in (whole, parts)]
    assert [*map(float, steps[0])] == [*map(float, steps[1])]


@pytest.mark.parametrize("at", [1, 400])
def test_run_that_died_does_not_end_with_other_weights(config, tmp_path, at):
    class Died(Exception):
        pass

    def die(text, done, total):
        if done > at:
            raise Died

    run(config, tmp_path / "whole")
    with pytest.raises(Died):
        run(config, tmp_path / "parts", progress=die)
    training.train(PLANAR, out=tmp_path / "parts", resume=True)
    assert same(tmp_path / "whole" / "last.zip", tmp_path / "parts" / "last.zip")


def test_worse_policy_does_not_replace_the_best(config, tmp_path, monkeypatch):
    payloads = iter([0.5, None, 1.0, 3.0, 2.0, 3.0])

    class Result:
        def __init__(self):
            self.payload = next(payloads)

    asked = []
    monkeypatch.setattr(training, "evaluate_dlcc", lambda policy, env_id, **given: asked.append(given) or Result())
    trained = run(config, tmp_path / "run", eval_every=128)
    card = Bundle.load(tmp_path / "run" / "best.zip").card
    assert (card["timesteps"], card["payload_kg"], card["base_payload_kg"]) == (384, 3.0, 0.5)
    assert [item["payload_kg"] for item in card["curve"]] == [None, 1.0, 3.0]
    assert trained.best.timesteps == 384
    assert [row["payload_kg"] for row in rows(tmp_path / "run" / "evaluations.csv")] == ["", "1.0", "3.0", "2.0", "3.0"]
    assert asked == [{"criterion": "task", **QUICK}] * 6


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A run that was stopped."""
    folder = tmp_path_factory.mktemp("stopped")
    path = folder / "ppo.yaml"
    path.write_text(f"default:\n{TINY['ppo']}  env_wrapper:{WRAPPERS}", encoding="utf-8")
    with pytest.raises(training.Interrupted):
        run(lambda _: path, folder / "run", progress=stopping(64))
    return folder / "run"


def damaged(stopped, folder, how):
    """A copy of a run with another checkpoint."""
    folder.mkdir()
    data = (stopped / "checkpoint.zip").read_bytes()
    if how == "cut":
        data = data[: len(data) // 2]
    elif how == "changed":
        place = len(data) // 2
        data = data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]
    elif how == "empty":
        data = b""
    (folder / "checkpoint.zip").write_bytes(data)
    if how in ("short", "newer"):
        with zipfile.ZipFile(stopped / "checkpoint.zip") as file:
            parts = {name: file.read(name) for name in file.namelist()}
        if how == "short":
            del parts["random.pkl"]
        else:
            parts["state.json"] = json.dumps(json.loads(parts["state.json"]) | {"format": 99}).encode()
        with zipfile.ZipFile(folder / "checkpoint.zip", "w") as file:
            for name, blocks in parts.items():
                file.writestr(name, blocks)
    (folder / "progress.csv").write_text("kept", encoding="utf-8")
    return folder


@pytest.mark.parametrize("how", ["cut", "changed", "empty", "short", "newer"])
def test_damaged_checkpoint_is_not_resumed_and_nothing_is_overwritten(stopped, tmp_path, how):
    folder = damaged(stopped, tmp_path / "run", how)
    before = contents(folder)
    with pytest.raises(ValueError, match=r"checkpoint .* cannot be resumed .*no file was changed"):
        training.train(PLANAR, out=folder, resume=True)
    assert contents(folder) == before


def test_checkpoint_of_other_code_is_not_resumed(stopped, tmp_path, monkeypatch):
    folder = damaged(stopped, tmp_path / "run", "kept")
    before = contents(folder)
    monkeypatch.delattr("cablebot_baselines.learned.wrappers.steered.SteeredVector")
    with pytest.raises(ValueError, match="with these versions of the packages"):
        training.train(PLANAR, out=folder, resume=True)
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"algorithm": "sac"}, "was started with --algo ppo, not sac: omit it"),
        ({"seed": 4}, "was started with --seed 0, not 4"),
        ({"eval_every": 3}, "was started with --eval-every 320, not 3"),
        ({"config": HYPERPARAMS / "ppo.yaml"}, "was started with another --config"),
        ({"evaluation": {}}, "was started with --evaluation"),
    ],
)
def test_run_does_not_go_on_with_other_settings(stopped, changes, message):
    before = contents(stopped)
    with pytest.raises(ValueError, match=message):
        training.train(PLANAR, out=stopped, resume=True, **changes)
    with pytest.raises(ValueError, match="was started with ID CableBot-Planar-v0"):
        training.train("CableBot-Spatial-v0", out=stopped, resume=True)
    assert contents(stopped) == before


def test_folder_with_a_run_is_not_written_to(config, stopped, tmp_path):
    before = contents(stopped)
    with pytest.raises(
        ValueError, match=r"already contains a run .*: add --resume to resume it, or choose another --out"
    ):
        run(config, stopped)
    assert contents(stopped) == before
    with pytest.raises(ValueError, match=r"there is no run to resume.*Omit --resume"):
        training.train(PLANAR, out=tmp_path / "none", resume=True)
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"timesteps": 0}, "timesteps must be a whole number of at least 1"),
        ({"seed": -1}, "--seed must be at least 0"),
        ({"threads": 0}, "--threads must be at least 1"),
        ({"eval_every": 0}, "--eval-every must be at least 1"),
        ({"evaluation": {"draw": 3}}, "draw"),
    ],
)
def test_bad_argument_does_not_leave_a_file(config, tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        run(config, tmp_path / "run", **changes)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"policy_kwargs": {"net_arc": [8]}}, "ppo rejects the hyperparameters .*net_arc"),
        ({"env_kwargs": {"mass": 2}}, "mass"),
    ],
)
def test_value_that_others_refuse_does_not_leave_a_file(tmp_path, changes, message):
    path = tmp_path / "changed.yaml"
    path.write_text(yaml.safe_dump({PLANAR: plain(**changes)}), encoding="utf-8")
    with pytest.raises(ValueError, match=message):
        training.train(PLANAR, out=tmp_path / "run", config=path, evaluation=QUICK)
    assert not (tmp_path / "run").exists()


def test_run_that_is_done_is_not_trained_on_unless_it_is_asked(config, tmp_path):
    out, said = tmp_path / "run", []
    run(config, out, timesteps=128)
    before = contents(out)
    assert training.train(PLANAR, out=out, resume=True, say=said.append).timesteps == 128
    assert contents(out) == before
    assert training.train(PLANAR, out=out, resume=True, timesteps=256, say=said.append).timesteps == 256
    assert "nothing to do: 128 of 128 timesteps are done" in said[0]
    assert "schedules" in said[1]


def test_views_of_an_array_do_not_become_copies():
    whole = np.arange(12.0).reshape(3, 4)
    parts = [whole, whole[1], whole[:, ::-2], whole.T[2:]]
    whole_, row, columns, turned = pickle.loads(checkpoint.pickled(parts))
    assert all(np.array_equal(one, other) for one, other in zip(parts, (whole_, row, columns, turned), strict=True))
    whole_[:] = -1
    assert all(np.all(view == -1) for view in (row, columns, turned))


def test_compiled_function_does_not_become_a_copy():
    pickled = checkpoint.pickled(kernel.advance_spatial)
    assert len(pickled) < 200
    assert pickle.loads(pickled) is kernel.advance_spatial


# --------------------------------------------------------------------------------------------------------- the command


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_command_does_not_lack_a_checkpoint(config, tmp_path, monkeypatch, capsys, number):
    out = tmp_path / "run"
    start = (
        f"import signal, cablebot_gym.cli.app as c; signal.signal({int(signal.SIGINT)}, signal.default_int_handler); "
    )
    options = ["--config", config("ppo"), "--out", out, "--evaluation", json.dumps(QUICK), "--eval-every", 10**6]
    arguments = ["train", PLANAR, "--timesteps", 10**6, "--checkpoint-every", 64, *options]
    process = subprocess.Popen(
        [sys.executable, "-c", start + "c.main()", *map(str, arguments)], stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while not (out / "checkpoint.zip").exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(number)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert f"to resume: cablebot train {PLANAR} --out {out} --resume" in said
    with zipfile.ZipFile(out / "checkpoint.zip") as file:
        done = json.loads(file.read("state.json"))["timesteps"]
    assert f"stopped after {done} timesteps" in said
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
        (["--evaluation", "{"], "--evaluation is not valid JSON"),
        (["--evaluation", "[1]"], "--evaluation must be a JSON object"),
        (["--config", "none.yaml"], "--config: cannot read 'none.yaml'"),
    ],
)
def test_bad_input_of_the_command_does_not_leave_a_file(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.setattr(sys, "argv", ["cablebot", "train", PLANAR, "--out", str(tmp_path / "run"), *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run").exists()
