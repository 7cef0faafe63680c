"""Largest payload of a motion within the limits: a direct collocation that shares the equations of
the textbook with the product, but neither its splines nor its program.

The nodes have equal distances. Accelerations are linear in between. CasADi differentiates the whole
program. Limits hold at the nodes only, and the springs of redundant cables may start with any
internal tension: the payload is slightly optimistic.
"""

import numpy as np
import pytest

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
    _keep_error_bounds(opti, pose[:, 1:], reference[1:].T, error_bounds)
    columns = [pose, velocity, acceleration]
    if robot.flexible:
        angles = textbook.static_motor_angle(robot, robot.mass, reference)
        columns += _states(opti, robot.cables, times, angles)
        opti.subject_to(acceleration[:, 0] == 0)
        opti.subject_to(columns[4][:, 0] == 0)
    else:
        tensions = opti.variable(robot.cables, nodes + 1)
        opti.set_initial(tensions, 1.0)
        columns.append(tensions)
    mass = ca.repmat(robot.mass + payload, 1, nodes + 1)
    balance, least, action = _stage(robot, period).map(nodes + 1)(ca.vertcat(*columns, mass))
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
    value, rate, second = (opti.variable(count, len(times)) for _ in range(3))
    step = times[1] - times[0]
    before = second[:, :-1]
    after = second[:, 1:]
    opti.subject_to(rate[:, 1:] == rate[:, :-1] + step / 2 * (before + after))
    moved = step * rate[:, :-1] + step**2 / 6 * (2 * before + after)
    opti.subject_to(value[:, 1:] == value[:, :-1] + moved)
    opti.set_initial(value, values.T)
    opti.set_initial(rate, np.gradient(values, step, axis=0).T)
    return value, rate, second


def _keep_error_bounds(opti, pose, reference, error_bounds):
    error = (pose - reference) / error_bounds.position
    opti.subject_to(ca.vec(ca.sum1(error**2)) <= 1)


def _stage(robot, period):
    """Balance of forces, least tensions and actions at a node as a function of its column."""
    n = robot.coordinates
    m = robot.cables
    sizes = [n, n, n, m, m, m] if robot.flexible else [n, n, n, m]
    column = ca.SX.sym("column", sum(sizes) + 1)
    entries = np.array(ca.vertsplit(column), dtype=object)
    x, v, a, *cables = (part[None] for part in np.split(entries, np.cumsum(sizes))[:-1])
    least = []
    if robot.flexible:
        angle, speed, second = cables
        torque, springs = textbook.spring_drive(robot, x, v, angle, speed, second)
        least.append(springs[0] / UNIT)
        drag = robot.damping * textbook.pulley_speed(robot, x, v)
        pulley = robot.pulley_inertia * textbook.pulley_acceleration(robot, x, v, a) + drag
        tensions = springs - pulley / robot.pulley_radius
    else:
        tensions = UNIT * cables[0]
        speed = textbook.pulley_speed(robot, x, v)
        second = textbook.pulley_acceleration(robot, x, v, a)
        torque = textbook.required_torques(robot, tensions, x, v, a)
    pull = np.swapaxes(textbook.jacobian(robot, x), -1, -2) @ tensions[..., None]
    balance = (textbook.load(robot, entries[-1:], x, v, a) + pull[..., 0]) / UNIT
    least.append(tensions[0] / UNIT)
    # The limits of a constant torque change with the speed in the period.
    ends = [speed - period / 2 * second, speed + period / 2 * second]
    action = [textbook.normalised_action(robot, torque, end)[0] for end in ends]
    outputs = [ca.vertcat(*np.concatenate(part)) for part in (balance, least, action)]
    return ca.Function("stage", [column], outputs)
