"""Checks of trajectories of the user: warnings and errors."""

from __future__ import annotations

import warnings

import gymnasium as gym
import numpy as np
import pytest

from cablebot_gym.trajectories import Reference, SmoothCircle, find_trajectory, trajectory_names

RIGID, FLEXIBLE = "CableBot-Planar-v0", "CableBot-FlexPlanar-v0"
ORDERS = ("position", "velocity", "acceleration", "jerk", "snap")


class Own:
    """A circle, altered by ``change`` of the times and the arrays by name."""

    name, duration, coordinates = "own", 1.0, 2

    def __init__(self, change):
        self._circle, self._change = SmoothCircle(radius=0.2165, center=(0.0, 0.0), duration=self.duration), change

    def __call__(self, times):
        times = np.asarray(times, float)
        arrays = {name: np.array(getattr(self._circle(times), name)) for name in ORDERS}
        self._change(times, arrays)
        return Reference(**arrays)


def scaled(name, factor):
    def change(times, arrays):
        arrays[name] *= factor

    return change


def warnings_of(change, env_id):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        gym.make(env_id, trajectory=Own(change)).reset()
    return [str(one.message) for one in caught if "trajectory 'own'" in str(one.message)]


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_wrong_derivative_warns_where_it_is_used(order):
    """Rigid robots do not use jerk and snap."""
    wrong = f"the {ORDERS[order]} of trajectory 'own' is not the time derivative of its {ORDERS[order - 1]}, first at 0"
    change = scaled(ORDERS[order], 2.0)
    assert warnings_of(change, FLEXIBLE)[0].startswith(wrong)
    assert bool(warnings_of(change, RIGID)) == (order < 3)


def trapezium(times, arrays):
    """Constant acceleration along x up to the middle, then the opposite one: jumps at three instants."""
    late = times > Own.duration / 2
    rest = np.where(late, Own.duration - np.minimum(times, Own.duration), times)
    for values in arrays.values():
        values[:] = 0.0
    half = 0.4 * rest**2
    arrays["position"][..., 0] = np.where(late, 0.2 - half, half)
    arrays["velocity"][..., 0] = 0.8 * rest
    arrays["acceleration"][..., 0] = np.where(times > Own.duration, 0.0, np.where(late, -0.8, 0.8))


def test_jump_of_a_derivative_does_not_warn():
    assert warnings_of(trapezium, RIGID) == warnings_of(trapezium, FLEXIBLE) == []


def test_motion_after_the_duration_warns():
    def continued(times, arrays):
        arrays["position"][..., 0] += 0.05 * times
        arrays["velocity"][..., 0] += 0.05

    assert [message for message in warnings_of(continued, RIGID) if "still moves after its duration" in message]


@pytest.mark.parametrize(("kind", "coordinates"), [("Planar", 2), ("Spatial", 6)])
@pytest.mark.parametrize(("frequency", "duration"), [(20.0, 0.05), (500.0, 1.0)])
def test_motions_of_the_library_do_not_warn(kind, coordinates, frequency, duration):
    for name in trajectory_names(coordinates):
        # The accelerations of loops set their durations, and the motions of chains.
        fields = {} if name.startswith(("loop", "chain")) else {"duration": duration}
        motion = find_trajectory({"name": name, **fields}, coordinates)
        gym.make(f"CableBot-Flex{kind}-v0", trajectory=motion, control_frequency=frequency).reset()


def nan_at(name, time):
    def change(times, arrays):
        arrays[name][times >= time - 1e-9, 1] = np.nan

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (nan_at("acceleration", 0.25), "its acceleration at 0.25 s is not finite"),
        (nan_at("position", 1.1), "not finite after its duration"),
    ],
)
def test_bad_values_of_a_motion_raise(change, message):
    with pytest.raises(ValueError, match=message):
        gym.make(RIGID, trajectory=Own(change)).reset()


@pytest.mark.parametrize(("frequency", "duration"), [(5e6, 1.0), (500.0, 1e4)])
def test_motion_of_too_many_steps_raises(frequency, duration):
    motion = {"name": "dwell-planar", "duration": duration}
    with pytest.raises(ValueError, match=r"at most 1000 s|more than 1,000,000"):
        gym.make(RIGID, trajectory=motion, control_frequency=frequency).reset()
