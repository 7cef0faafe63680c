"""Differences between the true robot and the controller's model, as data.

An :class:`Uncertainty` defines four things: the distributions of the true parameters around the
nominal robot, the external wrench on the platform, noise and bias of the observation, and the delay
of the actions. The caller supplies the random numbers; this module has no state and no seed. Every
draw starts from the nominal robot.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import POSE, Measurement
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import all_finite, choice, mapping, number, numbers, record, whole
from cablebot_gym.utils.files import JSON_FORM, check_not_a_file

Distribution = Literal["uniform", "normal"]

LONGEST_DELAY = 1000
"""Largest actuation delay [control steps]."""


@dataclass(frozen=True, kw_only=True)
class ParameterDistribution:
    """Distribution of the deviation of a parameter from its nominal value. It is drawn once per
    episode.

    Raises:
        ValueError: if ``low`` > ``high``, a number is not finite, or ``std`` does not match
            ``distribution``.
    """

    low: float
    """Smallest deviation, as a fraction of the nominal value, or in its unit if not
    ``relative``."""
    high: float
    """Largest deviation, in the same unit as ``low``."""
    distribution: Distribution = "uniform"
    """Shape of the distribution between the bounds. ``normal`` is truncated at the bounds."""
    mean: float = 0.0
    """Mean of the normal distribution before truncation; has no effect if uniform."""
    std: float | None = None
    """Standard deviation of the normal distribution before truncation; > 0. None if uniform."""
    relative: bool = True
    """Whether the deviation is a fraction of the nominal value. A nominal value of zero then stays
    zero."""
    each: bool = True
    """Whether each motor, axis or coordinate has its own draw. False: all of them have the same
    deviation."""

    def __post_init__(self) -> None:
        for name in ("low", "high", "mean"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        for name in ("relative", "each"):
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise ValueError(f"{name} must be True or False, not {getattr(self, name)!r}")
        if self.low > self.high:
            raise ValueError(
                f"low must not exceed high, but they are {self.low:g} and {self.high:g}; exchange them"
            )
        choice("distribution", self.distribution, get_args(Distribution))
        if (self.distribution == "normal") != (self.std is not None):
            raise ValueError("a normal distribution needs std and a uniform one has none")
        if self.std is not None:
            object.__setattr__(self, "std", number("std", self.std, above=0))
            if not self.low < self.mean + 8 * self.std or not self.high > self.mean - 8 * self.std:
                raise ValueError(
                    "low and high must lie within eight std of the mean; change them, mean or std"
                )

    def deviation(self, uniform: Array) -> Array:
        """Deviations from numbers that are uniform in [0, 1), by the inverse cumulative
        distribution function.

        Raises:
            ValueError: if a number is not finite.
        """
        all_finite("uniform", uniform)
        if self.std is None:
            return self.low + (self.high - self.low) * uniform
        from scipy.special import ndtr, ndtri  # slow to import

        bounds = (np.array([self.low, self.high]) - self.mean) / self.std
        side = (
            -1.0 if bounds[0] > 0 else 1.0
        )  # the upper tail is mirrored: ndtr loses digits near 1
        first, last = ndtr(side * bounds)
        drawn = self.mean + self.std * side * ndtri(first + (last - first) * uniform)
        return np.asarray(np.clip(drawn, self.low, self.high))

    def applied(self, nominal: Array, deviation: Array) -> Array:
        """The true value for a nominal value and a deviation in the unit of ``low`` and
        ``high``."""
        all_finite("nominal", nominal)
        all_finite("deviation", deviation)
        return nominal * (1 + deviation) if self.relative else nominal + deviation


@dataclass(frozen=True, kw_only=True)
class _Parameter:
    """Properties of one uncertain parameter."""

    attribute: str
    """Name of the attribute of :class:`~cablebot_gym.robots.record.Robot`."""
    unit: str
    """SI unit."""
    positive: bool
    """Whether the value must be greater than 0."""
    jointed: bool = False
    """Whether only robots with joint springs have the parameter."""
    turns: bool = False
    """Whether only robots whose platform turns have the parameter."""
    elastic: bool = False
    """Whether only robots with elastic cables have the parameter."""
    position: bool = False
    """Whether the parameter is a position, which may have either sign."""
    lowers_frequency: bool = False
    """Whether a larger value lowers the natural frequencies of a flexible robot."""

    def belongs_to(self, robot: Robot) -> bool:
        """Whether a robot has the parameter."""
        lacking = (self.jointed and not robot.jointed) or (self.elastic and not robot.elastic)
        return not lacking and not (self.turns and robot.point_mass)


PARAMETERS: Mapping[str, _Parameter] = MappingProxyType(
    {
        "platform_mass": _Parameter(
            attribute="mass", unit="kg", positive=True, lowers_frequency=True
        ),
        "payload": _Parameter(attribute="payload", unit="kg", positive=False),
        "platform_inertia": _Parameter(
            attribute="moments", unit="kg·m²", positive=True, turns=True, lowers_frequency=True
        ),
        "pulley_inertia": _Parameter(
            attribute="pulley_inertia", unit="kg·m²", positive=False, lowers_frequency=True
        ),
        "damping": _Parameter(attribute="damping", unit="N·m·s/rad", positive=False),
        "stiffness": _Parameter(attribute="stiffness", unit="N·m/rad", positive=True, jointed=True),
        "motor_inertia": _Parameter(
            attribute="motor_inertia",
            unit="kg·m²",
            positive=True,
            jointed=True,
            lowers_frequency=True,
        ),
        "motor_damping": _Parameter(
            attribute="motor_damping", unit="N·m·s/rad", positive=False, jointed=True
        ),
        "motor_strength": _Parameter(attribute="stall_torque", unit="N·m", positive=True),
        "base_anchors": _Parameter(attribute="base", unit="m", positive=False, position=True),
        "platform_anchors": _Parameter(
            attribute="platform", unit="m", positive=False, turns=True, position=True
        ),
        "motor_lag": _Parameter(attribute="motor_lag", unit="s", positive=False),
        "coulomb_friction": _Parameter(attribute="coulomb_friction", unit="N·m", positive=False),
        "axial_stiffness": _Parameter(
            attribute="axial_stiffness", unit="N", positive=True, elastic=True
        ),
    }
)
"""The parameters that may be uncertain. ``motor_strength`` scales the stall torque; the free speed
does not change."""


@dataclass(frozen=True, kw_only=True)
class ExternalWrench:
    """Random forces and moments on the platform. The components are independent, normal and
    piecewise constant.

    Raises:
        ValueError: if a number is not finite, is negative where it must not be, or has the wrong
            shape.
    """

    force_mean: float | tuple[float, ...] = 0.0
    """Mean force along the axes of the base frame [N], one value for all axes or one per axis
    (planar: x, y)."""
    force_std: float | tuple[float, ...] = 0.0
    """Standard deviation of the force [N], one value for all axes or one per axis; ≥ 0."""
    moment_mean: float | tuple[float, ...] = 0.0
    """Mean moment about the axes of the base frame at the centre of mass [N·m], one value in a
    plane; not for a point mass."""
    moment_std: float | tuple[float, ...] = 0.0
    """Standard deviation of the moment [N·m]; ≥ 0."""
    correlation_time: float = 0.01
    """Time between two draws [s]; > 0. It is rounded to whole control periods, at least one."""
    factor: tuple[float, float] = (1.0, 1.0)
    """(low, high) of a uniform factor, which is drawn once per episode for each component."""

    def __post_init__(self) -> None:
        for name in ("force_mean", "force_std", "moment_mean", "moment_std"):
            least = 0.0 if name.endswith("std") else -math.inf
            form = "one number or one per axis"
            values = numbers(
                name, getattr(self, name), shapes=[(), (2,), (3,)], form=form, least=least
            ).tolist()
            object.__setattr__(self, name, tuple(values) if isinstance(values, list) else values)
        object.__setattr__(
            self,
            "correlation_time",
            number("correlation_time", self.correlation_time, above=0, unit="s"),
        )
        low, high = numbers("factor", self.factor, shapes=[(2,)], form="(low, high)").tolist()
        if low > high:
            raise ValueError(f"factor must be (low, high) with low ≤ high, not {self.factor!r}")
        object.__setattr__(self, "factor", (low, high))

    @property
    def random(self) -> bool:
        """Whether two draws can differ."""
        varies = any(np.any(np.asarray(std) > 0) for std in (self.force_std, self.moment_std))
        return varies or self.factor[0] < self.factor[1]

    def statistics(self, robot: Robot) -> tuple[Array, Array]:
        """Mean and standard deviation of the components (force, then moment), each of shape (n,).

        Raises:
            ValueError: if the length of a tuple is not the number of axes of the robot.
        """
        sizes = {"force": robot.dimensions, "moment": robot.coordinates - robot.dimensions}

        def components(statistic: str) -> Array:
            values = []
            for kind, axes in sizes.items():
                value = np.asarray(getattr(self, f"{kind}_{statistic}"))
                if axes and value.shape not in ((), (axes,)):
                    raise ValueError(
                        f"wrench: {kind}_{statistic} needs {axes} components for {robot.name!r}"
                    )
                values.append(np.broadcast_to(value if axes else 0.0, (axes,)))
            return np.concatenate(values)

        return components("mean"), components("std")


@dataclass(frozen=True, kw_only=True)
class SensorNoise:
    """Standard deviations of normal errors of the observation.

    White noise is drawn in every control step, a bias once per episode.

    Raises:
        ValueError: if a value is negative or not finite.
    """

    position: float = 0.0
    """Standard deviation of x, y and z [m]; ≥ 0."""
    rotation: float = 0.0
    """Standard deviation of ψ, θ and φ [rad]; ≥ 0."""
    velocity: float = 0.0
    """Standard deviation of the velocity [m/s]; ≥ 0."""
    rotation_rate: float = 0.0
    """Standard deviation of the Euler angle rates [rad/s]; ≥ 0."""
    motor_angle: float = 0.0
    """Standard deviation of the motor angle β′ of a flexible robot, or of any winch [rad]; ≥ 0."""
    motor_speed: float = 0.0
    """Standard deviation of the motor speed β̇′ of a flexible robot, or of any winch [rad/s]; ≥
    0."""
    tension: float = 0.0
    """Standard deviation of the tension at a load cell [N]; ≥ 0."""
    tilt: float = 0.0
    """Standard deviation of the roll ψ and pitch θ of an IMU [rad]; ≥ 0."""
    yaw: float = 0.0
    """Standard deviation of the yaw φ of an IMU [rad]; ≥ 0."""
    angular_rate: float = 0.0
    """Standard deviation of the angular rate of an IMU [rad/s]; ≥ 0."""
    specific_force: float = 0.0
    """Standard deviation of the specific force of an IMU [m/s²]; ≥ 0."""

    def __post_init__(self) -> None:
        for item in fields(self):
            object.__setattr__(
                self, item.name, number(f"sensors.{item.name}", getattr(self, item.name), least=0)
            )

    def deviations(self, robot: Robot, measurement: Measurement = POSE) -> Array:
        """Standard deviations of the components of the measured blocks of the observation."""
        positions = robot.dimensions
        rotations = robot.coordinates - robot.dimensions
        values: dict[str, ArrayLike] = {
            "pose": [self.position] * positions + [self.rotation] * rotations,
            "velocity": [self.velocity] * positions + [self.rotation_rate] * rotations,
            "motor_angle": self.motor_angle,
            "motor_speed": self.motor_speed,
            "tensions": self.tension,
            "orientation": [self.tilt, self.tilt, self.yaw],
            "angular_rate": self.angular_rate,
            "specific_force": self.specific_force,
        }
        sizes = measurement.sizes(robot)
        return np.concatenate([np.broadcast_to(values[name], size) for name, size in sizes.items()])


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """All uncertainty of an episode. The default is no uncertainty.

    Raises:
        ValueError: if a parameter is unknown, the deviation of a position is relative, or ``delay``
            is invalid.
    """

    parameters: Mapping[str, ParameterDistribution] = field(default_factory=dict)
    """Distribution of each uncertain parameter; the keys are names of :data:`PARAMETERS`."""
    wrench: ExternalWrench | None = None
    """External wrench on the platform; None for none."""
    sensors: SensorNoise | None = None
    """White noise of the observation; None for none."""
    sensor_bias: SensorNoise | None = None
    """Bias of the observation; None for none."""
    delay: int | tuple[int, int] = 0
    """Delay of the actions [control steps], or (low, high) of a delay drawn once per episode; ≥ 0.

    Until the first action takes effect, the motors hold the robot at the start with its true
    payload. ``info["commanded_action"]`` is the delayed action. The last ``delay`` actions of an
    episode never take effect.
    """

    def __post_init__(self) -> None:
        parameters = mapping("parameters", self.parameters, PARAMETERS)
        for name, given in parameters.items():
            parameters[name] = record(f"distribution of {name}", ParameterDistribution, given)
            if PARAMETERS[name].position and parameters[name].relative:
                raise ValueError(
                    f"{name}: a position has no relative deviation; give it in m with relative=False"
                )
        object.__setattr__(self, "parameters", parameters)
        if self.wrench is not None:
            object.__setattr__(self, "wrench", record("wrench", ExternalWrench, self.wrench))
        for name in ("sensors", "sensor_bias"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, record(name, SensorNoise, getattr(self, name)))
        object.__setattr__(self, "delay", _checked_delay(self.delay))

    def __hash__(self) -> int:
        return hash(
            (
                frozenset(self.parameters.items()),
                self.wrench,
                self.sensors,
                self.sensor_bias,
                self.delay,
            )
        )

    @property
    def delay_range(self) -> tuple[int, int]:
        """Least and largest delay [control steps]."""
        return self.delay if isinstance(self.delay, tuple) else (self.delay, self.delay)

    @property
    def random(self) -> bool:
        """Whether two episodes can differ."""
        varies = any(
            distribution.low < distribution.high for distribution in self.parameters.values()
        )
        sensors = [one for one in (self.sensors, self.sensor_bias) if one is not None]
        noisy = any(getattr(one, item.name) > 0 for one in sensors for item in fields(SensorNoise))
        late = self.delay_range[0] < self.delay_range[1]
        return varies or noisy or late or (self.wrench is not None and self.wrench.random)

    def check(self, robot: Robot) -> None:
        """Checks that the uncertainty is possible for a robot.

        Raises:
            ValueError: if the robot does not have an uncertain parameter, or a drawn value would
                not be physical.
        """
        for name, distribution in self.parameters.items():
            parameter = PARAMETERS[name]
            if not parameter.belongs_to(robot):
                raise ValueError(
                    f"{robot.name!r} has no parameter {name}; leave it out of the uncertainty"
                )
            if name == "payload":  # draw() clips a negative absolute payload to zero
                if distribution.relative:
                    number("low of payload", distribution.low, least=-1)
            elif not parameter.position:
                nominal = np.asarray(getattr(robot, parameter.attribute))
                least = float(np.min(distribution.applied(nominal, np.asarray(distribution.low))))
                divides = name == "pulley_inertia" and robot.elastic
                above = 0.0 if parameter.positive or divides else -math.inf
                number(
                    f"smallest {name} of {robot.name!r}",
                    least,
                    above=above,
                    least=0.0,
                    unit=parameter.unit,
                )
        if "platform_inertia" in self.parameters:
            self._check_inertia(robot, self.parameters["platform_inertia"])
        if self.wrench is not None:
            self.wrench.statistics(robot)

    def _check_inertia(self, robot: Robot, distribution: ParameterDistribution) -> None:
        if robot.planar:
            return
        moments = robot.moments
        least, most = (
            distribution.applied(moments, np.asarray(end))
            for end in (distribution.low, distribution.high)
        )
        # With each=False, all three moments have the same deviation.
        for others, own in (
            ((least, most),) if distribution.each else ((least, least), (most, most))
        ):
            if np.any(np.sum(others) - others < own * (1 - 1e-9)):
                raise ValueError(
                    "platform_inertia: one moment can exceed the sum of the other two; use a relative deviation "
                    "with each=False, or move low and high closer together"
                )

    def draw(self, robot: Robot, payload: Array, uniform: Array) -> RobotBatch:
        """Draws the true robots of N episodes.

        Args:
            robot: nominal robot, for which :meth:`check` has passed.
            payload: nominal payloads, shape (N,) [kg].
            uniform: numbers in [0, 1), shape (N, :func:`draw_size`). Each parameter has its own
                columns, so adding an uncertain parameter does not change the draws of the others.

        Raises:
            ValueError: if a number is not finite.
        """
        all_finite("payload", payload)
        all_finite("uniform", uniform)
        deviations = {}
        for name, (start, shape) in _columns(robot).items():
            if name in self.parameters:
                distribution, size = self.parameters[name], math.prod(shape)
                numbers = uniform[:, start : start + (size if distribution.each else 1)]
                numbers = np.broadcast_to(numbers, (len(uniform), size)).reshape(
                    len(uniform), *shape
                )
                deviations[name] = distribution.deviation(numbers)
        return self._true_robots(robot, payload, deviations)

    def fastest(self, robot: Robot) -> RobotBatch:
        """The possible robot with the fastest motor dynamics. It determines the physics step."""
        deviations = {}
        for name, distribution in self.parameters.items():
            if name != "payload" and not PARAMETERS[name].position:
                deviation = (
                    distribution.low if PARAMETERS[name].lowers_frequency else distribution.high
                )
                deviations[name] = np.full((1, *_columns(robot)[name][1]), deviation)
        return self._true_robots(robot, np.zeros(1), deviations)

    def _true_robots(
        self, robot: Robot, payload: Array, deviations: Mapping[str, Array]
    ) -> RobotBatch:
        count = len(payload)
        values: dict[str, Array] = {}
        for name, parameter in PARAMETERS.items():
            if not parameter.belongs_to(robot):
                continue
            nominal = payload
            if name != "payload":
                value = np.asarray(getattr(robot, parameter.attribute), float)
                nominal = np.broadcast_to(value, (count, *value.shape))
            if name in deviations:
                nominal = self.parameters[name].applied(nominal, deviations[name])
            values[parameter.attribute] = nominal
        values["payload"] = np.maximum(values["payload"], 0.0)
        values["speed_slope"] = robot.speed_slope * values["stall_torque"] / robot.stall_torque
        if not robot.point_mass:
            values["inertia_tensor"] = _scaled_tensor(robot, values["moments"])
        return RobotBatch(robot, values)


def _scaled_tensor(robot: Robot, moments: Array) -> Array:
    """Inertia tensors (N, 3, 3) with the given moments; products grow as the roots of the moments
    they belong to."""
    factor = np.ones((len(moments), 3))
    factor[:, 3 - moments.shape[-1] :] = np.sqrt(moments / robot.moments)
    scaled: Array = robot.inertia_tensor * factor[:, :, None] * factor[:, None, :]
    index = np.arange(3 - moments.shape[-1], 3)
    scaled[:, index, index] = moments
    return scaled


def _checked_delay(delay: Any) -> int | tuple[int, int]:
    if not isinstance(delay, (tuple, list)):
        return whole("delay", delay, most=LONGEST_DELAY)
    if len(delay) != 2:
        raise ValueError(f"delay must be one number of control steps or (low, high), not {delay!r}")
    low = whole("low of delay", delay[0], most=LONGEST_DELAY)
    return low, whole("high of delay", delay[1], least=low, most=LONGEST_DELAY)


class RobotBatch:
    """N robots: the attributes of the nominal :class:`~cablebot_gym.robots.record.Robot`, and values with
    a leading axis N.

    Args:
        nominal: the robot whose attributes all N robots share.
        values: arrays (N, …) by the name of the attribute that they replace, and ``payload`` (N,)
            [kg].
    """

    mass: Array
    payload: Array
    stall_torque: Array

    def __init__(self, nominal: Robot, values: Mapping[str, Array]) -> None:
        self.nominal = nominal
        self.__dict__.update(values)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.nominal, name)


RobotArrays = Robot | RobotBatch
"""Robots as the equations see them: one robot, or N robots with values of their own."""


def draw_size(robot: Robot) -> int:
    """Number of uniform numbers that :meth:`Uncertainty.draw` needs per episode."""
    return sum(math.prod(shape) for _, shape in _columns(robot).values())


def _columns(robot: Robot) -> dict[str, tuple[int, tuple[int, ...]]]:
    """First column of the uniform numbers and shape of each parameter."""
    shapes: dict[str, tuple[int, ...]] = {}
    for name, parameter in PARAMETERS.items():
        if name == "payload":
            shapes[name] = ()
        elif name == "platform_inertia" and robot.point_mass:
            shapes[name] = (3,)
        elif parameter.jointed and not robot.jointed:
            shapes[name] = (robot.cables,)
        elif robot.elastic or not parameter.elastic:
            shapes[name] = np.shape(getattr(robot, parameter.attribute))
    columns, start = {}, 0
    for name, shape in shapes.items():
        columns[name] = (start, shape)
        start += math.prod(shape)
    return columns


def _table6(robot: Robot) -> Uncertainty:
    tenth = ParameterDistribution(low=-0.1, high=0.1, each=False)
    flexible = {"stiffness": tenth} if robot.jointed else {}
    wrench = ExternalWrench(
        force_mean=0.5, force_std=math.sqrt(0.2), correlation_time=0.01, factor=(0.9, 1.1)
    )
    return Uncertainty(parameters={"platform_mass": tenth, **flexible}, wrench=wrench)


def _table6_load(robot: Robot) -> Uncertainty:
    paper = _table6(robot)
    load = ParameterDistribution(low=-0.1, high=0.1, each=False)
    return dataclasses.replace(paper, parameters={**paper.parameters, "payload": load})


def _hardware(robot: Robot) -> Uncertainty:
    def within(
        low: float, high: float, *, relative: bool = True, each: bool = True
    ) -> ParameterDistribution:
        return ParameterDistribution(low=low, high=high, relative=relative, each=each)

    stall = float(robot.stall_torque.min())
    parameters = {
        "platform_mass": within(-0.03, 0.03),
        "payload": within(-0.03, 0.03),
        "motor_strength": within(-0.03, 0.03),
        "motor_lag": within(1e-3, 2e-3, relative=False, each=False),
        "coulomb_friction": within(0.005 * stall, 0.015 * stall, relative=False),
        "pulley_inertia": within(-0.1, 0.1),
        "base_anchors": within(-1.5e-3, 1.5e-3, relative=False),
    }
    viscous = within(0.0, 1.3e-3, relative=False)
    if robot.jointed:
        spring = within(-0.05, 0.05)  # with 10 % it would dominate: FlexPlanar laws fail unloaded
        parameters |= {
            "motor_damping": viscous,
            "motor_inertia": within(-0.1, 0.1),
            "stiffness": spring,
        }
    else:
        parameters["damping"] = viscous
    if robot.elastic:
        parameters["axial_stiffness"] = within(-0.3, 0.3, each=False)
    if not robot.point_mass:
        parameters["platform_inertia"] = within(-0.1, 0.1, each=False)
        parameters["platform_anchors"] = within(-0.5e-3, 0.5e-3, relative=False)
    return Uncertainty(
        parameters=parameters,
        wrench=ExternalWrench(force_std=0.5, moment_std=0.05, correlation_time=0.1),
        sensors=SensorNoise(
            position=1e-4,
            rotation=2e-4,
            velocity=2e-3,
            rotation_rate=4e-3,
            motor_angle=2e-4,
            motor_speed=1e-2,
        ),
        sensor_bias=SensorNoise(position=1.5e-4, rotation=3.5e-4),
        delay=(0, 1),
    )


def _sensors(robot: Robot) -> Uncertainty:
    noise = SensorNoise(
        position=1e-4,
        rotation=2e-4,
        velocity=2e-3,
        rotation_rate=4e-3,
        motor_angle=1e-3,
        motor_speed=1e-2,
    )
    return Uncertainty(sensors=noise)


UNCERTAINTIES = {
    "none": lambda robot: Uncertainty(),
    "table6": _table6,
    "table6-load": _table6_load,
    "hardware": _hardware,
    "sensors": _sensors,
}
"""Uncertainties by name; each value is a function of the nominal robot.

