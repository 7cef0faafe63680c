"""Attainable deviation of an estimate: the posterior Cramér–Rao bound along a motion."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_baselines.estimation.ekf import ExtendedKalmanFilter
from cablebot_gym.physics import textbook
from cablebot_gym.task import Task

Array = NDArray[Any]


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
    robot, measurement = estimator.robot, task.measurement
    estimator.reset([task])
    period = 1 / task.control_frequency
    reference = task.trajectory(period * np.arange(task.steps))
    mass = np.full(task.steps, robot.mass + task.model_payload)
    motion = (reference.position, reference.velocity, reference.acceleration)
    required = textbook.inverse_dynamics(
        robot, mass, *motion, minimum=textbook.allocated_minimum(robot), strict=False
    )
    angle = textbook.pulley_angle(robot, reference.position)
    speed, torque = required.speeds, required.torques
    if robot.flexible:
        angle = angle + required.torques / textbook.joint_stiffness(robot, reference.position)
        speed = np.gradient(angle, period, axis=0)
        rotor = robot.motor_inertia * np.gradient(speed, period, axis=0)
        torque = torque + rotor + textbook.motor_friction(robot, speed)
    action = textbook.normalised_action(robot, torque, speed)
    blocks = {
        "motor_angle": angle,
        "motor_speed": speed,
        "last_actions": np.concatenate([action[:1], action[:-1]]),
        "model_payload": np.full((task.steps, 1), task.model_payload),
    }
    if measurement.tensions:
        blocks["tensions"] = required.tensions
    if measurement.imu:
        for name in ("orientation", "angular_rate", "specific_force"):
            blocks[name] = np.zeros((task.steps, 3))  # the covariance does not depend on readings
    state = None
    deviations = []
    n = robot.coordinates
    for step in range(task.steps):
        readings = {name: values[step : step + 1] for name, values in blocks.items()}
        _, state = estimator.update(readings, state, np.array([state is None]))
        mean = np.zeros_like(state.mean)
        mean[:, :n], mean[:, n : 2 * n] = reference.position[step], reference.velocity[step]
        state = dataclasses.replace(state, mean=mean)
        deviations.append(np.sqrt(np.diagonal(state.covariance[0])[:n]))
    return np.array(deviations)
