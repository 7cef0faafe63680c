"""What may differ between the plant and what the controller is told, as data.

A :class:`Uncertainty` says how the true parameters of an episode are drawn around the nominal robot, which external
wrench acts on the platform, how noisy the observation is, and how late a command arrives. Drawing needs random numbers
from outside: nothing here has a state or a seed, and every draw starts from the nominal robot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from numbers import Real
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from scipy.special import ndtr, ndtri

from cablebot_gym.kinematics import Array
from cablebot_gym.robots import Robot
from cablebot_gym.utils.suggestions import no_such

Distribution = Literal["uniform", "normal"]

LONGEST_DELAY = 1000
"""Largest actuation delay [control steps]."""


@dataclass(frozen=True, kw_only=True)
class Spread:
    """How far the true value of a parameter may be from its nominal one; drawn once an episode.

    Raises:
        ValueError: if ``low`` > ``high``, a number is not finite, or ``std`` and ``distribution`` do not fit.
    """

    low: float
    """Least deviation: a share of the nominal value, or in its unit if not ``relative``."""
    high: float
    """Largest deviation."""
    distribution: Distribution = "uniform"
    """Between the bounds; ``normal`` is cut off at them."""
    mean: float = 0.0
    """Of the normal distribution before it is cut off; no effect if uniform."""
    std: float | None = None
    """Standard deviation of the normal distribution before it is cut off; > 0. None if uniform."""
    relative: bool = True
    """Whether the deviation is a share of the nominal value: of nothing, as the planar robot's damping, nothing."""
    each: bool = True
    """One draw for each motor, axis or coordinate; False: the same deviation for all of them."""

    def __post_init__(self) -> None:
        for name in ("low", "high", "mean"):
            object.__setattr__(self, name, _number(name, getattr(self, name)))
        for name in ("relative", "each"):
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise ValueError(f"{name} must be True or False, not {getattr(self, name)!r}")
        if self.low > self.high:
            raise ValueError(f"a spread needs low ≤ high, not {self.low:g} and {self.high:g}: exchange them")
        if self.distribution not in get_args(Distribution):
            raise ValueError(
                f"unknown distribution {self.distribution!r}; choose one of {', '.join(get_args(Distribution))}"
            )
        if (self.distribution == "normal") != (self.std is not None):
            raise ValueError("std belongs to a normal distribution, which needs it: give both or neither")
        if self.std is not None:
            object.__setattr__(self, "std", _number("std", self.std))
            if not self.std > 0:
                raise ValueError(
                    f"std must be greater than 0, not {self.std:g}; without spread leave the parameter out"
                )
            if not self.low < self.mean + 8 * self.std or not self.high > self.mean - 8 * self.std:
                raise ValueError("the bounds low and high lie more than eight std from the mean: nothing can be drawn")

    def deviation(self, uniform: Array) -> Array:
        """Deviations from numbers that are uniform in [0, 1), by the inverse of the distribution."""
        if self.std is None:
            return self.low + (self.high - self.low) * uniform
        ends = (np.array([self.low, self.high]) - self.mean) / self.std
        side = -1.0 if ends[0] > 0 else 1.0  # the upper tail is drawn as the lower one: digits are lost near 1
        first, last = ndtr(side * ends)
        drawn = self.mean + self.std * side * ndtri(first + (last - first) * uniform)
        return np.asarray(np.clip(drawn, self.low, self.high))

    def applied(self, nominal: Array, deviation: Array) -> Array:
        """The true value for a nominal one and a deviation in the unit of the spread."""
        return nominal * (1 + deviation) if self.relative else nominal + deviation


@dataclass(frozen=True, kw_only=True)
class _Parameter:
    """One named parameter: the attribute of :class:`~cablebot_gym.robots.Robot` and what its value may be."""

    attribute: str
    positive: bool
    flexible: bool = False
    spatial: bool = False
    place: bool = False
    """A position, of either sign."""
    slows: bool = False
    """More of it makes a flexible robot swing slower."""


