"""Figs. 10 to 15: what is marked, drawn and counted is what was found, under the reading that was asked for."""

from __future__ import annotations

import io
import json
import math

import numpy as np
import pytest

from cablebot_baselines.paper.exact import LargestPayload, exact_profile, state_space_profile
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.parts import flexible_saturation, saturation
from cablebot_baselines.paper.parts.profiles import PayloadSummary, computed_profile, first_saturation
from cablebot_gym.physics import textbook

pytest.importorskip("matplotlib")

DEFAULT = Interpretation()
RIGID = {part.name: part for part in saturation.PARTS}
FLEXIBLE = {part.name: part for part in flexible_saturation.PARTS}
SLOW = ("motor_pd", "composite", "task")
"""Cells of Fig. 15 that only add numbers."""


def ran(part, interpretation, *, skipped=()):
    return {name: cell() for name, cell in part.cells(interpretation).items() if name not in skipped}


@pytest.fixture(scope="module")
def rigid():
    """What the cells of Figs. 10 and 12 found; those of 11 and 13 are the same."""
    return {name: ran(RIGID[name], DEFAULT) for name in ("fig10", "fig12")}


@pytest.fixture(scope="module")
def flexible():
    """What the cells of Fig. 14 found, and of Fig. 15, the slow ones replaced by the one of fl4."""
    path = ran(FLEXIBLE["fig14"], DEFAULT)
    torques = ran(FLEXIBLE["fig15"], DEFAULT, skipped=("fl4", "empty", *SLOW))
    same = {name: path["fl4"] for name in SLOW}
    return {"fig14": path, "fig15": torques | same | {name: path[name] for name in ("fl4", "empty")}}


@pytest.fixture(scope="module")
def numbers(rigid, flexible):
    """Of every part under the default reading."""
    found = {"fig11": rigid["fig10"], "fig13": rigid["fig12"]} | rigid | flexible
    return {name: part.outcome(DEFAULT, found[name]).numbers for name, part in (RIGID | FLEXIBLE).items()}


def panels(figure):
    return [axes for axes in figure.axes if axes.get_title().startswith("motor")]


def drawn(axes):
    """Upper limit, lower limit, torque, as drawn."""
    return [line.get_xydata() for line in axes.get_lines()[:3]]


def marked(axes_of_all):
    """Motor, time and torque of the one dot."""
    dots = [
        (motor, *line.get_xydata()[0])
        for motor, axes in enumerate(axes_of_all, start=1)
        for line in axes.get_lines()
        if line.get_marker() == "o"
    ]
    assert len(dots) == 1
    return dots[0]


def titles(figure):
    return " ".join([figure.get_suptitle(), *(part.get_suptitle() for part in figure.subfigs)])


@pytest.mark.parametrize("name", ["fig10", "fig12"])
def test_mark_is_not_elsewhere_than_where_a_motor_first_reaches_its_limit(name, rigid, numbers):
    history = rigid[name]["paper"].history
    saturated = np.abs(history["commanded_action"]) >= 0.999
    step = int(np.argmax(saturated.any(axis=1)))
    motor = int(np.argmax(saturated[step]))
    expected = (motor + 1, history["action_time"][step], history["torques"][step, motor])
    assert marked(panels(RIGID[name].draw(DEFAULT, rigid[name]))) == pytest.approx(expected)
    assert (numbers[name]["motor"], numbers[name]["time_s"]) == pytest.approx(expected[:2])
    assert np.abs(history["commanded_action"]).max() <= 1 + 1e-12


def test_mark_of_the_springs_is_not_that_of_the_other_half_of_the_figure(flexible, numbers):
    axes = panels(FLEXIBLE["fig15"].draw(DEFAULT, flexible["fig15"]))
    for half, prefix in ((axes[:6], ""), (axes[6:], "state_space_")):
        found = numbers["fig15"][f"{prefix}motor"], numbers["fig15"][f"{prefix}time_s"]
        assert marked(half)[:2] == pytest.approx(found)


@pytest.mark.parametrize("kind", ["fig10", "fig12"])
def test_closed_loop_does_not_carry_another_payload_than_the_closed_form(kind, numbers):
    assert numbers[kind]["payload_kg"] == pytest.approx(numbers[kind]["exact_payload_kg"], rel=0.03)
    assert numbers[kind]["motor"] == numbers[kind]["exact_motor"] == 2


def test_torques_drawn_do_not_lose_the_saturation_to_the_thinning(rigid):
    for motor, axes in enumerate(panels(RIGID["fig12"].draw(DEFAULT, rigid["fig12"]))):
        upper, lower, torque = drawn(axes)
        assert np.all(torque[:, 1] <= upper[:, 1] + 1e-9)
        assert np.all(torque[:, 1] >= lower[:, 1] - 1e-9)
        least = np.min(upper[:, 1] - torque[:, 1])
        assert least < 0.01 if motor == 1 else least > 0.1


