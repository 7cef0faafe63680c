"""Learned policies that ship: statistics of their cards, how a card comes about, and the files in the repository."""

from __future__ import annotations

import hashlib
import importlib.util
import io
import itertools
import json
import subprocess
import sys
import tomllib
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import trim_mean
from stable_baselines3 import PPO

import cablebot_gym.benchmark.run
from baselines.learned.base import find_base
from baselines.learned.bundle import Bundle
from baselines.learned.cards import (
    LEAST_SEEDS,
    Card,
    base_text,
    card_markdown,
    draw_curves,
    iqm,
    iqm_interval,
    make_card,
    read_bests,
    read_cards,
    typical,
    with_bests,
)
from baselines.learned.config import read_yaml
from baselines.learned.export import silent_network
from baselines.learned.gradient_run import ALGORITHM, VALIDATION, make_gradient_config
from baselines.learned.runs import BEST, CHECKPOINT, LAST
from baselines.learned.shipped import SHIPPED, WEIGHTS, env_id_of, load_shipped, stem
from baselines.learned.steering import Steering
from baselines.learned.training import train
from cablebot_gym import ENV_IDS
from cablebot_gym.benchmark.cells import PolicyCell, Record
from cablebot_gym.dlcc import evaluate_dlcc
from cablebot_gym.envs import env_robot
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, find_robot
from cablebot_gym.trajectories import FIRST_HELD_OUT_SEED, TRAINING_SEEDS

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "leaderboard" / "results.json"
AGAIN = "make it anew: python scripts/train_shipped.py --page"
PLANAR_ID, SPATIAL_ID = ENV_IDS[:2]
CURVE = SHIPPED["curve"]
CARDS = {card.stem: card for card in read_cards()}
"""Those of the repository."""

each_policy = pytest.mark.parametrize(
    ("name", "env_id"), [(one.name, env_id) for one in SHIPPED.values() for env_id in one.env_ids]
)


def _imported(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(sys.modules[path.stem])
    return sys.modules[path.stem]


script = _imported(ROOT / "scripts" / "train_shipped.py")


# ---------------------------------------------------------------------------------------------------------- statistics


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([4.0], 4.0),
        ([1.0, 2.0, 9.0], 4.0),
        ([100.0, 2.0, 1.0, 3.0], 2.5),
        ([3.0, -50.0, 1.0, 2.0, 100.0], 2.0),
        ([0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 9.0, 9.0], 2.5),
    ],
)
def test_a_quarter_of_the_values_is_left_out_at_either_end(values, expected):
    assert iqm(values) == pytest.approx(expected)
    assert trim_mean(values, 0.25) == pytest.approx(expected)


def test_many_means_at_once_are_those_one_by_one():
    values = np.random.default_rng(3).normal(size=(4, 3, 11))
    assert iqm(values) == pytest.approx(trim_mean(values, 0.25, axis=-1))


def test_interval_is_that_of_all_resamples_there_are():
    values = np.array([1.0, 2.0, 4.0, 8.0, 16.0])
    every = np.sort([iqm(values[list(places)]) for places in itertools.product(range(5), repeat=5)])
    for confidence in (0.5, 0.8, 0.95):
        low, high = iqm_interval([values], confidence=confidence)
        for end, share in ((low, (1 - confidence) / 2), (high, (1 + confidence) / 2)):
            # As exact as so many resamples are: four of their standard deviations in the share.
            near = [share - 4 * 0.5 / 100, share + 4 * 0.5 / 100]
            assert np.quantile(every, max(near[0], 0)) <= end <= np.quantile(every, min(near[1], 1))


def test_two_seeds_by_hand():
    """Resamples of (0, 1): mean 0 in a quarter of them, 1/2 in a half, 1 in a quarter."""
    assert iqm_interval([[0.0, 1.0]], confidence=0.95) == (0.0, 1.0)
    assert iqm_interval([[0.0, 1.0]], confidence=0.4) == (0.5, 0.5)


def test_resamples_stay_within_their_strata():
    """Each stratum is constant, so that nothing can differ; without strata it would."""
    strata = [[0.0] * 5, [1.0] * 5, [7.0] * 5]
    assert iqm_interval(strata) == (iqm(np.concatenate(strata)),) * 2
    assert np.ptp(iqm_interval([np.concatenate(strata)])) > 1


