"""The stored page and its numbers in reproduction/docs, the verdicts, and the command."""

import json
import math
import re
import sys
from pathlib import Path

import pytest

from cablebot_gym.cli.app import main
from cablebot_reproduction import texts
from cablebot_reproduction.findings import rows
from cablebot_reproduction.page import markdown
from cablebot_reproduction.run import PAGE, PARTS, RESULTS, run

FOLDER = Path(__file__).parents[1] / "docs"
STORED = json.loads((FOLDER / RESULTS).read_text(encoding="utf-8"))
NUMBERS = STORED["numbers"]
AGAIN = "refresh it: cablebot reproduce --out reproduction/docs"

TOLERANCES = {
    r"^(fig14|fig15|fig9|fig7)\.(eq22|closed_loop)_": (1e-3, 0.05),  # unstable loops
    r"^scan\.(with|hits)": (2.0, 0.005),  # geometries on the border of what counts
    r"_kg$": (1.1e-3, 1e-6),  # the resolution of a search
    r"": (1e-6, 1e-3),
}
"""Absolute and relative difference between machines, by the name of a number."""


def test_rows_and_page_follow_the_stored_numbers():
    assert list(rows(NUMBERS)) == STORED["rows"], AGAIN
    assert (FOLDER / PAGE).read_text(encoding="utf-8") == markdown(STORED), AGAIN
    assert list(STORED["parts"]) == list(PARTS)
    figures = {name for name, part in STORED["parts"].items() if part["figure"]}
    assert figures == {path.stem for path in FOLDER.glob("*.svg")}
    assert len(STORED["rows"]) == 41


def test_page_points_only_to_sections_that_it_has():
    """Also if some parts were not run; a sentence may hold `Eq. 24`."""
    whole = markdown(STORED)
    assert whole.count("section *Interpretations*") > 2
    few = {name: STORED["parts"][name] for name in ("fig12", "fig15", "scan")}
    page = markdown(STORED | {"parts": few})
    assert "section *Interpretations*" in page
    page = markdown(STORED | {"parts": {name: few[name] for name in ("fig12", "fig15")}})
    assert "section *" not in page
    assert "the speed in U± on the payload of the state space" not in page
    assert "both computed by the same method" in page


def test_three_sentences_answer_why_the_capacities_differ():
    _, _, rest = markdown(STORED).partition("## Why 2.2, 2.56 and 1.4 kg\n\n")
    answer, details, *_ = rest.split("\n\n")
    assert len(re.findall(r"\.(?=\s|$)", answer)) == 3
    assert details.startswith("**2.2 kg, planar robot.**")


def test_least_tension_is_that_between_control_instants():
    """At the control instants it is T_min of the law."""
    assert 4.8 < NUMBERS["fig5.least_tension_N"] < 5


def test_no_sentence_of_the_page_lacks_a_number():
    """A misspelled name would drop its sentence or its paragraph."""
    package = Path(texts.__file__).parent
    for name in ("published.toml", "head.md"):
        template = (package / name).read_text(encoding="utf-8")
        texts.fill(re.sub(r"(?m)^#.*$", "", template), NUMBERS)


@pytest.mark.nightly
def test_new_numbers_and_verdicts_are_the_stored_ones(tmp_path):
    new = run(tmp_path)
    assert list(new["numbers"]) == list(NUMBERS), AGAIN
    for name, value in NUMBERS.items():
        absolute, relative = next(
            v for pattern, v in TOLERANCES.items() if re.search(pattern, name)
        )
        if isinstance(value, (str, bool, type(None))):
            assert value == new["numbers"][name], name
        else:
            is_close = math.isclose(value, new["numbers"][name], abs_tol=absolute, rel_tol=relative)
            assert is_close, (name, AGAIN)
    verdicts = [[row["verdict"] for row in results["rows"]] for results in (STORED, new)]
    assert verdicts[0] == verdicts[1], AGAIN


@pytest.mark.parametrize(
    ("key", "name", "good", "bad"),
    [
        ("5.2.1.payload", "fig10.payload_kg", 2.1, 2.05),
        ("5.2.1.motor", "fig10.motor", 2, 1),
        ("1.tension", "fig5.slack", False, True),
        ("4.4.sum", "fig9.flex_sum_reduction_1e-3", 0.601, 0.6),
        ("3.4.uncontrollable", "eq22.controllable_states", 12, 24),
        ("4.3.vibration", "fig7.ripple_late_Nm", 0.44, 0.45),
        ("5.1.accuracy", "claims.payload_unknown_spatial_paper_kg", 1.75, 1.6),
    ],
)
def test_verdict_follows_its_number(key, name, good, bad):
    """One item for each comparison."""
    verdicts = []
    for value in (good, bad):
        (row,) = (row for row in rows(NUMBERS | {name: value}) if row["key"] == key)
        verdicts.append(row["verdict"])
    assert verdicts == ["reproduced", "not reproduced"]


@pytest.mark.parametrize(
    ("kind", "platform", "closest"),
    [
        ("planar", 0.0, ["left_least_0.0_cable"]),
        ("planar", 1.0, ["up_least_0.0_physical"]),
        ("spatial", 0.0, [f"inverted_half-side_table5_10_{line}" for line in ("cable", "flat")]),
        ("flexible", 0.0, ["corrected_2_pulley"]),
    ],
)
def test_combinations_of_the_page_are_the_closest_with_motor_2(kind, platform, closest):
    load = texts.PUBLISHED[f"{kind}_payload_kg"]
    distances = {}
    for key, motor in NUMBERS.items():
        stem = key.removesuffix("_motor")
        if key.startswith(f"interpretations.{kind}_") and stem != key and motor == 2:
            distance = abs(NUMBERS[f"{stem}_kg"] + platform - load)
            distances[stem.removeprefix(f"interpretations.{kind}_")] = distance
    assert sorted(distances, key=distances.get)[: len(closest)] == closest


def test_command_writes_the_parts_that_are_named(tmp_path, monkeypatch, capsys):
    def typed(only):
        command = ["cablebot", "reproduce", "--only", only, "--out", str(tmp_path)]
        monkeypatch.setattr(sys, "argv", command)
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code

    assert typed("sizes,fig5") == 0
    results = json.loads((tmp_path / RESULTS).read_text(encoding="utf-8"))
    assert {name.partition(".")[0] for name in results["numbers"]} == {"sizes", "fig5"}
    assert {path.name for path in tmp_path.iterdir()} == {RESULTS, PAGE, "fig5.svg"}
    assert "1.tension" not in {row["key"] for row in results["rows"]}  # fig6 was not run
    page = (tmp_path / PAGE).read_text(encoding="utf-8")
    assert "section *Interpretations*" not in page
    assert "errata.md" not in page
    assert typed("fig4") == 2
    assert "unknown part 'fig4'" in capsys.readouterr().err
