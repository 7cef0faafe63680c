"""Engine of the reproduction: computed, kept and written results."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cablebot_baselines.paper import engine
from cablebot_baselines.paper.engine import MARKDOWN, RESULTS, find_parts, reproduce, save_figure
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Outcome, Part, Table, job
from cablebot_gym.plotting.figures import new_figure

DEFAULT = Interpretation()
ran = []


def limit(*, interpretation, mark=0):
    ran.append(mark)
    return 1.802 if interpretation.line == "physical" else 2.345


def drawn(interpretation, results):
    figure = new_figure(2.0)
    figure.subplots().plot([0, 1], [0, results["a"]], label="a line")
    return figure


def outcome(interpretation, results):
    table = Table(title="a table", header=("a", "b"), rows=((1.5, None),))
    return Outcome(
        numbers={"kg": results["a"], "motor": np.int64(2), "third": np.float64(1 / 3), "none": np.inf}, tables=(table,)
    )


def part(name, *, draw=None, outcome=outcome, **marks):
    def jobs(interpretation):
        interpretation.spatial("payload")
        return {key: job(limit, interpretation=interpretation, mark=mark) for key, mark in marks.items()}

    return Part(name=name, title=name, text="Words.", jobs=jobs, outcome=outcome, draw=draw)


@pytest.fixture(autouse=True)
def parts(monkeypatch):
    ran.clear()
    made = (part("one", a=1), part("two", a=1, b=2), part("ten", a=3))
    monkeypatch.setattr(engine, "PARTS", made)


def interrupt_at(count):
    def progress(activity, done, total):
        if done >= count:
            raise KeyboardInterrupt

    return progress


def test_shared_computations_run_once_and_figures_are_written(tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "PARTS", (part("one", draw=drawn, a=1), part("two", a=1, b=2), part("ten", a=3)))
    results = reproduce(DEFAULT, tmp_path, workers=1)
    assert ran == [1, 2, 3]
    assert results["numbers"]["one.kg"] == results["numbers"]["two.kg"] == 1.802
    assert (results["numbers"]["one.third"], results["numbers"]["one.none"]) == (0.3333333333, None)  # as JSON has them
    assert (tmp_path / "one.png").stat().st_size > 1000
    assert (tmp_path / "one.svg").read_text().startswith("<?xml")
    assert not (tmp_path / "two.png").exists()


def test_interpretation_is_part_of_the_key_of_a_job():
    one, other, same = (
        job(limit, interpretation=Interpretation(line=line)) for line in ("physical", "flat", "physical")
    )
    assert one.key == same.key != other.key


def test_only_keeps_other_parts_of_the_same_code_and_interpretation(tmp_path, monkeypatch):
    reproduce(DEFAULT, tmp_path, workers=1)
    ran.clear()
    results = reproduce(DEFAULT, tmp_path, only=["two"], workers=1)
    assert ran == [1, 2]
    assert [item["name"] for item in results["parts"]] == ["one", "two", "ten"]
    assert results["missing"] == []
    before = (tmp_path / RESULTS).read_bytes()
    flat = Interpretation(line="flat")
    with pytest.raises(ValueError, match="choose another --out"):
        reproduce(flat, tmp_path, only=["two"], workers=1)
    monkeypatch.setattr(engine, "source_hash", lambda *_, **__: "other")
    with pytest.raises(ValueError, match="another interpretation or of other code"):
        reproduce(DEFAULT, tmp_path, only=["two"], workers=1)
    assert (tmp_path / RESULTS).read_bytes() == before
    assert reproduce(flat, tmp_path, workers=1)["numbers"]["one.kg"] == 2.345


def test_damaged_results_are_replaced(tmp_path):
    (tmp_path / RESULTS).write_text("{")
    results = reproduce(DEFAULT, tmp_path, only=["one"], workers=1)
    assert json.loads((tmp_path / RESULTS).read_text())["numbers"] == results["numbers"]


def test_interrupt_keeps_finished_parts(tmp_path, monkeypatch):
    with pytest.raises(KeyboardInterrupt):
        reproduce(DEFAULT, tmp_path, workers=1, progress=interrupt_at(2))
    results = json.loads((tmp_path / RESULTS).read_text())
    assert [item["name"] for item in results["parts"]] == ["one"]
    assert results["missing"] == ["two", "ten"]
    ran.clear()
    reproduce(DEFAULT, tmp_path, workers=1, only=results["missing"])
    assert ran == [1, 2, 3]
    with pytest.raises(KeyboardInterrupt):
        reproduce(DEFAULT, tmp_path, workers=1, progress=interrupt_at(1))
    assert json.loads((tmp_path / RESULTS).read_text())["missing"] == []
    monkeypatch.setattr(engine, "versions", lambda: {"python": "other"})
    with pytest.raises(KeyboardInterrupt):
        reproduce(DEFAULT, tmp_path, workers=1, progress=interrupt_at(2))
    assert json.loads((tmp_path / RESULTS).read_text())["missing"] == ["two", "ten"]


def test_interpretation_without_equilibrium_is_stated_on_the_page(tmp_path):
    results = reproduce(Interpretation(triangles="aligned"), tmp_path, workers=1)
    assert all("no equilibrium with positive tensions" in item["impossible"] for item in results["parts"])
    assert "no equilibrium with positive tensions" in (tmp_path / MARKDOWN).read_text()


def test_error_in_the_outcome_of_a_part_is_raised(tmp_path, monkeypatch):
    def broken(interpretation, results):
        raise RuntimeError("a bug")

    monkeypatch.setattr(engine, "PARTS", (part("one", outcome=broken, a=1),))
    with pytest.raises(RuntimeError, match="a bug"):
        reproduce(DEFAULT, tmp_path, workers=1)


def test_invalid_arguments_raise_before_the_computations(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match=r"unknown part 'map-stiffness'; choose one of one, two, ten; .* paper-maps"):
        find_parts(["map-stiffness"])
    with pytest.raises(ValueError, match="workers"):
        reproduce(DEFAULT, tmp_path, workers=0)
    with pytest.raises(ValueError, match="choose another"):
        reproduce(DEFAULT, tmp_path / "file", workers=1)
    assert ran == []


def test_figures_have_reproducible_bytes(tmp_path):
    for place in ("first", "second"):
        save_figure(drawn(DEFAULT, {"a": 1.0}), tmp_path / place / "figure")
    for suffix in (".png", ".svg"):
        one, other = ((tmp_path / place / f"figure{suffix}").read_bytes() for place in ("first", "second"))
        assert one == other
