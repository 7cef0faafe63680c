"""Largest payload of a motion within the limits: a direct collocation that shares the equations of
the textbook with the product, but neither its splines nor its program.

The nodes have equal distances. Accelerations are linear in between. CasADi differentiates the whole
program. Limits hold at the nodes only, and the springs of redundant cables may start with any
internal tension: the payload is slightly optimistic.
"""

import numpy as np
import pytest

from cablebot_gym.kinematics import times_vector
from cablebot_gym.physics import textbook
from cablebot_gym.task import start_pose

ca = pytest.importorskip("casadi")

UNIT = 50.0
"""Unit of forces [N]."""


def largest_payload(robot, trajectory, error_bounds, *, nodes, period):
    """Largest payload of the collocation [kg] for torques that are constant over a period [s]."""
    opti = ca.Opti()
    payload = opti.variable()
    times = np.linspace(0.0, trajectory.duration, nodes + 1)
    reference = trajectory(times).position
    pose, velocity, acceleration = _states(opti, robot.coordinates, times, reference)
    opti.subject_to(pose[:, 0] == start_pose(robot, trajectory, error_bounds))
    opti.subject_to(velocity[:, 0] == trajectory(0.0).velocity)
    error = (pose[:, 1:] - reference[1:].T) / error_bounds.position
    opti.subject_to(ca.vec(ca.sum1(error**2)) <= 1)
    columns = [pose, velocity, acceleration]
    if robot.flexible:
        rest_angles = textbook.static_motor_angle(robot, robot.mass, reference)
        motors = _states(opti, robot.cables, times, rest_angles)
        columns += motors
        _, motor_speed, _ = motors
        opti.subject_to(acceleration[:, 0] == 0)
        opti.subject_to(motor_speed[:, 0] == 0)
    else:
        tensions = opti.variable(robot.cables, nodes + 1)
        opti.set_initial(tensions, 1.0)
        columns.append(tensions)
    columns.append(ca.repmat(robot.mass + payload, 1, nodes + 1))
    stages = _stage(robot, period).map(nodes + 1)
    balance, least, action = stages(ca.vertcat(*columns))
    opti.subject_to(ca.vec(balance) == 0)
    opti.subject_to(ca.vec(least) >= robot.minimum_tension / UNIT)
    opti.subject_to(opti.bounded(-1, ca.vec(action), 1))
    opti.subject_to(payload >= -0.9 * robot.mass)
    opti.minimize(-payload)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-6})
    return float(opti.solve().value(payload))


def _states(opti, count, times, values):
    """Values, rates and second rates at the nodes, each (count, nodes); second rates are linear in
    between."""
    nodes = len(times)
    value = opti.variable(count, nodes)
    rate = opti.variable(count, nodes)
    second = opti.variable(count, nodes)
    step = times[1] - times[0]
    start_rate = rate[:, :-1]
    start_second = second[:, :-1]
    end_second = second[:, 1:]
    rate_change = step / 2 * (start_second + end_second)
    change = step * start_rate + step**2 / 6 * (2 * start_second + end_second)
    opti.subject_to(rate[:, 1:] == start_rate + rate_change)
    opti.subject_to(value[:, 1:] == value[:, :-1] + change)
    opti.set_initial(value, values.T)
    opti.set_initial(rate, np.gradient(values, step, axis=0).T)
    return value, rate, second


def _stage(robot, period):
    """Balance of forces, least tensions and actions at a node as a function of its column."""
    rows_per_cable = 1
    if robot.flexible:
        rows_per_cable = 3
    sizes = 3 * [robot.coordinates] + rows_per_cable * [robot.cables]
    column = ca.SX.sym("column", sum(sizes) + 1)
    entries = np.array(ca.vertsplit(column), dtype=object)
    *parts, mass = np.split(entries, np.cumsum(sizes))
    x, v, a, *cables = (part[None] for part in parts)
    speed = textbook.pulley_speed(robot, x, v)
    second = textbook.pulley_acceleration(robot, x, v, a)
    if robot.flexible:
        pulley_torque = robot.pulley_inertia * second + robot.damping * speed
        angle, speed, second = cables
        torque, spring_forces = textbook.spring_drive(robot, x, v, angle, speed, second)
        tensions = spring_forces - pulley_torque / robot.pulley_radius
        least = [spring_forces[0] / UNIT, tensions[0] / UNIT]
    else:
        tensions = UNIT * cables[0]
        torque = textbook.required_torques(robot, tensions, x, v, a)
        least = [tensions[0] / UNIT]
    pull = times_vector(textbook.jacobian(robot, x).mT, tensions)
    balance = (textbook.load(robot, mass, x, v, a) + pull) / UNIT
    # The limits of a constant torque change with the speed in the period.
    half = period / 2 * second
    actions = []
    for end_speed in (speed - half, speed + half):
        actions.append(textbook.normalised_action(robot, torque, end_speed)[0])
    outputs = [ca.vertcat(*np.concatenate(rows)) for rows in (balance, least, actions)]
    return ca.Function("stage", [column], outputs)
