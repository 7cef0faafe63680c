"""Cells: what tells them apart, what they ask, and what code made them."""

from __future__ import annotations

import dataclasses
import importlib
import json
import sys
from importlib.metadata import EntryPoint

import gymnasium as gym
import pytest

from cablebot_gym.benchmark import policy_source as policy_sources
from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, cell_from_dict, compute
from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.evaluation import DLCCMonitor, evaluate_dlcc
from cablebot_gym.policies import PolicyEntry, load_policy
from cablebot_gym.robots import FLEX_PLANAR, PLANAR
from cablebot_gym.utils import code_hash
from cablebot_gym.utils.code_hash import source_hash

PLANAR_ID = "CableBot-Planar-v0"
CIRCLE = {"name": "paper-planar"}
FL = PolicyCell(env_id=PLANAR_ID, trajectory=CIRCLE, policy="fl")
OTHERS = {
    "env_id": "CableBot-Spatial-v0",
    "trajectory": {"name": "paper-planar", "duration": 2.0},
    "policy": "robust",
    "criterion": "paper",
    "payload_known": False,
    "model_payload_factor": 0.9,
    "uncertainty": "table6",
    "draws": 4,
    "probability": 0.5,
    "error_bounds": {"position": 0.02, "rotation": 0.01},
    "control_frequency": 250.0,
    "seed": 1,
    "resolution": 0.5,
    "stiffness": 10.0,
}


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Writes a module of policies and forgets what was known of it."""

    def write(name, text):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
        importlib.invalidate_caches()
        here, there = (code_hash.source_hash, code_hash.module_file, code_hash._parsed), policy_sources
        for cached in (*here, there.policy_source, there._data_files):
            cached.cache_clear()
        return path

    monkeypatch.syspath_prepend(tmp_path)
    yield write
    for name in [name for name in sys.modules if name.startswith("toy_")]:
        del sys.modules[name]


def test_no_field_is_missing_from_the_key():
    assert set(OTHERS) == {item.name for item in dataclasses.fields(PolicyCell)}
    keys = {FL.key, *(dataclasses.replace(FL, **{name: value}).key for name, value in OTHERS.items())}
    assert len(keys) == 1 + len(OTHERS)
    best = BestKnownCell(env_id=PLANAR_ID, trajectory=CIRCLE)
    assert best.key not in keys


@pytest.mark.parametrize(
    "cell", [FL, dataclasses.replace(FL, **OTHERS), BestKnownCell(env_id=PLANAR_ID, trajectory=CIRCLE)]
)
def test_cell_is_not_another_after_json(cell):
    again = cell_from_dict(json.loads(json.dumps(cell.to_dict())))
    assert again == cell
    assert again.key == cell.key


_ASKED = ("env_id", "criterion", "uncertainty", "draws", "probability", "stiffness")


@pytest.mark.parametrize("name", sorted(set(OTHERS) - set(_ASKED)))
def test_field_is_not_read_and_then_discarded(name):
    """That the payload moves; draws and the rest are tested by what the evaluator is asked."""
    base = dataclasses.replace(FL, uncertainty="sensors") if name == "seed" else FL
    assert (
        compute(base).result["payload"] != compute(dataclasses.replace(base, **{name: OTHERS[name]})).result["payload"]
    )


def test_stiffness_is_not_read_and_then_discarded():
    springs = PolicyCell(env_id="CableBot-FlexPlanar-v0", trajectory=CIRCLE, policy="motor-pd", stiffness=10.0)
    stiffer = FLEX_PLANAR.replace(transmission=FLEX_PLANAR.transmission.replace(stiffness=10.0))
    expected = evaluate_dlcc(load_policy("motor-pd", stiffer), springs.env_id, robot=stiffer).payload
    assert compute(springs).result["payload"] == expected
    assert compute(dataclasses.replace(springs, stiffness=None)).result["payload"] != expected


def test_stiffness_of_a_rigid_robot_is_one_sentence():
    error = compute(dataclasses.replace(FL, stiffness=10.0)).error
    assert error == f"{PLANAR_ID} has no joint springs; omit the stiffness or choose an id with -Flex"


def test_draws_and_probability_are_not_read_and_then_discarded():
    cell = dataclasses.replace(FL, uncertainty="table6", draws=8, probability=0.5)
    expected = evaluate_dlcc("fl", PLANAR_ID, uncertainty="table6", draws=8, probability=0.5)
    assert compute(cell).result["payload"] == expected.payload
    assert compute(dataclasses.replace(cell, probability=0.99)).result["payload"] < expected.payload


def test_same_cell_does_not_give_other_results():
    assert compute(FL).result == compute(FL).result
    assert "seconds" not in json.dumps(compute(FL).result)


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_model_payload_factor_reaches_the_evaluation(factor):
    found = compute(dataclasses.replace(FL, model_payload_factor=factor)).result
    assert found["payload"] != compute(FL).result["payload"]
    assert found["total_mass"] == found["payload"] + PLANAR.mass
    for more, carried in ((0.0, True), (found["resolution"], False)):
        true = found["payload"] + more
        wrong = {"parameters": {"payload": {"low": 1 / factor - 1, "high": 1 / factor - 1}}}
        env = DLCCMonitor(gym.make(PLANAR_ID, payload=factor * true, uncertainty=wrong, max_episode_steps=None))
        policy = load_policy("fl", PLANAR)
        observation, info = env.reset(seed=0)
        assert info["payload"] == pytest.approx(true)
        assert env.unwrapped.layout.split(observation)["model_payload"] == pytest.approx(factor * true)
        for _ in range(500):
            observation, _, terminated, _, _ = env.step(policy.predict(observation)[0])
            if terminated:
                break
        assert env.verdict.carried == carried


def test_paper_criterion_of_a_policy_that_clips_is_no_number(module):
    module(
        "toy_clips.py",
        "import numpy as np\nfrom cablebot_baselines.classical import FeedbackLinearization\n"
        "def make(robot):\n    law = FeedbackLinearization(robot)\n"
        "    return lambda observation: np.clip(law.predict(observation)[0], -1, 1)\n",
    )
    result = compute(dataclasses.replace(FL, policy="toy_clips:make", criterion="paper")).result
    assert (result["applicable"], result["payload"]) == (False, None)
    assert compute(dataclasses.replace(FL, criterion="paper")).result["payload"] == pytest.approx(1.06, abs=0.01)


FAILING = """
class Fails:
    fallbacks = 640
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise KeyError("no such gain")
def make(robot):
    return Fails()
