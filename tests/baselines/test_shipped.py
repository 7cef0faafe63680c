"""Learned policies that ship: the script that trains and judges them, and the files in the repository."""

from __future__ import annotations

import hashlib
import importlib
import io
import subprocess
import sys
import tomllib
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from cards import LEAST_SEEDS, card_markdown, median_seed, read_best_known, read_cards, with_best_known
from shipping import CURVE, PLANAR_ID, ROOT, SPATIAL_ID, save_run, script, ship
from stable_baselines3 import PPO

import cablebot_gym.benchmark.engine
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.config import read_yaml
from cablebot_baselines.learned.gradient_run import ALGORITHM, VALIDATION, make_gradient_config
from cablebot_baselines.learned.runs import BEST, CHECKPOINT, LAST
from cablebot_baselines.learned.shipped import SHIPPED, WEIGHTS, env_id_of, load_shipped, stem
from cablebot_baselines.learned.training import train
from cablebot_gym import ENV_IDS
from cablebot_gym.benchmark.cells import Record
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED, TRAINING_SEEDS

RESULTS = ROOT / "docs" / "leaderboard" / "results.json"
AGAIN = "make it anew: python scripts/train_shipped.py --page"
CARDS = {card.stem: card for card in read_cards()}
"""Those of the repository."""

each_policy = pytest.mark.parametrize(
    ("name", "env_id"), [(one.name, env_id) for one in SHIPPED.values() for env_id in one.env_ids]
)


# ---------------------------------------------------------------------------------------------------------- the script


def test_what_was_judged_is_not_judged_again(runs, computed, tmp_path):
    first = ship(runs, tmp_path / "weights")
    many = len(computed)
    assert many == 7 * 2 + 2 * 4
    assert ship(runs, tmp_path / "weights") == first
    assert len(computed) == many


def test_interrupt_keeps_what_is_finished(runs, computed, monkeypatch, tmp_path):
    whole = cablebot_gym.benchmark.engine.compute

    def interrupted(cell):
        if len(computed) == 5:
            raise KeyboardInterrupt
        return whole(cell)

    monkeypatch.setattr(cablebot_gym.benchmark.engine, "compute", interrupted)
    with pytest.raises(KeyboardInterrupt):
        ship(runs, tmp_path / "weights")
    assert not list((tmp_path / "weights").glob("*"))
    monkeypatch.setattr(cablebot_gym.benchmark.engine, "compute", whole)
    ship(runs, tmp_path / "weights")
    assert len({cell.key for cell in computed}) == len(computed)


def test_failed_evaluation_ends_it(runs, monkeypatch, tmp_path):
    def fail(cell):
        return Record(cell=cell, source=cell.source, versions={}, result={"error": "it raised"}, seconds=0.0)

    monkeypatch.setattr(cablebot_gym.benchmark.engine, "compute", fail)
    with pytest.raises(RuntimeError, match="on CableBot-Planar-v0 failed: it raised"):
        ship(runs, tmp_path / "weights")
    assert not list((tmp_path / "weights").glob("*"))


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"seed": 3}, "another seed"), ({"config": {"motions": {"loops": 2}}}, "another config")],
)
def test_finished_run_of_something_else_is_refused(runs, computed, tmp_path, changes, words):
    save_run(runs / "apg-circle-planar-2", **{"seed": 2, **changes})
    with pytest.raises(ValueError, match=f"{words} than the present apg-circle: remove the folder"):
        ship(runs, tmp_path / "weights")
    assert not computed


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"seeds": 4}, "--seeds must be at least 5"),
        ({"draws": 0}, "--draws"),
        ({"searched": -1}, "--searched at least 0, not 256, 20 and -1"),
        ({"jobs": 0}, "workers must be at least 1"),
    ],
)
def test_too_few_of_something_is_refused_before_the_work(tmp_path, keywords, words):
    with pytest.raises(ValueError, match=words):
        script.ship_all([(CURVE, PLANAR_ID)], **{"seeds": 5, "runs": tmp_path / "runs", **keywords})
    assert not (tmp_path / "runs").exists()


