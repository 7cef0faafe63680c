"""Motions of one's own: what an environment warns of, and what it refuses."""

from __future__ import annotations

import warnings
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from cablebot_gym.trajectories import Reference, find_trajectory, trajectory_names

RIGID, FLEXIBLE = "CableBot-Planar-v0", "CableBot-FlexPlanar-v0"
ORDERS = ("position", "velocity", "acceleration", "jerk", "snap")


class Own:
    """The library's circle, spoilt: ``spoil`` gets the times and the arrays by name, and changes these."""

    name, duration, coordinates = "own", 1.0, 2

    def __init__(self, spoil):
        self._right, self._spoil = find_trajectory({"name": "circle-planar", "duration": self.duration}, 2), spoil

    def __call__(self, times):
        times = np.asarray(times, float)
        arrays = {name: np.array(getattr(self._right(times), name)) for name in ORDERS}
        self._spoil(times, arrays)
        return Reference(**arrays)


def scaled(name, factor):
    def spoil(times, arrays):
        arrays[name] *= factor

    return spoil


def told(spoil, env_id):
    """The warnings about a motion."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        gym.make(env_id, trajectory=Own(spoil)).reset()
    return [str(one.message) for one in caught if "trajectory 'own'" in str(one.message)]


@pytest.mark.parametrize("env_id", [RIGID, FLEXIBLE])
@pytest.mark.parametrize("order", [1, 2])
def test_a_derivative_with_a_forgotten_factor_does_not_pass_in_silence(env_id, order):
    messages = told(scaled(ORDERS[order], 2.0), env_id)
    named = f"the {ORDERS[order]} of trajectory 'own' is not the time derivative of its {ORDERS[order - 1]}, first at 0"
    assert messages[0].startswith(named)


@pytest.mark.parametrize("name", ["jerk", "snap"])
def test_jerk_and_snap_are_looked_at_where_they_are_used(name):
    assert told(scaled(name, 0.0), RIGID) == []
    assert any(message.startswith(f"the {name} of") for message in told(scaled(name, 0.0), FLEXIBLE))


def trapezium(times, arrays):
    """Along x by constant acceleration up to the middle and the opposite one from there: jumps at three instants."""
    late = times > Own.duration / 2
    from_end = Own.duration - np.minimum(times, Own.duration)
    rest = np.where(late, from_end, times)
    for values in arrays.values():
        values[:] = 0.0
    half = 0.4 * rest**2
    arrays["position"][..., 0] = np.where(late, 0.2 - half, half)
    arrays["velocity"][..., 0] = 0.8 * rest
    arrays["acceleration"][..., 0] = np.where(times > Own.duration, 0.0, np.where(late, -0.8, 0.8))


@pytest.mark.parametrize("env_id", [RIGID, FLEXIBLE])
def test_a_jump_of_a_derivative_is_not_taken_for_a_wrong_one(env_id):
    assert told(trapezium, env_id) == []


def test_a_motion_without_an_end_does_not_pass_in_silence():
    def on_and_on(times, arrays):
        arrays["position"][..., 0] += 0.05 * times
        arrays["velocity"][..., 0] += 0.05

    assert told(on_and_on, RIGID) == [
        "trajectory 'own' still moves after its duration of 1 s: return its final pose at rest there"
    ]


@pytest.mark.parametrize("kind", ["Planar", "Spatial"])
@pytest.mark.parametrize("frequency", [20.0, 500.0])
@pytest.mark.parametrize("duration", [0.05, 1.0])
def test_the_librarys_motions_are_not_doubted(kind, frequency, duration):
    coordinates = 2 if kind == "Planar" else 6
    for name in trajectory_names(coordinates):
        motion = find_trajectory(name, coordinates)
        if not name.startswith("loop"):  # their durations follow from their accelerations
            motion = replace(motion, duration=duration)
        gym.make(f"CableBot-Flex{kind}-v0", trajectory=motion, control_frequency=frequency).reset()


def test_arrays_by_name_are_not_taken_for_a_reference():
    class Named(Own):
        def __call__(self, times):
            return vars(super().__call__(times))

    with pytest.raises(ValueError, match="trajectory 'own' must return a Reference, not dict"):
        gym.make(RIGID, trajectory=Named(lambda times, arrays: None)).reset()


def nan_at(name, time):
    def spoil(times, arrays):
        arrays[name][times >= time - 1e-9, 1] = np.nan

    return spoil


def flat(times, arrays):
    arrays["velocity"] = arrays["velocity"][..., 0]


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (
            nan_at("acceleration", 0.25),
            "trajectory 'own' must return finite numbers: its acceleration at 0.25 s is not finite",
        ),
        (nan_at("position", 0.0), "its position at 0 s is not"),
        (nan_at("position", 1.1), "is not finite after its duration: return its final pose at rest there"),
        (flat, r"must return a velocity of shape \(..., 2\): \(\d+, 2\) for \d+ times, not \(\d+,\)"),
    ],
    ids=["nan", "nan from the start", "nan afterwards", "one axis short"],
)
def test_a_refused_motion_is_not_left_without_what_is_wrong_where(spoil, message):
    with pytest.raises(ValueError, match=message):
        gym.make(RIGID, trajectory=Own(spoil)).reset()
