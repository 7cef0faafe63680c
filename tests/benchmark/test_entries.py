"""Entries of others: tampered folders and claims are refused. The commands have tests in
tests/cli."""

import json
import shutil
import sys
from dataclasses import replace

import pytest
from attacks.hostile_entries import HOSTILE_ENTRIES

from cablebot_gym.benchmark import entries, suites
from cablebot_gym.benchmark.board import policy_digest
from cablebot_gym.benchmark.cells import PolicyCell
from cablebot_gym.benchmark.engine import local, run_cells
from cablebot_gym.benchmark.entries import (
    check_entry,
    entry_cells,
    find_entries,
    make_entry,
    note,
    read_claims,
    refuted,
    renamed,
    status,
)
from cablebot_gym.benchmark.leaderboard import Results, markdown
from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.benchmark.records import Record
from cablebot_gym.benchmark.store import Store
from cablebot_gym.benchmark.suites import Block, Suite
from cablebot_gym.isolation.deadlines import BUDGET, Deadlines
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import PLANAR

ENV_ID = "CableBot-Planar-v0"
TEXTS = {
    "authors": "A. Author",
    "licence": "MIT",
    "compute": "none",
    "data": "none",
    "seeds": "none",
}
BLOCKS = (Block(), Block(conditions={"uncertainty": "sensors", "draws": 64}))
TINY = Suite(name="tiny", summary="circle", env_ids=(ENV_ID,), blocks=BLOCKS)
LAW = """
import numpy as np
from toy_gains import GAIN  # gains.txt

def make(robot):
    return lambda observation: np.full(robot.cables, GAIN)
"""


@pytest.fixture
def entry(module, tmp_path, monkeypatch):
    """Folder of an entry that claims 1 kg without noise and 0.5 kg with noise."""
    monkeypatch.setattr(suites, "SUITES", {"tiny": TINY} | suites.SUITES)
    module("toy_law.py", LAW)
    module("toy_gains.py", "GAIN = 0.5\n")
    module("gains.txt", "0.5")
    folder = tmp_path / "entries" / "law"
    make_entry(folder, "toy_law:make", [ENV_ID], TEXTS)
    policy_source.cache_clear()
    records = renamed(reruns(folder, 1.0, 0.5), "law")
    results = Results(
        suite="tiny", command="", records=records, entries=[note(folder, "unverified")]
    )
    (folder / "results.json").write_text(results.to_json())
    return folder


def reruns(folder, exact, drawn, seed=0):
    """Records of a rerun with two payloads; text is an error."""
    cells = entry_cells(folder, "tiny", seed=seed, claims_only=True).values()
    records = []
    for cell, payload in zip(cells, (exact, drawn), strict=True):
        if isinstance(payload, str):
            result = {"error": payload}
        else:
            is_assured = None if cell.uncertainty is None else True
            total_mass = None if payload is None else 1 + payload
            result = {
                "payload": payload,
                "total_mass": total_mass,
                "resolution": 0.001,
                "assured": is_assured,
            }
        records.append(
            Record(
                cell=replace(cell, seed=seed), source="a", versions={}, result=result, seconds=0.0
            )
        )
    return records


def test_entry_has_the_files_of_its_policy(entry):
    assert sorted(path.name for path in (entry / "policy").iterdir()) == [
        "gains.txt",
        "toy_gains.py",
        "toy_law.py",
    ]
    assert check_entry(entry).env_ids == (ENV_ID,)
    assert find_entries(entry.parent) == ({str(entry): check_entry(entry)}, {})
    with pytest.raises(ValueError, match="in a process of its own only"):
        load_policy(str(entry), PLANAR)
    assert policy_digest(str(entry)) != policy_digest("fl")


def write(path, text):
    path.parent.mkdir(exist_ok=True)
    path.write_text(text)


def edit(entry, change):
    card = json.loads((entry / "entry.json").read_text())
    write(entry / "entry.json", json.dumps(card | change))