def test_what_is_wanted_has_to_ship():
    assert script.select_pairs(list(SHIPPED.values()), SPATIAL_ID) == [(one, SPATIAL_ID) for one in SHIPPED.values()]
    with pytest.raises(ValueError, match="ppo-circle for CableBot-Spatial-v0"):
        script.select_pairs([SHIPPED["ppo-circle"]], PLANAR_ID)


def test_only_what_is_not_finished_is_trained(runs, monkeypatch):
    (runs / "apg-circle-planar-1" / LAST).unlink()
    started = []
    monkeypatch.setattr(script, "_train", lambda *arguments: started.append(arguments[3].name) or "done")
    script.train_missing([(CURVE, PLANAR_ID)], seeds=7, runs=runs, jobs=1)
    assert started == ["apg-circle-planar-1", "apg-circle-planar-5", "apg-circle-planar-6"]


def test_sb3_model_has_the_actor_of_the_bundle_and_nothing_of_the_machine(tmp_path):
    (tmp_path / "tiny.yaml").write_text(
        """
default:
  n_timesteps: 256
  n_envs: 32
  n_steps: 4
  batch_size: 64
  n_epochs: 1
  policy: MlpPolicy
  policy_kwargs: {net_arch: [8, 8]}
  learning_rate: lin_1e-3
  normalize: true
  env_kwargs: {control_frequency: 100, max_episode_steps: 100}
  env_wrapper:
    - cablebot_baselines.learned.wrappers.Steered:
        base: {law: fl, gains: [900, 60]}
        steering: {kind: shift}
        features: [time_since_start, actions, error, model_payload]
""",
        encoding="utf-8",
    )
    quick = {"control_frequency": 100, "payload_max": 1.0, "resolution": 0.5}
    out = tmp_path / "run"
    train(PLANAR_ID, out=out, algorithm="ppo", config=tmp_path / "tiny.yaml", eval_every=128, evaluation=quick)
    assert (out / CHECKPOINT).is_file()
    bundle = Bundle.load(out / LAST)  # for this once as if the best had been another network than the last
    network = replace(bundle.network, weights=tuple(0.7 * weight for weight in bundle.network.weights))
    replace(bundle, network=network).save(out / BEST)
    data = script.sb3_model(out / BEST)
    model = PPO.load(io.BytesIO(data), device="cpu")
    seen = np.random.default_rng(0).normal(size=(20, network.inputs))
    normalised = np.clip((seen - network.mean) / network.scale, -10, 10).astype(np.float32)
    assert model.predict(normalised, deterministic=True)[0] == pytest.approx(np.clip(network(seen), -1, 1), abs=1e-5)
    assert model._last_obs is None
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        assert "system_info.txt" not in file.namelist()
        text = b"".join(file.read(name) for name in file.namelist())
    for place in (str(ROOT), str(tmp_path), str(Path(torch.__file__).parent), str(Path.home())):
        assert place.encode() not in text or place == "/"
    replace(bundle, card={"algorithm": ALGORITHM}).save(out / BEST)
    assert script.sb3_model(out / BEST) is None