def test_strata_are_drawn_independently_and_may_differ_in_size():
    """(0, 1) twice: were the draws the same, the mean 1/2 would come up half of the time, not 3/8 of it."""
    twice = [[0.0, 1.0], [0.0, 1.0]]
    # 4 values, the middle two: 0, 1/2 or 1, with 5/16, 6/16 and 5/16.
    assert iqm_interval(twice, confidence=0.30) == (0.5, 0.5)
    assert iqm_interval(twice, confidence=0.44) == (0.0, 1.0)
    assert iqm_interval([[1.0, 1.0], [1.0]]) == (1.0, 1.0)


def test_interval_is_the_same_each_time_and_another_with_another_seed():
    values = [np.random.default_rng(1).normal(size=7)]
    assert iqm_interval(values) == iqm_interval(values)
    assert iqm_interval(values, resamples=200, seed=1) != iqm_interval(values, resamples=200, seed=2)


@pytest.mark.parametrize(
    ("payloads", "expected"),
    [
        ({0: 1.0, 1: 5.0, 2: 3.0, 3: 2.0, 4: 4.0}, 2),
        ({0: 4.0, 1: 1.0, 2: 3.0, 3: 2.0}, 3),
        ({0: None, 1: 0.0, 2: 0.5}, 1),
        ({3: 1.0, 1: 1.0, 2: 1.0}, 2),
        ({7: None}, 7),
    ],
)
def test_typical_seed_has_the_median_payload(payloads, expected):
    assert typical(payloads) == expected


# ------------------------------------------------------------------------------------------------- how a card is made

CARRIED = {0: 2.0, 1: None, 2: 2.8, 3: 2.4, 4: 2.6}
"""What seeds are made to carry where the payload is told; 1 kg less where it is not."""


def save_run(folder, seed=0, env_id=PLANAR_ID, **changes):
    """A finished run of ``curve`` whose network says next to nothing; ``changes`` are of its card."""
    plain = read_yaml(env_id, Path("gradient"))
    made = make_gradient_config(env_id, plain)
    steering = Steering(find_robot(env_robot(env_id)), base=made.base, way=made.way, features=made.features)
    network = silent_network(steering.inputs, steering.actions)
    network.biases[0][:] = 1e-9 * seed
    card = {
        "command": f"cablebot train {env_id} --algo gradient --config gradient --seed {seed} --threads 1",
        "env_id": env_id,
        "algorithm": ALGORITHM,
        "config": json.loads(json.dumps(plain)),
        "seed": seed,
        "timesteps": 700 + seed,
        "wall_s": 60.0 + seed,
        "threads": 1,
        "versions": {"python": "3.11", "torch": "2"},
        "evaluation": {"criterion": "task", "resolution": 0.05},
        "planner_output_used": False,
        "curve": [{"timesteps": 350, "wall_s": 30.0, "payload_kg": None}, {"wall_s": 60.0, "payload_kg": 2.0}],
        **changes,
    }
    bundle = Bundle(env_id=env_id, base=made.base, way=made.way, features=made.features, network=network, card=card)
    bundle.save(folder / BEST)
    bundle.save(folder / LAST)
    return folder


@pytest.fixture
def runs(tmp_path):
    for seed in CARRIED:
        save_run(tmp_path / "runs" / f"curve-planar-{seed}", seed)
    return tmp_path / "runs"


@pytest.fixture
def computed(monkeypatch):
    """Payloads that cost nothing: seeds carry :data:`CARRIED`, the base alone 1.5 kg and every law 1.9 kg."""
    cells = []

    def compute(cell):
        assert isinstance(cell, PolicyCell)
        cells.append(cell)
        number = Path(cell.policy).parent.name.rpartition("-")[2]
        payload = CARRIED[int(number)] if number.isdigit() else 1.5 if "base" in cell.policy else 1.9
        if cell.information == "untold" and payload is not None:
            payload -= 1.0
        if "seed" in cell.trajectory:
            payload = 2.0 if cell.policy == "fl" else payload + (1.0 if cell.trajectory["seed"] % 2 else -1.0)
        return Record(cell=cell, source=cell.source, versions={}, result={"payload": payload}, seconds=0.0)

    monkeypatch.setattr(cablebot_gym.benchmark.run, "compute", compute)
    return cells


