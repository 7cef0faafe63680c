"""What a policy expects of a robot that is not exactly known: means and standard deviations of an
uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.textbook import joint_equivalent
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.uncertainty import PARAMETERS, ExternalWrench, SensorNoise, Uncertainty

_LOWER, _MEDIAN, _UPPER = 0.15866, 0.5, 0.84134
"""Probabilities of the mean of a normal distribution and of one standard deviation on both
sides."""


UNKNOWN_START = (0.1, 0.1)
"""Standard deviations of an unknown start pose [m, rad]. Any that are far above the errors of the
lengths give the same estimates; larger ones leave fewer digits."""


def possible_payload(robot: Robot, task: Task) -> float:
    """Largest payload that is considered possible if the payload is unknown [kg]: the one with which
    the motors can follow the motion exactly, at least the mass of the platform; this mass where the
    motors hold every payload."""
    exact = exact_payload(task.robot, task.trajectory).payload
    if math.isfinite(exact):
        return max(float(robot.mass), exact)
    return float(robot.mass)


@dataclass(frozen=True, kw_only=True, eq=False)
class Expectation:
    """Expected robot, and standard deviations of what differs from it."""

    robot: Robot
    """Robot with the median of each uncertain parameter, without motor lag."""
    delay: tuple[int, int]
    """Shortest and longest delay of the actions [control steps]."""
    lag: tuple[float, float]
    """Shortest and longest lag of the motors [s]."""
    mass_spread: float
    """Standard deviation of the platform mass [kg]."""
    payload_spread: float
    """Standard deviation of the payload as a fraction of it."""
    strength_spread: float
    """Standard deviation of the strength of a motor as a fraction of it."""
    friction_spread: float
    """Standard deviation of the Coulomb friction as a fraction of it."""
    inertia_spread: float
    """Standard deviation of the inertia of a pulley as a fraction of it."""
    damping_spread: float
    """Standard deviation of the damping of a pulley [N·m·s/rad]."""
    stiffness_spread: float
    """Standard deviation of the stiffness of a joint spring as a fraction of it."""
    anchor_spread: float
    """Standard deviation of the length of a cable by the positions of its anchors [m]."""
    wrench_mean: Array
    """Mean of the wrench on the platform, (n,) [N, N·m]."""
    wrench_spread: Array
    """Standard deviation of the wrench, (n,) [N, N·m]."""
    wrench_time: float
    """Time for which the wrench is constant [s]."""
    noise: SensorNoise
    """White noise of the sensors."""
    bias: SensorNoise
    """Constant errors of the sensors."""
    start_spread: tuple[float, float]
    """Standard deviations of the start pose, which matter where it is not measured [m, rad]."""

    @classmethod
    def of(
        cls,
        robot: Robot,
        uncertainty: Uncertainty,
        *,
        start_spread: tuple[float, float] = UNKNOWN_START,
    ) -> Expectation:
        """The expectation for an uncertainty of a nominal robot."""
        shortest = longest = np.asarray(np.mean(robot.motor_lag))
        if "motor_lag" in uncertainty.parameters:
            shortest, longest = uncertainty.parameters["motor_lag"].extremes(longest)
        wrench = uncertainty.wrench or ExternalWrench(correlation_time=1.0)
        wrench_mean, wrench_spread = wrench.statistics(robot)
        spread = partial(_spread, robot, uncertainty)
        friction_spread = spread("coulomb_friction")
        if friction_spread and uncertainty.parameters["coulomb_friction"].each:
            friction_spread /= np.sqrt(robot.cables)  # of the mean friction
        return cls(
            robot=_expected(robot, uncertainty),
            delay=uncertainty.delay_range,
            lag=(float(shortest), float(longest)),
            mass_spread=spread("platform_mass", relative=False),
            payload_spread=_relative_spread(uncertainty, "payload"),
            strength_spread=spread("motor_strength"),
            friction_spread=friction_spread,
            inertia_spread=spread("pulley_inertia"),
            damping_spread=spread("damping", relative=False),
            stiffness_spread=spread("stiffness"),
            anchor_spread=float(
                np.hypot(
                    spread("base_anchors", relative=False),
                    spread("platform_anchors", relative=False),
                )
            ),
            wrench_mean=wrench_mean,
            wrench_spread=wrench_spread,
            wrench_time=wrench.correlation_time,
            noise=uncertainty.sensors or SensorNoise(),
            bias=uncertainty.sensor_bias or SensorNoise(),
            start_spread=start_spread,
        )

    @property
    def light_on_springs(self) -> bool:
        """Whether springs hold a platform that is lighter than the rotors behind them: it then swings
        against the rotors, and not they against it."""
        if not self.robot.flexible:
            return False
        model = joint_equivalent(self.robot)
        rotors = model.motor_inertia / model.pulley_radius**2
        return bool(model.mass < rotors.min())

    def effect_times(self, period: float) -> tuple[float, float]:
        """Shortest and longest time between the request of an action and its torque [s], with a
        control period [s]: delay and lag."""
        shortest, longest = (
            steps * period + lag for steps, lag in zip(self.delay, self.lag, strict=True)
        )
        return shortest, longest


def _expected(robot: Robot, uncertainty: Uncertainty) -> Robot:
    """The robot with the median of each parameter of motors and transmission, without lag."""
    changes: dict[str, Any] = {}
    names = ("pulley_inertia", "damping", "stiffness", "motor_inertia", "motor_damping")
    for name in (*names, "coulomb_friction"):
        if PARAMETERS[name].belongs_to(robot):
            changes[name] = _median(robot, uncertainty, name)
    transmission = robot.transmission.replace(**changes)
    stall = _median(robot, uncertainty, "motor_strength")
    motors = robot.motors.replace(lag=0.0, stall_torque=stall)
    mass = float(_median(robot, uncertainty, "platform_mass"))
    return robot.replace(transmission=transmission, motors=motors, mass=mass)


def _value(robot: Robot, uncertainty: Uncertainty, name: str, probability: float) -> Array:
    """A parameter of the robot that is exceeded with a probability of one minus ``probability``."""
    nominal = np.asarray(getattr(robot, PARAMETERS[name].attribute), float)
    if name not in uncertainty.parameters:
        return nominal
    distribution = uncertainty.parameters[name]
    return distribution.applied(nominal, distribution.deviation(np.asarray(probability)))


def _median(robot: Robot, uncertainty: Uncertainty, name: str) -> Array:
    return _value(robot, uncertainty, name, _MEDIAN)


def _spread(robot: Robot, uncertainty: Uncertainty, name: str, *, relative: bool = True) -> float:
    """Largest standard deviation of a parameter of all motors, in its unit or as a fraction of its
    median."""
    if name not in uncertainty.parameters or not PARAMETERS[name].belongs_to(robot):
        return 0.0
    upper = _value(robot, uncertainty, name, _UPPER)
    spread = (upper - _value(robot, uncertainty, name, _LOWER)) / 2
    if relative:
        median = _median(robot, uncertainty, name)
        spread = np.divide(spread, median, out=np.zeros_like(spread), where=median > 0)
    return float(np.max(spread))


def _relative_spread(uncertainty: Uncertainty, name: str) -> float:
    """Standard deviation of a relative parameter whose nominal value is unknown."""
    if name not in uncertainty.parameters:
        return 0.0
    distribution = uncertainty.parameters[name]
    lower, upper = distribution.deviation(np.array([_LOWER, _UPPER]))
    return float(upper - lower) / 2
