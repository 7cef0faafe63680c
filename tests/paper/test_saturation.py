"""Figs. 10 to 15: numbers, marks and curves agree with the computed results under the chosen interpretation."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest

from cablebot_baselines.paper.contents import PARTS
from cablebot_baselines.paper.exact import LargestPayload, exact_profile, paper_circle, state_space_profile
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.parts.flexible_saturation import with_friction
from cablebot_baselines.paper.parts.profiles import PayloadSummary, computed_profile, first_saturation
from cablebot_gym.physics import textbook

pytest.importorskip("matplotlib")

DEFAULT = Interpretation()
BY_NAME = {part.name: part for part in PARTS}


def computed(name, interpretation, *, skipped=()):
    return {key: job.compute() for key, job in BY_NAME[name].jobs(interpretation).items() if key not in skipped}


@pytest.fixture(scope="module")
def results():
    """Results of Figs. 10 to 15. Slow evaluations of Fig. 15, which only add numbers, are replaced by that of fl4."""
    planar, spatial, path = (computed(name, DEFAULT) for name in ("fig10", "fig12", "fig14"))
    slow = ("motor_pd", "composite", "task")
    torques = computed("fig15", DEFAULT, skipped=("fl4", "empty", *slow))
    torques |= {name: path["fl4"] for name in (*slow, "fl4")} | {"empty": path["empty"]}
    return {"fig10": planar, "fig11": planar, "fig12": spatial, "fig13": spatial, "fig14": path, "fig15": torques}


@pytest.fixture(scope="module")
def numbers(results):
    return {name: BY_NAME[name].outcome(DEFAULT, found).numbers for name, found in results.items()}


def drawn_panels(name, interpretation, found):
    """Panels of the motors, and all titles."""
    figure = BY_NAME[name].draw(interpretation, found)
    figure.savefig(io.BytesIO(), format="svg")
    titles = " ".join([figure.get_suptitle(), *(part.get_suptitle() for part in figure.subfigs)])
    return [axes for axes in figure.axes if axes.get_title().startswith("motor")], titles


def curves(axes):
    """Upper limit, lower limit and torque."""
    return [line.get_xydata() for line in axes.get_lines()[:3]]


def marked(panels):
    """Motor, time and torque of the only dot."""
    lines = [(motor, line) for motor, axes in enumerate(panels, start=1) for line in axes.get_lines()]
    (mark,) = [(motor, *line.get_xydata()[0]) for motor, line in lines if line.get_marker() == "o"]
    return mark


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fig10", "fig12"])
def test_mark_is_where_a_motor_first_saturates(name, results, numbers):
    arrays = results[name]["paper"].rollout.arrays
    saturated = np.abs(arrays["commanded_action"]) >= 0.999
    step = int(np.argmax(saturated.any(axis=1)))
    motor = int(np.argmax(saturated[step]))
    expected = (motor + 1, arrays["action_time"][step], arrays["torques"][step, motor])
    panels, _ = drawn_panels(name, DEFAULT, results[name])
    assert marked(panels) == pytest.approx(expected)
    assert (numbers[name]["motor"], numbers[name]["time_s"]) == pytest.approx(expected[:2])
    assert numbers[name]["payload_kg"] == pytest.approx(numbers[name]["exact_payload_kg"], rel=0.03)
    assert numbers[name]["motor"] == numbers[name]["exact_motor"] == 2
    for number, (upper, lower, torque) in enumerate(map(curves, panels), 1):
        margin = np.minimum(upper[:, 1] - torque[:, 1], torque[:, 1] - lower[:, 1]).min()
        assert margin >= -1e-9
        assert margin < 0.01 if number == 2 else margin > 0.1


@pytest.mark.slow
def test_both_halves_of_fig_15_mark_their_saturation(results, numbers):
    panels, _ = drawn_panels("fig15", DEFAULT, results["fig15"])
    for half, prefix in ((panels[:6], ""), (panels[6:], "state_space_")):
        expected = numbers["fig15"][f"{prefix}motor"], numbers["fig15"][f"{prefix}time_s"]
        assert marked(half)[:2] == pytest.approx(expected)


def test_line_without_closed_loop_shows_exact_tracking_with_its_limits():
    interpretation = DEFAULT.replace(line="reversed")
    found = computed("fig12", interpretation)
    panels, titles = drawn_panels("fig12", interpretation, found)
    assert "exact tracking, no closed loop" in titles
    assert not BY_NAME["fig12"].outcome(interpretation, found).numbers["simulated"]
    robot = interpretation.spatial("payload")
    for motor, (upper, lower, _) in enumerate(map(curves, panels)):
        motion = paper_circle(robot)(upper[:, 0])
        speed = -textbook.pulley_speed(robot, motion.position, motion.velocity)[:, motor]
        np.testing.assert_allclose(upper[:, 1], 10.0 - robot.speed_slope[motor] * speed, atol=1e-9)
        np.testing.assert_allclose(upper[:, 1] - lower[:, 1], 20.0)
    for name in ("fig11", "fig14"):
        found = computed(name, interpretation)
        assert BY_NAME[name].outcome(interpretation, found).numbers["peak_error_mm"] is None
        assert "by assumption" in drawn_panels(name, interpretation, found)[1]


@pytest.mark.slow
def test_robot_that_fails_unloaded_is_reported():
    interpretation = DEFAULT.replace(minimum_tension=0.0)
    found = computed("fig10", interpretation)
    for name in ("fig10", "fig11"):
        outcome = BY_NAME[name].outcome(interpretation, found).numbers
        assert outcome["payload_kg"] is None
        titles = drawn_panels(name, interpretation, found)[1]
        assert all(text in titles for text in ("fails unloaded", "slack", "the episode ends at"))
    assert outcome["within"] is False  # the episode is not complete


def test_mark_without_payload_is_the_first_saturation_unloaded():
    interpretation = DEFAULT.replace(stiffness="2")
    profile = computed_profile(state_space_profile(interpretation, interpretation.flexible("payload"), 0.0))
    fraction = np.abs(2 * profile.torques - profile.upper - profile.lower) / (profile.upper - profile.lower)
    mark = first_saturation(profile, PayloadSummary.computed(LargestPayload(payload=-0.2, motor=3, time=0.9)))
    assert mark.step == np.flatnonzero(fraction.max(axis=1) >= 1)[0]
    assert mark.motor == np.argmax(fraction[mark.step])


def test_mark_at_the_jump_is_on_the_side_of_the_larger_torque():
    profile = computed_profile(exact_profile(DEFAULT, DEFAULT.spatial("payload"), 1.8))
    mark = first_saturation(profile, PayloadSummary(payload=1.8, motor=3, time=0.5, violation="motor 3"))
    sides = np.flatnonzero(np.abs(profile.times - 0.5) < 1e-6)
    assert len(sides) == 2
    assert profile.torques[mark.step, 2] == profile.torques[sides, 2].max()


@pytest.mark.parametrize("payload", [-0.5, -math.inf, math.inf])
def test_infeasible_or_infinite_payload_is_none(payload):
    summary = PayloadSummary.computed(LargestPayload(payload=payload, motor=2, time=0.5))
    found = summary.numbers(DEFAULT, DEFAULT.planar)
    assert found["payload_kg"] is found["counted_kg"] is found["total_mass_kg"] is found["time_s"] is None
    assert "fails unloaded" in summary.sentence(DEFAULT.planar)


def test_counted_payload_includes_the_platform_if_the_payload_is_total():
    summary, robot = PayloadSummary(payload=1.5, motor=2, time=0.5, violation="motor 2"), DEFAULT.spatial("payload")
    assert summary.numbers(DEFAULT, robot)["counted_kg"] == 1.5
    total = summary.numbers(DEFAULT.replace(payload="total"), robot)
    assert (total["payload_kg"], total["counted_kg"], total["total_mass_kg"]) == (1.5, 11.5, 11.5)


@pytest.mark.slow
def test_errors_and_curves_are_those_of_the_drawn_episodes(results, numbers):
    for name, result in (("fig11", "paper"), ("fig13", "paper"), ("fig14", "fl4")):
        peak = 1e3 * results[name][result].rollout.arrays["tracking_error"].max()
        assert peak * (1 - 1e-12) <= numbers[name]["peak_error_mm"] <= 1.01 * peak + 1e-3
        assert (numbers[name]["within"], numbers[name]["bound_mm"]) == (True, 10.0)
    path = BY_NAME["fig13"].draw(DEFAULT, results["fig13"]).axes[0]
    drawn = [line.get_xydata().tolist() for line in path.get_lines()]
    for key in ("paper", "task", "payload_unknown"):
        assert results["fig13"][key].rollout.arrays["pose"][:, :2].tolist() in drawn


@pytest.mark.slow
def test_eq_22_leaves_the_tube_without_motor_friction_only(results, numbers):
    found = numbers["fig14"]
    assert not found["eq22_within"]
    assert found["eq22_leaves_s"] < 0.6
    assert found["eq22_friction_within"]
    assert found["eq22_friction_leaves_s"] is None
    assert numbers["fig15"]["eq22_payload_kg"] is None
    axes = BY_NAME["fig14"].draw(DEFAULT, results["fig14"]).axes
    arrays = results["fig14"]["eq22"].arrays
    for column, one in enumerate(axes[2:], start=2):
        error = 1e3 * (arrays["pose"] - arrays["reference_pose"])[:, column]
        np.testing.assert_allclose(one.get_lines()[1].get_ydata(), error, atol=1e-9)
    robot = DEFAULT.flexible("payload")
    changed = with_friction(DEFAULT, robot)
    assert changed.motor_damping.tolist() == DEFAULT.spatial("payload").damping.tolist()
    assert changed.damping.tolist() == robot.damping.tolist()