def ship(runs, weights, **keywords):
    script.ship_all([(CURVE, PLANAR_ID)], seeds=5, runs=runs, weights=weights, held_out=4, **keywords)
    (card,) = read_cards(weights)
    return card


def test_card_says_what_every_seed_carries_and_the_typical_one_ships(runs, computed, tmp_path):
    weights = tmp_path / "weights"
    card = ship(runs, weights)
    assert [run.payloads for run in card.seeds] == [
        (2.0, 1.0),
        (None, None),
        (2.8, 2.8 - 1.0),
        (2.4, 1.4),
        (2.6, 1.6),
    ]
    assert card.shipped_seed == 3
    assert (weights / "curve-planar.zip").read_bytes() == (runs / "curve-planar-3" / BEST).read_bytes()
    assert card.sha256 == hashlib.sha256((weights / "curve-planar.zip").read_bytes()).hexdigest()
    assert (card.base_payloads, card.law, card.law_payloads) == ((1.5, 0.5), "fl", (1.9, 1.9 - 1.0))
    summary = card.summary(0)
    assert summary.iqm == pytest.approx((2.0 + 2.4 + 2.6) / 3)  # none counts as 0, and is the smallest
    assert summary.median == 2.4
    assert summary.low < summary.iqm < summary.high
    assert card.best_found == pytest.approx(2.875, abs=2e-3)
    found = [(one.seed, one.payload, one.law_payload) for one in card.held_out]
    assert found == [(10_000 + place, 2.4 + (1.0 if place % 2 else -1.0), 2.0) for place in range(4)]
    assert card.held_out[0].best_found == pytest.approx(4.486, abs=2e-3)
    assert [one.best_found is None for one in card.held_out] == [False, False, False, True]
    assert [(run.seed, run.wall_s, run.timesteps) for run in card.seeds][4] == (4, 64.0, 704)
    assert not card.planner_output_used
    assert card.base["gains"] == [2500.0, 100.0]
    assert card.base_text.startswith("`fl` with K_P = 2500 1/s², K_D = 100 1/s, tensions of at least 2 N")
    base = Bundle.load(runs / "curve-planar-base.zip").network
    assert not any(np.any(array) for array in (*base.weights, *base.biases))


def test_cards_are_read_as_they_were_written(runs, computed, tmp_path):
    card = ship(runs, tmp_path / "weights")
    text = (tmp_path / "weights" / "curve-planar.json").read_text(encoding="utf-8")
    assert Card.from_json(text).to_json() == text == card.to_json()
    assert json.loads(text)["summaries"][0]["median"] == 2.4


@pytest.mark.parametrize("text", ["{}", "[]", "no JSON", '{"seeds": [], "conditions": [], "held_out": []}'])
def test_broken_card_is_named(tmp_path, text):
    (tmp_path / "preview-planar.json").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"preview-planar.json' cannot be read .*train_shipped.py --policy preview"):
        read_cards(tmp_path)


def test_what_was_judged_is_not_judged_again(runs, computed, tmp_path):
    first = ship(runs, tmp_path / "weights")
    many = len(computed)
    assert many == 7 * 2 + 2 * 4
    assert ship(runs, tmp_path / "weights") == first
    assert len(computed) == many


def test_interrupt_keeps_what_is_finished(runs, computed, monkeypatch, tmp_path):
    whole = cablebot_gym.benchmark.run.compute

    def interrupted(cell):
        if len(computed) == 5:
            raise KeyboardInterrupt
        return whole(cell)

    monkeypatch.setattr(cablebot_gym.benchmark.run, "compute", interrupted)
    with pytest.raises(KeyboardInterrupt):
        ship(runs, tmp_path / "weights")
    assert not list((tmp_path / "weights").glob("*"))
    monkeypatch.setattr(cablebot_gym.benchmark.run, "compute", whole)
    ship(runs, tmp_path / "weights")
    assert len({cell.key for cell in computed}) == len(computed)


def test_failed_evaluation_ends_it(runs, monkeypatch, tmp_path):
    def fail(cell):
        return Record(cell=cell, source=cell.source, versions={}, result={"error": "it raised"}, seconds=0.0)

    monkeypatch.setattr(cablebot_gym.benchmark.run, "compute", fail)
    with pytest.raises(RuntimeError, match="could not be judged on CableBot-Planar-v0: it raised"):
        ship(runs, tmp_path / "weights")
    assert not list((tmp_path / "weights").glob("*"))


