"""Friction of the winches of the library robot ``ttk4900``: motor currents while a winch lifts and
lowers a weight at constant speed.

The torque constant of the motors cancels in the ratio of half the difference and the mean of both
currents, which is the friction over the torque of gravity.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import median_filter

from cablebot_gym.physics.textbook import motor_torques
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION
from cablebot_winches.identification.regression import ParameterEstimate, fit
from cablebot_winches.identification.samples import Samples, drive_factors, parameter_names
from cablebot_winches.reality.comparison import LogComparison, Validation

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPEEDS = {"05": 0.5, "1": 1.0, "25": 2.5, "4": 4.0}
"""Speeds [rev/s] by their texts in names of files."""

WINCHES = {1: (2,), 5: (0, 1, 2, 3)}
"""Lifting winches by weight [kg]."""

TORQUE_CONSTANT = 8.27 / 150
"""Torque constant of the motors by their data sheet, 150 rpm/V [N·m/A]."""

SAMPLES = 9
"""Samples of the median that removes the noise of the measured speed, about 0.3 s."""

SPEED_TOLERANCE = 0.1
"""Largest relative deviation of the filtered speed in a steady run."""

LEAST_DURATION = 0.8
"""Least duration of a steady run [s]."""

TRIMMED = 0.25
"""Time at either end of a steady run that may belong to an acceleration [s]."""

FITTED = {
    "coulomb_friction": ("constant friction", "N·m"),
    "load_friction": ("friction per cable torque", "1"),
    "damping": ("viscous friction", "N·m·s/rad"),
}
"""Quantity and unit of the fitted fields of the transmission."""

FRICTION_GOAL = 0.05
"""Largest relative deviation of the friction of a winch from the fit to the others."""

CURRENT_GOAL = 0.02
"""Largest relative deviation of the currents of a winch from the fit to the others. Friction is less
than a tenth of them: half of it or one and a half times of it would hold a goal of 5 %."""


@dataclass(frozen=True, kw_only=True)
class Lift:
    """Mean currents of a winch that lifts and lowers a weight at a constant speed."""

    weight: float
    """Mass of the weight [kg]."""
    hook: float = 0.0
    """Mass of the hook [kg]."""
    winch: int
    """Index of the winch."""
    speed: float
    """Speed of the motor [rad/s]."""
    up: float
    """Current while lifting [A]."""
    down: float
    """Current while lowering [A]."""

    @property
    def mass(self) -> float:
        """Mass of weight and hook [kg]."""
        return self.weight + self.hook

    @property
    def mean(self) -> float:
        """Current that holds the weight without friction [A]."""
        return (self.up + self.down) / 2

    @property
    def friction(self) -> float:
        """Friction over the torque of gravity."""
        return (self.up - self.down) / (self.up + self.down)


def validate(logs: Mapping[str, bytes]) -> Validation:
    """Compares friction and torque constant of the robot with its model."""
    robot = find_robot("ttk4900")
    lifts = []
    for weight, winches in WINCHES.items():
        for winch in winches:
            for text, speed in SPEEDS.items():
                folder = f"Lifting_tests/{weight}kg/ODrive{winch}"
                up_log = logs[f"{folder}/Up{text}.csv"]
                down_log = logs[f"{folder}/Down{text}.csv"]
                lift = Lift(
                    weight=weight,
                    winch=winch,
                    speed=2 * math.pi * speed,
                    up=steady_current(up_log, winch, speed, lifting=True),
                    down=steady_current(down_log, winch, speed, lifting=False),
                )
                lifts.append(lift)
    hook = _hook(lifts)
    hooked = [replace(lift, hook=hook) for lift in lifts]
    return Validation(
        comparisons=(
            *_ratios(robot, lifts),
            *_torque_constants(robot, lifts),
            *_fit(robot, lifts, "nominal weights"),
            *_fit(robot, hooked, "with the hook"),
            *predictions(robot, lifts),
        ),
        notes=(
            "The mean currents of the two weights are not proportional to them. A hook of about "
            f"{hook:.2f} kg that both tests share would explain it. {_hook_effect(robot, lifts, hooked)}",
        ),
        draw=partial(draw, robot, lifts),
    )


def steady_current(log: bytes, winch: int, speed: float, *, lifting: bool) -> float:
    """Mean magnitude of the current of a winch at a constant speed [A].

    The run is steady while the filtered speed is near the nominal one. A file may have several
    attempts: the last steady run counts, without :data:`TRIMMED` at its ends.

    Args:
        log: CSV file with time, and position, velocity and current of the four winches.
        winch: index of the winch.
        speed: nominal speed [rev/s].
        lifting: whether the winch lifts, else it lowers.

    Raises:
        ValueError: if the file has no steady run.
    """
    columns = (0, 5 + winch, 9 + winch)
    rows = np.loadtxt(io.BytesIO(log), delimiter=",", skiprows=1, usecols=columns)
    time, velocity, current = rows[np.isfinite(rows).all(axis=1)].T
    # In these logs, velocity and current of a winch that lifts have opposite signs.
    direction = -np.sign(np.median(current))
    if not lifting:
        direction = -direction
    deviation = np.abs(median_filter(velocity, SAMPLES) - direction * speed)
    steady = deviation < SPEED_TOLERANCE * speed
    edges = np.flatnonzero(np.diff(steady, prepend=False, append=False))
    for first, end in edges.reshape(-1, 2)[::-1]:
        start = time[first]
        stop = time[end - 1]
        if stop - start >= LEAST_DURATION:
            is_inner = (time >= start + TRIMMED) & (time <= stop - TRIMMED)
            mean_current = current[is_inner].mean()
            return float(np.abs(mean_current))
    raise ValueError(f"a log of winch {winch} has no steady run at {speed:g} rev/s")


def model_friction(robot: Robot, mass: float, winch: int, speed: float) -> float:
    """Friction over the torque of gravity, from the motor torques of the model while lifting and
    lowering."""
    still = np.zeros(robot.cables)
    tension = mass * robot.gravity
    up = motor_torques(robot, tension, still + speed, still)[winch]
    down = motor_torques(robot, tension, still - speed, still)[winch]
    return float((up - down) / (up + down))


def _ratios(robot: Robot, lifts: Sequence[Lift]) -> list[LogComparison]:
    """Friction of all lifts by weight. The robot has been fitted to them, so that they are no goal."""
    comparisons = []
    for weight in WINCHES:
        lifts_of_weight = [lift for lift in lifts if lift.weight == weight]
        quantity = f"friction over gravity, {weight} kg"
        comparisons.append(_friction_comparison(quantity, robot, lifts_of_weight))
    return comparisons


def _friction_comparison(
    quantity: str, robot: Robot, lifts: Sequence[Lift], goal: float | None = None
) -> LogComparison:
    """Mean friction of lifts, over gravity, by the model ``robot`` and as measured."""
    model = []
    for lift in lifts:
        model.append(model_friction(robot, lift.mass, lift.winch, lift.speed))
    measured = [lift.friction for lift in lifts]
    return LogComparison(
        quantity=quantity,
        unit="1",
        model=float(np.mean(model)),
        robot=float(np.mean(measured)),
        goal=goal,
    )


def _mean_current(lifts: Sequence[Lift], weight: float) -> float:
    currents = [lift.mean for lift in lifts if lift.weight == weight]
    return float(np.mean(currents))


def _gravity_torque(robot: Robot, lift: Lift) -> float:
    return float(robot.pulley_radius[lift.winch] * lift.mass * robot.gravity)


def _torque_constants(robot: Robot, lifts: Sequence[Lift]) -> list[LogComparison]:
    """The torque constant by the larger weight, and by the difference of the weights, which is free
    of a hook that both have."""
    torque = float(robot.pulley_radius.mean() * robot.gravity)
    light = _mean_current(lifts, 1)
    heavy = _mean_current(lifts, 5)
    constants = {
        "5 kg": 5 * torque / heavy,
        "5 kg less 1 kg": 4 * torque / (heavy - light),
    }
    comparisons = []
    for name, constant in constants.items():
        comparison = LogComparison(
            quantity=f"torque constant, {name} (model: data sheet)",
            unit="N·m/A",
            model=TORQUE_CONSTANT,
            robot=constant,
        )
        comparisons.append(comparison)
    return comparisons


def _hook(lifts: Sequence[Lift]) -> float:
    """Mass of a hook with which the currents are proportional to the masses [kg]."""
    light = _mean_current(lifts, 1)
    heavy = _mean_current(lifts, 5)
    return 4 * light / (heavy - light) - 1


def _samples(robot: Robot, lifts: Sequence[Lift]) -> Samples:
    """Torques of all lifts as of one winch: the currents over their mean, times the torque of
    gravity, so that the torque constant cancels."""
    shape = (len(lifts), 2)
    gravity = np.repeat([_gravity_torque(robot, lift) for lift in lifts], 2)
    ratios = [(lift.up / lift.mean, lift.down / lift.mean) for lift in lifts]
    speed = np.outer([lift.speed for lift in lifts], [1.0, -1.0]).ravel()
    regressors = np.zeros((speed.size, robot.cables, 4))
    regressors[:, 0] = drive_factors(robot, speed, np.zeros(speed.size), gravity)
    return Samples(
        response=gravity * np.ravel(ratios),
        known=gravity,
        regressors=regressors,
        motor=np.zeros(speed.size, np.int64),
        block=np.indices(shape)[0].ravel(),
        is_current=False,
        time=np.zeros(speed.size),
        log=np.zeros(speed.size, np.int64),
    )


def fitted_friction(robot: Robot, lifts: Sequence[Lift]) -> dict[str, ParameterEstimate]:
    """Estimates of the frictions that all winches share, by name."""
    names = parameter_names(robot)
    values = {name: getattr(robot, name) for name in names}
    estimates = fit(_samples(robot, lifts), names, values).estimates
    return {item.name: item for item in estimates}


def _fit(robot: Robot, lifts: Sequence[Lift], masses: str) -> list[LogComparison]:
    """Constant friction, its part that grows with the load, and viscous friction, by least squares
    over all lifts with masses in words."""
    estimates = fitted_friction(robot, lifts)
    comparisons = []
    for name, (quantity, unit) in FITTED.items():
        comparison = LogComparison(
            quantity=f"{quantity}, fitted, {masses}",
            unit=unit,
            model=float(getattr(robot, name).mean()),
            robot=estimates[name].value,
        )
        comparisons.append(comparison)
    return comparisons


def _hook_effect(robot: Robot, lifts: Sequence[Lift], hooked: Sequence[Lift]) -> str:
    """A sentence about the constant friction with the hook."""
    name = "coulomb_friction"
    nominal = fitted_friction(robot, lifts)[name]
    change = fitted_friction(robot, hooked)[name].value - nominal.value
    return (
        f"With it, the constant friction would change by {change:+.4f} N·m, "
        f"{abs(change) / nominal.half_width:.1f} half widths of its interval."
    )


def predictions(robot: Robot, lifts: Sequence[Lift]) -> list[LogComparison]:
    """Friction and currents of each winch with the large weight, from a fit to the others and to
    the small weight."""
    frictions = []
    currents = []
    heavy = max(WINCHES)
    for winch in WINCHES[heavy]:
        unseen = [lift for lift in lifts if (lift.weight, lift.winch) == (heavy, winch)]
        others = [lift for lift in lifts if lift not in unseen]
        estimates = fitted_friction(robot, others)
        # Not the values of the robot, which have been fitted to all winches.
        fields = {name: estimates[name].value for name in FITTED}
        predicted = robot.replace(transmission=robot.transmission.replace(**fields))
        quantity = f"friction over gravity, {heavy} kg, winch {winch} from the others"
        frictions.append(_friction_comparison(quantity, predicted, unseen, FRICTION_GOAL))
        mean = _mean_current(others, heavy)
        deviations = []
        for lift in unseen:
            friction = model_friction(predicted, heavy, winch, lift.speed)
            deviations.append(mean * (1 + friction) / lift.up - 1)
            deviations.append(mean * (1 - friction) / lift.down - 1)
        current = LogComparison(
            quantity=f"largest deviation of the currents, {heavy} kg, winch {winch} from the others",
            unit="1",
            robot=float(np.max(np.abs(deviations))),
            goal=CURRENT_GOAL,
        )
        currents.append(current)
    return frictions + currents


def draw(robot: Robot, lifts: Sequence[Lift]) -> Figure:
    """Draws the currents, and the friction of robot and model, over the speed."""
    from cablebot_gym.plotting.figures import add_legend, new_figure

    figure = new_figure(4.2)
    currents, ratios = figure.subplots(1, 2)
    grid = np.linspace(min(SPEEDS.values()), max(SPEEDS.values()), 50)
    for weight, colour in zip(WINCHES, (BLUE, VERMILLION), strict=True):
        chosen = [lift for lift in lifts if lift.weight == weight]
        speeds = [lift.speed / (2 * math.pi) for lift in chosen]
        for direction, marker in (("up", "^"), ("down", "v")):
            values = [getattr(lift, direction) for lift in chosen]
            currents.plot(speeds, values, marker, color=colour, label=f"{weight} kg {direction}")
        measured = [100 * lift.friction for lift in chosen]
        ratios.plot(speeds, measured, "o", color=colour)
        winch = WINCHES[weight][0]
        model = []
        for speed in grid:
            friction = model_friction(robot, weight, winch, 2 * math.pi * float(speed))
            model.append(100 * friction)
        ratios.plot(grid, model, color=colour)
    currents.set(xlabel="speed [rev/s]", ylabel="motor current [A]", ylim=(0, None))
    ratios.plot([], [], "o", color=GREY, label="robot")
    ratios.plot([], [], color=GREY, label="model")
    ratios.legend(frameon=False)
    ratios.set(xlabel="speed [rev/s]", ylabel="friction over gravity [%]", ylim=(0, None))
    add_legend(figure, currents)
    return figure
