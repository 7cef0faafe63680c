"""Load iteration of the paper: the corrected form finds the exact payload, the printed form half of
it; tests/errata has the coefficients of single motors."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_gym.trajectories import TRAJECTORIES, find_trajectory, trajectory_names
from cablebot_reproduction.load_iteration import iterate_load

MOVING = {name for kind in ("planar", "spatial") for name in trajectory_names(kind)} - {
    "dwell-planar"
}
CIRCLE = find_trajectory("paper-spatial", 6)
TOO_FAST = find_trajectory({"name": "smooth-circle-spatial", "duration": 1.0, "dwell": 0}, 6)
"""Motor 2 is overloaded by the platform alone, by 1.26 kg."""


@pytest.mark.parametrize("name", sorted(MOVING))
def test_corrected_form_finds_the_payload_and_printed_form_half(name):
    trajectory = TRAJECTORIES[name]()
    robot = PLANAR if name.endswith("planar") else SPATIAL
    for minimum, guess, line_speed in ((0.0, 0.1, 1.0), (5.0, 50.0, -1.0)):
        options = {"minimum_tension": minimum, "line_speed": line_speed}
        bound = exact_payload(robot, trajectory, frequency=500.0, **options)
        corrected = iterate_load(robot, trajectory, guess=guess, corrected=True, **options)
        assert corrected.converged
        assert corrected.payload == pytest.approx(bound.payload, abs=2e-6)
        assert corrected.loads[-1] == pytest.approx(bound.payload, abs=2e-6)
        # where all motors saturate together, or at two times
        if not name.startswith(("dwell", "chain")):
            assert (corrected.motor, corrected.time) == (bound.motor, bound.time)
        if minimum == 0.0:
            printed = iterate_load(robot, trajectory, guess=guess, corrected=False, **options)
            assert printed.converged
            assert printed.payload == pytest.approx(bound.payload / 2, abs=2e-6)


def test_next_guess_is_the_average_of_guess_and_payload():
    """The corrected form has the payload of an affine torque from the first guess on."""
    payload = exact_payload(SPATIAL, CIRCLE, frequency=500.0).payload
    corrected = iterate_load(SPATIAL, CIRCLE, guess=5.0, corrected=True)
    distances = np.array(corrected.loads) - payload
    assert_allclose(distances[1:], distances[:-1] / 2, atol=1e-9)
    assert abs(distances[-1]) <= 1e-6 < abs(distances[-2])


def test_torque_with_kinks_needs_several_guesses():
    line = find_trajectory("line-planar", 2)
    iteration = iterate_load(PLANAR, line, guess=5.0, corrected=True, minimum_tension=5.0)
    assert abs(2 * iteration.loads[1] - 5.0 - iteration.payload) > 0.1


@pytest.mark.parametrize("guess", [5.0, 1.258])
def test_overload_by_the_platform_is_a_negative_payload(guess):
    bound = exact_payload(SPATIAL, TOO_FAST, frequency=500.0)
    assert bound.payload == pytest.approx(-1.258, abs=1e-3)
    corrected = iterate_load(SPATIAL, TOO_FAST, guess=guess, corrected=True)
    assert corrected.converged
    assert corrected.payload == pytest.approx(bound.payload, abs=2e-6)
    assert (corrected.motor, corrected.time) == (bound.motor, bound.time)
    printed = iterate_load(SPATIAL, TOO_FAST, guess=guess, corrected=False)
    assert printed.payload > 0  # because of abs()


def test_motion_without_any_payload_does_not_converge():
    trajectory = find_trajectory({"name": "smooth-circle-spatial", "duration": 0.3, "dwell": 0}, 6)
    iteration = iterate_load(SPATIAL, trajectory, guess=5.0, corrected=True)
    assert exact_payload(SPATIAL, trajectory, frequency=500.0).payload == -math.inf
    assert not iteration.converged
    assert min(iteration.loads) > -SPATIAL.mass


def test_motors_without_load_have_no_limit():
    iteration = iterate_load(PLANAR, find_trajectory("dwell-planar", 2), guess=2.0, corrected=True)
    assert iteration.payload == math.inf
    assert iteration.converged
    assert iteration.motor is iteration.time is None


def test_zero_is_rejected():
    with pytest.raises(ValueError, match="guess"):
        iterate_load(SPATIAL, CIRCLE, guess=0.0, corrected=True)
