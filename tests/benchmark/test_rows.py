"""Rows: their keys, the evaluation that they request, and the hash of the code that computes
them."""

import json
import os
import sys
from dataclasses import fields, replace

import pytest
from benchmark.made_rows import PLANAR, asked

from cablebot_gym.benchmark.rows import WITHOUT_EFFECT, compute, jobs, row_from_dict
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.isolation.process import has_bubblewrap
from cablebot_gym.robots import find_robot
from cablebot_gym.utils import code_hash

SLOW = 125.0
"""Control frequency with a quarter of the usual steps [1/s]."""
SEARCH = {"resolution": 0.02, "payload_max": 4.0}
FL = asked(policy="fl", control_frequency=SLOW, search=SEARCH)
BEST = asked("best-known")
SHORT = {"name": "dwell-planar", "duration": 0.02}
OTHERS = {
    "env_id": "CableBot-Spatial-v0",
    "robot": "flex-planar",
    "trajectory": {"name": "circle-planar", "duration": 2.0},
    "error_bounds": {"position": 0.02, "rotation": 0.01},
    "control_frequency": 250.0,
    "measurement": "winches",
    "criterion": "paper",
    "payload_known": False,
    "model_payload_factor": 0.9,
    "uncertainty": "table6",
    "draws": 60,
    "seed": 2**127 + 1,
    "further": {"initial_error": [0.004, 0.0]},
}


def changed(policy="fl", search=SEARCH, **conditions):
    given = replace(FL.conditions, **conditions)
    return replace(FL, policy=policy, search=search, conditions=given)


def result_of(row):
    (computed,) = compute([row])
    return computed.result


def test_every_field_changes_the_key_and_survives_json():
    assert set(OTHERS) == {item.name for item in fields(Conditions)}
    rows = [FL, BEST, changed("robust"), changed(search={})]
    rows += [changed(**{name: value}) for name, value in OTHERS.items()]
    assert len({row.key for row in rows}) == len(rows)
    for row in rows:
        read = row_from_dict(json.loads(json.dumps(row.to_dict())))
        assert read.key == row.key
        assert read.conditions == row.conditions


REACHING = set(OTHERS) - {"env_id", "robot", "criterion", "measurement", "draws", "uncertainty"}


@pytest.fixture(scope="module")
def default_payload():
    """Payload of the usual row."""
    return result_of(FL)["payload"]


@pytest.mark.parametrize("name", sorted(REACHING))
def test_field_reaches_the_evaluation(default_payload, name):
    assert result_of(changed(**{name: OTHERS[name]}))["payload"] != default_payload


@pytest.mark.landing
def test_motions_of_a_family_are_computed_together_with_robots_of_their_own():
    """A row has the payload of its motion and its seed, whatever its company is."""
    motions = [{"name": "loop-planar", "seed": seed} for seed in (10_000, 10_001)]
    given = {"uncertainty": "table6", "draws": 3, "control_frequency": SLOW}
    rows = [
        asked(policy="fl", motion=motion, seed=7 + k, **given) for k, motion in enumerate(motions)
    ]
    others = [FL, asked(policy="robust", motion=motions[0], **given)]
    assert jobs([rows[0], *others, rows[1]]) == [tuple(rows), *((row,) for row in others)]
    many = [replace(rows[0], conditions=replace(rows[0].conditions, seed=k)) for k in range(25)]
    assert [len(job) for job in jobs(many)] == [10, 10, 5]  # workers share them
    together = [row.result["payload"] for row in compute(rows)]
    assert together == [result_of(row)["payload"] for row in rows]


@pytest.mark.landing
def test_policy_of_a_row_has_a_process_of_its_own(module, request):
    module("toy_policies.py", TOYS)
    coarse = changed("toy_policies:numbered", {"resolution": 1.0}, trajectory=SHORT)
    isolated = dict(result_of(coarse))
    request.getfixturevalue("inline")
    here = result_of(coarse)
    assert isolated.pop("fallbacks") != here["fallbacks"] == os.getpid()
    assert isolated.pop("isolated")
    assert isolated.pop("bubblewrap") == has_bubblewrap()
    assert isolated == {name: here[name] for name in isolated}


def test_robot_reaches_plant_and_policy():
    """A law of another robot would refuse the task."""
    robot = find_robot("gch-klaus")
    motion = {"name": f"dwell-{robot.kind}", "pose": robot.home, "duration": 0.02}
    env_id = "CableBot-PlanarPlatform-v0"
    row = asked(policy="fl", motion=motion, env_id=env_id, robot=robot.name, search={})
    result = result_of(row)
    assert result["total_mass"] - result["payload"] == pytest.approx(robot.mass)


@pytest.mark.landing
def test_draws_and_search_reach_the_evaluation():
    draws = {"uncertainty": "table6", "draws": 20, "seed": 2**127}
    search = {"resolution": 0.1, "payload_max": 4.0, "probability": 0.5}
    expected = evaluate_dlcc("fl", PLANAR, control_frequency=SLOW, **draws, **search)
    result = result_of(changed(search=search, **draws))
    assert result["payload"] == expected.payload
    assert result["assured"]
    likely = changed(search=search | {"probability": 0.9}, **draws)
    assert result_of(likely)["payload"] < expected.payload


def test_row_of_a_time_has_time_per_action_and_processor():
    result = result_of(asked("time", "fl"))
    assert 0 < result["median"] <= result["p99"]
    assert 0 <= result["missed"] <= 1
    assert result["start"] > 0
    assert result["processor"]
    assert not result["exchange"]


