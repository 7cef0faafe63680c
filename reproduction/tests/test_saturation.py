"""Figs. 10 to 15: numbers, marks and curves agree with the computed results under the chosen
interpretation."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablebot_gym.physics import textbook
from cablebot_reproduction.contents import PARTS
from cablebot_reproduction.exact import (
    LargestPayload,
    exact_profile,
    paper_circle,
    state_space_profile,
)
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.parts.profiles import (
    PayloadSummary,
    computed_profile,
    first_saturation,
)

pytest.importorskip("matplotlib")

DEFAULT = Interpretation()
BY_NAME = {figure.name: figure for figure in PARTS}


def compute(name, interpretation):
    jobs = BY_NAME[name].jobs(interpretation)
    return {key: job.compute() for key, job in jobs.items()}


@pytest.fixture(scope="module")
def results():
    return {name: compute(name, DEFAULT) for name in ("fig10", "fig12", "fig14")}


def numbers(name, interpretation, results):
    return BY_NAME[name].outcome(interpretation, results).numbers


def draw(name, interpretation, results):
    """Panels of the motors, and the title."""
    figure = BY_NAME[name].draw(interpretation, results)
    panels = [axes for axes in figure.axes if axes.get_title().startswith("motor")]
    return panels, figure.get_suptitle()


def marked(panels):
    """Motor, time and torque of the only dot."""
    dots = []
    for motor, axes in enumerate(panels, start=1):
        for line in axes.get_lines():
            if line.get_marker() == "o":
                dots.append((motor, *line.get_xydata()[0]))
    (dot,) = dots
    return dot


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fig10", "fig12"])
def test_mark_is_where_a_motor_first_saturates(name, results):
    arrays = results[name]["paper"].rollout.arrays
    saturated = np.abs(arrays["commanded_action"]) >= 0.999
    step = int(np.argmax(saturated.any(axis=1)))
    motor = int(np.argmax(saturated[step]))
    panels, _ = draw(name, DEFAULT, results[name])
    expected = (motor + 1, arrays["action_time"][step], arrays["torques"][step, motor])
    assert marked(panels) == pytest.approx(expected)
    shown = numbers(name, DEFAULT, results[name])
    assert (shown["motor"], shown["time_s"]) == pytest.approx(expected[:2])
    assert shown["payload_kg"] == pytest.approx(shown["exact_payload_kg"], rel=0.03)
    assert shown["motor"] == shown["exact_motor"] == 2


def test_line_without_closed_loop_shows_exact_tracking():
    interpretation = Interpretation(line="reversed")
    computed = compute("fig12", interpretation)
    panels, title = draw("fig12", interpretation, computed)
    assert "exact tracking, no closed loop" in title
    assert not numbers("fig12", interpretation, computed)["simulated"]
    robot = interpretation.spatial("payload")
    for motor, axes in enumerate(panels):
        upper, lower = (line.get_xydata() for line in axes.get_lines()[:2])
        motion = paper_circle(robot)(upper[:, 0])
        speed = -textbook.pulley_speed(robot, motion.position, motion.velocity)[:, motor]
        assert_allclose(upper[:, 1], 10.0 - robot.speed_slope[motor] * speed, atol=1e-9)
        assert_allclose(upper[:, 1] - lower[:, 1], 20.0)


@pytest.mark.parametrize("name", ["fig11", "fig14"])
def test_path_without_closed_loop_is_the_reference(name):
    interpretation = Interpretation(line="reversed")
    computed = compute(name, interpretation)
    assert numbers(name, interpretation, computed)["peak_error_mm"] is None
    assert "by assumption" in draw(name, interpretation, computed)[1]


@pytest.mark.slow
def test_robot_that_fails_unloaded_is_reported():
    interpretation = Interpretation(minimum_tension=0.0)
    computed = compute("fig10", interpretation)
    for name in ("fig10", "fig11"):
        assert numbers(name, interpretation, computed)["payload_kg"] is None
        title = draw(name, interpretation, computed)[1]
        for text in ("fails unloaded", "slack", "the episode ends at"):
            assert text in title
    # the episode is not complete
    assert numbers("fig11", interpretation, computed)["within"] is False


def test_mark_without_payload_is_the_first_saturation_unloaded():
    interpretation = Interpretation(stiffness="2")
    profile = computed_profile(
        state_space_profile(interpretation, interpretation.flexible("payload"), 0.0)
    )
    action = np.abs(2 * profile.torques - profile.upper - profile.lower) / (
        profile.upper - profile.lower
    )
    mark = first_saturation(
        profile, PayloadSummary.computed(LargestPayload(payload=-0.2, motor=3, time=0.9))
    )
    assert mark.step == np.flatnonzero(action.max(axis=1) >= 1)[0]
    assert mark.motor == np.argmax(action[mark.step])


def test_mark_at_the_jump_is_on_the_side_of_the_larger_torque():
    profile = computed_profile(exact_profile(DEFAULT, DEFAULT.spatial("payload"), 1.8))
    mark = first_saturation(
        profile, PayloadSummary(payload=1.8, motor=3, time=0.5, violation="motor 3")
    )
    sides = np.flatnonzero(np.abs(profile.times - 0.5) < 1e-6)
    assert len(sides) == 2
    assert profile.torques[mark.step, 2] == profile.torques[sides, 2].max()


@pytest.mark.parametrize("payload", [-0.5, -math.inf, math.inf])
def test_infeasible_or_infinite_payload_is_none(payload):
    summary = PayloadSummary.computed(LargestPayload(payload=payload, motor=2, time=0.5))
    for name in ("payload_kg", "counted_kg", "total_mass_kg", "time_s"):
        assert summary.numbers(DEFAULT, DEFAULT.planar)[name] is None
    assert "fails unloaded" in summary.sentence(DEFAULT.planar)


def test_counted_payload_includes_the_platform_if_total():
    summary = PayloadSummary(payload=1.5, motor=2, time=0.5, violation="motor 2")
    shown = summary.numbers(Interpretation(payload="total"), DEFAULT.spatial("payload"))
    assert (shown["payload_kg"], shown["counted_kg"]) == (1.5, 11.5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "source", "loop"), [("fig11", "fig10", "paper"), ("fig14", "fig14", "fl4")]
)
def test_errors_are_those_of_the_drawn_episodes(results, name, source, loop):
    peak = 1e3 * results[source][loop].rollout.arrays["tracking_error"].max()
    shown = numbers(name, DEFAULT, results[source])
    assert peak * (1 - 1e-12) <= shown["peak_error_mm"] <= 1.01 * peak + 1e-3
    assert (shown["within"], shown["bound_mm"]) == (True, 10.0)