TAMPERING = {
    "other code": (
        lambda entry: write(entry / "policy" / "toy_law.py", "make = 1"),
        "match its card in toy_law.py",
    ),
    "another file": (
        lambda entry: write(entry / "policy" / "numpy.py", ""),
        "match its card in numpy.py",
    ),
    "compiled code": (
        lambda entry: write(entry / "policy" / "__pycache__" / "a.pyc", ""),
        "its card in __pycache__",
    ),
    "missing weights": (
        lambda entry: (entry / "policy" / "gains.txt").unlink(),
        "its card in gains.txt",
    ),
    "finished cells": (
        lambda entry: write(entry / "work" / "run.json", "{}"),
        "unknown or links: work",
    ),
    "link": (lambda entry: (entry / "policy" / "a").symlink_to("/etc/passwd"), "is a link"),
    "linked results": (
        lambda entry: (entry / "README.md").symlink_to("/etc/passwd"),
        "links: README.md",
    ),
    "licence": (lambda entry: edit(entry, {"licence": " "}), "licence must be a text"),
    "unknown field": (lambda entry: edit(entry, {"score": 1}), "unknown key of the card 'score'"),
    "other folder": (
        lambda entry: edit(entry, {"policy": "../../law:make"}),
        "policy must be module:factory",
    ),
    "command": (
        lambda entry: edit(entry, {"package": "law==1; rm -rf ."}),
        "package must be name==version",
    ),
    "name": (lambda entry: edit(entry, {"name": "fl"}), "must have the name of the entry"),
}


@pytest.mark.parametrize(("tamper", "message"), TAMPERING.values(), ids=TAMPERING)
def test_tampered_folder_is_refused(entry, tamper, message):
    tamper(entry)
    with pytest.raises(ValueError, match=message):
        check_entry(entry)


@pytest.mark.skipif(sys.platform == "win32", reason="pipes and links have names on POSIX")
@pytest.mark.parametrize("hostile", HOSTILE_ENTRIES, ids=lambda hostile: hostile.name)
def test_hostile_entry_is_invalid_and_costs_itself_only(entry, hostile):
    """Before, it ended or misled the run of all entries."""
    honest = entry.with_name("honest")
    shutil.copytree(entry, honest)
    edit(honest, {"name": "honest"})
    hostile.change(entry)
    valid, invalid = find_entries(entry.parent)
    assert list(valid) == [str(honest)]
    (reason,) = invalid.values()
    assert hostile.now in reason
    assert len(reason) <= 400
    assert "".join(invalid).isascii()


FALSE_CLAIMS = {
    "wide bounds": (
        '"position": 0.01',
        '"position": 1.0',
        "does not have the cells of suite 'tiny'",
    ),
    "another suite": (
        '"suite": "tiny"',
        '"suite": "smoke"',
        "does not have the cells of suite 'smoke'",
    ),
    "text": ('"payload": 1.0', '"payload": "many"', "payload that is no number"),
    "damaged": ('"cells"', '"sells"', "holds no results"),
}


@pytest.mark.parametrize(("old", "new", "message"), FALSE_CLAIMS.values(), ids=FALSE_CLAIMS)
def test_claims_under_other_conditions_are_refused(entry, old, new, message):
    path = entry / "results.json"
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(ValueError, match=message):
        read_claims(entry)


