"""Shipped learned policies: the script that trains and evaluates them, and the files in the
repository."""

import hashlib
import io
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cards.card import CONDITIONS, LEAST_SEEDS, read_cards
from cards.statistics import median_seed
from shipping import PLANAR_ID, PLANNER, ROOT, save_run, script, ship
from stable_baselines3 import PPO
from test_training import run as train

from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.runs import BEST, LAST, read_yaml
from cablebot_baselines.learned.shipped import SHIPPED, WEIGHTS, load_shipped, stem
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.robots import PLANAR
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED

AGAIN = "run python scripts/train_shipped.py --page"
CARDS = {card.stem: card for card in read_cards()}
"""Cards in the repository."""


def test_invalid_requests_are_rejected_before_the_work(runs, computed, tmp_path):
    with pytest.raises(ValueError, match="--seeds must be at least 5"):
        script.ship_all([(PLANNER, PLANAR_ID)], seeds=4, runs=tmp_path / "none")
    assert not (tmp_path / "none").exists()
    save_run(runs / "planner-planar-2", 2, config={"motions": {"loops": 2}})
    with pytest.raises(
        ValueError, match="another config than the present planner: remove the folder"
    ):
        ship(runs, tmp_path / "weights")
    assert not computed


@pytest.mark.slow
def test_sb3_model_has_the_actor_of_the_bundle_and_no_paths(tmp_path):
    out = tmp_path / "run"
    train(out)
    bundle = Bundle.load(out / LAST)  # the best network differs from the last one
    network = replace(
        bundle.network, weights=tuple(0.7 * weight for weight in bundle.network.weights)
    )
    replace(bundle, network=network).save(out / BEST)
    data = script.sb3_model(out / BEST)
    model = PPO.load(io.BytesIO(data), device="cpu")
    observed = np.random.default_rng(0).normal(size=(20, network.inputs))
    inputs = np.clip((observed - network.mean) / network.scale, -10, 10).astype(np.float32)
    expected = np.clip(network(observed), -1, 1)
    assert model.predict(inputs, deterministic=True)[0] == pytest.approx(expected, abs=1e-5)
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        text = b"".join(file.read(name) for name in file.namelist())
    assert not any(str(folder).encode() in text for folder in (ROOT, tmp_path))


def test_weights_and_cards_of_all_policies_are_present():
    expected = set()
    for policy in SHIPPED.values():
        expected |= {stem(policy.name, env_id) for env_id in policy.env_ids}
    models = {f"{name}-sb3" for name, card in CARDS.items() if card.sb3}
    weights = list(WEIGHTS.glob("*.zip"))
    assert set(CARDS) == expected
    assert {path.stem for path in WEIGHTS.glob("*.json")} == expected
    assert {path.stem for path in weights} == expected | models
    assert max(path.stat().st_size for path in weights) < script.LARGEST


@pytest.mark.slow
def test_shipped_policies_load_without_torch():
    code = """
import sys
sys.modules["torch"] = sys.modules["stable_baselines3"] = None
from cablebot_baselines.learned.shipped import load_shipped
from cablebot_gym.robots import PLANAR
load_shipped("planner", PLANAR)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.parametrize("name", CARDS)
def test_card_belongs_to_its_weights(name):
    card = CARDS[name]
    path = WEIGHTS / f"{name}.zip"
    bundle = Bundle.load(path)
    shipped = SHIPPED[card.policy]
    assert (WEIGHTS / f"{name}.json").read_text() == card.to_json(), AGAIN
    assert card.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert len(card.seeds) >= LEAST_SEEDS
    assert card.shipped_seed == median_seed({run.seed: run.in_training for run in card.seeds})
    assert card.algorithm == shipped.algorithm
    assert bundle.env_id == card.env_id
    assert bundle.card["seed"] == card.shipped_seed
    assert bundle.card["dwell"] == card.dwell > 0
    assert card.conditions == CONDITIONS[card.policy]
    assert bundle.card["config"] == read_yaml(card.env_id, Path(card.algorithm))
    for loop in card.held_out:
        assert loop.seed >= FIRST_HELD_OUT_SEED


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in CARDS if name.endswith("-planar")])
def test_payload_of_a_planar_card_is_reproduced(name):
    card = CARDS[name]
    policy = load_shipped(card.policy, PLANAR)
    known = card.conditions[0].payload_known
    result = evaluate_dlcc(policy, PLANAR_ID, payload_known=known)
    assert result.payload == pytest.approx(card.shipped.payloads[0], abs=2 * result.resolution)
