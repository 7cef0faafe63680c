"""Engine of the reproduction: computed, kept and written results."""

import json

import numpy as np
import pytest

from cablebot_gym.plotting.figures import new_figure
from cablebot_reproduction import engine
from cablebot_reproduction.engine import MARKDOWN, RESULTS, find_parts, reproduce, save_figure
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.part import Outcome, Part, Table, job

DEFAULT = Interpretation()
FLAT = Interpretation(line="flat")
computed = []


def limit(*, interpretation, mark=0):
    computed.append(mark)
    return 1.802 if interpretation.line == "physical" else 2.345


def draw(interpretation, results):
    figure = new_figure(2.0)
    figure.subplots().plot([0, 1], [0, results["a"]], label="a line")
    return figure


def outcome(interpretation, results):
    table = Table(title="a table", header=("a", "b"), rows=((1.5, None),))
    numbers = {"kg": results["a"], "motor": np.int64(2), "third": np.float64(1 / 3), "none": np.inf}
    return Outcome(numbers=numbers, tables=(table,))


def broken(interpretation, results):
    raise RuntimeError("a bug")


def part(name, *, draw=None, outcome=outcome, **marks):
    def jobs(interpretation):
        interpretation.spatial("payload")
        return {
            key: job(limit, interpretation=interpretation, mark=mark) for key, mark in marks.items()
        }

    return Part(name=name, title=name, text="Words.", jobs=jobs, outcome=outcome, draw=draw)


@pytest.fixture(autouse=True)
def parts(monkeypatch):
    computed.clear()
    parts = (part("one", draw=draw, a=1), part("two", a=1, b=2), part("ten", a=3))
    monkeypatch.setattr(engine, "PARTS", parts)


def interrupt(folder, count):
    """Runs until ``count`` computations are finished, and returns the missing parts."""

    def progress(done, total, activity):
        if done >= count:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reproduce(DEFAULT, folder, workers=1, progress=progress)
    return json.loads((folder / RESULTS).read_text())["missing"]


def test_shared_computations_run_once(tmp_path):
    numbers = reproduce(DEFAULT, tmp_path, workers=1)["numbers"]
    assert computed == [1, 2, 3]
    assert numbers["one.kg"] == numbers["two.kg"] == 1.802
    assert numbers["one.third"] == 0.3333333333  # digits on which machines agree
    assert numbers["one.none"] is None
    assert {path.name for path in tmp_path.glob("*.[ps][nv]g")} == {"one.png", "one.svg"}


def test_only_keeps_parts_of_the_same_code_and_interpretation(tmp_path, monkeypatch):
    reproduce(DEFAULT, tmp_path, workers=1)
    computed.clear()
    results = reproduce(DEFAULT, tmp_path, only=["two"], workers=1)
    assert computed == [1, 2]
    assert [item["name"] for item in results["parts"]] == ["one", "two", "ten"]
    before = (tmp_path / RESULTS).read_bytes()
    with pytest.raises(ValueError, match="choose another --out"):
        reproduce(FLAT, tmp_path, only=["two"], workers=1)
    monkeypatch.setattr(engine, "source_hash", lambda *_, **__: "changed")
    with pytest.raises(ValueError, match="another interpretation or of other code"):
        reproduce(DEFAULT, tmp_path, only=["two"], workers=1)
    assert (tmp_path / RESULTS).read_bytes() == before
    assert reproduce(FLAT, tmp_path, workers=1)["numbers"]["one.kg"] == 2.345


def test_damaged_results_are_replaced(tmp_path):
    (tmp_path / RESULTS).write_text("{")
    results = reproduce(DEFAULT, tmp_path, only=["one"], workers=1)
    assert json.loads((tmp_path / RESULTS).read_text())["numbers"] == results["numbers"]


def test_interrupt_keeps_finished_parts(tmp_path, monkeypatch):
    assert interrupt(tmp_path, 2) == ["two", "ten"]
    computed.clear()
    reproduce(DEFAULT, tmp_path, workers=1, only=["two", "ten"])
    assert computed == [1, 2, 3]
    assert interrupt(tmp_path, 1) == []
    monkeypatch.setattr(engine, "versions", lambda: {"python": "changed"})
    assert interrupt(tmp_path, 2) == ["two", "ten"]


def test_page_states_an_interpretation_without_equilibrium(tmp_path):
    reproduce(Interpretation(triangles="aligned"), tmp_path, workers=1)
    assert (tmp_path / MARKDOWN).read_text().count("has no equilibrium with positive tensions") >= 3


def test_error_in_the_outcome_of_a_part_is_raised(tmp_path, monkeypatch):
    monkeypatch.setattr(engine, "PARTS", (part("one", outcome=broken, a=1),))
    with pytest.raises(RuntimeError, match="a bug"):
        reproduce(DEFAULT, tmp_path, workers=1)


def test_invalid_arguments_raise_before_the_computations(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(
        ValueError,
        match=r"unknown part 'map-stiffness'; choose one of one, two, ten; .* paper-maps",
    ):
        find_parts(["map-stiffness"])
    with pytest.raises(ValueError, match="workers"):
        reproduce(DEFAULT, tmp_path, workers=0)
    with pytest.raises(ValueError, match="choose another"):
        reproduce(DEFAULT, tmp_path / "file", workers=1)
    assert computed == []


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_figures_have_reproducible_bytes(tmp_path, suffix):
    contents = []
    for _ in range(2):
        save_figure(draw(DEFAULT, {"a": 1.0}), tmp_path / "figure")
        contents.append((tmp_path / f"figure.{suffix}").read_bytes())
    assert contents[0] == contents[1]
