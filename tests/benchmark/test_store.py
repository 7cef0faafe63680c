"""Store and runs of rows: finished rows are kept, damaged ones and those of other code are not used."""

from dataclasses import replace

import pytest
from benchmark.made_rows import answered, asked, carries

from cablebot_gym.benchmark.engine import run_rows
from cablebot_gym.benchmark.rows import failed
from cablebot_gym.benchmark.store import Store, read, read_all
from cablebot_gym.utils.workers import WorkerDied

ROW, OTHER = (asked(policy=policy) for policy in ("fl", "robust"))


def answer(row=ROW, payload=1.0 / 3.0):
    """The row with a result of the present code."""
    return replace(answered(row, payload=payload), code=row.present_code, seconds=0.123)


@pytest.fixture
def messages():
    return []


@pytest.fixture
def make_store(tmp_path, messages):
    def make(seed_text=None, command="cablebot benchmark"):
        head = {"suite": "smoke", "command": command, "seed_text": seed_text}
        return Store(tmp_path, **head, say=messages.append)

    return make


def test_row_is_read_as_it_was_written(make_store, messages):
    make_store().add([answer()])
    stored = make_store().find(ROW)
    assert stored.to_dict() == answer().to_dict()
    assert make_store().find(OTHER) is None
    assert messages == []


def test_row_of_other_code_is_due_and_replaced(make_store, tmp_path):
    make_store().add([carries("fl", 1.0)])
    assert make_store().find(ROW) is None
    make_store().add([answer(payload=3.0)])
    assert make_store().find(ROW).result["payload"] == 3.0
    results = make_store().close([])
    assert [row.result["payload"] for row in results.rows] == [3.0]
    assert read(tmp_path / "smoke.jsonl").to_text() == results.to_text()


def test_row_cut_by_a_power_failure_is_computed_again(make_store, messages, tmp_path):
    make_store().add([answer(), answer(OTHER)])
    path = tmp_path / "smoke.jsonl"
    path.write_text(path.read_text()[:-20])
    store = make_store()
    assert store.find(ROW) is not None
    assert store.find(OTHER) is None
    assert len(messages) == 1
    assert "line 3 is no row" in messages[0]


def test_rows_of_other_policies_stay_behind_those_of_the_run(make_store):
    store = make_store()
    store.add([answer(OTHER), answer()])
    assert [row.policy for row in store.close([ROW.key]).rows] == ["fl", "robust"]
    for command in ("cablebot benchmark", "cablebot benchmark --policies fl"):
        results = make_store(command=command).close([])
        assert results.command.endswith(command)
    both = f"cablebot benchmark; {command}"
    assert results.command == make_store(command=both).close([]).command == both


def test_other_seed_text_is_refused(make_store):
    make_store("a headline").add([answer()])
    with pytest.raises(ValueError, match="another --seed-text"):
        make_store("another headline")


@pytest.mark.parametrize("text", ["", "{}\n", "[1]\n", '{"suite": "smoke"}\n{"cell": 1}\n'])
def test_damaged_file_is_refused(tmp_path, text):
    (tmp_path / "smoke.jsonl").write_text(text)
    with pytest.raises(ValueError, match="holds no results"):
        read(tmp_path / "smoke.jsonl")
    with pytest.raises(ValueError, match="cannot read"):
        read(tmp_path / "none.jsonl")
    (tmp_path / "smoke.jsonl").unlink()
    with pytest.raises(ValueError, match="holds no rows"):
        read_all(tmp_path)


# --- runs -------------------------------------------------------------------------------------------------------------


def run(store, outcomes=None, rows=(ROW, OTHER), progress=lambda *step: None):
    """Runs rows with a backend that gives these outcomes by policy; rows in the order of their
    computation."""
    computed = []

    def backend(jobs):
        for key, job in jobs.items():
            (group,) = job.args
            computed.extend(group)
            yield key, (outcomes or {}).get(group[0].policy, [answer(row) for row in group])

    run_rows(rows, store, backend, progress)
    return computed


def test_only_missing_rows_are_computed_and_progress_ends_at_all(make_store):
    store = make_store()
    store.add([answer()])
    steps = []
    assert run(store, progress=lambda *step: steps.append(step)) == [OTHER]
    assert steps == [(1, 2), (2, 2)]
    assert run(make_store()) == []


@pytest.mark.parametrize(
    "outcome", [WorkerDied("the kernel killed it"), [replace(answer(), code="b" * 16)]]
)
def test_row_of_a_dead_or_different_worker_is_tried_again(make_store, outcome):
    store = make_store()
    run(store, {"fl": outcome})
    assert store.find(ROW) is None
    assert store.find(OTHER) is not None
    assert run(make_store()) == [ROW]
    assert not failed(ROW, "no memory").final


def test_longest_rows_start_first(make_store):
    drawn = asked(policy="observing", uncertainty="table6", draws=9)
    best = asked("best-known")
    assert run(make_store(), rows=(ROW, drawn, best)) == [best, drawn, ROW]
