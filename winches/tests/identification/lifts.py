"""Synthetic logs of winches that lift and lower masses, by the equation of the drive."""

import numpy as np
from scipy.signal import lfilter

from cablebot_gym.robots import find_robot
from cablebot_winches.identification.log import Log

ROBOT = find_robot("ttk4900")
CONSTANT = 0.055
TRUTH = {
    "torque_constant": CONSTANT,
    "pulley_inertia": 4e-4,
    "damping": 1e-3,
    "coulomb_friction": 0.03,
    "load_friction": 0.05,
}
PERIOD = 0.005
REMEMBERED = 0.95
"""Correlation of the errors of neighbouring samples."""


def profile(speeds, *, are_constant=False):
    """Speeds of a winch that lifts and lowers at each speed, from rest to rest, or without its
    accelerations."""
    ramp = np.sin(np.linspace(0, np.pi / 2, 40)) ** 2
    pieces = []
    for speed in speeds:
        for velocity in (speed, -speed):
            if are_constant:
                pieces.append(np.full(300, velocity))
                continue
            pieces += [np.zeros(40), velocity * ramp, np.full(200, velocity), velocity * ramp[::-1]]
    return np.concatenate(pieces)


def lift(seed, load, speeds=(3, 12, 25), *, quantity="torque", motors=(1,), are_constant=False):
    """Log of motors that lift a load."""
    rng = np.random.default_rng((seed, int(1000 * load)))
    speed = profile(speeds, are_constant=are_constant)
    acceleration = np.gradient(speed, PERIOD)
    if are_constant:
        acceleration = 0 * speed
    direction = speed / np.hypot(speed, 0.5)
    gravity = 0.02 * load * (9.81 + 0.02 * acceleration)
    torque = gravity * (1 + TRUTH["load_friction"] * direction)
    torque += TRUTH["pulley_inertia"] * acceleration + TRUTH["damping"] * speed
    torque += TRUTH["coulomb_friction"] * direction
    columns = {"time": PERIOD * np.arange(len(speed))}
    for motor in motors:
        white = 0.01 * np.sqrt(1 - REMEMBERED**2) * rng.standard_normal(len(speed))
        measured = torque + lfilter([1], [1, -REMEMBERED], white)
        if quantity == "current":
            measured /= CONSTANT
        columns[f"speed_{motor}"] = speed + 0.01 * rng.standard_normal(len(speed))
        columns[f"{quantity}_{motor}"] = measured
        columns[f"load_{motor}"] = np.full(len(speed), load)
    return Log(name=f"{load:g}kg.csv", file=f"{load:g}kg.csv", columns=columns)


def by_motor(result):
    """Estimates of the motors by name."""
    estimates = {}
    for item in result.estimates:
        estimates.setdefault(item.name, []).append(item)
    return estimates


def write(log, folder, *, without=(), rename=None):
    """The log as a CSV file in a folder."""
    columns = {name: values for name, values in log.columns.items() if name not in without}
    header = ",".join((rename or {}).get(name, name) for name in columns)
    path = folder / log.name
    table = np.stack(list(columns.values()), axis=1)
    np.savetxt(path, table, delimiter=",", header=header, comments="", fmt="%.8g")
    return path
