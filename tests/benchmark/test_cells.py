"""Cells: their keys, the evaluation that they request, and the hash of the code that computes
them."""

import dataclasses
import json
import os
import sys
from importlib.metadata import EntryPoint

import pytest

from cablebot_gym.benchmark import policy_source as policy_sources
from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, TimingCell, cell_from_dict
from cablebot_gym.benchmark.records import compute
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.isolation.process import has_bubblewrap
from cablebot_gym.policies import PolicyEntry, load_policy
from cablebot_gym.robots import find_robot
from cablebot_gym.utils import code_hash

PLANAR_ID = "CableBot-Planar-v0"
CIRCLE = {"name": "circle-planar"}
SLOW = 125.0
"""Control frequency with a quarter of the usual steps [1/s]."""
FL = PolicyCell(
    env_id=PLANAR_ID,
    trajectory=CIRCLE,
    policy="fl",
    resolution=0.02,
    payload_max=4.0,
    control_frequency=SLOW,
)
BEST = BestKnownCell(env_id=PLANAR_ID, trajectory=CIRCLE)
OTHERS = {
    "env_id": "CableBot-Spatial-v0",
    "trajectory": {"name": "circle-planar", "duration": 2.0},
    "policy": "robust",
    "criterion": "paper",
    "payload_known": False,
    "model_payload_factor": 0.9,
    "uncertainty": "table6",
    "draws": 60,
    "probability": 0.5,
    "error_bounds": {"position": 0.02, "rotation": 0.01},
    "control_frequency": 250.0,
    "seed": 2**127 + 1,
    "resolution": 1e-3,
    "payload_max": 1.5,
    "robot_name": "flex-planar",
}


def changed(**fields):
    return dataclasses.replace(FL, **fields)


def test_every_field_changes_the_key_and_survives_json():
    assert set(OTHERS) == {item.name for item in dataclasses.fields(PolicyCell)}
    cells = [FL, BEST, *(changed(**{name: value}) for name, value in OTHERS.items())]
    assert len({cell.key for cell in cells}) == len(cells)
    assert [cell_from_dict(json.loads(json.dumps(cell.to_dict()))) for cell in cells] == cells


UNCERTAIN = {"uncertainty", "draws", "probability"}


@pytest.fixture(scope="module")
def default_payload():
    """Payload of the usual cell."""
    return compute(FL).result["payload"]


@pytest.mark.parametrize(
    "name", sorted(set(OTHERS) - UNCERTAIN - {"env_id", "robot_name", "criterion"})
)
def test_field_reaches_the_evaluation(default_payload, name):
    assert compute(changed(**{name: OTHERS[name]})).result["payload"] != default_payload


@pytest.mark.landing
def test_policy_of_a_cell_has_a_process_of_its_own(module, request):
    module("toy_policies.py", TOYS)
    short = {"name": "dwell-planar", "duration": 0.02}
    coarse = changed(policy="toy_policies:numbered", resolution=1.0, trajectory=short)
    isolated = compute(coarse).result
    request.getfixturevalue("inline")
    here = compute(coarse).result
    assert isolated.pop("fallbacks") != here.pop("fallbacks") == os.getpid()
    assert isolated.pop("isolated")
    assert isolated.pop("bubblewrap") == has_bubblewrap()
    assert isolated == {name: here[name] for name in isolated}


@pytest.mark.landing
def test_robot_name_reaches_plant_and_policy():
    klaus = find_robot("gch-klaus")
    kind = "planar-platform"
    motion = {
        "name": f"lemniscate-{kind}",
        "amplitude": [0.01, 0.01],
        "center": [0.0, 0.0, 0.0],
        "duration": 1.0,
    }
    options = {"trajectory": motion, "resolution": 0.5, "payload_max": 5.0}
    cell = PolicyCell(
        env_id="CableBot-PlanarPlatform-v0", policy="fl", robot_name=klaus.name, **options
    )
    expected = evaluate_dlcc(
        load_policy("fl", klaus), cell.env_id, robot=klaus, error_bounds=FL.error_bounds, **options
    )
    result = compute(cell).result
    assert [result["payload"], result["total_mass"]] == [
        expected.payload,
        expected.payload + klaus.mass,
    ]


