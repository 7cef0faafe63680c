"""Public numeric functions refuse NaN and infinity: a NaN bound once gave tensions of NaN with the
status HELD."""

import inspect
import math
from functools import partial

import numpy as np
import pytest

from cablebot_gym import kinematics
from cablebot_gym.bounds.closed_form import exact_payload, tension_bounds
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import sag, textbook
from cablebot_gym.physics.forward import forward_kinematics
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.physics.tensions import distribution
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL, find_robot

POSE = np.array([0.01, -0.02, 0.12, 0.05, -0.04, 0.03])
RATE = np.array([0.1, 0.2, -0.1, 0.3, -0.2, 0.1])
LOAD = np.array([0.0, 0, -117.7, 0, 0, 0])
HEAVY = find_robot("flex-cogiro")
LINE = find_trajectory("line-spatial", "spatial")

ARGUMENTS = {
    "pose": POSE,
    "velocity": RATE,
    "acceleration": -RATE,
    "mass": np.array(12.0),
    "euler": POSE[3:],
    "rates": RATE[3:],
    "vectors": SPATIAL.platform,
    "base": SPATIAL.base,
    "platform": SPATIAL.platform,
    "tensions": np.full(6, 20.0),
    "torques": np.full(6, 20.0),
    "speed": np.full(6, 2.0),
    "structure": textbook.jacobian(SPATIAL, POSE),
    "load": LOAD,
    "lower": np.full(6, 1.0),
    "upper": np.full(6, 900.0),
    "reference": np.ones(6),
    "slope": np.ones(6),
    "offset": np.zeros(6),
    "smoothing": 0.01,
    "unit_load": LOAD / 12,
    "largest": np.array(90.0),
    "times": np.array([0.1, 0.2]),
}
"""Valid values by the name of an argument."""

OF_SPATIAL = """
    jacobian mass_matrix bias load pulley_speed pulley_angle pulley_acceleration static_torque
    required_tensions required_torques motor_torques coulomb_torque torque_limits normalised_action
    inverse_dynamics forward_dynamics
"""
"""Functions of the textbook."""
PLAIN = (
    kinematics.rotation_matrix,
    kinematics.euler_rate_matrix,
    kinematics.euler_rate_matrix_rate,
    kinematics.turned,
    kinematics.cable_vectors,
    kinematics.cable_lengths,
    kinematics.structure_jacobian,
    kinematics.jacobian_and_rate,
    distribution.least_norm,
    distribution.largest_scale,
)
OTHER = {
    "inverse_dynamics of the kernel": (partial(inverse_dynamics, SPATIAL), {"minimum": 1.0}),
    "rest_angles": (partial(textbook.rest_angles, FLEX_SPATIAL), {}),
    "forward_kinematics": (
        partial(forward_kinematics, SPATIAL),
        {"lengths": textbook.cable_lengths(SPATIAL, POSE), "guess": POSE},
    ),
    "sag": (partial(sag.sag, HEAVY), {"pose": HEAVY.home, "tensions": np.full(8, 900.0)}),
    "exact_payload": (
        partial(exact_payload, SPATIAL, LINE),
        {"minimum_tension": 1.0, "frequency": 100.0, "line_speed": np.ones(6), "grid": 100.0},
    ),
    "tension_bounds": (
        partial(tension_bounds, SPATIAL, LINE(np.array([0.5, 1.0]))),
        {"minimum": 1.0, "line_speed": np.ones(6)},
    ),
    "trajectory": (LINE.__call__, {}),
}
FUNCTIONS = {
    **{function.__name__: (function, {}) for function in PLAIN},
    **{
        f"textbook.{name}": (partial(getattr(textbook, name), SPATIAL), {})
        for name in OF_SPATIAL.split()
    },
    **OTHER,
}
VALID = {("lower", -math.inf), ("upper", math.inf), ("times", -math.inf), ("times", math.inf)}
"""Bounds that exclude nothing, and times before and after a motion."""


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function_rejects_a_number_that_is_not_finite(name):
    function, values = FUNCTIONS[name]
    arguments = dict(values)
    for argument in inspect.signature(function).parameters:
        if argument not in values and argument in ARGUMENTS:
            arguments[argument] = ARGUMENTS[argument]
    function(**arguments)
    for argument, value in arguments.items():
        for bad in (math.nan, math.inf, -math.inf):
            broken = np.array(value, float)
            broken.flat[-1] = bad
            changed = {**arguments, argument: broken if np.ndim(value) else float(broken)}
            if (argument, bad) in VALID:
                function(**changed)
            else:
                with pytest.raises(ValueError, match=r"finite|numbers"):
                    function(**changed)


def test_every_public_function_of_tensions_is_in_the_table():
    for name, value in vars(distribution).items():
        if inspect.isfunction(value) and value.__module__ == distribution.__name__:
            assert name.startswith(("_", "unchecked")) or name in FUNCTIONS
