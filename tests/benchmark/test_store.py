"""Store and runs of cells: finished cells are kept, damaged or foreign files are not used."""

import pytest

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell
from cablebot_gym.benchmark.engine import run_cells
from cablebot_gym.benchmark.records import Record, failed_record
from cablebot_gym.benchmark.store import Store
from cablebot_gym.utils.workers import WorkerDied

CELL, OTHER = (
    PolicyCell(env_id="CableBot-Planar-v0", trajectory={"name": "circle-planar"}, policy=policy)
    for policy in ("fl", "robust")
)


def record(cell=CELL, source=None, payload=1.0 / 3.0):
    result = {"payload": payload, "feasible": [[0.0, payload]], "violation": {"kind": "torque"}}
    return Record(
        cell=cell,
        source=source or cell.source,
        versions={"python": "3"},
        result=result,
        seconds=0.1234,
    )


@pytest.fixture
def messages():
    return []


@pytest.fixture
def store(tmp_path, messages):
    return Store(tmp_path, say=messages.append)


def files(folder):
    return sorted((folder / "cells").iterdir())


@pytest.mark.landing
def test_record_is_read_as_it_was_written(store, messages, tmp_path):
    store.add(record())
    stored = store.find(CELL)
    assert stored.cell == CELL
    assert stored.source == CELL.source
    assert stored.result == record().result
    assert stored.versions == {"python": "3"}
    assert stored.seconds == 0.123
    assert store.find(OTHER) is None
    assert messages == []
    assert files(tmp_path)[0].name.startswith("planar-fl-payload-known-task-circle-planar-")


def test_store_keeps_results_of_other_code_and_finds_those_of_this_code(store, messages, tmp_path):
    store.add(record(source="a" * 16, payload=1.0))
    assert store.find(CELL) is None
    store.add(record(payload=3.0))
    assert len(files(tmp_path)) == 2
    assert store.find(CELL).result["payload"] == 3.0
    assert messages == []


def test_cell_with_a_record_of_other_code_under_its_name_is_missing(store, tmp_path):
    store.add(record())
    (path,) = files(tmp_path)
    path.write_text(path.read_text().replace(CELL.source, "a" * 16))
    assert store.find(CELL) is None


# --- runs -------------------------------------------------------------------------------------------------------------


def run(store, outcomes=None, cells=(CELL, OTHER), progress=lambda *step: None):
    """Records of the cells and the computed cells; outcomes replace records, and an interrupt is
    raised."""
    computed = []

    def backend(jobs, say, returned):
        for key, job in jobs.items():
            cell = job.args[0]
            computed.append(cell)
            outcome = (outcomes or {}).get(
                cell.policy if isinstance(cell, PolicyCell) else ""
            ) or record(cell)
            if isinstance(outcome, KeyboardInterrupt):
                raise outcome
            yield key, outcome

    return run_cells({cell.key: cell for cell in cells}, store, backend, progress, print), computed


@pytest.mark.parametrize(
    ("outcome", "message"),
    [
        (WorkerDied("its process died"), "its process died"),
        (record(source="f" * 16), "different code"),
    ],
)
def test_cell_of_a_dead_worker_is_tried_again(store, tmp_path, outcome, message):
    (bad, good), _ = run(store, {"fl": outcome})
    assert message in bad.error
    assert good.error is None
    assert len(files(tmp_path)) == 1
    assert run(store)[1] == [CELL]
    assert not failed_record(CELL, "no memory").final


def test_longest_cells_start_first(store):
    best = BestKnownCell(env_id="CableBot-Planar-v0", trajectory={"name": "circle-planar"})
    drawn = PolicyCell(**{**vars(CELL), "policy": "adaptive", "uncertainty": "table6", "draws": 9})
    records, computed = run(store, cells=(CELL, drawn, best))
    assert computed == [best, drawn, CELL]
    assert [record.cell for record in records] == [CELL, drawn, best]