def test_page_and_figure_are_written_with_the_best_found_of_now(runs, computed, tmp_path):
    weights, docs = tmp_path / "weights", tmp_path / "docs"
    card = ship(runs, weights)
    replace(card, best_known=9.0).save(weights)
    script.write_page(weights, docs)
    assert read_cards(weights) == [card]
    assert (docs / "learned.md").read_text(encoding="utf-8") == card_markdown([card])
    assert (docs / "learned.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match=r"folder docs contains no card\. Make one"):
        script.write_page(docs, docs)


# -------------------------------------------------------------------------------------------- names, weights, messages


def test_entry_points_name_the_table():
    """Of pyproject.toml: what is installed may be older."""
    with (ROOT / "pyproject.toml").open("rb") as file:
        points = tomllib.load(file)["project"]["entry-points"]["cablebot_gym.policies"]
    ours = {name: value.partition(":") for name, value in points.items() if "learned" in value}
    assert set(ours) == (set(SHIPPED) if CARDS else set()), "a name without weights could not be made"
    for name, (module, _, attribute) in ours.items():
        entry = getattr(importlib.import_module(module), attribute)
        assert isinstance(entry, PolicyEntry)
        assert (entry.name, entry.kind, entry.env_ids) == (name, "learned", SHIPPED[name].env_ids)
        assert set(entry.env_ids) <= set(ENV_IDS)


def test_listing_and_reading_needs_no_torch():
    code = (
        "import sys; sys.path.insert(0, 'scripts'); "
        "import cablebot_baselines.learned.shipped, cards; cards.read_cards(); "
        "assert not {'torch', 'stable_baselines3', 'matplotlib'} & set(sys.modules), sorted(sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


@pytest.mark.parametrize(
    ("robot", "env_id"), list(zip((PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL), ENV_IDS, strict=True))
)
def test_kind_of_robot_chooses_the_weights(tmp_path, robot, env_id):
    for one in ENV_IDS:
        save_run(tmp_path / one, env_id=one)
        (tmp_path / one / BEST).rename(tmp_path / f"{stem('apg-loops', one)}.zip")
    own = robot.replace(name="own", mass=1.1 * robot.mass)
    assert env_id_of(own) == env_id
    assert load_shipped("apg-loops", own, tmp_path).bundle.env_id == env_id
    if robot is FLEX_PLANAR:
        anchors = (*robot.base_anchors, (0.0, -0.6))
        with pytest.raises(ValueError, match="evaluate it on the environment that it was trained on"):
            load_shipped("apg-loops", robot.replace(name="four", base_anchors=anchors), tmp_path)


def test_what_is_missing_is_said_in_words(tmp_path):
    with pytest.raises(ValueError, match=r"apg-circle-planar.zip is missing \(present: none\)"):
        load_shipped("apg-circle", PLANAR, tmp_path)
    save_run(tmp_path)
    (tmp_path / BEST).rename(tmp_path / "apg-circle-planar.zip")
    words = r"apg-circle-spatial.zip is missing \(present: apg-circle-planar.zip\). Reinstall .* --policy apg-circle"
    with pytest.raises(ValueError, match=words):
        load_shipped("apg-circle", SPATIAL, tmp_path)
    words = (
        r"'ppo-circle' has weights for CableBot-Spatial-v0, not for CableBot-Planar-v0\. "
        "Choose apg-circle, apg-loops, or train it"
    )
    with pytest.raises(ValueError, match=words):
        load_shipped("ppo-circle", PLANAR, tmp_path)
    with pytest.raises(ValueError, match="choose one of ppo-circle, apg-circle, apg-circle-margin, apg-loops"):
        load_shipped("trajopt", PLANAR, tmp_path)
    (tmp_path / "apg-circle-planar.zip").write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"apg-circle-planar.zip' cannot be used"):
        load_shipped("apg-circle", PLANAR, tmp_path)


# ---------------------------------------------------------------------------------------------------- held-out motions


def seeds_in(value):
    """Every number called ``seed`` anywhere in data."""
    if isinstance(value, dict):
        yield from (number for name, number in value.items() if name == "seed")
    if isinstance(value, (dict, list, tuple)):
        for blocks in value.values() if isinstance(value, dict) else value:
            yield from seeds_in(blocks)


def check_apart(env_id, algorithm, config):
    """Neither trained nor chosen on held-out motions."""
    assert all(seed in TRAINING_SEEDS for seed in seeds_in(config))
    if algorithm == ALGORITHM:
        made = make_gradient_config(env_id, config)
        trained, judged = (
            {getattr(one, "seed", None) for one in some} for some in (made.trajectories, made.validation)
        )
        assert all(seed is None or seed < FIRST_HELD_OUT_SEED for seed in trained | judged)
        assert trained == judged == {None} or not trained & judged


def test_training_and_validation_seeds_are_apart_from_the_held_out_ones():
    assert max(TRAINING_SEEDS) < FIRST_HELD_OUT_SEED
    assert {*VALIDATION} <= {*TRAINING_SEEDS}
    plain = {"base": "fl", "steering": "shift", "features": ["rbf_time"]}
    with pytest.raises(ValueError, match="loops must be"):
        make_gradient_config(PLANAR_ID, {**plain, "motions": {"loops": VALIDATION[0] + 1}})


@each_policy
def test_no_configuration_that_ships_trains_on_held_out_motions(name, env_id):
    shipped = SHIPPED[name]
    check_apart(env_id, shipped.algorithm, read_yaml(env_id, Path(shipped.config or shipped.algorithm)))


# ------------------------------------------------------------------------------------------------ what ships, as it is


def test_all_or_nothing_ships():
    """A policy without its weights could not be made by anybody."""
    expected = {stem(one.name, env_id) for one in SHIPPED.values() for env_id in one.env_ids}
    models = {f"{name}-sb3" for name, card in CARDS.items() if card.sb3}
    assert set(CARDS) in (set(), expected)
    assert {path.stem for path in WEIGHTS.glob("*.zip")} == set(CARDS) | models
    assert {path.stem for path in WEIGHTS.glob("*.json")} == set(CARDS)


def test_page_is_that_of_the_cards():
    path, bests = ROOT / "docs" / "learned.md", read_best_known(RESULTS)
    page = path.read_text(encoding="utf-8") if path.exists() else ""
    assert page == (card_markdown(list(CARDS.values())) if CARDS else ""), AGAIN
    assert [with_best_known(card, bests) for card in CARDS.values()] == list(CARDS.values()), AGAIN


def test_weights_are_small_and_load_without_torch_or_unpickling():
    paths = sorted(WEIGHTS.glob("*.zip"))
    assert all(path.stat().st_size < script.LARGEST for path in paths)
    code = """
import pickle, sys
from pathlib import Path
import numpy
for name in ("torch", "stable_baselines3"):
    sys.modules[name] = None
def refuse(*arguments, **keywords):
    raise AssertionError("unpickled")
pickle.load = pickle.loads = refuse
numpy.lib.format.pickle = pickle
from cablebot_baselines.learned.bundle import Bundle
for path in sys.argv[1:]:
    Bundle.load(Path(path))
"""
    bundles = [str(path) for path in paths if not path.stem.endswith("-sb3")]
    assert subprocess.run([sys.executable, "-c", code, *bundles], cwd=ROOT, check=False).returncode == 0


def test_cards_are_those_of_their_weights():
    for name, card in CARDS.items():
        path, shipped = WEIGHTS / f"{name}.zip", SHIPPED[card.policy]
        bundle = Bundle.load(path)
        assert (WEIGHTS / f"{name}.json").read_text(encoding="utf-8") == card.to_json(), AGAIN
        assert card.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
        assert len(card.seeds) >= LEAST_SEEDS
        assert card.shipped_seed == median_seed({run.seed: run.in_training for run in card.seeds})
        assert (card.algorithm, card.config, card.conditions) == (shipped.algorithm, shipped.config, shipped.conditions)
        assert (bundle.env_id, bundle.card["seed"]) == (card.env_id, card.shipped_seed)
        assert bundle.card["planner_output_used"] == card.planner_output_used
        assert bundle.card["config"] == read_yaml(card.env_id, Path(card.config or card.algorithm))
        check_apart(card.env_id, card.algorithm, bundle.card["config"])
        assert all(one.seed >= FIRST_HELD_OUT_SEED for one in card.held_out)


def test_payloads_of_the_planar_cards_still_hold():
    for card in (card for name, card in CARDS.items() if name.endswith("-planar")):
        made = evaluate_dlcc(
            load_shipped(card.policy, PLANAR), PLANAR_ID, payload_known=card.conditions[0].payload_known
        )
        assert made.payload == pytest.approx(card.shipped.payloads[0], abs=2 * made.resolution)
