"""Public numeric functions refuse NaN and infinity: a NaN bound once gave tensions of NaN with the status HELD."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cablebot_gym import kinematics
from cablebot_gym.bounds.closed_form import exact_payload, tension_bounds
from cablebot_gym.physics import distribution, sag, textbook
from cablebot_gym.physics.forward import forward_kinematics
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.robots import FLEX_SPATIAL, SPATIAL, find_robot
from cablebot_gym.trajectories import find_trajectory
from cablebot_gym.uncertainty import ParameterDistribution, Uncertainty, draw_size

POSE = np.array([0.01, -0.02, 0.12, 0.05, -0.04, 0.03])
RATE = np.array([0.1, 0.2, -0.1, 0.3, -0.2, 0.1])
MOTION = {"pose": POSE, "velocity": RATE, "acceleration": -RATE}
MASS = {"mass": np.array(12.0)}
EULER = {"euler": POSE[3:], "rates": RATE[3:]}
CABLES = {"base": SPATIAL.base, "platform": SPATIAL.platform, "pose": POSE}
S = textbook.jacobian(SPATIAL, POSE)
PROBLEM = {
    "structure": S,
    "load": np.array([0.0, 0, -117.7, 0, 0, 0]),
    "lower": np.full(6, 1.0),
    "upper": np.full(6, 900.0),
}
SIX = {"tensions": np.full(6, 20.0), "speed": np.full(6, 2.0), "acceleration": np.full(6, 3.0)}
CABLE = {
    "across": np.array(3.0),
    "rise": np.array(1.0),
    "tension": np.array(90.0),
    "weight": np.array(0.6),
}
HEAVY = find_robot("flex-cogiro")
UNIFORM = ParameterDistribution(low=-0.1, high=0.1)
LINE = find_trajectory("line-spatial", "spatial")
REFERENCE = LINE(np.array([0.5, 1.0]))


def of_robot(function, robot=SPATIAL):
    return lambda **arguments: function(robot, **arguments)


def chosen(values, *names):
    return {name: values[name] for name in names}


FUNCTIONS = {
    "rotation_matrix": (kinematics.rotation_matrix, chosen(EULER, "euler")),
    "euler_rate_matrix": (kinematics.euler_rate_matrix, chosen(EULER, "euler")),
    "euler_rate_matrix_rate": (kinematics.euler_rate_matrix_rate, EULER),
    "turned": (kinematics.turned, {"pose": POSE, "vectors": SPATIAL.platform}),
    "cable_vectors": (kinematics.cable_vectors, CABLES),
    "cable_lengths": (kinematics.cable_lengths, {**CABLES, "swivel": np.full(6, 0.01)}),
    "structure_jacobian": (kinematics.structure_jacobian, CABLES),
    "structure_jacobian_rate": (kinematics.structure_jacobian_rate, {**CABLES, "velocity": RATE}),
    "jacobian_and_rate": (kinematics.jacobian_and_rate, {**CABLES, "velocity": RATE}),
    "textbook.jacobian": (of_robot(textbook.jacobian), {"pose": POSE}),
    "mass_matrix": (of_robot(textbook.mass_matrix), {**MASS, "pose": POSE}),
    "bias": (of_robot(textbook.bias), {**MASS, **chosen(MOTION, "pose", "velocity")}),
    "load": (of_robot(textbook.load), {**MASS, **MOTION}),
    "pulley_speed": (of_robot(textbook.pulley_speed), chosen(MOTION, "pose", "velocity")),
    "pulley_angle": (of_robot(textbook.pulley_angle), {"pose": POSE}),
    "pulley_acceleration": (of_robot(textbook.pulley_acceleration), MOTION),
    "static_torque": (of_robot(textbook.static_torque), {**MASS, "pose": POSE}),
    "rest_angles": (
        of_robot(textbook.rest_angles, FLEX_SPATIAL),
        {"tensions": SIX["tensions"], "pose": POSE},
    ),
    "required_tensions": (of_robot(textbook.required_tensions), {**MASS, **MOTION}),
    "required_torques": (
        of_robot(textbook.required_torques),
        {"tensions": SIX["tensions"], **MOTION},
    ),
    "motor_torques": (of_robot(textbook.motor_torques), SIX),
    "coulomb_torque": (of_robot(textbook.coulomb_torque), chosen(SIX, "speed")),
    "torque_limits": (of_robot(textbook.torque_limits), chosen(SIX, "speed")),
    "normalised_action": (
        of_robot(textbook.normalised_action),
        {"torques": SIX["tensions"], "speed": SIX["speed"]},
    ),
    "textbook.inverse_dynamics": (of_robot(textbook.inverse_dynamics), {**MASS, **MOTION}),
    "forward_dynamics": (
        of_robot(textbook.forward_dynamics),
        {**MASS, **chosen(MOTION, "pose", "velocity"), "torques": np.ones(6)},
    ),
    "inverse_dynamics": (of_robot(inverse_dynamics), {**MASS, **MOTION, "minimum": 1.0}),
    "forward_kinematics": (
        of_robot(forward_kinematics),
        {"lengths": textbook.cable_lengths(SPATIAL, POSE), "guess": POSE},
    ),
    "least_norm": (
        distribution.least_norm,
        {**PROBLEM, "reference": np.ones(6), "weights": np.ones(6)},
    ),
    "least_largest_action": (
        distribution.least_largest_action,
        {
            **PROBLEM,
            "slope": np.ones(6),
            "offset": np.zeros(6),
            "smoothing": 0.01,
            "weights": np.ones(6),
        },
    ),
    "feasible": (distribution.feasible, PROBLEM),
    "largest_scale": (
        distribution.largest_scale,
        {
            **PROBLEM,
            "unit_load": PROBLEM["load"] / 12,
            "largest": np.array(90.0),
            "least": np.array(0.0),
            "unit_lower": np.zeros(6),
            "unit_upper": np.zeros(6),
        },
    ),
    "catenary": (sag.catenary, CABLE),
    "parabola": (sag.parabola, CABLE),
    "sag": (of_robot(sag.sag, HEAVY), {"pose": HEAVY.home, "tensions": np.full(8, 900.0)}),
    "settle": (
        of_robot(sag.settle, HEAVY),
        {"mass": 91.0, "pose": HEAVY.home, "tensions": np.full(8, 900.0)},
    ),
    "exact_payload": (
        lambda **arguments: exact_payload(SPATIAL, LINE, **arguments),
        {"minimum_tension": 1.0, "frequency": 100.0, "line_speed": np.ones(6), "grid": 100.0},
    ),
    "tension_bounds": (
        lambda **arguments: tension_bounds(SPATIAL, REFERENCE, **arguments),
        {"minimum": 1.0, "line_speed": np.ones(6)},
    ),
    "trajectory": (LINE, {"times": np.array([0.1, 0.2])}),
    "trajectory without dwells": (LINE.motion, {"times": np.array([0.1, 0.2])}),
    "chain": (find_trajectory("chain-planar", "planar").motion, {"times": np.array([0.1, 0.2])}),
    "deviation": (UNIFORM.deviation, {"uniform": np.array([0.2])}),
    "applied": (UNIFORM.applied, {"nominal": np.array([2.0]), "deviation": np.array([0.1])}),
    "draw": (
        of_robot(Uncertainty(parameters={"platform_mass": UNIFORM}).draw),
        {"payload": np.zeros(2), "uniform": np.full((2, draw_size(SPATIAL)), 0.5)},
    ),
}
VALID = {("lower", -math.inf), ("upper", math.inf), ("times", -math.inf), ("times", math.inf)}
"""Bounds that exclude nothing, and times before and after a motion."""


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function_rejects_a_number_that_is_not_finite(name):
    function, arguments = FUNCTIONS[name]
    function(**arguments)
    for argument, value in arguments.items():
        for bad in (math.nan, math.inf, -math.inf):
            broken = np.array(value, float)
            broken.flat[-1] = bad
            changed = {**arguments, argument: broken if np.ndim(value) else float(broken)}
            if (argument, bad) in VALID:
                function(**changed)
                continue
            with pytest.raises(ValueError, match=r"finite|numbers"):
                function(**changed)


def test_every_public_function_of_tensions_is_in_the_table():
    defined = {
        name
        for name, value in vars(distribution).items()
        if callable(value) and not name.startswith("_") and getattr(value, "__module__", "") == distribution.__name__
    }
    public = {name for name in defined if name[0].islower() and not name.startswith("unchecked")}
    assert public <= set(FUNCTIONS)