def test_limits_are_not_sloped_under_a_flat_line_and_the_payload_is_not_that_of_a_sloped_one(numbers):
    flat = DEFAULT.replace(line="flat")
    found = ran(RIGID["fig12"], flat, skipped=("task", "payload_unknown", "empty"))
    found |= {"task": found["paper"], "payload_unknown": found["paper"], "empty": None}
    for axes in panels(RIGID["fig12"].draw(flat, found)):
        upper, lower, _ = drawn(axes)
        np.testing.assert_allclose(upper[:, 1], 10.0, atol=1e-4)
        np.testing.assert_allclose(lower[:, 1], -10.0, atol=1e-4)
    outcome = RIGID["fig12"].outcome(flat, found).numbers
    assert outcome["payload_kg"] == pytest.approx(outcome["exact_payload_kg"], rel=0.03)
    assert outcome["payload_kg"] > 1.2 * numbers["fig12"]["payload_kg"]


@pytest.mark.parametrize(("line", "factor"), [("reversed", -1.0), ("cable", -0.05)])
def test_limits_are_not_those_of_another_line_where_no_loop_can_be_run(line, factor):
    interpretation = DEFAULT.replace(line=line)
    found = ran(RIGID["fig12"], interpretation)
    figure = RIGID["fig12"].draw(interpretation, found)
    assert "exact tracking, no closed loop" in titles(figure)
    assert f"line = {line}" in titles(figure)
    assert not RIGID["fig12"].outcome(interpretation, found).numbers["simulated"]
    robot = interpretation.spatial("payload")
    for motor, axes in enumerate(panels(figure)):
        upper, lower, _ = drawn(axes)
        motion = saturation.paper_circle(robot)(upper[:, 0])
        speed = factor * textbook.pulley_speed(robot, motion.position, motion.velocity)[:, motor]
        np.testing.assert_allclose(upper[:, 1], 10.0 - robot.speed_slope[motor] * speed, atol=1e-9)
        np.testing.assert_allclose(upper[:, 1] - lower[:, 1], 20.0)


@pytest.mark.parametrize("interpretation", [Interpretation(line="reversed"), Interpretation(alpha="constant")])
def test_paths_that_nothing_travelled_do_not_have_errors(interpretation):
    found = ran(RIGID["fig11"], interpretation)
    assert RIGID["fig11"].outcome(interpretation, found).numbers["peak_error_mm"] is None
    assert "by assumption" in titles(RIGID["fig11"].draw(interpretation, found))


def test_a_reading_that_carries_nothing_does_not_fail_or_hide_it():
    interpretation = DEFAULT.replace(minimum_tension=0.0)
    found = ran(RIGID["fig10"], interpretation)
    for name in ("fig10", "fig11"):
        outcome = RIGID[name].outcome(interpretation, found).numbers
        assert outcome["payload_kg"] is None
        title = titles(RIGID[name].draw(interpretation, found))
        assert "fails unloaded" in title
        assert "slack" in title
        assert "the episode ends at" in title
    assert outcome["within"] is False  # though small, the error is that of a part of the motion


def test_zero_payload_is_not_marked_when_a_later_motor_fails(flexible):
    interpretation = DEFAULT.replace(stiffness="2")
    robot = interpretation.flexible("payload")
    profile = computed_profile(state_space_profile(interpretation, robot, 0.0))
    fraction = np.abs(2 * profile.torques - profile.upper - profile.lower) / (profile.upper - profile.lower)
    mark = first_saturation(profile, PayloadSummary.computed(LargestPayload(payload=-0.2, motor=3, time=0.9)))
    assert mark.step == np.flatnonzero(fraction.max(axis=1) >= 1)[0]
    assert mark.motor == np.argmax(fraction[mark.step])


def test_the_jump_is_not_marked_on_its_free_side():
    robot = DEFAULT.spatial("payload")
    profile = computed_profile(exact_profile(DEFAULT, robot, 1.8))
    mark = first_saturation(profile, PayloadSummary(payload=1.8, motor=3, time=0.5, violation="motor 3"))
    sides = np.flatnonzero(np.abs(profile.times - 0.5) < 1e-6)
    assert len(sides) == 2
    assert profile.torques[mark.step, 2] == profile.torques[sides, 2].max()


