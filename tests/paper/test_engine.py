"""The engine: what it runs, keeps, writes and says."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest

from cablebot_baselines.paper import engine
from cablebot_baselines.paper.engine import RESULTS, find_parts, json_number, reproduce, save_figure
from cablebot_baselines.paper.exact import exact_limit, exact_profile
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Outcome, Part, Table, cell_key
from cablebot_gym.plotting.figures import new_figure
from cablebot_gym.robots import SPATIAL

ran = []


def limit(*, interpretation, mark=0):
    ran.append(mark)
    return exact_limit(interpretation, interpretation.spatial("payload")).payload


def limit_cells(interpretation, **marks):
    interpretation.spatial("payload")
    return {name: partial(limit, interpretation=interpretation, mark=mark) for name, mark in marks.items()}


def drawn(interpretation, found):
    figure = new_figure(2.0)
    figure.subplots().plot([0, 1], [0, found["a"]], label="a line")
    return figure


def outcome(interpretation, found):
    table = Table(title="a table", header=("a", "b"), rows=((1.5, None),))
    return Outcome(numbers={"kg": found["a"], "motor": np.int64(2)}, tables=(table,))


def part(name, *, draw=None, **marks):
    return Part(
        name=name,
        title=name,
        text="Words.",
        cells=partial(limit_cells, **marks),
        outcome=outcome,
        draw=draw,
    )


@pytest.fixture
def parts(monkeypatch):
    ran.clear()
    made = (part("one", draw=drawn, a=1), part("two", a=1, b=2), part("ten", a=3))
    monkeypatch.setattr(engine, "PARTS", made)
    return made


def test_equal_computations_of_several_parts_run_once(parts, tmp_path):
    results = reproduce(Interpretation(), tmp_path, workers=1)
    assert ran == [1, 2, 3]
    assert results["numbers"]["one.kg"] == results["numbers"]["two.kg"] == pytest.approx(1.802, abs=1e-3)
    assert (tmp_path / "one.png").stat().st_size > 1000
    assert (tmp_path / "one.svg").read_text().startswith("<?xml")
    assert not (tmp_path / "two.png").exists()


def test_cells_that_differ_in_a_reading_are_different():
    one, other = (
        partial(limit, interpretation=interpretation)
        for interpretation in (Interpretation(), Interpretation(line="flat"))
    )
    assert cell_key(one) != cell_key(other)
    assert cell_key(one) == cell_key(partial(limit, interpretation=Interpretation()))


def test_only_keeps_what_the_folder_holds_of_the_same_readings(parts, tmp_path):
    reproduce(Interpretation(), tmp_path, workers=1)
    ran.clear()
    results = reproduce(Interpretation(), tmp_path, only=["two"], workers=1)
    assert ran == [1, 2]
    assert [item["name"] for item in results["parts"]] == ["one", "two", "ten"]
    assert results["missing"] == []
    before = (tmp_path / RESULTS).read_bytes()
    with pytest.raises(ValueError, match="choose another --out"):
        reproduce(Interpretation(line="flat"), tmp_path, only=["two"], workers=1)
    assert (tmp_path / RESULTS).read_bytes() == before
    assert reproduce(Interpretation(line="flat"), tmp_path, workers=1)["numbers"]["one.kg"] > 2.3


def test_results_of_other_code_are_not_kept(parts, tmp_path, monkeypatch):
    reproduce(Interpretation(), tmp_path, workers=1)
    monkeypatch.setattr(engine, "source_hash", lambda: "other")
    with pytest.raises(ValueError, match="another interpretation or of other code"):
        reproduce(Interpretation(), tmp_path, only=["two"], workers=1)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"interpretation": 1}'])
def test_broken_results_are_made_anew(parts, tmp_path, text):
    (tmp_path / RESULTS).write_text(text)
    results = reproduce(Interpretation(), tmp_path, only=["one"], workers=1)
    assert json.loads((tmp_path / RESULTS).read_text())["numbers"] == results["numbers"]


def test_interrupt_leaves_what_was_done(parts, tmp_path):
    def interrupt(last, done, expected):
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reproduce(Interpretation(), tmp_path, workers=1, progress=interrupt)
    results = json.loads((tmp_path / RESULTS).read_text())
    assert [item["name"] for item in results["parts"]] == ["one"]
    assert results["missing"] == ["two", "ten"]
    ran.clear()
    reproduce(Interpretation(), tmp_path, workers=1, only=results["missing"])
    assert ran == [1, 2, 3]


def test_interrupt_of_a_second_run_does_not_lose_the_first(parts, tmp_path):
    def interrupt(last, done, expected):
        raise KeyboardInterrupt

    reproduce(Interpretation(), tmp_path, workers=1)
    with pytest.raises(KeyboardInterrupt):
        reproduce(Interpretation(), tmp_path, workers=1, progress=interrupt)
    assert json.loads((tmp_path / RESULTS).read_text())["missing"] == []


def test_readings_that_allow_no_robot_say_so_on_the_page(parts, tmp_path):
    results = reproduce(Interpretation(triangles="aligned"), tmp_path, workers=1)
    assert all("no equilibrium with positive tensions" in item["impossible"] for item in results["parts"])
    assert "no equilibrium with positive tensions" in (tmp_path / engine.MARKDOWN).read_text()


def test_workers_give_the_same_numbers_and_tell_of_their_progress(tmp_path, monkeypatch):
    interpretation = Interpretation()

    def cells(_):
        robot = interpretation.planar
        return {
            "a": partial(exact_profile, interpretation=interpretation, robot=robot, payload=0.5),
            "b": partial(exact_profile, interpretation=interpretation, robot=robot, payload=1.0),
        }

    def sums(_, found):
        return Outcome(numbers={name: float(found[name].torques.sum()) for name in "ab"})

    monkeypatch.setattr(engine, "PARTS", (Part(name="one", title="", text="", cells=cells, outcome=sums),))
    seen = []
    several = reproduce(interpretation, tmp_path / "several", workers=2, progress=lambda *step: seen.append(step[1:]))
    single = reproduce(interpretation, tmp_path / "single", workers=1)
    assert several["numbers"] == single["numbers"]
    assert list(dict.fromkeys(seen)) == [(1, 2), (2, 2)]


def test_error_that_is_no_reading_is_not_hidden(tmp_path, monkeypatch):
    def broken(_, found):
        raise RuntimeError("a bug")

    made = Part(name="one", title="", text="", cells=partial(limit_cells, a=1), outcome=broken)
    monkeypatch.setattr(engine, "PARTS", (made,))
    with pytest.raises(RuntimeError, match="a bug"):
        reproduce(Interpretation(), tmp_path, workers=1)


def test_unknown_part_lists_the_known_ones(parts, tmp_path):
    with pytest.raises(ValueError, match="unknown part 'fig99'; valid parts are one, two, ten"):
        find_parts(["fig99"])
    with pytest.raises(ValueError, match="workers"):
        reproduce(Interpretation(), tmp_path, workers=0)


def test_folder_that_is_a_file_is_refused_before_the_work(parts, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ValueError, match="choose another"):
        reproduce(Interpretation(), tmp_path / "file", workers=1)
    assert ran == []


def test_figures_are_the_same_bytes_each_time(tmp_path):
    for place in ("first", "second"):
        (tmp_path / place).mkdir()
        save_figure(drawn(Interpretation(), {"a": 1.0}), tmp_path / place / "figure")
    for suffix in (".png", ".svg"):
        one, other = ((tmp_path / place / f"figure{suffix}").read_bytes() for place in ("first", "second"))
        assert one == other


def test_numbers_become_plain_ones():
    assert json_number(np.float64(1 / 3)) == 0.3333333333
    assert json_number(np.inf) is None
    assert json_number(float("nan")) is None
    assert json_number(np.bool_(True)) is True
    assert json_number(np.int64(3)) == 3
    with pytest.raises(TypeError):
        json_number(SPATIAL)