TOYS = """
import os
import numpy as np
from cablebot_baselines.laws import FeedbackLinearization


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


def fails(robot):
    return Fails()


def impossible(robot):
    raise RuntimeError("not today")
"""


PAPER = {"criterion": "paper", "trajectory": {"name": "paper-planar"}, "control_frequency": 500.0}


@pytest.mark.landing
@pytest.mark.usefixtures("inline")
def test_paper_criterion_does_not_apply_to_saturated_actions(module):
    module("toy_policies.py", TOYS)
    result = result_of(changed("toy_policies:clips", **PAPER))
    assert not result["applicable"]
    assert result["payload"] is None


@pytest.mark.usefixtures("inline")
def test_exception_of_a_policy_is_the_final_error_of_its_row(module):
    module("toy_policies.py", TOYS)
    (row,) = compute([changed("toy_policies:fails")])
    assert "KeyError" in row.error
    assert row.final
    assert "not today" in result_of(changed("toy_policies:impossible"))["error"]


def test_missing_package_is_an_error_that_is_not_final(monkeypatch):
    monkeypatch.setitem(sys.modules, "cablebot_gym.bounds.best_known", None)
    (row,) = compute([BEST])
    assert "best_known" in row.error
    assert not row.final


@pytest.mark.usefixtures("inline")
def test_fallbacks_are_counted_per_episode(module):
    module("toy_policies.py", TOYS)
    for draws in ({}, {"uncertainty": "table6", "draws": 40}):
        result = result_of(changed("toy_policies:Falls", trajectory=SHORT, **draws))
        assert result["fallbacks"] == 3
    assert result_of(changed(trajectory=SHORT))["fallbacks"] is None


# --- hash of the code -------------------------------------------------------------------------------------------------


IMPORTED = "from toy_package.gains import K\n"
FLAT = "import numpy, toy_helper, toy_package.other\ndef make(robot): ...\n"
BOTH = "from toy_package.law import make\nfrom toy_package.other import K\n"


@pytest.mark.parametrize(
    ("policy", "files", "writes"),
    [
        # Imports and data of a package, but no comments.
        (
            "toy_package.law:make",
            {"__init__.py": "", "law.py": IMPORTED, "gains.py": "K = 1\n"},
            [
                ("unused.py", "K = 2\n", False),
                ("gains.py", '"""Gains."""\n\nK = 1  # why\n', False),
                ("weights.bin", "1", True),
                ("gains.py", "K = 3\n", True),
            ],
        ),
        # Imports of a module in its folder.
        (
            "toy_flat:make",
            {"__init__.py": "", "../toy_flat.py": FLAT, "../toy_helper.py": "", "other.py": ""},
            [
                ("unused.py", "K = 1\n", False),
                ("other.py", "K = 1\n", True),
                ("../toy_helper.py", "K = 1\n", True),
            ],
        ),
        # A name of a package that imports all of its laws.
        (
            "toy_package:make",
            {"__init__.py": BOTH, "law.py": "def make(robot): ...\n", "other.py": "K = 1\n"},
            [("other.py", "K = 2\n", False), ("law.py", "def make(): ...\n", True)],
        ),
    ],
    ids=["package", "module", "name"],
)
def test_hash_follows_the_code_of_a_policy(module, policy, files, writes):
    for name, text in files.items():
        module(f"toy_package/{name}", text)
    before = changed(policy).present_code
    for name, text, is_other in writes:
        module(f"toy_package/{name}", text)
        after = changed(policy).present_code
        assert (after != before) == is_other, name
        before = after


def test_hash_has_plant_judge_and_the_law_alone():
    """With all modules that the package imports, every row was due after every commit."""
    files = set(
        code_hash.source_files(
            "cablebot_gym.envs.vector",
            "cablebot_gym.evaluation.judge",
            "cablebot_baselines.laws:OBSERVING",
            without=WITHOUT_EFFECT,
        )
    )
    names = (
        "physics.kernel.integrate",
        "envs.disturbances",
        "evaluation.judge",
        "robots.paper",
    )
    assert {f"cablebot_gym.{name}" for name in names} <= files
    laws = {name.rpartition(".")[2] for name in files if name.startswith("cablebot_baselines.laws")}
    assert {"observing", "law"} <= laws
    assert not laws & {"robust", "flex_eq22"}
    assert not {name for name in files if "benchmark" in name or "cli" in name or "utils" in name}


def test_hash_has_the_file_of_a_real_robot(tmp_path, monkeypatch):
    best = replace(BEST, conditions=replace(BEST.conditions, robot="cogiro"))
    rows = [changed(robot="flex-cogiro"), best, FL]
    hashes = []
    monkeypatch.setattr(
        "cablebot_gym.benchmark.rows.library", lambda: {"cogiro": tmp_path / "cogiro.toml"}
    )
    for content in ("mass = 1", "mass = 2"):
        (tmp_path / "cogiro.toml").write_text(content)
        code_hash.source_hash.cache_clear()
        hashes.append([row.present_code for row in rows])
    assert [before == after for before, after in zip(*hashes, strict=True)] == [False, False, True]


def test_hash_of_a_policy_file_is_that_of_its_contents(tmp_path):
    row = changed(str(tmp_path / "model.zip"))
    hashes = set()
    for content in (b"1", b"2"):
        (tmp_path / "model.zip").write_bytes(content)
        code_hash.source_hash.cache_clear()
        hashes.add(row.present_code)
    assert len(hashes) == 2
