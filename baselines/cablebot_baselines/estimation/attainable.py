"""Attainable deviation of an estimate: the posterior Cramér–Rao bound along a motion."""

from __future__ import annotations

import dataclasses

import numpy as np

from cablebot_baselines.estimation.ekf import ExtendedKalmanFilter
from cablebot_gym.kinematics import Array
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.trajectories import Reference


def attainable_deviation(estimator: ExtendedKalmanFilter, task: Task) -> Array:
    """Standard deviation of each coordinate of the pose, which no unbiased estimate falls below,
    (steps, n).

    The recursion of Tichavský for the posterior Cramér–Rao bound, with the model of the filter
    linearised at the true motion, is that of the filter's covariance. The true motion is the
    reference with the model payload.

    Args:
        estimator: the filter with the expected errors.
        task: task with the sensors; the motion starts at rest.
    """
    estimator.reset([task])
    period = 1 / task.control_frequency
    reference = task.trajectory(period * np.arange(task.steps))
    blocks = _exact_readings(estimator.robot, task, reference)
    n = estimator.robot.coordinates
    state = None
    deviations = []
    for step in range(task.steps):
        readings = {name: values[step : step + 1] for name, values in blocks.items()}
        starts = np.array([state is None])
        _, state = estimator.update(readings, state, starts)
        true_mean = np.zeros_like(state.mean)
        true_mean[:, :n] = reference.position[step]
        true_mean[:, n : 2 * n] = reference.velocity[step]
        state = dataclasses.replace(state, mean=true_mean)
        variances = np.diagonal(state.covariance[0])
        deviations.append(np.sqrt(variances[:n]))
    return np.array(deviations)


def _exact_readings(robot: Robot, task: Task, reference: Reference) -> dict[str, Array]:
    """Blocks of the observations along the reference, each (steps, size)."""
    period = 1 / task.control_frequency
    pose = reference.position
    required = textbook.inverse_dynamics(
        robot,
        np.full(task.steps, robot.mass + task.model_payload),
        pose,
        reference.velocity,
        reference.acceleration,
        minimum=textbook.allocated_minimum(robot),
        strict=False,
    )
    angle = textbook.pulley_angle(robot, pose)
    speed = required.speeds
    torque = required.torques
    if robot.flexible:
        angle = angle + torque / textbook.joint_stiffness(robot, pose)
        speed = np.gradient(angle, period, axis=0)
        rotor_torque = robot.motor_inertia * np.gradient(speed, period, axis=0)
        torque = torque + rotor_torque + textbook.motor_friction(robot, speed, torque)
    action = textbook.normalised_action(robot, torque, speed)
    blocks = {
        "motor_angle": angle,
        "motor_speed": speed,
        "last_actions": np.concatenate([action[:1], action[:-1]]),
        "model_payload": np.full((task.steps, 1), task.model_payload),
    }
    if task.measurement.tensions:
        blocks["tensions"] = required.tensions
    if task.measurement.imu:
        unread = np.zeros((task.steps, 3))  # the covariance does not depend on readings
        for name in ("orientation", "angular_rate", "specific_force"):
            blocks[name] = unread
    return blocks