def unmakeable(robot):
    raise RuntimeError("not today")
"""


def test_policy_that_fails_costs_its_cell_alone(module):
    module("toy_fails.py", FAILING)
    record = compute(dataclasses.replace(FL, policy="toy_fails:make"))
    assert "raised KeyError at t = 0.000 s" in record.error
    assert record.final
    assert "not today" in compute(dataclasses.replace(FL, policy="toy_fails:unmakeable")).error


def test_cell_that_lacks_a_package_is_tried_again_another_time(monkeypatch):
    monkeypatch.setitem(sys.modules, "cablebot_gym.bounds.best_known", None)
    record = compute(BestKnownCell(env_id=PLANAR_ID, trajectory=CIRCLE))
    assert "best_known" in record.error
    assert not record.final


def test_fallbacks_are_those_of_one_episode_at_the_payload(module):
    module(
        "toy_falls.py",
        "from cablebot_baselines.classical import FeedbackLinearization\n"
        "class Falls(FeedbackLinearization):\n"
        "    def reset(self, tasks):\n        self.fallbacks = 3 * len(tasks)\n"
        "def make(robot):\n    return Falls(robot)\n",
    )
    cell = dataclasses.replace(FL, policy="toy_falls:make")
    assert compute(cell).result["fallbacks"] == 3
    drawn = dataclasses.replace(
        cell, uncertainty="table6", draws=40, trajectory={"name": "dwell-planar", "duration": 0.02}
    )
    assert compute(drawn).result["fallbacks"] == 3
    assert compute(FL).result["fallbacks"] is None


# --- which code made it -----------------------------------------------------------------------------------------------

PLAIN = 'GAIN = 1.0\n\n\ndef make(robot):\n    """A policy."""\n    return lambda observation: GAIN\n'


def test_comments_and_docstrings_do_not_make_other_code(module):
    module("toy_plain.py", PLAIN)
    before = dataclasses.replace(FL, policy="toy_plain:make").source
    module("toy_plain.py", "# why\n" + PLAIN.replace("A policy.", "The policy."))
    assert dataclasses.replace(FL, policy="toy_plain:make").source == before
    module("toy_plain.py", PLAIN.replace("1.0", "2.0"))
    assert dataclasses.replace(FL, policy="toy_plain:make").source != before


def test_change_in_what_a_policy_imports_or_loads_makes_other_code(module):
    for name, text in (("__init__", ""), ("law", "from toy_package.gains import K\n"), ("gains", "K = 1\n")):
        module(f"toy_package/{name}.py", text)
    module("toy_package/unused.py", "K = 1\n")
    module("toy_package/weights.bin", "1")
    seen = {dataclasses.replace(FL, policy="toy_package.law:make").source}
    module("toy_package/unused.py", "K = 2\n")
    assert {dataclasses.replace(FL, policy="toy_package.law:make").source} == seen
    for name in ("gains.py", "weights.bin", "__init__.py"):
        module(f"toy_package/{name}", "K = 3\n")
        seen.add(dataclasses.replace(FL, policy="toy_package.law:make").source)
    assert len(seen) == 4


def test_data_that_an_entry_does_not_name_does_not_make_other_code(module, monkeypatch):
    for name, text in (("__init__.py", ""), ("law.py", "K = 1\n"), ("own.bin", "1"), ("card.json", "1")):
        path = module(f"toy_package/{name}", text)
    files = (path.parent / "own.bin",)
    entry = PolicyEntry(name="toy", kind="learned", env_ids=(), factory=lambda robot: None, summary="", files=files)
    point = EntryPoint(name="toy", group="cablebot_gym.policies", value="toy_package.law:ENTRY")
    monkeypatch.setattr(policy_sources, "entry_points", lambda **_: [point])
    monkeypatch.setattr(policy_sources, "policy_entries", lambda: {"toy": entry})
    cell, seen = dataclasses.replace(FL, policy="toy"), []
    for name, text in (("own.bin", "1"), ("card.json", "2"), ("own.bin", "2")):
        module(f"toy_package/{name}", text)
        seen.append(cell.source)
    assert seen[0] == seen[1] != seen[2]


def test_code_of_a_module_of_no_package_is_what_it_imports_from_its_folder_too(module):
    module("toy_flat.py", "import numpy\nimport toy_helper\nfrom toy_helpers.deep import K\ndef make(robot): ...\n")
    module("toy_helpers/__init__.py", "")
    seen = set()
    for name in ("toy_helper.py", "toy_helpers/deep.py", "toy_helpers/__init__.py", "toy_other.py"):
        for value in (1, 2):
            module(name, f"K = {value}\n")
            seen.add(dataclasses.replace(FL, policy="toy_flat:make").source)
    assert len(seen) == 6  # the last does not count: nobody imports it


def test_code_of_a_cell_does_not_lack_the_physics_or_the_law():
    files = {}
    real = code_hash._parsed.__wrapped__

    def meaning(path, name):
        files[name] = path
        return real(path, name)

    code_hash.source_hash.cache_clear()
    original, code_hash._parsed = code_hash._parsed, meaning
    try:
        source_hash("cablebot_gym.evaluation.evaluator", *policy_source("adaptive")[0])
    finally:
        code_hash._parsed = original
        code_hash.source_hash.cache_clear()
    for name in (
        "physics.kernel",
        "envs.vector",
        "envs.disturbances",
        "evaluation.constraints",
        "robots",
        "uncertainty",
    ):
        assert f"cablebot_gym.{name}" in files
    assert {"cablebot_baselines.classical.adaptive", "cablebot_baselines.classical.law"} <= set(files)
    assert not [name for name in files if name.startswith(("cablebot_baselines.paper", "cablebot_gym.cli.app"))]


def test_file_of_a_policy_is_its_code(tmp_path):
    (tmp_path / "model.zip").write_bytes(b"1")
    one = dataclasses.replace(FL, policy=str(tmp_path / "model.zip"))
    before = one.source
    code_hash.source_hash.cache_clear()
    (tmp_path / "model.zip").write_bytes(b"2")
    assert one.source != before