@pytest.mark.landing
def test_draws_and_probability_reach_the_evaluation():
    draws = {"uncertainty": "table6", "draws": 20, "probability": 0.5, "seed": 2**127}
    cell = changed(resolution=0.1, **draws)
    search = {"resolution": 0.1, "payload_max": 4.0, "control_frequency": SLOW}
    expected = evaluate_dlcc("fl", PLANAR_ID, **draws, **search)
    result = compute(cell).result
    assert result["payload"] == expected.payload
    assert result["assured"]
    likely = dataclasses.replace(cell, probability=0.9)
    assert compute(likely).result["payload"] < expected.payload


def test_timing_cell_has_time_per_action_and_processor():
    result = compute(TimingCell(env_id=PLANAR_ID, trajectory=CIRCLE, policy="fl")).result
    assert 0 < result["median"] <= result["p99"]
    assert 0 <= result["missed"] <= 1
    assert result["start"] > 0
    assert result["processor"]
    assert not result["exchange"]


TOYS = """
import os
import numpy as np
from cablebot_baselines.classical import FeedbackLinearization


class Falls(FeedbackLinearization):
    fallbacks = 0

    def reset(self, tasks):
        self.fallbacks = 3 * len(tasks)


class Numbered(Falls):
    def reset(self, tasks):  # tells the number of its process
        self.fallbacks = os.getpid() * len(tasks)


class Fails:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise KeyError("no such gain")


def clips(robot):
    law = FeedbackLinearization(robot)
    return lambda observation: np.clip(law.predict(observation)[0], -1, 1)


def numbered(robot):
    return Numbered(robot)


def claims(robot):
    return FeedbackLinearization(robot)


def fails(robot):
    return Fails()


def impossible(robot):
    raise RuntimeError("not today")
"""


PAPER = {"criterion": "paper", "trajectory": {"name": "paper-planar"}, "control_frequency": 500.0}


@pytest.mark.landing
@pytest.mark.usefixtures("inline")
def test_paper_criterion_takes_unsaturated_policies(module):
    module("toy_policies.py", TOYS)
    result = compute(changed(policy="toy_policies:clips", **PAPER)).result
    assert not result["applicable"]
    assert result["payload"] is None
    assert compute(changed(policy="toy_policies:claims", **PAPER)).result[
        "payload"
    ] == pytest.approx(1.06, abs=0.03)


@pytest.mark.usefixtures("inline")
def test_exception_of_a_policy_is_the_final_error_of_its_cell(module):
    module("toy_policies.py", TOYS)
    record = compute(changed(policy="toy_policies:fails"))
    assert "KeyError" in record.error
    assert record.final
    assert "not today" in compute(changed(policy="toy_policies:impossible")).error


def test_missing_package_is_an_error_that_is_not_final(monkeypatch):
    monkeypatch.setitem(sys.modules, "cablebot_gym.bounds.best_known", None)
    record = compute(BEST)
    assert "best_known" in record.error
    assert not record.final


@pytest.mark.usefixtures("inline")
def test_fallbacks_are_counted_per_episode(module):
    module("toy_policies.py", TOYS)
    short = {"name": "dwell-planar", "duration": 0.02}
    for draws in ({}, {"uncertainty": "table6", "draws": 40}):
        assert (
            compute(changed(policy="toy_policies:Falls", trajectory=short, **draws)).result[
                "fallbacks"
            ]
            == 3
        )
    assert compute(changed(trajectory=short)).result["fallbacks"] is None


# --- hash of the code -------------------------------------------------------------------------------------------------


def sources(module, policy, files):
    """Hashes of the code of a policy after each file is written."""
    hashes = []
    for name, text in files:
        module(name, text)
        hashes.append(changed(policy=policy).source)
    return hashes


