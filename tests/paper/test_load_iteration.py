"""Load iteration of the paper: the corrected form finds the exact payload, the printed form half of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from cablebot_baselines.paper.load_iteration import iterate_load, load_coefficient
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.robots import PLANAR, RPM, SPATIAL, Robot
from cablebot_gym.trajectories import TRAJECTORIES, Trajectory, find_trajectory, trajectory_names

NAMES = [name for name in (*trajectory_names("planar"), *trajectory_names("spatial")) if name != "dwell-planar"]
TOO_FAST = find_trajectory({"name": "smooth-circle-spatial", "duration": 1.0, "dwell": 0}, 6)
"""Motor 2 is overloaded by the platform alone, by 1.26 kg."""
CIRCLE = find_trajectory("paper-spatial", 6)


def exact(robot: Robot, trajectory: Trajectory, **keywords: Any) -> Any:
    return exact_payload(robot, trajectory, frequency=500.0, **keywords)


@pytest.mark.parametrize(
    ("full", "empty", "corrected", "printed"),
    [
        (3.0, 1.0, 2.0, 1.0),  # (5 - 1)/2; the printed (5 - 3)/2
        (-1.0, 1.0, 3.0, 2.0),  # (-5 - 1)/-2; the printed (-5 + 1)/-2
        (1.0, 2.0, 7.0, 4.0),  # positive, but falling to -5: (-5 - 2)/-1; the printed |(5 - 1)/-1|
        (-1.0, -2.0, 7.0, 4.0),  # negative, but rising to 5
        (7.0, 6.0, -1.0, 2.0),  # overloaded without load: (5 - 6)/1; the printed |(5 - 7)/1|
        (2.0, 2.0, math.inf, math.inf),  # does not depend on the load
        (5.0, 5.0, math.inf, math.inf),
    ],
)
def test_coefficient_of_both_forms(full: float, empty: float, corrected: float, printed: float) -> None:
    """Planar motors of 5 N·m."""
    for form, expected in ((True, corrected), (False, printed)):
        motors = load_coefficient(PLANAR, [full, 1.0, 1.0], [empty, 1.0, 1.0], np.zeros(3), corrected=form)
        np.testing.assert_allclose(motors, [expected, np.inf, np.inf])


@pytest.mark.parametrize("corrected", [True, False])
def test_coefficient_uses_the_motor_speed(corrected: bool) -> None:
    """At 200 rpm of 1000 the line has fallen by a fifth of 5 N·m."""
    speed = np.array([200.0, -200.0, 0.0]) * RPM
    motors = load_coefficient(PLANAR, np.full(3, 2.0), np.ones(3), speed, corrected=corrected)
    used = 1.0 if corrected else 2.0
    np.testing.assert_allclose(motors, [4 - used, 6 - used, 5 - used])


@pytest.mark.parametrize("name", NAMES)
def test_corrected_form_converges_to_the_exact_payload_and_the_printed_form_to_half(name: str) -> None:
    trajectory = TRAJECTORIES[name]()
    robot = PLANAR if name.endswith("planar") else SPATIAL
    for minimum, guess, line_speed in ((0.0, 0.1, 1.0), (5.0, 50.0, -1.0)):
        bound = exact(robot, trajectory, minimum_tension=minimum, line_speed=line_speed)
        keywords: dict[str, Any] = {"guess": guess, "minimum_tension": minimum, "line_speed": line_speed}
        found = iterate_load(robot, trajectory, corrected=True, **keywords)
        assert found.converged
        assert found.payload == pytest.approx(bound.payload, abs=2e-6)
        assert found.loads[-1] == pytest.approx(bound.payload, abs=2e-6)
        if not name.startswith(("dwell", "chain")):  # where all motors saturate together, or at two times
            assert (found.motor, found.time) == (bound.motor, bound.time)
        if minimum == 0.0:
            printed = iterate_load(robot, trajectory, corrected=False, **keywords)
            assert printed.converged
            assert printed.payload == pytest.approx(bound.payload / 2, abs=2e-6)


def test_affine_torque_needs_one_guess_and_torque_with_kinks_several() -> None:
    found = iterate_load(SPATIAL, CIRCLE, guess=5.0, corrected=True, max_iterations=1)
    assert found.payload == pytest.approx(exact(SPATIAL, CIRCLE).payload, abs=1e-9)
    assert (found.loads, found.converged) == ((5.0,), False)
    line = find_trajectory("line-planar", 2)
    kinked = iterate_load(PLANAR, line, guess=5.0, corrected=True, minimum_tension=5.0, max_iterations=1)
    assert abs(kinked.payload - exact(PLANAR, line, minimum_tension=5.0).payload) > 0.1


@pytest.mark.parametrize("corrected", [True, False])
def test_next_guess_is_the_average_until_the_tolerance(corrected: bool) -> None:
    one, three = (
        iterate_load(SPATIAL, CIRCLE, guess=5.0, corrected=corrected, max_iterations=count) for count in (1, 3)
    )
    assert len(three.loads) == 3
    assert three.loads[:2] == (5.0, pytest.approx((5.0 + one.payload) / 2))
    assert not three.converged
    for tolerance in (0.1, 1e-9):
        found = iterate_load(SPATIAL, CIRCLE, guess=5.0, corrected=corrected, tolerance=tolerance)
        assert found.converged
        assert abs(found.loads[-1] - found.payload) <= tolerance
        assert abs(found.loads[-1] - found.payload) > 1e-9 or tolerance < 0.1 or not corrected


def test_overload_by_the_platform_is_a_negative_payload_in_the_corrected_form_only() -> None:
    bound = exact(SPATIAL, TOO_FAST)
    assert bound.payload == pytest.approx(-1.258, abs=1e-3)
    for guess in (5.0, -bound.payload):  # the second guess of the latter is zero
        found = iterate_load(SPATIAL, TOO_FAST, guess=guess, corrected=True)
        assert found.converged
        assert found.payload == pytest.approx(bound.payload, abs=2e-6)
        assert (found.motor, found.time) == (bound.motor, bound.time)
    printed = iterate_load(SPATIAL, TOO_FAST, guess=5.0, corrected=False)
    assert printed.converged
    assert printed.payload > 0  # because of abs()


def test_motion_without_any_payload_does_not_converge() -> None:
    trajectory = find_trajectory({"name": "smooth-circle-spatial", "duration": 0.3, "dwell": 0}, 6)
    found = iterate_load(SPATIAL, trajectory, guess=5.0, corrected=True)
    assert exact(SPATIAL, trajectory).payload == -math.inf
    assert not found.converged
    assert min(found.loads) > -SPATIAL.mass


def test_motors_without_load_have_no_limit() -> None:
    found = iterate_load(PLANAR, find_trajectory("dwell-planar", 2), guess=2.0, corrected=True)
    assert (found.payload, found.converged, found.motor, found.time) == (math.inf, True, None, None)


@pytest.mark.parametrize("name", ["guess", "tolerance", "max_iterations", "frequency"])
def test_zero_is_rejected(name: str) -> None:
    arguments: dict[str, Any] = {"guess": 2.0, "corrected": True} | {name: 0}
    with pytest.raises(ValueError, match=name):
        iterate_load(PLANAR, find_trajectory("paper-planar", 2), **arguments)