@pytest.mark.parametrize(
    ("changes", "words"),
    [({"seed": 3}, "another seed"), ({"config": {"motions": {"loops": 2}}}, "another config")],
)
def test_finished_run_of_something_else_is_refused(runs, computed, tmp_path, changes, words):
    save_run(runs / "curve-planar-2", **{"seed": 2, **changes})
    with pytest.raises(ValueError, match=f"{words} than curve has now: remove the folder"):
        ship(runs, tmp_path / "weights")
    assert not computed


def test_runs_of_different_policies_make_no_card(runs):
    folders = [save_run(runs / "a", 0), save_run(runs / "b", 0)]

    def make(policy, env_id):
        return make_card(policy, env_id, folders, evaluate=lambda cells: [], bests={}, command="")

    with pytest.raises(ValueError, match="different seeds"):
        make(CURVE, PLANAR_ID)
    save_run(runs / "b", 1, config={})
    with pytest.raises(ValueError, match="different configurations"):
        make(CURVE, PLANAR_ID)
    with pytest.raises(ValueError, match="is of CableBot-Planar-v0 by gradient, not of CableBot-Spatial-v0 by ppo"):
        make(SHIPPED["ppo"], SPATIAL_ID)


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"seeds": 4}, "--seeds must be at least 5"),
        ({"draws": 0}, "--draws"),
        ({"jobs": 0}, "workers must be at least 1"),
    ],
)
def test_too_few_of_something_is_refused_before_the_work(tmp_path, keywords, words):
    with pytest.raises(ValueError, match=words):
        script.ship_all([(CURVE, PLANAR_ID)], **{"seeds": 5, "runs": tmp_path / "runs", **keywords})
    assert not (tmp_path / "runs").exists()


def test_what_is_wanted_has_to_ship():
    assert script.wanted(list(SHIPPED.values()), SPATIAL_ID) == [(one, SPATIAL_ID) for one in SHIPPED.values()]
    with pytest.raises(ValueError, match="ppo for CableBot-Spatial-v0"):
        script.wanted([SHIPPED["ppo"]], PLANAR_ID)


def test_only_what_is_not_finished_is_trained(runs, monkeypatch):
    (runs / "curve-planar-1" / LAST).unlink()
    started = []
    monkeypatch.setattr(script, "_train", lambda *arguments: started.append(arguments[3].name) or "done")
    script.train_missing([(CURVE, PLANAR_ID)], seeds=7, runs=runs, jobs=1)
    assert started == ["curve-planar-1", "curve-planar-5", "curve-planar-6"]


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
    - baselines.learned.wrappers.Steered:
        base: {law: fl, gains: [900, 60]}
        steering: {kind: shift}
        features: [elapsed, actions, error, told_payload]
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


@pytest.mark.parametrize(
    ("env_id", "base", "words"),
    [
        (SPATIAL_ID, {}, "`fl` with K_P = 30 1/s², K_D = 20 1/s"),
        (SPATIAL_ID, {"weighs": True, "allocates": True}, "estimate of the payload (prior 0.01 s), sharing out"),
        (ENV_IDS[3], {"law": "motor-pd"}, "`motor-pd` with ω = 200 rad/s, ζ = 0.7"),
        (ENV_IDS[2], {"law": "motor-pd", "frequency": 90}, "ω = 90 rad/s, ζ = 0.7, tensions of at least 5 N"),
        (ENV_IDS[3], {"law": "fl4"}, "`fl4` with poles -15, -15, -60, -60 1/s"),
        (ENV_IDS[3], {"law": "composite"}, "K_P = 30 1/s², K_D = 20 1/s, K_v ≤ 1 √(K J′)"),
    ],
)
def test_base_laws_gains_are_in_words(env_id, base, words):
    assert words in base_text(find_base({"law": "fl", **base}), env_id)


# ------------------------------------------------------------------------------------------------------------ the page


