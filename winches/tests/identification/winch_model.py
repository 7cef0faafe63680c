"""Logs of a winch by a model of its own: torques at fine steps of time, then the sensors."""

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter

from cablebot_gym.robots import find_robot
from cablebot_winches.identification.log import Log

ROBOT = find_robot("ttk4900")
TRUTH = {
    "pulley_inertia": 8e-4,
    "damping": 0.01,
    "coulomb_friction": 0.05,
    "load_friction": 0.04,
}
FINE_STEP = 0.0005
PERIOD = 0.005
SPEED_NOISE = 0.01

MOTIONS = {
    "slow": {"rate": 1.5, "first": 2.0, "growth": 0.4},
    "alike": {"rate": 1.5, "first": 5.0, "growth": 0.1},
    "fast": {"rate": 6.0, "first": 5.0, "growth": 0.5},
    "quick": {"rate": 12.0, "first": 8.0, "growth": 0.8},
}
"""Sinusoidal speeds whose amplitude grows: rate [rad/s], first amplitude [rad/s], growth [rad/s²].
They reverse all the time."""

CASES = {
    "reversals": {},
    "encoder": {"encoder_steps": 8192, "torque_noise": 0.003},
    "dry friction": {"friction_speed": 0.0},
    "filtered speed": {"speed_filter": 0.015},
}
"""Imperfections of real logs by name."""


def winch_log(
    seed,
    load,
    motion,
    *,
    duration=20.0,
    friction_speed=ROBOT.transmission.friction_speed,
    speed_filter=0.0,
    encoder_steps=0,
    torque_noise=0.02,
):
    """Log of motor 1 that lifts and lowers a load [kg]: with the angle of an encoder, if it has
    steps, in place of the speed, whose filter has a time constant [s]. The friction speed of dry
    friction is 0."""
    rng = np.random.default_rng((seed, int(1000 * load)))
    time = np.arange(0, duration, FINE_STEP)
    phase = motion["rate"] * time + rng.uniform(0, 2 * np.pi)
    amplitude = motion["first"] + motion["growth"] * time
    speed = amplitude * np.sin(phase)
    acceleration = motion["growth"] * np.sin(phase) + amplitude * motion["rate"] * np.cos(phase)
    direction = np.sign(speed)
    if friction_speed:
        direction = speed / np.hypot(speed, friction_speed)
    radius = float(ROBOT.pulley_radius[0])
    tension = load * (ROBOT.gravity + radius * acceleration)
    torque = radius * tension * (1 + TRUTH["load_friction"] * direction)
    torque += TRUTH["pulley_inertia"] * acceleration + TRUTH["damping"] * speed
    torque += TRUTH["coulomb_friction"] * direction
    rows = slice(None, None, round(PERIOD / FINE_STEP))
    count = len(time[rows])
    columns = {"time": time[rows], "load_1": np.full(count, load)}
    columns["torque_1"] = torque[rows] + torque_noise * rng.standard_normal(count)
    if encoder_steps:
        step = 2 * np.pi / encoder_steps
        angle = cumulative_trapezoid(speed, dx=FINE_STEP, initial=0)
        columns["angle_1"] = step * np.round(angle[rows] / step)
    else:
        if speed_filter:
            kept = np.exp(-FINE_STEP / speed_filter)
            speed, _ = lfilter([1 - kept], [1, -kept], speed, zi=[kept * speed[0]])
        columns["speed_1"] = speed[rows] + SPEED_NOISE * rng.standard_normal(count)
    return Log(name="log", columns=columns)
