"""The published items and the verdicts on them; test_golden has their rows."""

import json
from pathlib import Path

import pytest

from cablebot_gym.robots import PLANAR
from cablebot_reproduction import interpretation as interpretation_module
from cablebot_reproduction.contents import VERDICTS
from cablebot_reproduction.findings import find
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Run
from cablebot_reproduction.published import PUBLISHED
from cablebot_reproduction.summary import POINTS

RESULTS = Path(__file__).parents[1] / "docs" / "results.json"
NUMBERS = json.loads(RESULTS.read_text())["numbers"]


def finding(key, interpretation=None, changes=None, *, without=()):
    """Finding for the stored numbers with changes, without those of some parts."""
    numbers = {name: value for name, value in NUMBERS.items() if not name.startswith(without)}
    run = Run(interpretation=interpretation or Interpretation(), numbers=numbers | (changes or {}))
    return find(PUBLISHED[key], run, {})


# --- published items ------------------------------------------------------------------------------------------------


def test_every_result_and_claim_has_a_verdict_function():
    judged = {key for key, item in PUBLISHED.items() if item.kind != "input"}
    assert VERDICTS.keys() == judged


def test_every_sentence_is_filled_by_the_stored_numbers():
    """A misspelled name would drop its sentence."""
    run = Run(interpretation=Interpretation(), numbers=NUMBERS)
    texts = {"closest_spatial": "a", "closest_flexible": "b", "fl4_drop": "c"}
    for key, verdict in VERDICTS.items():
        judgement = verdict.judge(run)
        assert all(map(run.sentence, judgement.evidence)), key
        assert run.sentence(judgement.text or "ours", ours="ours"), key
    for point in POINTS:
        assert set(point["keys"]) <= set(PUBLISHED)
        assert all(run.sentence(template, **texts) for template in point["text"]), point["title"]


# --- verdicts -------------------------------------------------------------------------------------------------------


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
        ("6.drop", "fig15.state_space_drop_fraction", 0.31, 0.32),
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
        ("5.1.converges", "eq37.literal_spread_kg", 1e-9, None),
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
    """One item for each rule."""
    numbers = {
        "fig5.peak_error_mm": 0.3,
        "fig6.peak_error_mm": 0.4,
        "claims.closed_loop_planar_paper_kg": 2.0,
        "eq22.max_growth_K2": -1.0,
        "eq22.max_growth_K3": -1.0,
    }
    assert finding(key, changes=numbers | {name: good}).verdict == "reproduced"
    assert finding(key, changes=numbers | {name: bad}).verdict == "not reproduced"


def test_robot_that_fails_unloaded_has_no_payload_and_no_motor():
    unloaded = {"fig12.payload_kg": None, "fig12.counted_kg": None}
    for key, ours in (("5.2.2.payload", "fails unloaded"), ("5.2.2.motor", "–")):
        row = finding(key, changes=unloaded)
        assert (row.ours, row.value, row.verdict) == (ours, None, "not reproduced")
    neither = {
        "claims.closed_loop_spatial_paper_kg": None,
        "claims.open_loop_spatial_paper_kg": None,
    }
    assert finding("6.open-payload", changes=neither).verdict == "not reproduced"


def test_finding_of_a_missing_part_names_its_command():
    row = finding("5.2.2.payload", Interpretation(line="flat"), without=("fig12.",))
    assert (row.verdict, row.ours, row.evidence) == (None, None, "")
    assert row.command == "cablebot reproduce --only fig12 --line flat"


def test_number_without_value_makes_a_finding_undecided():
    row = finding("5.2.1.path", changes={"fig11.peak_error_mm": None})
    assert (row.verdict, row.evidence) == ("undecided", "`fig11.peak_error_mm` has no value.")
    row = finding("5.2.3.path", Interpretation(line="cable"), {"fig14.eq22_peak_error_mm": None})
    assert "no motor can have the torque-speed line cable" in row.evidence


# --- inputs ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "options", "ours", "verdict"),
    [
        ("table4.m", {"platform_mass": "10"}, "10 kg", "contradicted"),
        ("5.2.3.K", {"stiffness": "2"}, "2 N·m/rad", "contradicted"),
        ("table4.a", {"sides": "circumradius", "triangles": "turned"}, "0.47 m", "used"),
        ("table4.b", {"sides": "circumradius"}, "0.148 m", "used"),
        ("table4.J", {"pulleys": "table5"}, "0.0004 kg·m²", "replaced"),
        ("table8.speed", {"line": "flat"}, "9.549 · 10⁹ rpm", "replaced"),
        ("table8.guess", {}, "5 kg", "used"),
        ("table4.m", {"triangles": "aligned"}, "–", "undecided"),
        ("table2.m", {"triangles": "aligned"}, "1 kg", "used"),
    ],
)
def test_inputs_follow_the_interpretation(key, options, ours, verdict):
    row = finding(key, Interpretation(**options))
    assert (row.ours, row.verdict) == (ours, verdict)


@pytest.mark.parametrize(
    "key", ["table2.m", "table7.m", "table2.side", "table7.torque", "table2.J", "table2.r"]
)
def test_inputs_follow_the_robot(monkeypatch, key):
    changed = PLANAR.replace(
        mass=1.2,
        base_anchors=1.1 * PLANAR.base,
        motors=PLANAR.motors.replace(stall_torque=(5.0, 5.0, 6.0)),
        transmission=PLANAR.transmission.replace(pulley_inertia=1e-3, pulley_radius=0.06),
    )
    monkeypatch.setattr(interpretation_module, "PLANAR", changed)
    assert finding(key).verdict == "replaced"
    assert finding("table4.r").verdict == "used, corrected"