* ``none``: no uncertainty.
* ``table6``: Table 6 of the paper. The platform mass and, if flexible, K (one deviation for all
  joints) are uniform within ± 10 %. Three forces are normal with mean 0.5 N and variance 0.2 N²,
  redrawn every 10 ms, each times a factor that is uniform in [0.9, 1.1].
* ``table6-load``: the same, and the payload is uniform within ± 10 %, too. Table 6 varies the mass
  of Table 4, 11 kg with a load of 1 kg.
* ``hardware``: what a real winch robot does not know. The page on uncertainty lists the source of
  each range.
* ``sensors``: noise of 0.1 mm, 0.2 mrad, 2 mm/s and 4 mrad/s, of the motors 1 mrad and 10 mrad/s.
"""


def find_uncertainty(
    uncertainty: str | Mapping[str, Any] | Uncertainty | None, robot: Robot
) -> Uncertainty:
    """An uncertainty for a robot from a name, names joined by ``+``, JSON-able data or an
    :class:`Uncertainty`.

    Args:
        uncertainty: such as ``"table6"``, ``"table6+sensors"``, or ``{"parameters": {"stiffness":
            {"low": -0.2, "high": 0.2}}, "wrench": {"force_std": 1.0}, "sensors": {"position":
            1e-4}, "delay": 1}``. None for no uncertainty.
        robot: nominal robot.

    Raises:
        ValueError: if a name or a field is unknown, or the uncertainty is impossible for the robot.
    """
    if uncertainty is None:
        return Uncertainty()
    result = _joined(uncertainty, robot) if isinstance(uncertainty, str) else uncertainty
    result = record("uncertainty", Uncertainty, result)
    result.check(robot)
    return result


def _joined(names: str, robot: Robot) -> Uncertainty:
    merged: dict[str, Any] = {}
    check_not_a_file("uncertainty", names, JSON_FORM)
    for name in names.split("+"):
        one = UNCERTAINTIES[choice("uncertainty", name, UNCERTAINTIES, ", or join several by '+'")](
            robot
        )
        given = {
            item.name: getattr(one, item.name) for item in fields(one) if getattr(one, item.name)
        }
        if twice := set(given) & set(merged):
            raise ValueError(
                f"uncertainty {names!r} defines {sorted(twice)[0]} twice; leave one name out"
            )
        merged |= given
    return Uncertainty(**merged)
