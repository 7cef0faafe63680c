"""Synthetic logs of a platform whose pose is measured."""

import numpy as np

from cablebot_winches.identification.log import Log, pose_columns

POSE_NOISE = 2e-5


def noisy_log(robot, time, pose, signals, rng, *, payload=None):
    """A log with noise of pose and of signals, (values, standard deviation) by quantity."""
    columns = {"time": time}
    for name, values in zip(pose_columns(robot), pose.T, strict=True):
        columns[name] = values + POSE_NOISE * rng.standard_normal(len(time))
    for quantity, (table, noise) in signals.items():
        for motor in range(robot.cables):
            errors = noise * rng.standard_normal(len(time))
            columns[f"{quantity}_{motor + 1}"] = table[:, motor] + errors
    if payload is not None:
        columns["payload"] = np.full(len(time), payload)
    return Log(name="motion.csv", file="motion.csv", columns=columns)


def smooth_motion(robot, rng, *, period=0.002, samples=6000):
    """Times, pose, velocity and acceleration of a motion of several frequencies. A longer period
    makes it slower."""
    time = period * np.arange(samples)
    sizes = np.full(robot.coordinates, 0.05)
    sizes[: robot.dimensions] = 0.03
    pose = np.tile(robot.home, (samples, 1))
    velocity = np.zeros_like(pose)
    acceleration = np.zeros_like(pose)
    for _ in range(3):
        rate = rng.uniform(2, 7, robot.coordinates) * 0.002 / period
        phase = rng.uniform(0, 6, robot.coordinates)
        argument = time[:, None] * rate + phase
        pose += sizes / 2 * np.sin(argument)
        velocity += sizes / 2 * rate * np.cos(argument)
        acceleration -= sizes / 2 * rate**2 * np.sin(argument)
    return time, pose, velocity, acceleration