def test_hash_has_imports_and_data_of_a_package_but_no_comments(module):
    for name, text in (
        ("__init__", ""),
        ("law", "from toy_package.gains import K\n"),
        ("gains", "K = 1\n"),
    ):
        module(f"toy_package/{name}.py", text)
    files = (
        ("unused.py", "K = 1\n"),
        ("unused.py", "K = 2\n"),
        ("gains.py", '"""Gains."""\n\nK = 1  # why\n'),
        ("weights.bin", "1"),
        ("gains.py", "K = 3\n"),
        ("__init__.py", "K = 3\n"),
    )
    hashes = sources(
        module, "toy_package.law:make", [(f"toy_package/{name}", text) for name, text in files]
    )
    assert hashes[0] == hashes[1] == hashes[2]
    assert len(set(hashes)) == 4


def test_hash_of_an_installed_policy_has_its_files(module, monkeypatch):
    for name, text in (
        ("__init__.py", ""),
        ("law.py", "K = 1\n"),
        ("own.bin", "1"),
        ("card.json", "1"),
    ):
        path = module(f"toy_package/{name}", text)
    files = (path.parent / "own.bin",)
    entry = PolicyEntry(
        name="toy", kind="learned", env_ids=(), factory=lambda robot: None, summary="", files=files
    )
    point = EntryPoint(name="toy", group="cablebot_gym.policies", value="toy_package.law:ENTRY")
    monkeypatch.setattr("cablebot_gym.policies.spec.entry_points", lambda group, name: [point])
    monkeypatch.setattr(policy_sources, "public_entry", {"toy": entry}.get)
    changes = (("own.bin", "1"), ("card.json", "2"), ("own.bin", "2"))
    hashes = sources(module, "toy", [(f"toy_package/{name}", text) for name, text in changes])
    assert hashes[0] == hashes[1] != hashes[2]


def test_hash_of_a_module_has_imports_of_its_folder(module):
    module(
        "toy_flat.py",
        "import numpy\nimport toy_helper\nfrom toy_helpers.deep import K\ndef make(robot): ...\n",
    )
    module("toy_helpers/__init__.py", "")
    names = ("toy_helper.py", "toy_helpers/deep.py", "toy_helpers/__init__.py", "toy_other.py")
    hashes = sources(
        module, "toy_flat:make", [(name, f"K = {value}\n") for name in names for value in (1, 2)]
    )
    assert len(set(hashes)) == 6  # nobody imports the last module


@pytest.mark.landing
def test_hash_has_physics_evaluation_and_law_but_no_command(monkeypatch):
    files = []
    real = code_hash._parsed.__wrapped__
    monkeypatch.setattr(
        code_hash, "_parsed", lambda path, name: files.append(name) or real(path, name)
    )
    code_hash.source_hash.cache_clear()
    assert changed(policy="adaptive").source
    code_hash.source_hash.cache_clear()
    names = (
        "physics.kernel",
        "envs.vector",
        "envs.disturbances",
        "evaluation.constraints",
        "robots",
        "uncertainty",
    )
    assert {f"cablebot_gym.{name}" for name in names} <= set(files)
    assert {"cablebot_baselines.classical.adaptive", "cablebot_baselines.classical.law"} <= set(
        files
    )
    assert "cablebot_gym.cli.app" not in files


def test_hash_has_the_file_of_a_real_robot(tmp_path, monkeypatch):
    cells = [changed(robot_name="flex-cogiro"), dataclasses.replace(BEST, robot_name="cogiro"), FL]
    hashes = []
    monkeypatch.setattr(
        "cablebot_gym.benchmark.cells.library", lambda: {"cogiro": tmp_path / "cogiro.toml"}
    )
    for content in ("mass = 1", "mass = 2"):
        (tmp_path / "cogiro.toml").write_text(content)
        code_hash.source_hash.cache_clear()
        hashes.append([cell.source for cell in cells])
    assert [before == after for before, after in zip(*hashes, strict=True)] == [False, False, True]


def test_hash_of_a_policy_file_is_that_of_its_contents(tmp_path):
    cell = changed(policy=str(tmp_path / "model.zip"))
    hashes = set()
    for content in (b"1", b"2"):
        (tmp_path / "model.zip").write_bytes(content)
        code_hash.source_hash.cache_clear()
        hashes.add(cell.source)
    assert len(hashes) == 2
