"""The paper's load iteration: what the printed form does, and that the corrected one finds the exact payload."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablebot_baselines.paper.load_iteration import iterate_load, load_coefficient
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.robots import PLANAR, RPM, SPATIAL, Robot
from cablebot_gym.trajectories import TRAJECTORIES, find_trajectory

NAMES = [name for name in TRAJECTORIES if name != "dwell-planar"]
SPATIAL_NAMES = [name for name in NAMES if name.endswith("spatial")]
TOO_FAST = {"name": "circle-spatial", "duration": 1.0}
"""Motor 2 is overloaded by the platform alone, by 1.26 kg."""


def robot_for(name: str) -> Robot:
    return PLANAR if name.endswith("planar") else SPATIAL


# --- one guess, by hand: planar motors of 5 N·m -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("full", "empty", "corrected", "printed"),
    [
        (3.0, 1.0, 2.0, 1.0),  # (5 - 1)/2; the printed (5 - 3)/2
        (-1.0, 1.0, 3.0, 2.0),  # (-5 - 1)/-2; the printed (-5 + 1)/-2
        (1.0, 2.0, 7.0, 4.0),  # positive, but falling to -5: (-5 - 2)/-1; the printed |(5 - 1)/-1|
        (-1.0, -2.0, 7.0, 4.0),  # negative, but rising to 5
        (7.0, 6.0, -1.0, 2.0),  # overloaded without load: (5 - 6)/1; the printed |(5 - 7)/1|
        (2.0, 2.0, math.inf, math.inf),  # does not depend on the load
        (9.0, 9.0, math.inf, math.inf),
        (5.0, 5.0, math.inf, math.inf),
    ],
)
def test_coefficient_does_not_mix_the_two_forms(full: float, empty: float, corrected: float, printed: float) -> None:
    for form, expected in ((True, corrected), (False, printed)):
        motors = load_coefficient(PLANAR, [full, 1.0, 1.0], [empty, 1.0, 1.0], np.zeros(3), corrected=form)
        np.testing.assert_allclose(motors, [expected, np.inf, np.inf])


@pytest.mark.parametrize("corrected", [True, False])
def test_speed_of_the_coefficient_is_not_the_cable_speed_or_ignored(corrected: bool) -> None:
    # At 200 rpm of 1000 the line has fallen by a fifth of 5 N·m.
    speed = np.array([200.0, -200.0, 0.0]) * RPM
    motors = load_coefficient(PLANAR, np.full(3, 2.0), np.ones(3), speed, corrected=corrected)
    used = 1.0 if corrected else 2.0
    np.testing.assert_allclose(motors, [4 - used, 6 - used, 5 - used])


# --- the iteration ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("guess", [0.1, 2.0, 5.0, 50.0])
@pytest.mark.parametrize("name", SPATIAL_NAMES)
def test_corrected_form_needs_no_second_guess_where_torque_is_affine(name: str, guess: float) -> None:
    trajectory = find_trajectory(name, 6)
    found = iterate_load(SPATIAL, trajectory, guess=guess, corrected=True, max_iterations=1)
    assert found.payload == pytest.approx(exact_payload(SPATIAL, trajectory, frequency=500.0).payload, abs=1e-9)
    assert (found.loads, found.converged) == ((guess,), False)


@pytest.mark.parametrize("guess", [0.1, 5.0, 50.0])
@pytest.mark.parametrize("minimum", [0.0, 5.0])
@pytest.mark.parametrize("name", NAMES)
def test_corrected_form_does_not_converge_to_another_payload(name: str, minimum: float, guess: float) -> None:
    robot, trajectory = robot_for(name), TRAJECTORIES[name]()
    exact = exact_payload(robot, trajectory, minimum_tension=minimum, frequency=500.0)
    found = iterate_load(robot, trajectory, guess=guess, corrected=True, minimum_tension=minimum)
    assert found.converged
    assert found.payload == pytest.approx(exact.payload, abs=2e-6)
    assert found.loads[-1] == pytest.approx(exact.payload, abs=2e-6)
    if not name.startswith("dwell"):  # where all motors saturate together
        assert (found.motor, found.time) == (exact.motor, exact.time)


@pytest.mark.parametrize("guess", [0.1, 2.0, 5.0, 50.0])
@pytest.mark.parametrize("name", NAMES)
def test_printed_form_does_not_give_more_than_half_of_the_true_load(name: str, guess: float) -> None:
    robot, trajectory = robot_for(name), TRAJECTORIES[name]()
    found = iterate_load(robot, trajectory, guess=guess, corrected=False)
    assert found.converged
    assert found.payload == pytest.approx(exact_payload(robot, trajectory, frequency=500.0).payload / 2, abs=2e-6)


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL], ids=lambda robot: str(robot.name))
def test_true_load_is_no_fixed_point_of_the_printed_form(robot: Robot) -> None:
    trajectory = find_trajectory(f"paper-{robot.name}", robot.coordinates)
    true = exact_payload(robot, trajectory, frequency=500.0).payload
    found = iterate_load(robot, trajectory, guess=true, corrected=False, max_iterations=1)
    assert found.payload == pytest.approx(0, abs=1e-9)  # no torque left, so no load
    assert not found.converged


def test_torque_with_kinks_is_not_taken_for_affine() -> None:
    trajectory = find_trajectory("line-planar", 2)
    arguments: dict[str, Any] = {"guess": 5.0, "corrected": True, "minimum_tension": 5.0}
    exact = exact_payload(PLANAR, trajectory, minimum_tension=5.0, frequency=500.0).payload
    assert abs(iterate_load(PLANAR, trajectory, max_iterations=1, **arguments).payload - exact) > 0.1
    assert iterate_load(PLANAR, trajectory, **arguments).payload == pytest.approx(exact, abs=2e-6)


@pytest.mark.parametrize("corrected", [True, False])
def test_next_guess_is_not_anything_but_the_average(corrected: bool) -> None:
    trajectory = find_trajectory("paper-spatial", 6)
    one, *_, three = (
        iterate_load(SPATIAL, trajectory, guess=5.0, corrected=corrected, max_iterations=count) for count in (1, 2, 3)
    )
    assert one.loads == (5.0,)
    assert len(three.loads) == 3
    assert three.loads[:2] == (5.0, pytest.approx((5.0 + one.payload) / 2))
    assert not three.converged


def test_tolerance_is_not_without_effect() -> None:
    trajectory = find_trajectory("paper-spatial", 6)
    coarse, fine = (
        iterate_load(SPATIAL, trajectory, guess=5.0, corrected=True, tolerance=tolerance) for tolerance in (0.1, 1e-9)
    )
    assert coarse.converged
    assert fine.converged
    assert 1e-9 < abs(coarse.loads[-1] - coarse.payload) <= 0.1
    assert abs(fine.loads[-1] - fine.payload) <= 1e-9


# --- where the printed form misleads ------------------------------------------------------------------------------


def test_overload_by_the_platform_is_not_hidden_by_the_corrected_form() -> None:
    trajectory = find_trajectory(TOO_FAST, 6)
    exact = exact_payload(SPATIAL, trajectory, frequency=500.0)
    assert exact.payload == pytest.approx(-1.258, abs=1e-3)
    corrected = iterate_load(SPATIAL, trajectory, guess=5.0, corrected=True)
    assert corrected.converged
    assert corrected.payload == pytest.approx(exact.payload, abs=1e-9)
    assert (corrected.motor, corrected.time) == (exact.motor, exact.time)
    printed = iterate_load(SPATIAL, trajectory, guess=5.0, corrected=False)
    assert printed.converged
    assert printed.payload > 0  # abs() hides it


def test_guess_that_passes_through_zero_does_not_divide_by_it() -> None:
    trajectory = find_trajectory(TOO_FAST, 6)
    exact = exact_payload(SPATIAL, trajectory, frequency=500.0).payload
    found = iterate_load(SPATIAL, trajectory, guess=-exact, corrected=True)
    assert found.loads[1] == pytest.approx(0, abs=1e-9)
    assert found.loads[2] == pytest.approx(exact / 2, abs=1e-6)
    assert found.converged
    assert found.payload == pytest.approx(exact, abs=2e-6)


@settings(max_examples=30, deadline=None)
@given(guess=st.floats(1e-3, 100.0), duration=st.floats(1.0, 3.0))
def test_guess_does_not_change_the_answer(guess: float, duration: float) -> None:
    trajectory = find_trajectory({"name": "circle-spatial", "duration": duration}, 6)
    found = iterate_load(SPATIAL, trajectory, guess=guess, corrected=True, frequency=100.0)
    assert found.converged
    assert found.payload == pytest.approx(exact_payload(SPATIAL, trajectory, frequency=100.0).payload, abs=2e-6)


def test_motion_without_any_payload_does_not_converge() -> None:
    trajectory = find_trajectory({"name": "circle-spatial", "duration": 0.3}, 6)
    found = iterate_load(SPATIAL, trajectory, guess=5.0, corrected=True)
    assert exact_payload(SPATIAL, trajectory, frequency=500.0).payload == -math.inf
    assert not found.converged
    assert min(found.loads) > -SPATIAL.mass


@pytest.mark.parametrize("corrected", [True, False])
def test_motors_that_do_not_feel_the_load_do_not_divide_by_zero(corrected: bool) -> None:
    found = iterate_load(PLANAR, find_trajectory("dwell-planar", 2), guess=2.0, corrected=corrected)
    assert (found.payload, found.converged, found.motor, found.time) == (math.inf, True, None, None)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"guess": 0.0}, "guess"),
        ({"guess": -1.0}, "guess"),
        ({"guess": math.nan}, "guess"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"max_iterations": 0}, "max_iterations"),
        ({"frequency": 0.0}, "frequency"),
    ],
)
def test_invalid_argument_is_not_accepted(changes: dict[str, Any], named: str) -> None:
    arguments: dict[str, Any] = {"guess": 2.0, "corrected": True} | changes
    with pytest.raises(ValueError, match=named):
        iterate_load(PLANAR, find_trajectory("paper-planar", 2), **arguments)
