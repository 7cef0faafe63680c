"""The shipped learned policy: its files belong together, and it carries its recorded payload."""

import hashlib
import json
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.recipe import find_config
from cablebot_baselines.learned.shipped import BUNDLE, WEIGHTS
from cablebot_gym.evaluation import evaluate_dlcc

RECORD = json.loads((WEIGHTS / "ppo-circle-spatial.json").read_text())
"""Record of the training with every seed."""


@pytest.fixture(scope="module")
def bundle():
    return Bundle.load(BUNDLE)


def test_bundle_is_that_of_the_recorded_median_seed(bundle):
    runs = {run["seed"]: run for run in RECORD["seeds"]}
    payloads = {seed: run["curve"][-1]["payload_kg"] for seed, run in runs.items()}
    ordered = sorted(payloads, key=lambda seed: (payloads[seed], seed))
    shipped = ordered[len(ordered) // 2]
    assert RECORD["sha256"] == hashlib.sha256(BUNDLE.read_bytes()).hexdigest()
    assert bundle.card["seed"] == RECORD["shipped_seed"] == shipped
    assert bundle.card["command"] == runs[shipped]["command"]
    assert bundle.card["curve"] == runs[shipped]["curve"]


def test_bundle_was_trained_with_the_present_settings(bundle):
    assert bundle.card["config"] == find_config(bundle.env_id).plain


def test_sb3_model_has_the_actor_of_the_bundle(bundle):
    from stable_baselines3 import PPO

    model = PPO.load(WEIGHTS / "ppo-circle-spatial-sb3.zip", device="cpu")
    network = bundle.network
    observed = np.random.default_rng(0).normal(size=(20, network.inputs))
    inputs = np.clip((observed - network.mean) / network.scale, -10, 10).astype(np.float32)
    actions, _ = model.predict(inputs, deterministic=True)
    assert_allclose(actions, np.clip(network(observed), -1, 1), rtol=0, atol=1e-5)


@pytest.mark.nightly
def test_shipped_policy_loads_with_numpy_alone():
    code = """
import sys
sys.modules["torch"] = sys.modules["stable_baselines3"] = None
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import SPATIAL
load_policy("ppo-circle", SPATIAL)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.nightly
def test_recorded_payload_is_reproduced():
    recorded, _ = RECORD["seeds"][RECORD["shipped_seed"]]["payloads"]
    result = evaluate_dlcc("ppo-circle", RECORD["env_id"])
    assert result.payload == pytest.approx(recorded, abs=2 * result.resolution)
