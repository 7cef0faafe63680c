"""The published items, counted by hand, and the verdicts on them."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest

from cablebot_baselines.paper import inputs, interpretation
from cablebot_baselines.paper.findings import finding, rows
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.published import LOADS, PUBLISHED, published_value, within
from cablebot_baselines.paper.summary import POINTS
from cablebot_baselines.paper.verdicts import Run
from cablebot_gym.robots import PLANAR
from cablebot_gym.uncertainty import UNCERTAINTIES, Uncertainty

RESULTS = Path(__file__).parents[2] / "docs" / "reproduction" / "results.json"
NUMBERS = json.loads(RESULTS.read_text(encoding="utf-8"))["numbers"]

BY_HAND = {
    "Abstract": (5, 0, 2, 5),
    "§1": (0, 0, 3, 1),
    "§2.1": (2, 0, 0, 2),
    "§2.2": (2, 0, 0, 2),
    "§2.3": (3, 0, 1, 3),
    "§3.1": (5, 0, 1, 6),
    "§3.2": (2, 0, 1, 0),
    "§3.3": (3, 0, 3, 4),
    "§3.4": (4, 0, 3, 4),
    "Table 1": (5, 0, 0, 17),
    "Table 2": (6, 0, 0, 6),
    "§4.1": (0, 0, 1, 0),
    "Table 3": (9, 0, 0, 21),
    "Table 4": (11, 0, 0, 11),
    "Table 5": (11, 0, 0, 11),
    "§4.3": (1, 0, 1, 1),
    "Table 6": (5, 0, 0, 5),
    "§4.4": (0, 2, 0, 1),
    "§5.1": (1, 0, 5, 1),
    "Table 7": (5, 0, 0, 5),
    "§5.2.1": (0, 2, 1, 2),
    "Table 8": (5, 0, 0, 5),
    "§5.2.2": (0, 2, 1, 2),
    "§5.2.3": (2, 3, 3, 5),
    "Table 9": (3, 0, 0, 3),
    "§6": (0, 2, 4, 2),
}
"""Inputs, results, claims, and the numbers in digits and words that each place prints, counted in the paper.