PARAMETERS: Mapping[str, _Parameter] = MappingProxyType(
    {
        "platform_mass": _Parameter(attribute="mass", positive=True, slows=True),
        "payload": _Parameter(attribute="payload", positive=False),
        "platform_inertia": _Parameter(attribute="inertia", positive=True, spatial=True, slows=True),
        "pulley_inertia": _Parameter(attribute="pulley_inertia", positive=False, slows=True),
        "damping": _Parameter(attribute="damping", positive=False),
        "stiffness": _Parameter(attribute="stiffness", positive=True, flexible=True),
        "motor_inertia": _Parameter(attribute="motor_inertia", positive=True, flexible=True, slows=True),
        "motor_damping": _Parameter(attribute="motor_damping", positive=False, flexible=True),
        "motor_strength": _Parameter(attribute="stall_torque", positive=True),
        "base_anchors": _Parameter(attribute="base", positive=False, place=True),
        "platform_anchors": _Parameter(attribute="platform", positive=False, spatial=True, place=True),
    }
)
"""What can be uncertain. ``motor_strength`` scales the whole torque-speed line: the free speed stays."""


@dataclass(frozen=True, kw_only=True)
class ExternalWrench:
    """Forces and moments on the platform: normal, redrawn now and then and held in between, components independent.

    Raises:
        ValueError: if a number is not finite, negative where it must not be, or of the wrong shape.
    """

    force_mean: float | tuple[float, ...] = 0.0
    """Along the base frame's axes [N], one for all or one each (planar: x, y)."""
    force_std: float | tuple[float, ...] = 0.0
    """Standard deviation [N]; ≥ 0."""
    moment_mean: float | tuple[float, ...] = 0.0
    """About the base frame's axes through the centre of mass [N·m]; no effect on a planar robot."""
    moment_std: float | tuple[float, ...] = 0.0
    """Standard deviation [N·m]; ≥ 0."""
    correlation_time: float = 0.01
    """How long a draw lasts [s]; > 0. Rounded to whole control periods, at least one."""
    factor: tuple[float, float] = (1.0, 1.0)
    """(low, high) of a uniform factor, drawn once an episode for each component."""

    def __post_init__(self) -> None:
        for name in ("force_mean", "force_std", "moment_mean", "moment_std"):
            values = _numbers(name, getattr(self, name))
            if values.shape not in ((), (2,), (3,)):
                raise ValueError(f"{name} must be one number or one for each axis, not {getattr(self, name)!r}")
            if name.endswith("std") and np.any(values < 0):
                raise ValueError(f"{name} must be at least 0, not {getattr(self, name)!r}")
            object.__setattr__(self, name, values.tolist() if values.shape == () else tuple(values.tolist()))
        object.__setattr__(self, "correlation_time", _number("correlation_time", self.correlation_time))
        if not self.correlation_time > 0:
            raise ValueError(f"correlation_time must be greater than 0 s, not {self.correlation_time:g}")
        ends = _numbers("factor", self.factor)
        if ends.shape != (2,) or ends[0] > ends[1]:
            raise ValueError(f"factor must be (low, high) with low ≤ high, not {self.factor!r}")
        object.__setattr__(self, "factor", tuple(ends.tolist()))

    @property
    def random(self) -> bool:
        """Whether two draws can differ."""
        spread = any(np.any(np.asarray(std) > 0) for std in (self.force_std, self.moment_std))
        return spread or self.factor[0] < self.factor[1]

    def statistics(self, robot: Robot) -> tuple[Array, Array]:
        """Mean and standard deviation of the components (force, then moment if spatial), each (2,) or (6,).

        Raises:
            ValueError: if a tuple does not have as many components as the robot has axes.
        """
        axes = 2 if robot.planar else 3
        kinds = ("force",) if robot.planar else ("force", "moment")
        rows = []
        for statistic in ("mean", "std"):
            parts = []
            for kind in kinds:
                value = np.asarray(getattr(self, f"{kind}_{statistic}"))
                if value.shape not in ((), (axes,)):
                    raise ValueError(f"wrench: {kind}_{statistic} needs {axes} components for {robot.name!r}")
                parts.append(np.broadcast_to(value, (axes,)))
            rows.append(np.concatenate(parts))
        return rows[0], rows[1]


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """White noise on the observation, drawn anew for each control step; standard deviations.

    Raises:
        ValueError: if one is negative or not finite.
    """

    position: float = 0.0
    """[m]"""
    rotation: float = 0.0
    """[rad]"""
    velocity: float = 0.0
    """[m/s]"""
    rotation_rate: float = 0.0
    """[rad/s]"""
    motor_angle: float = 0.0
    """β′ where flexible [rad]"""
    motor_speed: float = 0.0
    """β̇′ where flexible [rad/s]"""

    def __post_init__(self) -> None:
        for item in fields(self):
            value = _number(item.name, getattr(self, item.name))
            if value < 0:
                raise ValueError(f"sensors: {item.name} must be at least 0, not {value:g}")
            object.__setattr__(self, item.name, value)

    def deviations(self, robot: Robot) -> Array:
        """Of the observation's measured part: pose, velocity and, where flexible, motor angle and speed."""
        turns = robot.coordinates - min(robot.coordinates, 3)
        places = robot.coordinates - turns
        parts = [self.position] * places + [self.rotation] * turns
        parts += [self.velocity] * places + [self.rotation_rate] * turns
        if robot.flexible:
            parts += [self.motor_angle] * robot.cables + [self.motor_speed] * robot.cables
        return np.array(parts)


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """Everything that a controller does not know. The default is: nothing.

    Raises:
        ValueError: if a parameter is unknown, a position's spread is relative, or ``delay`` is no whole number.
    """

    parameters: Mapping[str, Spread] = field(default_factory=dict)
    """Spread of each uncertain parameter, names out of :data:`PARAMETERS`."""
    wrench: ExternalWrench | None = None
    """On the platform."""
    sensors: SensorNoise | None = None
    """On the observation."""
    delay: int = 0
    """Control steps by which a drive command arrives late. Until the first one arrives the motors hold the start, the
    true payload included; ``info["drive_demand"]`` is the command that arrives, and the last ones sent never do."""

    def __post_init__(self) -> None:
        if not isinstance(self.parameters, Mapping):
            raise ValueError(f"parameters must be a dict with keys out of {', '.join(PARAMETERS)}")
        kinds = [("wrench", self.wrench, ExternalWrench), ("sensors", self.sensors, SensorNoise)]
        for name, value, kind in kinds:
            if value is not None and not isinstance(value, kind):
                raise ValueError(f"{name} must be of {kind.__name__} or None, not {value!r}")
        for name, spread in self.parameters.items():
            if name not in PARAMETERS:
                raise ValueError(f"unknown uncertain parameter {name!r}; choose out of {', '.join(PARAMETERS)}")
            if not isinstance(spread, Spread):
                raise ValueError(f"{name} needs a Spread, not {spread!r}")
            if PARAMETERS[name].place and spread.relative:
                raise ValueError(f"{name}: a position has no share of itself: give the spread in m with relative=False")
        whole = isinstance(self.delay, (int, np.integer)) and not isinstance(self.delay, bool)
        if not whole or not 0 <= self.delay <= LONGEST_DELAY:
            raise ValueError(f"delay must be 0 to {LONGEST_DELAY} whole control steps, not {self.delay!r}")
        object.__setattr__(self, "delay", int(self.delay))
        object.__setattr__(self, "parameters", dict(self.parameters))

    def __hash__(self) -> int:
        return hash((frozenset(self.parameters.items()), self.wrench, self.sensors, self.delay))

    @property
    def random(self) -> bool:
        """Whether two episodes can differ."""
        spread = any(spread.low < spread.high for spread in self.parameters.values())
        noisy = self.sensors is not None and any(getattr(self.sensors, item.name) > 0 for item in fields(SensorNoise))
        return spread or noisy or (self.wrench is not None and self.wrench.random)

    def check(self, robot: Robot) -> None:
        """Refuses what is impossible for a robot.

        Raises:
            ValueError: if the robot lacks an uncertain parameter, or a drawn value would not be physical.
        """
        for name, spread in self.parameters.items():
            parameter = PARAMETERS[name]
            if (parameter.flexible and not robot.flexible) or (parameter.spatial and robot.planar):
                raise ValueError(f"{robot.name!r} has no {name} that could be uncertain: leave it out")
            if parameter.place:
                continue
            nominal = np.asarray(0.0 if name == "payload" else getattr(robot, parameter.attribute))
            least = float(np.min(spread.applied(nominal, np.asarray(spread.low))))
            if name == "payload" and not spread.relative:
                continue  # any payload may be asked for; what is drawn below zero counts as zero
            if name == "payload":
                if spread.low < -1:
                    raise ValueError(f"payload can lose {-spread.low:.0%} of itself: low has to be at least -1")
                continue
            if least < 0 or (least == 0 and parameter.positive):
                bound = "stay above" if parameter.positive else "not fall below"
                raise ValueError(f"{name} of {robot.name!r} can reach {least:g}; it has to {bound} 0: raise low")
            if name == "platform_inertia":
                self._check_axes(robot, spread)
        if self.wrench is not None:
            self.wrench.statistics(robot)

    def _check_axes(self, robot: Robot, spread: Spread) -> None:
        moments = np.asarray(robot.inertia)
        least, most = (spread.applied(moments, np.asarray(end)) for end in (spread.low, spread.high))
        # With one deviation for all, the three moments stand at the same end.
        for others, own in ((least, most),) if spread.each else ((least, least), (most, most)):
            if np.any(np.sum(others) - others < own * (1 - 1e-9)):
                raise ValueError(
                    "platform_inertia: one moment can exceed the sum of the others, which no body has: "
                    "draw one relative deviation for all with each=False, or narrow the spread"
                )

    def draw(self, robot: Robot, payload: Array, uniform: Array) -> TrueRobots:
        """The true robots of N episodes.

        Args:
            robot: nominal robot, for which :meth:`check` has passed.
            payload: nominal payloads, (N,) [kg].
            uniform: numbers in [0, 1), (N, :func:`draw_size`). A parameter reads its own ones alone, so that adding
                another one changes nothing of its draw.
        """
        deviations = {}
        for name, (start, shape) in _places(robot).items():
            if name in self.parameters:
                spread, size = self.parameters[name], math.prod(shape)
                numbers = uniform[:, start : start + (size if spread.each else 1)]
                numbers = np.broadcast_to(numbers, (len(uniform), size)).reshape(len(uniform), *shape)
                deviations[name] = spread.deviation(numbers)
        return self._deviated(robot, payload, deviations)

    def fastest(self, robot: Robot) -> TrueRobots:
        """One robot of this set, the one whose motors swing and settle fastest: for the choice of a physics step."""
        deviations = {}
        for name, spread in self.parameters.items():
            if name != "payload" and not PARAMETERS[name].place:
                end = spread.low if PARAMETERS[name].slows else spread.high
                deviations[name] = np.full((1, *_places(robot)[name][1]), end)
        return self._deviated(robot, np.zeros(1), deviations)

    def _deviated(self, robot: Robot, payload: Array, deviations: Mapping[str, Array]) -> TrueRobots:
        count = len(payload)

        def true(name: str, nominal: Any) -> Array:
            values = np.broadcast_to(np.asarray(nominal, float), (count, *np.shape(nominal)))
            return self.parameters[name].applied(values, deviations[name]) if name in deviations else values

        strength = true("motor_strength", robot.stall_torque)
        springs = {
            name: true(name, getattr(robot, name)) if robot.flexible else np.zeros((count, robot.cables))
            for name in ("stiffness", "motor_inertia", "motor_damping")
        }
        load = (
            self.parameters["payload"].applied(payload, deviations["payload"]) if "payload" in deviations else payload
        )
        return TrueRobots(
            planar=robot.planar,
            flexible=robot.flexible,
            cables=robot.cables,
            coordinates=robot.coordinates,
            home=robot.home,
            gravity=robot.gravity,
            pulley_radius=robot.pulley_radius,
            mass=true("platform_mass", robot.mass),
            payload=np.maximum(load, 0.0),
            inertia=true("platform_inertia", robot.inertia),
            base=true("base_anchors", robot.base),
            platform=true("platform_anchors", robot.platform),
            pulley_inertia=true("pulley_inertia", robot.pulley_inertia),
            damping=true("damping", robot.damping),
            stall_torque=strength,
            speed_slope=robot.speed_slope * strength / robot.stall_torque,
            **springs,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueRobots:
    """The plants of N episodes. Reads like a :class:`~cablebot_gym.robots.Robot` whose values have a leading axis N."""

    planar: bool
    """As nominal."""
    flexible: bool
    """As nominal."""
    cables: int
    """m, as nominal."""
    coordinates: int
    """n, as nominal."""
    home: Array
    """X₀ (n,), as nominal: cables are measured from where the true robot has this pose."""
    gravity: float
    """As nominal [m/s²]."""
    pulley_radius: Array
    """r (m,), as nominal [m]."""
    mass: Array
    """Platform (N,) [kg]."""
    payload: Array
    """(N,) [kg]; ≥ 0."""
    inertia: Array
    """Principal moments (N, 3), or (N, 0) if planar [kg·m²]."""
    base: Array
    """Base anchors (N, m, 2 or 3) [m]."""
    platform: Array
    """Platform anchors (N, m, 2 or 3) [m]."""
    pulley_inertia: Array
    """J (N, m) [kg·m²]."""
    damping: Array
    """c (N, m) [N·m·s/rad]."""
    stall_torque: Array
    """τ_s (N, m) [N·m]."""
    speed_slope: Array
    """τ_s/ω_n (N, m) [N·m·s/rad]."""
    stiffness: Array
    """K (N, m) [N·m/rad]; zeros if rigid."""
    motor_inertia: Array
    """J′ (N, m) [kg·m²]; zeros if rigid."""
    motor_damping: Array
    """c′ (N, m) [N·m·s/rad]; zeros if rigid."""


def draw_size(robot: Robot) -> int:
    """How many uniform numbers :meth:`Uncertainty.draw` reads for one episode."""
    return sum(math.prod(shape) for _, shape in _places(robot).values())


def _places(robot: Robot) -> dict[str, tuple[int, tuple[int, ...]]]:
    """First uniform number and shape of each parameter."""
    shapes: dict[str, tuple[int, ...]] = {name: (robot.cables,) for name in PARAMETERS}
    shapes |= {"platform_mass": (), "payload": (), "platform_inertia": (3,)}
    shapes |= {"base_anchors": robot.base.shape, "platform_anchors": robot.platform.shape}
    places, start = {}, 0
    for name, shape in shapes.items():
        places[name] = (start, shape)
        start += math.prod(shape)
    return places


def _table6(robot: Robot) -> Uncertainty:
    tenth = Spread(low=-0.1, high=0.1, each=False)
    flexible = {"stiffness": tenth} if robot.flexible else {}
    wrench = ExternalWrench(force_mean=0.5, force_std=math.sqrt(0.2), correlation_time=0.01, factor=(0.9, 1.1))
    return Uncertainty(parameters={"platform_mass": tenth, **flexible}, wrench=wrench)


def _sensors(robot: Robot) -> Uncertainty:
    noise = SensorNoise(
        position=1e-4, rotation=2e-4, velocity=2e-3, rotation_rate=4e-3, motor_angle=1e-3, motor_speed=1e-2
    )
    return Uncertainty(sensors=noise)


UNCERTAINTIES = {"none": lambda robot: Uncertainty(), "table6": _table6, "sensors": _sensors}
"""Sets by name. ``table6``: the paper's Table 6, mass and, where flexible, K (one deviation for all joints) uniform
± 10 %, and three forces N(0.5 N, variance 0.2 N²), redrawn every 10 ms, each times a factor uniform in [0.9, 1.1].
``sensors``: 0.1 mm, 0.2 mrad, 2 mm/s, 4 mrad/s, motors 1 mrad and 10 mrad/s."""


def find_uncertainty(uncertainty: str | dict[str, Any] | Uncertainty | None, robot: Robot) -> Uncertainty:
    """An uncertainty for a robot from a name, names joined by ``+``, JSON-able data, itself, or None: no uncertainty.

    Args:
        uncertainty: such as ``"table6"``, ``"table6+sensors"``, or ``{"parameters": {"stiffness": {"low": -0.2,
            "high": 0.2}}, "wrench": {"force_std": 1.0}, "sensors": {"position": 1e-4}, "delay": 1}``.
        robot: nominal robot.

    Raises:
        ValueError: if a name or a field is unknown, or the set is impossible for the robot.
    """
    if uncertainty is None:
        return Uncertainty()
    if isinstance(uncertainty, str):
        found = _joined(uncertainty, robot)
    elif isinstance(uncertainty, Mapping):
        found = _from_data(uncertainty)
    elif isinstance(uncertainty, Uncertainty):
        found = uncertainty
    else:
        raise ValueError(
            f"{uncertainty!r} is no uncertainty: pass one of {', '.join(UNCERTAINTIES)}, names joined by '+', "
            f"a dict with keys out of {', '.join(_FIELDS)}, or an Uncertainty"
        )
    found.check(robot)
    return found


def _joined(names: str, robot: Robot) -> Uncertainty:
    merged: dict[str, Any] = {}
    for name in names.split("+"):
        if name not in UNCERTAINTIES:
            raise ValueError(no_such("uncertainty", name, UNCERTAINTIES, ", or join some by '+'"))
        one = UNCERTAINTIES[name](robot)
        given = {key: getattr(one, key) for key in _FIELDS if getattr(one, key)}
        if twice := set(given) & set(merged):
            raise ValueError(f"uncertainty {names!r} gives {sorted(twice)[0]} twice: leave one name out")
        merged |= given
    return Uncertainty(**merged)


def _from_data(data: Mapping[str, Any]) -> Uncertainty:
    if unknown := [key for key in data if key not in _FIELDS]:
        raise ValueError(f"unknown field {unknown[0]!r} of an uncertainty; the fields are {', '.join(_FIELDS)}")
    values = {key: value for key, value in data.items() if value is not None}
    if isinstance(spreads := values.get("parameters", {}), Mapping):
        values["parameters"] = {name: _made(Spread, spread, f"spread of {name}") for name, spread in spreads.items()}
    for key, kind in (("wrench", ExternalWrench), ("sensors", SensorNoise)):
        if key in values:
            values[key] = _made(kind, values[key], key)
    return Uncertainty(**values)


def _made(kind: type, data: Any, what: str) -> Any:
    if isinstance(data, kind):
        return data
    known = [item.name for item in fields(kind)]
    if not isinstance(data, Mapping) or set(data) - set(known):
        raise ValueError(f"{what} must be a dict with keys out of {', '.join(known)}, not {data!r}")
    try:
        return kind(**data)
    except TypeError as error:
        raise ValueError(f"{what}: {error}") from error


_FIELDS = [item.name for item in fields(Uncertainty)]


def _number(name: str, value: Any) -> float:
    if not isinstance(value, Real) or isinstance(value, bool) or not math.isfinite(value):
        raise ValueError(f"{name} must be a finite number, not {value!r}")
    return float(value)


def _numbers(name: str, value: Any) -> Array:
    try:
        numbers = np.asarray(value)
        if numbers.dtype.kind in "iuf" and np.all(np.isfinite(numbers)):
            return numbers.astype(float)
    except ValueError:
        pass
    raise ValueError(f"{name} must be finite numbers, not {value!r}")