def test_page_holds_the_numbers(runs, computed, tmp_path):
    card = ship(runs, tmp_path / "weights")
    other = replace(card, env_id=ENV_IDS[2], law="composite-tuned", sb3=True)
    page = card_markdown([card, other])
    row = next(line for line in page.splitlines() if line.startswith("| `curve` | Planar"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    low, high = card.summary(0).low, card.summary(0).high
    assert cells[2:4] == ["told", "5"]
    assert cells[4:8] == [f"2.33 [{low:.2f}, {high:.2f}]", "2.40", "1.50", "`fl` 1.90"]
    assert cells[8:] == ["81% of 2.87", "2 of 4", f"{1.4 / 4.4857:.0%} on 3", "62 s"]
    assert "| 1 | 701 | 61 s | none | none |  |" in page
    assert "| 3 | 703 | 63 s | 2.40 | 1.40 | ships |" in page
    assert "`cablebot train CableBot-Planar-v0 --algo gradient --config gradient --seed 3 --threads 1`" in page
    assert "python 3.11, torch 2" in page
    assert "No planner was used." in page
    assert "python scripts/train_shipped.py --policy curve --id CableBot-Planar-v0 --seeds 5 --draws 256" in page
    shares = [np.array([2.0, 0.0, 2.8, 2.4, 2.6]) / card.best_found] * 2
    low, high = iqm_interval(shares)
    interval = f"{iqm(np.concatenate(shares)):.1%} [{low:.1%}, {high:.1%}]"
    assert f"Over its 2 environments, told, the IQM of the shares of the best found is {interval}." in page
    assert page.count("curve-flexplanar-sb3.zip") == 1
    assert "curve-planar-sb3.zip" not in page


def test_page_and_figure_are_written_with_the_best_found_of_now(runs, computed, tmp_path):
    weights, docs = tmp_path / "weights", tmp_path / "docs"
    card = ship(runs, weights)
    replace(card, best_found=9.0).save(weights)
    script.write_page(weights, docs)
    assert read_cards(weights) == [card]
    assert (docs / "learned.md").read_text(encoding="utf-8") == card_markdown([card])
    assert (docs / "learned.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="there is no card in docs: make one"):
        script.write_page(docs, docs)


def test_figure_has_a_panel_for_each_card_and_lines_of_every_seed(runs, computed, tmp_path):
    card = ship(runs, tmp_path / "weights")
    loops = replace(card, policy="preview", motions={"loops": 9})
    circle, other, *empty = draw_curves([card, loops, card, card]).axes[:6]
    assert len(empty) == 4
    assert len(circle.lines) == 5 + 3
    assert len(other.lines) == 5  # what is carried on the circle says nothing of loops
    assert list(circle.lines[0].get_xdata()) == [30.0, 60.0]
    assert list(circle.lines[0].get_ydata()) == [0.0, 2.0]
    assert other.get_title() == "preview, Planar: loops, mean"


# --------------------------------------------------------------------------------------------- names, weights, messages


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
        "import sys; import baselines.learned.shipped, baselines.learned.cards as cards; cards.read_cards(); "
        "assert not {'torch', 'stable_baselines3', 'matplotlib'} & set(sys.modules), sorted(sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


@pytest.mark.parametrize(
    ("robot", "env_id"), list(zip((PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL), ENV_IDS, strict=True))
)
def test_kind_of_robot_chooses_the_weights(tmp_path, robot, env_id):
    for one in ENV_IDS:
        save_run(tmp_path / one, env_id=one)
        (tmp_path / one / BEST).rename(tmp_path / f"{stem('curve', one)}.zip")
    own = robot.replace(name="own", mass=1.1 * robot.mass)
    assert env_id_of(own) == env_id
    assert load_shipped("curve", own, tmp_path).bundle.env_id == env_id
    if robot is FLEX_PLANAR:
        anchors = (*robot.base_anchors, (0.0, -0.6))
        with pytest.raises(ValueError, match="evaluate it on the environment that it was trained on"):
            load_shipped("curve", robot.replace(name="four", base_anchors=anchors), tmp_path)


def test_what_is_missing_is_said_in_words(tmp_path):
    with pytest.raises(ValueError, match=r"curve-planar.zip is missing \(there: none\)"):
        load_shipped("curve", PLANAR, tmp_path)
    save_run(tmp_path)
    (tmp_path / BEST).rename(tmp_path / "curve-planar.zip")
    words = (
        r"curve-spatial.zip is missing \(there: curve-planar.zip\); install .* --policy curve --id CableBot-Spatial-v0"
    )
    with pytest.raises(ValueError, match=words):
        load_shipped("curve", SPATIAL, tmp_path)
    words = "'ppo' ships for CableBot-Spatial-v0, not for CableBot-Planar-v0: choose curve, preview, or train it"
    with pytest.raises(ValueError, match=words):
        load_shipped("ppo", PLANAR, tmp_path)
    with pytest.raises(ValueError, match="choose one of ppo, curve, curve-safe, preview"):
        load_shipped("tube", PLANAR, tmp_path)
    (tmp_path / "curve-planar.zip").write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"curve-planar.zip' cannot be used"):
        load_shipped("curve", PLANAR, tmp_path)


# ------------------------------------------------------------------------------------------------- held-out motions


def seeds_in(value):
    """Every number called ``seed`` anywhere in data."""
    if isinstance(value, dict):
        yield from (number for name, number in value.items() if name == "seed")
    if isinstance(value, (dict, list, tuple)):
        for part in value.values() if isinstance(value, dict) else value:
            yield from seeds_in(part)


def check_apart(env_id, algorithm, config):
    """Neither trained nor chosen on held-out motions."""
    assert all(seed in TRAINING_SEEDS for seed in seeds_in(config))
    if algorithm == ALGORITHM:
        made = make_gradient_config(env_id, config)
        trained, judged = ({getattr(one, "seed", None) for one in some} for some in (made.trajectories, made.judged))
        assert all(seed is None or seed < FIRST_HELD_OUT_SEED for seed in trained | judged)
        assert trained == judged == {None} or not trained & judged


def test_training_and_validation_seeds_are_apart_from_the_held_out_ones():
    assert max(TRAINING_SEEDS) < FIRST_HELD_OUT_SEED
    assert {*VALIDATION} <= {*TRAINING_SEEDS}
    plain = {"base": "fl", "steering": "shift", "features": ["bells"]}
    with pytest.raises(ValueError, match="motions must be"):
        make_gradient_config(PLANAR_ID, {**plain, "motions": {"loops": VALIDATION[0] + 1}})


@each_policy
def test_no_configuration_that_ships_trains_on_held_out_motions(name, env_id):
    shipped = SHIPPED[name]
    check_apart(env_id, shipped.algorithm, read_yaml(env_id, Path(shipped.config or shipped.algorithm)))


# ----------------------------------------------------------------------------------------------- what ships, as it is


def test_all_or_nothing_ships():
    """A policy without its weights could not be made by anybody."""
    expected = {stem(one.name, env_id) for one in SHIPPED.values() for env_id in one.env_ids}
    models = {f"{name}-sb3" for name, card in CARDS.items() if card.sb3}
    assert set(CARDS) in (set(), expected)
    assert {path.stem for path in WEIGHTS.glob("*.zip")} == set(CARDS) | models
    assert {path.stem for path in WEIGHTS.glob("*.json")} == set(CARDS)


def test_page_is_that_of_the_cards():
    path, bests = ROOT / "docs" / "learned.md", read_bests(RESULTS)
    page = path.read_text(encoding="utf-8") if path.exists() else ""
    assert page == (card_markdown(list(CARDS.values())) if CARDS else ""), AGAIN
    assert [with_bests(card, bests) for card in CARDS.values()] == list(CARDS.values()), AGAIN


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
from baselines.learned.bundle import Bundle
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
        assert card.shipped_seed == typical({run.seed: run.payloads[0] for run in card.seeds})
        assert (card.algorithm, card.config, card.conditions) == (shipped.algorithm, shipped.config, shipped.conditions)
        assert (bundle.env_id, bundle.card["seed"]) == (card.env_id, card.shipped_seed)
        assert bundle.card["planner_output_used"] == card.planner_output_used
        assert bundle.card["config"] == read_yaml(card.env_id, Path(card.config or card.algorithm))
        check_apart(card.env_id, card.algorithm, bundle.card["config"])
        assert all(one.seed >= FIRST_HELD_OUT_SEED for one in card.held_out)


def test_payloads_of_the_planar_cards_still_hold():
    for card in (card for name, card in CARDS.items() if name.endswith("-planar")):
        made = evaluate_dlcc(load_shipped(card.policy, PLANAR), PLANAR_ID, payload_known=card.conditions[0].told)
        assert made.payload == pytest.approx(card.shipped.payloads[0], abs=2 * made.resolution)
