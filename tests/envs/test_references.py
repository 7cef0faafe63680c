"""Checks of trajectories of the user: warnings and errors."""

import warnings

import numpy as np
import pytest
from oracles.episodes import FLEX_PLANAR, PLANAR, make

from cablebot_gym.motions import ORDERS, Reference, SmoothCircle


class Altered:
    """A circle, altered by ``change`` of the times and the arrays by name."""

    name = "altered"
    duration = 1.0
    coordinates = 2

    def __init__(self, change):
        self._circle = SmoothCircle(radius=0.2165, center=(0.0, 0.0), duration=self.duration)
        self._change = change

    def __call__(self, times):
        times = np.asarray(times, float)
        arrays = {name: np.array(getattr(self._circle(times), name)) for name in ORDERS}
        self._change(times, arrays)
        return Reference(**arrays)


def warnings_of(change, env_id):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make(env_id, trajectory=Altered(change)).reset()
    texts = [str(warning.message) for warning in caught]
    return [text for text in texts if "trajectory 'altered'" in text]


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_wrong_derivative_warns_where_it_is_used(order):
    """Rigid robots do not use jerk and snap."""

    def doubled(times, arrays):
        arrays[ORDERS[order]] *= 2.0

    wrong = f"the {ORDERS[order]} of trajectory 'altered' is not the time derivative of its {ORDERS[order - 1]}, "
    assert warnings_of(doubled, FLEX_PLANAR)[0].startswith(f"{wrong}first at 0")
    assert bool(warnings_of(doubled, PLANAR)) == (order < 3)


def test_motion_after_the_duration_warns():
    def continued(times, arrays):
        arrays["position"][..., 0] += 0.05 * times
        arrays["velocity"][..., 0] += 0.05

    assert "still moves after its duration" in " ".join(warnings_of(continued, PLANAR))


@pytest.mark.parametrize(
    ("order", "time", "message"),
    [
        ("acceleration", 0.25, "its acceleration at 0.25 s is not finite"),
        ("position", 1.1, "not finite after its duration"),
    ],
)
def test_values_that_are_not_finite_raise(order, time, message):
    def spoilt(times, arrays):
        arrays[order][times >= time - 1e-9, 1] = np.nan

    with pytest.raises(ValueError, match=message):
        make(PLANAR, trajectory=Altered(spoilt)).reset()