@pytest.mark.parametrize("interrupted", [False, True])
@pytest.mark.parametrize(("hours", "fitting"), [(10.0, 3), (24.0, 1), (8.0, 3), (6.1, 4), (0.0, 5)])
def test_entry_stops_when_its_budget_is_used(
    entry, tmp_path, monkeypatch, hours, fitting, interrupted
):
    """A resumed run goes on with the time of the stored cells. Shipped policies have no budget."""
    computed = []
    interrupts = [KeyboardInterrupt()] * interrupted

    def compute(cell):
        if interrupts and computed:
            raise interrupts.pop()
        computed.append(cell.policy)
        Deadlines.total += 3600 * hours
        return {"payload": 1.0}

    monkeypatch.setattr(PolicyCell, "compute", compute)
    cells = {}
    for policy in (str(entry), "fl"):
        for seed in range(5):
            cell = PolicyCell(
                env_id=ENV_ID, trajectory={"name": "circle-planar"}, policy=policy, seed=seed
            )
            cells[cell.key] = cell
    store = Store(tmp_path / "out", say=print)

    def run():
        return run_cells(cells, store, local(1), lambda *step: None, print)

    if interrupted:
        with pytest.raises(KeyboardInterrupt):
            run()
    errors = [record.error for record in run()]
    assert computed == [str(entry)] * fitting + ["fl"] * 5
    message = f"entry {entry} used its budget of {BUDGET / 3600:g} h of processor time"
    assert errors == [None] * fitting + [message] * (5 - fitting) + [None] * 5
    assert [record.error for record in run()] == errors
    assert len(computed) == fitting + 5


def test_claim_above_the_rerun_is_refuted(entry):
    claims = read_claims(entry)
    for exact, drawn in ((1.0, 0.5), (3.0, 3.0), (0.99, 0.48)):
        assert refuted(claims, reruns(entry, exact, drawn, seed=7)) == []
    (sentence,) = refuted(claims, reruns(entry, 0.9, 0.5, seed=7))
    assert sentence.endswith("1.000 kg claimed; rerun: it carries 0.900 kg")
    assert "sensors" in refuted(claims, reruns(entry, 1.0, 0.4))[0]
    assert "it fails unloaded" in refuted(claims, reruns(entry, None, 0.5))[0]
    assert "it lost its file" in refuted(claims, reruns(entry, "it lost its file", 0.5))[0]


@pytest.mark.parametrize(("payload", "exact", "count"), [(None, None, 0), (float("nan"), 1.0, 2)])
def test_claim_of_nan_is_refuted_and_of_no_payload_confirmed(entry, payload, exact, count):
    claims = read_claims(entry)
    records = [replace(claim, result={"payload": payload}) for claim in claims.records]
    assert len(refuted(replace(claims, records=records), reruns(entry, exact, exact))) == count


def test_entry_is_verified_by_a_rerun_in_a_sandbox(entry, monkeypatch):
    monkeypatch.setattr(entries, "sandbox_name", lambda: "bubblewrap 1")
    assert status(entry, reruns(entry, 1.0, 0.5, seed=7)) == "verified"
    assert "1.000 kg claimed" in status(entry, reruns(entry, 0.5, 0.5))
    assert status(entry, []) == "unverified: the rerun has no conditions of the claims"
    monkeypatch.setattr(entries, "sandbox_name", lambda: None)
    assert status(entry, reruns(entry, 1.0, 0.5)) == "unverified: it ran without a sandbox"
    (entry / "results.json").unlink()
    assert "holds no results" in status(entry, reruns(entry, 1.0, 0.5))


def test_table_gives_authors_licence_and_status(entry):
    notes = [note(entry, "unverified: 1.000 kg | claimed")]
    page = markdown(
        Results(suite="tiny", command="", records=reruns(entry, 1.0, 0.5), entries=notes)
    )
    assert f"| `{entry}`, unverified |" in page
    assert f"| `{entry}` | – | A. Author | MIT | none | none | none | unverified: 1.000 kg" in page
    verified = [replace(notes[0], status="verified")]
    again = Results.from_json(
        Results(
            suite="tiny", command="", records=reruns(entry, 1.0, 0.5), entries=verified
        ).to_json()
    )
    assert "`, unverified" not in markdown(again)


def test_policy_of_this_project_is_refused_as_an_entry(entry):
    with pytest.raises(ValueError, match="belongs to this project"):
        make_entry(entry.parent / "fl", "fl", [ENV_ID], TEXTS)
    with pytest.raises(ValueError, match="has another entry"):
        make_entry(entry, "toy_law:make", [ENV_ID], TEXTS | {"licence": "other"})
    with pytest.raises(ValueError, match="belong to boards"):
        entry_cells(entry, "ranked", seed=0)
