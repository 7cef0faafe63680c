"""Training runs with Stable-Baselines3: files, continued runs and the policy."""

import csv
import os

import numpy as np
import pytest
import torch
from oracles.episodes import ROBOTS
from stable_baselines3 import PPO

from cablebot_baselines.learned.training import train
from cablebot_gym.policies import load_policy

PLANAR = "CableBot-Planar-v0"


def logged(folder, name):
    """Column of SB3's log."""
    with (folder / "progress.csv").open(newline="", encoding="utf-8") as file:
        return [float(row[name]) for row in csv.DictReader(file) if row[name]]


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Folder and model of a run of two rollouts."""
    out = tmp_path_factory.mktemp("trained") / "run"
    model = train(PLANAR, out=out, timesteps=80, n_envs=2, seed=3)
    return out, model


@pytest.mark.landing
def test_policy_of_a_run_acts_as_its_model(trained):
    out, model = trained
    policy = load_policy(str(out / "policy.zip"), ROBOTS[PLANAR])
    observed = np.random.default_rng(0).normal(size=(50, policy.inputs)).astype(np.float32)
    expected, _ = model.predict(observed, deterministic=True)
    assert np.abs(np.clip(policy.act(observed), -1, 1) - expected).max() < 1e-6
    with pytest.raises(ValueError, match="evaluate it on the robot of its training"):
        load_policy(str(out / "policy.zip"), ROBOTS["CableBot-Spatial-v0"])


@pytest.mark.landing
def test_continued_run_has_the_model_and_the_ceiling_of_its_checkpoint(trained, monkeypatch):
    """Without updates the weights stay."""
    out, model = trained
    path = out / "checkpoints" / "rl_model_80_steps.zip"
    saved = PPO.load(path, device="cpu")
    saved.payload_ceiling = 1.25
    saved.save(path)
    monkeypatch.setattr(PPO, "train", lambda self: None)
    again = train(PLANAR, out=out, timesteps=120, n_envs=2, seed=3)
    assert again.num_timesteps == 120
    assert again.payload_ceiling == pytest.approx(1.25)
    assert logged(out / "log", "time/total_timesteps") == [40, 80]
    assert logged(out / "log_80", "rollout/payload_ceiling") == [1.25]
    assert (out / "checkpoints" / "rl_model_120_steps.zip").exists()
    for mine, other in zip(again.policy.parameters(), model.policy.parameters(), strict=True):
        assert torch.equal(mine, other)
    with pytest.raises(ValueError, match="that of seed 3: choose another --out"):
        train(PLANAR, out=out, timesteps=120, n_envs=2, seed=4)
    with pytest.raises(ValueError, match=r"cannot be continued .*: choose another --out"):
        train("CableBot-Spatial-v0", out=out, timesteps=120, n_envs=2)


@pytest.mark.landing
def test_same_seed_gives_the_same_weights(trained, tmp_path):
    for seed in (3, 4):
        train(PLANAR, out=tmp_path / str(seed), timesteps=80, n_envs=2, seed=seed)
        first = (tmp_path / str(seed) / "policy.zip").read_bytes()
        assert (first == (trained[0] / "policy.zip").read_bytes()) == (seed == 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"timesteps": 0}, "timesteps must be an integer of at least 1"),
        ({"seed": -1}, "seed must be"),
        ({"out": os.devnull}, "is not a folder|cannot"),
    ],
)
def test_invalid_values_are_refused_before_the_folder_is_made(tmp_path, options, message):
    out = tmp_path / "run"
    with pytest.raises(ValueError, match=message):
        train(PLANAR, **({"out": out} | options))
    assert not out.exists()