@pytest.mark.parametrize("payload", [-0.5, -math.inf, math.inf])
def test_a_payload_that_is_no_load_is_not_reported_as_one(payload):
    carried = PayloadSummary.computed(LargestPayload(payload=payload, motor=2, time=0.5))
    found = carried.numbers(DEFAULT, DEFAULT.planar)
    assert found["payload_kg"] is found["counted_kg"] is found["total_mass_kg"] is found["time_s"] is None
    assert "fails unloaded" in carried.sentence(DEFAULT.planar)


def test_the_platform_is_not_counted_twice_or_forgotten():
    carried, robot = PayloadSummary(payload=1.5, motor=2, time=0.5, violation="motor 2"), DEFAULT.spatial("payload")
    assert carried.numbers(DEFAULT, robot)["counted_kg"] == 1.5
    total = carried.numbers(DEFAULT.replace(payload="total"), robot)
    assert (total["payload_kg"], total["counted_kg"], total["total_mass_kg"]) == (1.5, 11.5, 11.5)


def test_drop_is_not_the_ratio_or_upside_down(numbers):
    found = numbers["fig15"]
    assert found["drop_fraction"] == pytest.approx(1 - found["payload_kg"] / found["rigid_payload_kg"])
    assert 0 < found["drop_fraction"] < 1
    assert found["state_space_drop_fraction"] == pytest.approx(
        1 - found["state_space_payload_kg"] / found["rigid_exact_payload_kg"]
    )


def test_rigid_robot_beside_the_springs_is_not_another_than_that_of_fig_12(numbers):
    names = ("payload_kg", "motor", "time_s")
    assert [numbers["fig15"][f"rigid_{name}"] for name in names] == [numbers["fig12"][name] for name in names]


def test_accuracy_is_not_taken_from_another_run(rigid, flexible, numbers):
    for name, run in (
        ("fig11", rigid["fig10"]["paper"]),
        ("fig13", rigid["fig12"]["paper"]),
        ("fig14", flexible["fig14"]["fl4"]),
    ):
        peak = 1e3 * run.history["tracking_error"].max()
        assert peak <= numbers[name]["peak_error_mm"] <= 1.01 * peak + 1e-3
        assert numbers[name]["within"] is True
        assert numbers[name]["bound_mm"] == 10.0


def test_curves_of_a_path_do_not_carry_the_name_of_another(rigid, numbers):
    plane = RIGID["fig13"].draw(DEFAULT, rigid["fig12"]).axes[0]
    named = {line.get_label(): line.get_xydata() for line in plane.get_lines()}
    for cell, prefix, words in (
        ("paper", "", "payload known, paper"),
        ("task", "task_", "payload known, task"),
        ("payload_unknown", "payload_unknown_", "payload unknown"),
    ):
        (label,) = [label for label in named if f", {words}" in label]
        assert label.startswith(f"{numbers['fig12'][prefix + 'payload_kg']:.3f} kg")
        np.testing.assert_array_equal(named[label], rigid["fig12"][cell].history["pose"][:, :2])


def test_eq_22_is_not_shown_as_stable_without_friction_or_unstable_with_it(flexible, numbers):
    found = numbers["fig14"]
    assert not found["eq22_within"]
    assert found["eq22_leaves_s"] < 0.6
    assert found["eq22_friction_within"]
    assert found["eq22_friction_leaves_s"] is None
    assert numbers["fig15"]["eq22_payload_kg"] is None
    axes = FLEXIBLE["fig14"].draw(DEFAULT, flexible["fig14"]).axes
    assert [one.get_ylabel().split()[0] for one in axes[1:]] == ["position", "z", "ψ", "θ", "φ"]
    errors = flexible["fig14"]["eq22"].arrays["pose"] - flexible["fig14"]["eq22"].arrays["reference_pose"]
    for column, one in enumerate(axes[2:], start=2):
        np.testing.assert_allclose(one.get_lines()[1].get_ydata(), 1e3 * errors[:, column], atol=1e-9)


def test_friction_is_not_put_on_the_pulleys():
    robot = DEFAULT.flexible("payload")
    changed = flexible_saturation.with_friction(DEFAULT, robot)
    assert changed.motor_damping.tolist() == DEFAULT.spatial("payload").damping.tolist()
    assert changed.damping.tolist() == robot.damping.tolist()


def test_numbers_are_not_what_json_cannot_hold(numbers):
    for found in numbers.values():
        assert json.loads(json.dumps(dict(found), allow_nan=False)) == found


def test_the_largest_drawing_is_not_too_heavy_for_the_page(flexible):
    file = io.BytesIO()
    FLEXIBLE["fig15"].draw(DEFAULT, flexible["fig15"]).savefig(file, format="svg")
    assert len(file.getvalue()) < 400_000
