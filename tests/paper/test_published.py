"""What the paper prints, counted by hand, and the verdicts on it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

import pytest

from cablebot_baselines.paper import inputs, interpretation, published, verdicts
from cablebot_baselines.paper.exact import exact_limit
from cablebot_baselines.paper.finding import as_text, kilograms, option_text
from cablebot_baselines.paper.findings import FINDING_RULES, find, rows
from cablebot_baselines.paper.interpretation import Interpretation, choices_of
from cablebot_baselines.paper.parts.interpretations import _merged, planar_interpretations
from cablebot_baselines.paper.published import LOADS, PUBLISHED, published_value, within
from cablebot_gym.robots import PLANAR
from cablebot_gym.uncertainty import UNCERTAINTIES, Uncertainty

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
"""Inputs, results, claims, and how many numbers in figures and words the place prints in all, counted in the paper.
Numbering of equations, figures, tables, sections and references is not counted, nor are units' exponents, nor words
that count things of their own sentence ("these two last equations", "three controller inputs" is one, "linear one" is
not). The cells of Tables 1 and 3 print most numbers several times."""

NUMBERS: dict[str, float | int | str | bool | None] = {
    "fig5.peak_error_mm": 0.3,
    "fig5.least_tension_N": 5.0,
    "fig5.slack": False,
    "fig6.peak_error_mm": 0.4,
    "fig6.least_tension_N": 27.0,
    "fig6.slack": False,
    "fig7.rigid_peak_Nm": 9.0,
    "fig7.flexible_peak_Nm": 9.3,
    "fig7.ripple_before_Nm": 0.2,
    "fig7.ripple_after_Nm": 0.8,
    "fig7.ripple_late_Nm": 0.8,
    "fig7.closed_loop_peak_error_mm": 27.0,
    **{
        f"fig9.{name}_reduction_{layer}": fraction
        for name in ("sum", "max", "flex_sum", "flex_max")
        for layer, fraction in (("1e-2", 0.2), ("1e-3", 0.65), ("1e-4", 0.9))
    },
    "fig10.payload_kg": 1.06,
    "fig10.counted_kg": 1.06,
    "fig10.motor": 2,
    "fig10.time_s": 0.5,
    "fig10.exact_payload_kg": 1.08,
    "fig10.exact_total_mass_kg": 2.08,
    "fig10.exact_motor": 2,
    "fig10.exact_time_s": 0.5,
    "fig11.payload_kg": 1.06,
    "fig11.peak_error_mm": 0.6,
    "fig11.within": True,
    "fig12.payload_kg": 1.78,
    "fig12.counted_kg": 1.78,
    "fig12.motor": 2,
    "fig12.time_s": 0.502,
    "fig12.exact_payload_kg": 1.8,
    "fig12.exact_total_mass_kg": 11.8,
    "fig12.exact_motor": 2,
    "fig12.exact_time_s": 0.5,
    "fig13.payload_kg": 1.78,
    "fig13.peak_error_mm": 0.4,
    "fig13.within": True,
    "fig13.peak_rotation_mrad": 0.1,
    "fig14.peak_error_mm": 5.5,
    "fig14.eq22_peak_error_mm": 28.0,
    "fig14.eq22_within": False,
    "fig14.eq22_friction_peak_error_mm": 7.8,
    "fig15.counted_kg": 1.44,
    "fig15.motor": 2,
    "fig15.state_space_counted_kg": 0.42,
    "fig15.state_space_motor": 2,
    "fig15.state_space_time_s": 0.502,
    "fig15.state_space_drop_fraction": 0.77,
    "fig15.rigid_counted_kg": 1.78,
    "fig15.rigid_exact_counted_kg": 1.8,
    "fig15.eq22_counted_kg": None,
    "fig15.drop_fraction": 0.19,
    "eq37.literal_payload_kg": 0.91,
    "eq37.literal_spread_kg": 0.0,
    "eq37.literal_converges": True,
    "eq37.literal_over_true": 0.5,
    "eq37.corrected_payload_kg": 1.83,
    "eq37.exact_payload_kg": 1.83,
    "eq22.max_growth_K2": 9.5,
    "eq22.max_growth_K3": 9.7,
    "eq22.least_growth_any_K": 9.0,
    "eq22.friction_needed": 0.0082,
    "eq22.lyapunov_printed_definite": False,
    "eq22.controllable_states": 24,
    "eq22.states": 24,
    "claims.fl_payload_known_kg": 4.0,
    "claims.fl_payload_unknown_kg": 0.4,
    "claims.fl_payload_known_paper_kg": 1.8,
    "claims.fl_payload_unknown_paper_kg": 0.4,
    **{
        f"claims.{loop}_loop_{kind}{criterion}_kg": load
        for kind in ("planar", "spatial")
        for loop, criterion, load in (
            ("open", "", 1.4),
            ("closed", "", 1.9),
            ("open", "_paper", 1.09),
            ("closed", "_paper", 1.06),
        )
    },
    "claims.closed_loop_planar_error_mm": 0.4,
    "claims.open_loop_planar_error_mm": 32.0,
    "claims.closed_loop_spatial_error_mm": 6.6,
    "claims.open_loop_spatial_error_mm": 7.6,
    "claims.pole_error_planar": 0.01,
    "claims.pole_error_spatial": 0.001,
    "claims.sampled_pole_error_planar": 0.08,
    "claims.sampled_pole_error_spatial": 0.002,
    "claims.poles_planar": "-5.00 + 44.44i, -5.00 − 44.44i",
    "claims.poles_spatial": "-18.37, -1.63",
    "claims.affine_planar": 0.15,
    "claims.affine_spatial": 1e-15,
    "claims.flex_composite_error_nominal_mm": 2.6,
    "claims.flex_composite_error_table6_mm": 7.3,
    "claims.flex_fl4_error_nominal_mm": 1.5,
    "claims.flex_fl4_error_table6_mm": 4.1,
    "interpretations.spatial_inverted_half-side_table4_10_flat_kg": 2.35,
    "interpretations.spatial_inverted_half-side_table4_10_flat_motor": 2,
    "interpretations.spatial_inverted_half-side_table5_10_reversed_kg": 3.07,
    "interpretations.spatial_inverted_half-side_table5_10_reversed_motor": 2,
    "interpretations.spatial_turned_circumradius_table4_11_cable_kg": 2.56,
    "interpretations.spatial_turned_circumradius_table4_11_cable_motor": 6,
    "interpretations.spatial_aligned_half-side_table4_10_flat_kg": None,
    "interpretations.spatial_aligned_half-side_table4_10_flat_motor": None,
    "interpretations.planar_up_least_0.0_physical_kg": 1.13,
    "interpretations.planar_up_least_0.0_physical_motor": 2,
    "interpretations.spatial_within_5pct": 3,
    "interpretations.spatial_total": 48,
    "scan.hits": 48,
    "scan.geometries": 12672,
    "scan.largest_kg": 6.9,
    "scan.planar_best_added_kg": 1.7,
}
"""Made up, of the size that a run gives; each is used by some finding."""


class Watched(Mapping[str, float | int | str | bool | None]):
    """Numbers that remember which of them were asked for."""

    def __init__(self) -> None:
        self.read: set[str] = set()

    def __getitem__(self, key: str) -> float | int | str | bool | None:
        self.read.add(key)
        return NUMBERS[key]

    def __iter__(self) -> Iterator[str]:
        return iter(NUMBERS)

    def __len__(self) -> int:
        return len(NUMBERS)


def found(key, interpretation=None, numbers=NUMBERS):
    finding = find(PUBLISHED[key], interpretation or Interpretation(), numbers)
    assert finding is not None
    return finding


# --- what is published ----------------------------------------------------------------------------------------------


def test_no_number_of_the_paper_is_missing():
    counted = {}
    for place in dict.fromkeys(item.place for item in PUBLISHED.values()):
        items = [item for item in PUBLISHED.values() if item.place == place]
        kinds = Counter(item.kind for item in items)
        counted[place] = (kinds["input"], kinds["result"], kinds["claim"], sum(item.times for item in items))
    assert counted == BY_HAND


def test_no_key_stands_twice():
    lists = (published._ROBOTS, published._CONTROL, published._SIMULATION, published._PAYLOAD)
    assert sum(len(items) for items in lists) == len(PUBLISHED)
    assert all(key == item.key for key, item in PUBLISHED.items())


def test_a_number_is_not_without_value_and_a_claim_not_with_one():
    for item in PUBLISHED.values():
        assert item.statement
        assert bool(item.printed) or item.kind == "claim"
        if item.kind == "result":
            assert item.value is not None
        if item.kind == "claim":
            assert item.value is None


def test_values_are_those_that_are_printed():
    words = {"two": 2, "three": 3, "six": 6, "second": 2, "middle": 0.5, "z₁ … z₄": 4, "1, …, 12": 12}
    words |= {"1, …, 6": 6, "1, 2, …, 6": 6, "ζ < 1": 1, "4π": 4}
    for item in PUBLISHED.values():
        if item.value is None:
            continue
        number = item.printed.replace("about ", "").replace("more than ", "").replace(",", "").replace("%", " %")
        expected = words[item.printed] if item.printed in words else float(number.split()[0])
        assert item.value == expected, item.key


def test_loads_are_those_of_the_results():
    assert LOADS == {"planar": 2.2, "spatial": 2.56, "flexible": 1.4}
    with pytest.raises(ValueError, match="no number"):
        published_value("5.1.accuracy")


@pytest.mark.parametrize(("ours", "same"), [(2.2, True), (2.309, True), (2.311, False), (2.091, True), (2.089, False)])
def test_within_is_not_a_bit_more_or_less_than_five_percent(ours, same):
    assert within(ours, 2.2) is same


# --- findings -------------------------------------------------------------------------------------------------------


def test_nothing_has_two_findings_or_none():
    of_inputs, of_verdicts = ([key for key, _ in module.finding_rules()] for module in (inputs, verdicts))
    assert sorted([*of_inputs, *of_verdicts]) == sorted(PUBLISHED)
    assert set(of_inputs) == {key for key, item in PUBLISHED.items() if item.kind == "input"}
    assert set(FINDING_RULES) == set(PUBLISHED)


def test_a_run_leaves_no_row_without_verdict():
    allowed = {
        "input": {"used", "used, corrected", "contradicted"},
        "result": {"reproduced", "not reproduced"},
        "claim": {"reproduced", "not reproduced", "undecided"},
    }
    made = rows(Interpretation(), NUMBERS)
    assert [row["key"] for row in made] == list(PUBLISHED)
    for row in made:
        assert row["verdict"] in allowed[row["kind"]], row["key"]
        assert row["ours"]
        assert row["evidence"]
        assert row["command"].startswith("cablebot reproduce --only ")


def test_no_number_is_asked_for_in_vain():
    watched = Watched()
    made = rows(Interpretation(), watched)
    assert None not in [row["verdict"] for row in made]
    assert set(NUMBERS) - watched.read == set()


def test_a_part_that_was_not_run_leaves_its_command():
    numbers = {key: value for key, value in NUMBERS.items() if not key.startswith("fig12.")}
    row = next(row for row in rows(Interpretation(line="flat"), numbers) if row["key"] == "5.2.2.payload")
    assert row["verdict"] is None
    assert row["ours"] is None
    assert row["command"] == "cablebot reproduce --only fig12 --line flat"


def test_a_part_that_was_run_without_its_number_is_not_called_missing():
    numbers = NUMBERS | {"fig11.peak_error_mm": None, "fig11.within": None}
    assert found("5.2.1.path", numbers=numbers).verdict == "undecided"
    assert "`fig11.peak_error_mm` has no value." in found("5.2.1.path", numbers=numbers).evidence
    numbers = {key: value for key, value in NUMBERS.items() if not key.startswith("fig14.eq22")}
    finding = found("5.2.3.path", Interpretation(line="cable"), numbers)
    assert finding.verdict == "undecided"
    assert "no motor can have the torque-speed line cable" in finding.evidence


def test_parts_that_only_add_to_the_evidence_are_not_needed():
    numbers = {key: value for key, value in NUMBERS.items() if not key.startswith(("scan.", "interpretations."))}
    assert "geometries" in found("5.2.2.payload").evidence
    finding = found("5.2.2.payload", numbers=numbers)
    assert finding.verdict == "not reproduced"
    assert "geometries" not in finding.evidence


def test_the_closest_reading_with_the_published_motor_is_named():
    evidence = found("5.2.2.payload").evidence
    closest = "2.35 kg (−8 %) with torque limits independent of speed"
    assert f"motor 2 as the limiting motor: {closest}. 3 of 48 combinations" in evidence
    planar = found("5.2.1.payload").evidence
    assert "1.13 kg (−49 %) with T_min = 0 N. Closest total mass of platform and load: 2.13 kg (−3 %)" in planar
    assert "Total mass with the platform: 2.08 kg (−5 %)." in planar


def test_readings_that_no_reader_could_tell_apart_by_the_load_are_both_named():
    name = "interpretations.spatial_inverted_half-side_table5_10_"
    near = {f"{name}{line}_kg": load for line, load in (("cable", 2.555), ("flat", 2.528), ("physical", 1.98))}
    motors = {key.replace("_kg", "_motor"): 2 for key in near}
    evidence = found("5.2.2.payload", numbers=NUMBERS | near | motors).evidence
    both = "2.56 kg (0 %) with pulleys of Table 5, torque limits from the cable speed in m/s, or 2.53 kg (−1 %) with"
    assert f"{both} pulleys of Table 5, torque limits independent of speed. " in evidence
    assert "1.98" not in evidence


def test_what_the_text_of_the_readings_says_of_the_closest():
    """Its tables combine all that decides these two, so that the words are as true under any other reading."""
    default = interpretation.Interpretation()
    for line in ("cable", "flat"):
        one = default.replace(pulleys="table5", line=line)
        limit = exact_limit(one, one.spatial("payload"))
        assert limit.payload == pytest.approx(LOADS["spatial"], rel=0.015)
        assert limit.motor == 2
    limits = {one: exact_limit(one, one.planar) for one in planar_interpretations(default) if one.alpha == "least"}
    second = {one: limit.payload for one, limit in limits.items() if limit.motor == 2}
    closest = min(second, key=lambda one: abs(second[one] - LOADS["planar"]))
    assert (closest.line, closest.planar_apex, closest.minimum_tension) == ("cable", "left", 0.0)


def test_what_is_published_twice_is_argued_once():
    assert found("5.2.3.rigid").ours == found("5.2.2.payload").ours
    assert found("5.2.3.rigid").evidence == "See §5.2.2: load capacity of the spatial robot."
    assert found("6.robust").evidence.startswith("See §4.4: ")


def test_nothing_carried_is_no_missing_number():
    nothing = NUMBERS | {"fig12.payload_kg": None, "fig12.counted_kg": None, "fig12.motor": None}
    assert found("5.2.2.payload", numbers=nothing).ours == "fails unloaded"
    assert found("5.2.2.payload", numbers=nothing).verdict == "not reproduced"
    assert found("5.2.2.motor", numbers=nothing).ours == "no motor"


@pytest.mark.parametrize(
    ("key", "name", "good", "bad"),
    [
        ("5.2.1.payload", "fig10.counted_kg", 2.1, 2.05),
        ("5.2.1.motor", "fig10.motor", 2, 1),
        ("5.2.2.payload", "fig12.counted_kg", 2.6, 2.8),
        ("5.2.3.payload", "fig15.state_space_counted_kg", 1.45, 1.5),
        ("5.2.3.rigid", "fig12.counted_kg", 2.6, 2.8),
        ("5.2.3.motor", "fig15.state_space_motor", 2, 3),
        ("5.2.3.less", "fig15.state_space_drop_fraction", 0.06, 0.04),
        ("6.drop", "fig15.state_space_drop_fraction", 0.31, 0.4),
        ("4.4.sum", "fig9.flex_sum_reduction_1e-3", 0.601, 0.6),
        ("4.4.max", "fig9.flex_max_reduction_1e-3", 0.601, 0.6),
        ("6.robust", "fig9.flex_sum_reduction_1e-3", 0.601, 0.6),
        ("abstract.accuracy", "claims.closed_loop_spatial_error_mm", 0.4, 0.6),
        ("1.tension", "fig6.least_tension_N", 0.1, -0.1),
        ("1.tension", "fig5.slack", False, True),
        ("1.controller", "claims.open_loop_spatial_kg", None, 2.0),
        ("3.1.poles", "claims.pole_error_planar", 0.04, 0.06),
        ("3.2.poles", "claims.pole_error_spatial", 0.04, 0.06),
        ("3.3.robust", "eq22.least_growth_any_K", -1.0, 1.0),
        ("3.4.uncontrollable", "eq22.controllable_states", 12, 24),
        ("3.4.lyapunov", "eq22.lyapunov_printed_definite", True, False),
        ("3.4.stability", "fig9.sum_reduction_1e-2", 0.1, -0.1),
        ("4.1.tension", "fig5.least_tension_N", 0.1, 0.0),
        ("4.3.vibration", "fig7.ripple_late_Nm", 0.4, 0.5),
        ("5.1.linear-planar", "claims.affine_planar", 1e-9, 1e-3),
        ("5.1.linear-spatial", "claims.affine_spatial", 1e-9, 1e-3),
        ("5.1.converges", "eq37.literal_spread_kg", 1e-9, 0.1),
        ("5.1.answer", "eq37.literal_over_true", 1.04, 1.06),
        ("5.1.accuracy", "claims.fl_payload_unknown_paper_kg", 1.75, 1.6),
        ("5.2.1.path", "fig11.within", True, False),
        ("5.2.2.path", "fig13.within", True, False),
        ("5.2.3.path", "fig14.eq22_within", True, False),
        ("6.torque", "fig7.ripple_after_Nm", 0.5, 0.4),
        ("6.uncertainty", "claims.flex_composite_error_table6_mm", 2.8, 2.7),
        ("6.open-tracking", "claims.open_loop_planar_error_mm", 0.5, 0.3),
    ],
)
def test_a_verdict_follows_its_number(key, name, good, bad):
    assert found(key, numbers=NUMBERS | {name: good}).verdict == "reproduced"
    assert found(key, numbers=NUMBERS | {name: bad}).verdict == "not reproduced"


def test_feedback_is_no_gain_for_a_law_that_carries_nothing():
    better = {f"claims.closed_loop_{kind}_paper_kg": 2.0 for kind in ("planar", "spatial")}
    assert found("6.open-payload").verdict == "not reproduced"
    assert found("6.open-payload", numbers=NUMBERS | better).verdict == "reproduced"
    nothing = better | {"claims.closed_loop_spatial_paper_kg": None, "claims.open_loop_spatial_paper_kg": None}
    assert found("6.open-payload", numbers=NUMBERS | nothing).verdict == "not reproduced"


@pytest.mark.parametrize("key", ["3.3.linear", "3.3.bounded", "5.2.3.stable"])
def test_stability_is_not_granted_while_one_stiffness_grows(key):
    calm = NUMBERS | {"eq22.max_growth_K2": -1.0, "eq22.max_growth_K3": -1.0}
    assert found(key, numbers=calm).verdict == "reproduced"
    assert found(key, numbers=calm | {"eq22.max_growth_K2": 1.0}).verdict == "not reproduced"


# --- inputs ---------------------------------------------------------------------------------------------------------


def test_inputs_follow_the_readings():
    assert found("table4.m").ours == "11 kg"
    assert found("table4.m", Interpretation(platform_mass="10")).ours == "10 kg"
    assert found("table8.m").ours == "10 kg"
    assert {found(key).verdict for key in ("table4.m", "table5.m", "table8.m", "table5.K", "5.2.3.K")} == {
        "contradicted"
    }
    assert found("5.2.3.K", Interpretation(stiffness="2")).ours == "2 N·m/rad"
    assert "uses 2 N·m/rad in §4 and 2 N·m/rad in §5.2" in found("5.2.3.K", Interpretation(stiffness="2")).evidence
    assert found("table4.half", Interpretation(sides="circumradius")).ours == "circumradius"
    assert found("table4.a", Interpretation(sides="circumradius")).ours == "0.47 m"
    assert found("table4.a", Interpretation(sides="circumradius")).verdict == "used"


def test_a_flat_line_has_no_free_speed():
    assert found("table8.speed").ours == "1000 rpm"
    assert found("table8.speed", Interpretation(line="flat")).verdict == "replaced"


@pytest.mark.parametrize(
    ("key", "changes"),
    [
        ("table2.m", {"mass": 1.2}),
        ("table7.m", {"mass": 1.2}),
        ("table2.side", {"base_anchors": 1.1 * PLANAR.base}),
        ("table7.torque", {"motors": PLANAR.motors.replace(stall_torque=(5.0, 5.0, 6.0))}),
        ("table2.J", {"transmission": PLANAR.transmission.replace(pulley_inertia=1e-3)}),
        ("table2.r", {"transmission": PLANAR.transmission.replace(pulley_radius=0.06)}),
    ],
)
def test_inputs_follow_the_robot(monkeypatch, key, changes):
    assert found(key).verdict.startswith("used")
    monkeypatch.setattr(interpretation, "PLANAR", PLANAR.replace(**changes))
    assert found(key).verdict == "replaced"


def test_inputs_follow_the_uncertainty_and_the_gains(monkeypatch):
    monkeypatch.setitem(inputs.PAPER_GAINS, "spatial", (31.0, 20.0))
    assert found("table4.K_P").verdict == "replaced"
    assert found("table4.K_D").verdict == "used"
    table6 = UNCERTAINTIES["table6"]

    def wider(robot):
        known = table6(robot)
        spread = {"low": -0.1, "high": 0.2, "each": False}
        return Uncertainty(
            parameters=dict(known.parameters) | {"platform_mass": type(known.parameters["stiffness"])(**spread)},
            wrench=known.wrench,
        )

    monkeypatch.setitem(UNCERTAINTIES, "table6", wider)
    assert found("table6.m").ours == "0.1, 0.2 of the mass"
    assert found("table6.m").verdict == "replaced"
    assert found("table6.k").verdict == "used"


def test_readings_without_a_robot_are_no_error():
    finding = found("table4.m", Interpretation(triangles="aligned"))
    assert finding.verdict == "undecided"
    assert "no equilibrium with positive tensions" in finding.evidence
    assert found("table2.m", Interpretation(triangles="aligned")).verdict == "used"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.23456, "1.235"),
        (-0.5, "−0.5"),
        (1e-5, "1 · 10⁻⁵"),
        (12672, "12672"),
        (None, "–"),
        (True, "yes"),
        (float("inf"), "∞"),
        (float("nan"), "–"),
        ("motor 2", "motor 2"),
    ],
)
def test_numbers_as_text(value, text):
    assert as_text(value) == text


@pytest.mark.parametrize(
    ("load", "text"),
    [(1.802, "1.80 kg"), (11.776, "11.8 kg"), (123.4, "123 kg"), (-0.5, "−0.500 kg"), (None, "fails unloaded")],
)
def test_loads_have_as_many_digits_as_the_papers(load, text):
    assert kilograms(load) == text


def test_every_choice_has_its_words():
    words = {option_text(name, choice) for name, choices in choices_of().items() for choice in choices}
    assert len(words) == sum(len(choices) for choices in choices_of().values())
    assert not any("=" in one and "K = " not in one for one in words)
    assert option_text("platform_mass", "as-printed") == "platform mass as printed: 11 kg in §4, 10 kg in §5.2"
    assert option_text("platform_mass", "as-printed", "payload") == "platform mass 10 kg"
    assert option_text("stiffness", "as-printed", "control") == "K = 2 N·m/rad"
    assert option_text("minimum_tension", 5.0) == "T_min = 5 N"


def test_rows_that_are_the_same_words_throughout_are_merged():
    rows = {("a", "x"): ["1", "2"], ("b", "x"): ["no", "no"], ("b", "y"): ["no", "no"], ("c", "x"): ["no", "3"]}
    assert list(_merged(rows)) == [("a", "x", "1", "2"), ("b", "any", "no", "no"), ("c", "x", "no", "3")]
