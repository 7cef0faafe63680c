"""The folder of results: nothing finished is lost, nothing broken, foreign or of other code is used unseen."""

from __future__ import annotations

import json
import os
import shutil

import pytest

from cablebot_gym.benchmark import cells
from cablebot_gym.benchmark.cells import PolicyCell, Record, failed_record
from cablebot_gym.benchmark.engine import run_cells
from cablebot_gym.benchmark.store import Store
from cablebot_gym.utils.workers import WorkerDied

CELL, OTHER = (
    PolicyCell(env_id="CableBot-Planar-v0", trajectory={"name": "paper-planar"}, policy=policy)
    for policy in ("fl", "robust")
)


def record(cell=CELL, source=None, payload=1.0 / 3.0):
    result = {"payload": payload, "feasible": [[0.0, payload]], "violation": {"kind": "torque"}}
    return Record(cell=cell, source=source or cell.source, versions={"python": "3"}, result=result, seconds=0.1234)


@pytest.fixture
def said():
    return []


@pytest.fixture
def store(tmp_path, said):
    return Store(tmp_path, say=said.append)


def only_file(folder):
    (path,) = (folder / "cells").iterdir()
    return path


def test_record_that_is_read_is_not_another(store, said, tmp_path):
    store.add(record())
    found = store.find(CELL)
    assert (found.cell, found.source, found.result) == (CELL, CELL.source, record().result)
    assert found.versions == {"python": "3"}
    assert found.seconds == 0.123
    assert store.find(OTHER) is None
    assert said == []
    assert only_file(tmp_path).name.startswith("planar-fl-payload-known-task-paper-planar-")


def truncated(path):
    text = path.read_text()
    path.write_text(text[: len(text) // 2])


def empty(path):
    path.write_text("")


def no_text(path):
    path.write_bytes(b"\xff\xfe\x00")


def no_record(path):
    path.write_text("[1, 2]")


def other_number(path):
    path.write_text(path.read_text().replace("0.333", "0.433"))


def no_checksum(path):
    data = json.loads(path.read_text())
    del data["checksum"]
    path.write_text(json.dumps(data))


def more_fields(path):
    data = json.loads(path.read_text())
    path.write_text(json.dumps(data | {"colour": "red"}))


@pytest.mark.parametrize("damage", [truncated, empty, no_text, no_record, other_number, no_checksum, more_fields])
def test_broken_file_is_reported_and_made_anew(store, said, tmp_path, damage):
    store.add(record())
    path = only_file(tmp_path)
    damage(path)
    assert store.find(CELL) is None
    assert len(said) == 1
    assert str(path) in said[0]
    assert said[0].endswith("its cell is computed again")
    store.add(record())
    assert store.find(CELL) is not None


def test_file_of_another_cell_is_not_taken_for_ones_own(store, said, tmp_path):
    store.add(record())
    path = only_file(tmp_path)
    store.add(record(OTHER, payload=7.0))
    (other,) = (one for one in (tmp_path / "cells").iterdir() if one != path)
    shutil.copy(other, path)
    assert store.find(CELL) is None
    assert "contains a different cell than its name says" in said[0]
    assert store.find(OTHER).result["payload"] == 7.0


def test_results_of_other_code_are_kept_but_not_used_unless_asked_for(store, said, tmp_path):
    for payload, source in ((1.0, "a" * 16), (2.0, "b" * 16)):
        store.add(record(source=source, payload=payload))
    for age, path in enumerate(sorted((tmp_path / "cells").iterdir())):
        os.utime(path, (1000 + age, 1000 + age))
    assert store.find(CELL) is None
    assert store.foreign == 1
    any_source = Store(tmp_path, say=said.append, any_source=True)
    assert any_source.find(CELL).result["payload"] == 2.0
    store.add(record(payload=3.0))
    assert len(list((tmp_path / "cells").iterdir())) == 3
    assert any_source.find(CELL).result["payload"] == store.find(CELL).result["payload"] == 3.0
    assert said == []


def test_record_that_is_not_final_is_not_kept(store, tmp_path):
    store.add(failed_record(CELL, "no memory"))
    assert store.find(CELL) is None
    assert not (tmp_path / "cells").exists()


# --- runs -------------------------------------------------------------------------------------------------------------


def backend(outcomes, asked):
    """Gives what it is told, in the order of the tasks; an exception is raised."""

    def run(tasks, say):
        for key, task in tasks.items():
            asked.append(task.args[0].policy)
            outcome = outcomes.get(task.args[0].policy) or record(task.args[0])
            if isinstance(outcome, KeyboardInterrupt):
                raise outcome
            yield key, outcome

    return run


def run(store, outcomes=None, some=(CELL, OTHER), progress=lambda *step: None):
    asked = []
    found = run_cells({cell.key: cell for cell in some}, store, backend(outcomes or {}, asked), progress, print)
    return found, asked


def test_finished_cells_are_not_computed_again(store):
    steps = []
    first, asked = run(store)
    assert asked == ["fl", "robust"]
    second, asked = run(store, progress=lambda *step: steps.append(step))
    assert asked == []
    assert steps == [(2, 2)]
    assert [one.result for one in second] == [one.result for one in first]


def test_interrupt_does_not_lose_what_is_done(store):
    with pytest.raises(KeyboardInterrupt):
        run(store, {"robust": KeyboardInterrupt()})
    assert run(store)[1] == ["robust"]


def test_only_the_broken_cell_is_computed_again(store, tmp_path):
    run(store)
    truncated(sorted((tmp_path / "cells").iterdir())[0])
    assert run(store)[1] == ["fl"]


def test_cell_whose_worker_died_costs_itself_and_is_tried_again(store):
    (bad, good), _ = run(store, {"fl": WorkerDied("its process died")})
    assert bad.error == "its process died"
    assert good.error is None
    assert run(store)[1] == ["fl"]


def test_what_other_code_computed_is_refused(store):
    (bad, good), _ = run(store, {"fl": record(source="f" * 16)})
    assert "different code" in bad.error
    assert good.error is None
    assert run(store)[1] == ["fl"]


def test_cells_that_take_long_come_first(store):
    best = cells.BestKnownCell(env_id="CableBot-Planar-v0", trajectory={"name": "paper-planar"})
    drawn = PolicyCell(**{**vars(CELL), "policy": "adaptive", "uncertainty": "table6", "draws": 9})
    order = []

    def note(tasks, say):
        order.extend(task.args[0] for task in tasks.values())
        yield from ((key, record(task.args[0])) for key, task in tasks.items())

    found = run_cells({cell.key: cell for cell in (CELL, drawn, best)}, store, note, lambda *step: None, print)
    assert order == [best, drawn, CELL]
    assert [one.cell for one in found] == [CELL, drawn, best]