The numbers of equations, figures, tables, sections and references, exponents of units, and words that count items of
their own sentence are excluded. Most cells of Tables 1 and 3 print a number several times.
"""


def found(key, chosen=None, changes=None, *, without=()):
    """Row of an item for the stored numbers with changes, without those of some parts."""
    numbers = {name: value for name, value in NUMBERS.items() if not name.startswith(without)} | (changes or {})
    return finding(PUBLISHED[key], Run(interpretation=chosen or Interpretation(), numbers=numbers), {})


# --- published items ------------------------------------------------------------------------------------------------


def test_items_of_each_place_are_complete():
    counted = {}
    for place in {item.place for item in PUBLISHED.values()}:
        items = [item for item in PUBLISHED.values() if item.place == place]
        kinds = Counter(item.kind for item in items)
        counted[place] = (kinds["input"], kinds["result"], kinds["claim"], sum(item.times for item in items))
    assert counted == BY_HAND


def test_values_are_the_printed_ones():
    words = {"two": 2, "three": 3, "six": 6, "second": 2, "middle": 0.5, "z₁ … z₄": 4, "1, …, 12": 12}
    words |= {"1, …, 6": 6, "1, 2, …, 6": 6, "ζ < 1": 1, "4π": 4, "half": None}
    for item in PUBLISHED.values():
        if item.kind == "claim":
            assert item.value is None
            continue
        number = item.printed.replace("about ", "").replace("more than ", "").replace(",", "").replace("%", " %")
        assert item.value == (words[item.printed] if item.printed in words else float(number.split()[0])), item.key
    assert LOADS == {"planar": 2.2, "spatial": 2.56, "flexible": 1.4}
    with pytest.raises(ValueError, match="no number"):
        published_value("5.1.accuracy")


def test_every_template_is_filled_by_the_stored_numbers():
    """A misspelled name would drop its sentence, and a repeated one would hide another."""
    run = Run(interpretation=Interpretation(), numbers=NUMBERS)
    for item in PUBLISHED.values():
        assert all(len(set(several)) == len(several) for several in (item.ours, item.holds)), item.key
        for template in item.evidence if item.kind != "input" else ():
            assert run.filled(template), (item.key, template)
        assert not item.text or run.filled(item.text, "ours")
    for point in POINTS:
        assert set(point["keys"]) <= set(PUBLISHED)
        for template in [point["text"]] if isinstance(point["text"], str) else point["text"]:
            assert run.filled(template), (point["title"], template)


# --- verdicts -------------------------------------------------------------------------------------------------------


def test_within_is_five_percent():
    assert [within(ours, 2.2) for ours in (2.2, 2.309, 2.311, 2.091, 2.089)] == [True, True, False, True, False]


@pytest.mark.parametrize(
    ("key", "name", "good", "bad"),
    [
        ("5.2.1.payload", "fig10.counted_kg", 2.1, 2.05),
        ("5.2.1.motor", "fig10.motor", 2, 1),
        ("5.2.2.payload", "fig12.counted_kg", 2.6, 2.8),
        ("5.2.3.payload", "fig15.state_space_counted_kg", 1.45, 1.5),
        ("5.2.3.motor", "fig15.state_space_motor", 2, 3),
        ("5.2.3.less", "fig15.state_space_drop_fraction", 0.06, 0.04),
        ("4.4.sum", "fig9.flex_sum_reduction_1e-3", 0.601, 0.6),
        ("abstract.accuracy", "claims.closed_loop_spatial_error_mm", 0.4, 0.6),
        ("1.tension", "fig6.least_tension_N", 0.1, -0.1),
        ("1.tension", "fig5.slack", False, True),
        ("1.controller", "claims.open_loop_spatial_kg", None, 5.0),
        ("3.1.poles", "claims.pole_error_planar", 0.04, 0.06),
        ("3.3.linear", "eq22.max_growth_K2", -1.0, 1.0),
        ("3.3.robust", "eq22.least_growth_any_K", -1.0, 1.0),
        ("3.4.uncontrollable", "eq22.controllable_states", 12, 24),
        ("3.4.lyapunov", "eq22.lyapunov_printed_definite", True, False),
        ("3.4.stability", "fig9.sum_reduction_1e-2", 0.1, -0.1),
        ("4.1.tension", "fig5.least_tension_N", 0.1, 0.0),
        ("4.3.vibration", "fig7.ripple_late_Nm", 0.44, 0.45),
        ("5.1.linear-planar", "claims.affine_planar", 1e-9, 1e-3),
        ("5.1.converges", "eq37.literal_spread_kg", 1e-9, 0.1),
        ("5.1.answer", "eq37.literal_over_true", 1.04, 1.06),
        ("5.1.accuracy", "claims.fl_payload_unknown_paper_kg", 1.75, 1.6),
        ("5.2.1.path", "fig11.within", True, False),
        ("5.2.3.path", "fig14.eq22_within", True, False),
        ("6.torque", "fig7.ripple_after_Nm", 0.45, 0.44),
        ("6.uncertainty", "claims.flex_composite_error_table6_mm", 2.8, 2.7),
        ("6.open-tracking", "claims.open_loop_planar_error_mm", 0.5, 0.3),
        ("6.open-payload", "claims.closed_loop_spatial_paper_kg", 2.0, 1.8),
    ],
)
def test_verdict_follows_its_number(key, name, good, bad):
    others = {"fig5.peak_error_mm": 0.3, "fig6.peak_error_mm": 0.4, "claims.closed_loop_planar_paper_kg": 2.0}
    others |= {"eq22.max_growth_K2": -1.0, "eq22.max_growth_K3": -1.0}
    assert found(key, changes=others | {name: good})["verdict"] == "reproduced"
    assert found(key, changes=others | {name: bad})["verdict"] == "not reproduced"


def test_robot_that_fails_unloaded_has_no_payload_and_no_motor():
    nothing = {"fig12.payload_kg": None, "fig12.counted_kg": None}
    for key, ours in (("5.2.2.payload", "fails unloaded"), ("5.2.2.motor", "–")):
        row = found(key, changes=nothing)
        assert (row["ours"], row["value"], row["verdict"]) == (ours, None, "not reproduced")
    neither = {"claims.closed_loop_spatial_paper_kg": None, "claims.open_loop_spatial_paper_kg": None}
    assert found("6.open-payload", changes=neither)["verdict"] == "not reproduced"


def test_row_of_a_part_that_was_not_run_names_its_command():
    row = found("5.2.2.payload", Interpretation(line="flat"), without=("fig12.",))
    assert (row["verdict"], row["ours"], row["evidence"]) == (None, None, "")
    assert row["command"] == "cablebot reproduce --only fig12 --line flat"


def test_number_without_value_makes_a_finding_undecided():
    row = found("5.2.1.path", changes={"fig11.peak_error_mm": None})
    assert (row["verdict"], row["evidence"]) == ("undecided", "`fig11.peak_error_mm` has no value.")
    row = found("5.2.3.path", Interpretation(line="cable"), {"fig14.eq22_peak_error_mm": None})
    assert "no motor can have the torque-speed line cable" in row["evidence"]


def test_inputs_follow_the_interpretation():
    assert found("table4.m", Interpretation(platform_mass="10"))["ours"] == "10 kg"
    assert found("table8.m")["verdict"] == found("5.2.3.K")["verdict"] == "contradicted"
    assert found("5.2.3.K", Interpretation(stiffness="2"))["ours"] == "2 N·m/rad"
    chosen = Interpretation(sides="circumradius", line="flat", triangles="turned")
    assert (found("table4.a", chosen)["ours"], found("table4.a", chosen)["verdict"]) == ("0.47 m", "used")
    assert found("table8.speed", chosen)["verdict"] == "replaced"


def test_inputs_follow_the_robot(monkeypatch):
    changed = PLANAR.replace(
        mass=1.2,
        base_anchors=1.1 * PLANAR.base,
        motors=PLANAR.motors.replace(stall_torque=(5.0, 5.0, 6.0)),
        transmission=PLANAR.transmission.replace(pulley_inertia=1e-3, pulley_radius=0.06),
    )
    monkeypatch.setattr(interpretation, "PLANAR", changed)
    verdicts = {row["key"]: row["verdict"] for row in rows(Interpretation(), NUMBERS)}
    for key in ("table2.m", "table7.m", "table2.side", "table7.torque", "table2.J", "table2.r"):
        assert verdicts[key] == "replaced"
    assert verdicts["table4.r"] == "used, corrected"


def test_inputs_follow_the_uncertainty_and_the_gains(monkeypatch):
    table6 = UNCERTAINTIES["table6"]

    def wider(robot):
        known = table6(robot)
        mass = type(known.parameters["stiffness"])(low=-0.1, high=0.2, each=False)
        return Uncertainty(parameters=dict(known.parameters) | {"platform_mass": mass}, wrench=known.wrench)

    monkeypatch.setitem(inputs.PAPER_GAINS, "spatial", (31.0, 20.0))
    monkeypatch.setitem(UNCERTAINTIES, "table6", wider)
    verdicts = {row["key"]: row["verdict"] for row in rows(Interpretation(), NUMBERS)}
    assert (verdicts["table4.K_P"], verdicts["table4.K_D"]) == ("replaced", "used")
    assert (verdicts["table6.m"], verdicts["table6.k"]) == ("replaced", "used")


def test_robot_without_equilibrium_makes_its_inputs_undecided():
    row = found("table4.m", Interpretation(triangles="aligned"))
    assert row["verdict"] == "undecided"
    assert "no equilibrium with positive tensions" in row["evidence"]
    assert found("table2.m", Interpretation(triangles="aligned"))["verdict"] == "used"
