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
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cablebot_gym.kinematics import Array
from cablebot_gym.measurement import POSE, Measurement
from cablebot_gym.robots import Robot
from cablebot_gym.robots.parts import as_tuples
from cablebot_gym.utils.checks import choice, mapping, number, numbers, record, whole
from cablebot_gym.utils.files import JSON_FORM, check_not_a_file

LONGEST_DELAY = 1000
"""Largest actuation delay [control steps]."""


@dataclass(frozen=True, kw_only=True)
class ParameterDistribution:
    """Uniform distribution of the deviation of a parameter from its nominal value. It is drawn once
    per episode.

    Raises:
        ValueError: if ``low`` > ``high``, or a number is not finite.
    """

    low: float
    """Smallest deviation, as a fraction of the nominal value, or in its unit if not
    ``relative``."""
    high: float
    """Largest deviation, in the same unit as ``low``."""
    relative: bool = True
    """Whether the deviation is a fraction of the nominal value. A nominal value of zero then stays
    zero."""
    each: bool = True
    """Whether each motor, axis or coordinate has its own draw. False: all of them have the same
    deviation."""

    def __post_init__(self) -> None:
        for name in ("low", "high"):
            object.__setattr__(self, name, number(name, getattr(self, name)))
        for name in ("relative", "each"):
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise ValueError(f"{name} must be True or False, not {getattr(self, name)!r}")
        if self.low > self.high:
            raise ValueError(
                f"low must not exceed high, but they are {self.low:g} and {self.high:g}; exchange them"
            )

    def deviation(self, uniform: Array) -> Array:
        """Deviations from numbers that are uniform in [0, 1)."""
        return self.low + (self.high - self.low) * uniform

    def applied(self, nominal: Array, deviation: Array) -> Array:
        """The true value for a nominal value and a deviation in the unit of ``low`` and
        ``high``."""
        if self.relative:
            return nominal * (1 + deviation)
        return nominal + deviation

    def extremes(self, nominal: Array) -> tuple[Array, Array]:
        """The true values for the deviations ``low`` and ``high``."""
        low = self.applied(nominal, np.asarray(self.low))
        high = self.applied(nominal, np.asarray(self.high))
        return low, high


@dataclass(frozen=True)
class _Parameter:
    """Properties of one uncertain parameter."""

    attribute: str
    """Name of the attribute of :class:`~cablebot_gym.robots.record.Robot`."""
    unit: str
    """SI unit."""
    _: dataclasses.KW_ONLY
    positive: bool = False
    """Whether the value must be greater than 0."""
    jointed: bool = False
    """Whether only robots with joint springs have the parameter."""
    turns: bool = False
    """Whether only robots whose platform turns have the parameter."""
    elastic: bool = False
    """Whether only robots with elastic cables have the parameter."""
    per_load: bool = False
    """Whether only robots with load friction have the parameter: the compiled plant of the others
    does not know it."""
    position: bool = False
    """Whether the parameter is a position, which may have either sign."""
    lowers_frequency: bool = False
    """Whether a larger value lowers the natural frequencies of a flexible robot."""

    def belongs_to(self, robot: Robot) -> bool:
        """Whether a robot has the parameter."""
        if self.jointed and not robot.jointed:
            return False
        if self.elastic and not robot.elastic:
            return False
        if self.turns and robot.point_mass:
            return False
        return bool(not self.per_load or np.any(robot.load_friction))


PARAMETERS: Mapping[str, _Parameter] = {
    "platform_mass": _Parameter("mass", "kg", positive=True, lowers_frequency=True),
    "payload": _Parameter("payload", "kg"),
    "platform_inertia": _Parameter(
        "moments", "kg·m²", positive=True, turns=True, lowers_frequency=True
    ),
    "pulley_inertia": _Parameter("pulley_inertia", "kg·m²", lowers_frequency=True),
    "damping": _Parameter("damping", "N·m·s/rad"),
    "stiffness": _Parameter("stiffness", "N·m/rad", positive=True, jointed=True),
    "motor_inertia": _Parameter(
        "motor_inertia", "kg·m²", positive=True, jointed=True, lowers_frequency=True
    ),
    "motor_damping": _Parameter("motor_damping", "N·m·s/rad", jointed=True),
    "motor_strength": _Parameter("stall_torque", "N·m", positive=True),
    "base_anchors": _Parameter("base", "m", position=True),
    "platform_anchors": _Parameter("platform", "m", turns=True, position=True),
    "motor_lag": _Parameter("motor_lag", "s"),
    "coulomb_friction": _Parameter("coulomb_friction", "N·m"),
    "axial_stiffness": _Parameter("axial_stiffness", "N", positive=True, elastic=True),
    "load_friction": _Parameter("load_friction", "1", per_load=True),
}
"""The parameters that may be uncertain. A new one comes last: a parameter takes its random numbers
after those before it, so the draws of the others stay. ``motor_strength`` scales the stall torque; the free speed
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
        shapes = [(), (2,), (3,)]
        form = "one number or one per axis"
        for name in ("force_mean", "force_std", "moment_mean", "moment_std"):
            least = -math.inf
            if name.endswith("std"):
                least = 0.0
            values = numbers(name, getattr(self, name), shapes=shapes, form=form, least=least)
            object.__setattr__(self, name, as_tuples(values))
        time = number("correlation_time", self.correlation_time, above=0, unit="s")
        low, high = numbers("factor", self.factor, shapes=[(2,)], form="(low, high)").tolist()
        if low > high:
            raise ValueError(f"factor must be (low, high) with low ≤ high, not {self.factor!r}")
        object.__setattr__(self, "correlation_time", time)
        object.__setattr__(self, "factor", (low, high))

    @property
    def random(self) -> bool:
        """Whether two draws can differ."""
        low, high = self.factor
        return bool(np.any(self.force_std) or np.any(self.moment_std) or low < high)

    def statistics(self, robot: Robot) -> tuple[Array, Array]:
        """Mean and standard deviation of the components (force, then moment), each of shape (n,).

        Raises:
            ValueError: if the length of a tuple is not the number of axes of the robot.
        """
        d = robot.dimensions

        def components(statistic: str) -> Array:
            values = np.zeros(robot.coordinates)
            for quantity, entries in (("force", values[:d]), ("moment", values[d:])):
                name = f"{quantity}_{statistic}"
                value = np.asarray(getattr(self, name))
                axes = len(entries)
                if axes == 0:  # a point mass takes no moment, whatever its value
                    continue
                if value.shape not in ((), (axes,)):
                    raise ValueError(f"wrench: {name} needs {axes} components for {robot.name!r}")
                entries[:] = value
            return values

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
        for name, value in vars(self).copy().items():
            object.__setattr__(self, name, number(f"sensors.{name}", value, least=0))

    @property
    def random(self) -> bool:
        """Whether two draws can differ."""
        return any(vars(self).values())

    def deviations(self, robot: Robot, measurement: Measurement = POSE) -> Array:
        """Standard deviations of the components of the measured blocks of the observation."""
        d = robot.dimensions
        pose = np.full(robot.coordinates, self.rotation)
        pose[:d] = self.position
        velocity = np.full(robot.coordinates, self.rotation_rate)
        velocity[:d] = self.velocity
        values: dict[str, ArrayLike] = {
            "pose": pose,
            "velocity": velocity,
            "motor_angle": self.motor_angle,
            "motor_speed": self.motor_speed,
            "tensions": self.tension,
            "orientation": [self.tilt, self.tilt, self.yaw],
            "angular_rate": self.angular_rate,
            "specific_force": self.specific_force,
        }
        blocks = []
        for name, size in measurement.sizes(robot).items():
            blocks.append(np.broadcast_to(values[name], size))
        return np.concatenate(blocks)


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
        for name, value in parameters.items():
            distribution = record(f"distribution of {name}", ParameterDistribution, value)
            parameters[name] = distribution
            if PARAMETERS[name].position and distribution.relative:
                raise ValueError(
                    f"{name}: a position has no relative deviation; give it in m with relative=False"
                )
        object.__setattr__(self, "parameters", parameters)
        for name, kind in _RECORDS.items():
            value = getattr(self, name)
            if value is not None:
                object.__setattr__(self, name, record(name, kind, value))
        object.__setattr__(self, "delay", _checked_delay(self.delay))

    def __hash__(self) -> int:
        parameters = frozenset(self.parameters.items())
        return hash((parameters, self.wrench, self.sensors, self.sensor_bias, self.delay))

    @property
    def delay_range(self) -> tuple[int, int]:
        """Least and largest delay [control steps]."""
        if isinstance(self.delay, tuple):
            return self.delay
        return self.delay, self.delay

    @property
    def random(self) -> bool:
        """Whether two episodes can differ."""
        least_delay, largest_delay = self.delay_range
        if least_delay < largest_delay:
            return True
        if any(item.low < item.high for item in self.parameters.values()):
            return True
        disturbances = (self.wrench, self.sensors, self.sensor_bias)
        return any(item is not None and item.random for item in disturbances)

    def errors(self) -> dict[str, Uncertainty]:
        """Each error alone, by name: an uncertain parameter, ``wrench``, ``sensors``,
        ``sensor_bias`` or ``delay``."""
        alone = {}
        for name, distribution in self.parameters.items():
            alone[name] = Uncertainty(parameters={name: distribution})
        for name in (*_RECORDS, "delay"):
            value = getattr(self, name)
            if value:
                alone[name] = Uncertainty(**{name: value})
        return alone

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
                least, largest = distribution.extremes(nominal)
                smallest = float(np.min(least))
                divides = name == "pulley_inertia" and robot.elastic
                above = -math.inf
                if parameter.positive or divides:
                    above = 0.0
                label = f"smallest {name} of {robot.name!r}"
                number(label, smallest, above=above, least=0.0, unit=parameter.unit)
                if parameter.per_load:
                    number(f"largest {name}", float(np.max(largest)), above=0.0, below=1.0)
        if "platform_inertia" in self.parameters and not robot.planar:
            _check_inertia(robot.moments, self.parameters["platform_inertia"])
        if self.wrench is not None:
            self.wrench.statistics(robot)

    def draw(self, robot: Robot, payload: Array, uniform: Array) -> RobotBatch:
        """Draws the true robots of N episodes.

        Args:
            robot: nominal robot, for which :meth:`check` has passed.
            payload: nominal payloads, shape (N,) [kg].
            uniform: numbers in [0, 1), shape (N, :func:`draw_size`). Each parameter has its own
                columns, whether it is uncertain or not.
        """
        deviations = {}
        for name, (start, shape) in _columns(robot).items():
            if name in self.parameters:
                distribution = self.parameters[name]
                columns = uniform[:, start : start + math.prod(shape)]
                if not distribution.each:  # the other columns of the parameter are unused
                    columns = np.broadcast_to(columns[:, :1], columns.shape)
                columns = columns.reshape(len(uniform), *shape)
                deviations[name] = distribution.deviation(columns)
        return self._true_robots(robot, payload, deviations)

    def fastest(self, robot: Robot) -> RobotBatch:
        """The possible robot with the fastest motor dynamics. It determines the physics step."""
        deviations = {}
        columns = _columns(robot)
        for name, distribution in self.parameters.items():
            parameter = PARAMETERS[name]
            if name != "payload" and not parameter.position:
                deviation = distribution.high
                if parameter.lowers_frequency:
                    deviation = distribution.low
                _, shape = columns[name]
                deviations[name] = np.full((1, *shape), deviation)
        return self._true_robots(robot, np.zeros(1), deviations)

    def _true_robots(
        self, robot: Robot, payload: Array, deviations: Mapping[str, Array]
    ) -> RobotBatch:
        count = len(payload)
        values: dict[str, Array] = {}
        for name, parameter in PARAMETERS.items():
            if not parameter.belongs_to(robot):
                continue
            value = payload
            if name != "payload":
                nominal = np.asarray(getattr(robot, parameter.attribute), float)
                value = np.broadcast_to(nominal, (count, *nominal.shape))
            if name in deviations:
                value = self.parameters[name].applied(value, deviations[name])
            values[parameter.attribute] = value
        values["payload"] = np.maximum(values["payload"], 0.0)
        values["speed_slope"] = robot.speed_slope * values["stall_torque"] / robot.stall_torque
        if not robot.point_mass:
            values["inertia_tensor"] = scaled_tensor(robot, values["moments"])
        return RobotBatch(robot, values)


_RECORDS = {"wrench": ExternalWrench, "sensors": SensorNoise, "sensor_bias": SensorNoise}
"""Fields of :class:`Uncertainty` that may be given as a mapping."""


def _check_inertia(moments: Array, distribution: ParameterDistribution) -> None:
    """Checks that no moment can exceed the sum of the other two, for nominal moments (3,)."""
    least, largest = distribution.extremes(moments)
    extremes = [(least, least), (largest, largest)]
    if distribution.each:  # one moment can be the largest while the other two are the least
        extremes = [(least, largest)]
    for pair_moments, moments in extremes:
        sums_of_pairs = np.sum(pair_moments) - pair_moments
        # The moments of a thin plate have equality, up to rounding.
        if np.any(sums_of_pairs < moments * (1 - 1e-9)):
            raise ValueError(
                "platform_inertia: one moment can exceed the sum of the other two; use a relative deviation "
                "with each=False, or move low and high closer together"
            )


def scaled_tensor(robot: Robot, moments: Array) -> Array:
    """Inertia tensors (N, 3, 3) with the given moments; products grow as the roots of the moments
    they belong to."""
    axes = np.arange(3 - moments.shape[-1], 3)  # the last: all of them, or the normal of a plane
    factor = np.ones((len(moments), 3))
    factor[:, axes] = np.sqrt(moments / robot.moments)
    scaled: Array = robot.inertia_tensor * factor[:, :, None] * factor[:, None, :]
    scaled[:, axes, axes] = moments
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
    columns = {}
    start = 0
    for name, parameter in PARAMETERS.items():
        if (parameter.elastic or parameter.per_load) and not parameter.belongs_to(robot):
            continue
        shape: tuple[int, ...] = ()
        if name == "platform_inertia" and robot.point_mass:
            shape = (3,)
        elif parameter.jointed and not robot.jointed:
            shape = (robot.cables,)
        elif name != "payload":
            shape = np.shape(getattr(robot, parameter.attribute))
        columns[name] = (start, shape)
        start += math.prod(shape)
    return columns


_TENTH = ParameterDistribution(low=-0.1, high=0.1, each=False)


def _table6(robot: Robot) -> Uncertainty:
    parameters = {"platform_mass": _TENTH}
    if robot.jointed:
        parameters["stiffness"] = _TENTH
    wrench = ExternalWrench(
        force_mean=0.5, force_std=math.sqrt(0.2), correlation_time=0.01, factor=(0.9, 1.1)
    )
    return Uncertainty(parameters=parameters, wrench=wrench)


def _table6_load(robot: Robot) -> Uncertainty:
    paper = _table6(robot)
    return dataclasses.replace(paper, parameters={**paper.parameters, "payload": _TENTH})


_NOISE = SensorNoise(
    position=1e-4, rotation=2e-4, velocity=2e-3, rotation_rate=4e-3, motor_speed=1e-2
)


def _gusts(robot: Robot) -> ExternalWrench:
    """Gusts on a platform. One below 1 kg is small: the force is in proportion to its mass. The arm of
    the moment does not reach beyond the anchors."""
    force = 0.5 * min(1.0, robot.mass)
    arm = 0.1
    if not robot.point_mass:
        arm = min(arm, float(np.linalg.norm(robot.platform, axis=-1).max()))
    return ExternalWrench(force_std=force, moment_std=arm * force, correlation_time=0.1)


def _hardware(robot: Robot) -> Uncertainty:
    def within(deviation: float, *, each: bool = True) -> ParameterDistribution:
        return ParameterDistribution(low=-deviation, high=deviation, each=each)

    def between(low: float, high: float, *, each: bool = True) -> ParameterDistribution:
        return ParameterDistribution(low=low, high=high, relative=False, each=each)

    stall = float(robot.stall_torque.min())
    parameters = {
        "platform_mass": within(0.03),
        "payload": within(0.03),
        "motor_strength": within(0.03),
        "motor_lag": between(1e-3, 2e-3, each=False),
        "coulomb_friction": between(0.005 * stall, 0.015 * stall),
        "pulley_inertia": within(0.1),
        "base_anchors": between(-1.5e-3, 1.5e-3),
    }
    viscous = between(0.0, 1.3e-3)
    if robot.jointed:
        parameters["motor_damping"] = viscous
        parameters["motor_inertia"] = within(0.1)
        # With 10 % the springs would dominate: laws of FlexPlanar fail unloaded.
        parameters["stiffness"] = within(0.05)
    else:
        parameters["damping"] = viscous
    if robot.elastic:
        parameters["axial_stiffness"] = within(0.3, each=False)
    if not robot.point_mass:
        parameters["platform_inertia"] = within(0.1, each=False)
        parameters["platform_anchors"] = between(-0.5e-3, 0.5e-3)
    return Uncertainty(
        parameters=parameters,
        wrench=_gusts(robot),
        sensors=dataclasses.replace(_NOISE, motor_angle=2e-4),
        sensor_bias=SensorNoise(position=1.5e-4, rotation=3.5e-4),
        delay=(0, 1),
    )


def _sensors(robot: Robot) -> Uncertainty:
    return Uncertainty(sensors=dataclasses.replace(_NOISE, motor_angle=1e-3))


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


_ERROR_SEPARATOR = ":"
"""What separates the name of an uncertainty from that of one of its errors, ``hardware:delay``."""


def find_uncertainty(
    uncertainty: str | Mapping[str, Any] | Uncertainty | None, robot: Robot
) -> Uncertainty:
    """An uncertainty for a robot from a name, names joined by ``+``, JSON-able data or an
    :class:`Uncertainty`.

    Args:
        uncertainty: such as ``"table6"``, ``"table6+sensors"``, ``"hardware:delay"`` for one error
            of ``hardware`` alone, or ``{"parameters": {"stiffness":
            {"low": -0.2, "high": 0.2}}, "wrench": {"force_std": 1.0}, "sensors": {"position":
            1e-4}, "delay": 1}``. None for no uncertainty.
        robot: nominal robot.

    Raises:
        ValueError: if a name or a field is unknown, or the uncertainty is impossible for the robot.
    """
    if uncertainty is None:
        return Uncertainty()
    if isinstance(uncertainty, str):
        uncertainty = _joined(uncertainty, robot)
    uncertainty = record("uncertainty", Uncertainty, uncertainty)
    uncertainty.check(robot)
    return uncertainty


def _joined(names: str, robot: Robot) -> Uncertainty:
    """The uncertainty of names joined by ``+``, which must not define a field twice."""
    merged: dict[str, Any] = {}
    for name in names.split("+"):
        name, _, error = name.partition(_ERROR_SEPARATOR)
        if name not in UNCERTAINTIES:
            check_not_a_file("uncertainty", names, JSON_FORM)
        choice("uncertainty", name, UNCERTAINTIES, ", or join several by '+'")
        uncertainty = UNCERTAINTIES[name](robot)
        if error:
            errors = uncertainty.errors()
            uncertainty = errors[choice(f"error of {name!r}", error, errors)]
        for key, value in vars(uncertainty).items():
            if not value:
                continue
            if key in merged:
                raise ValueError(f"uncertainty {names!r} defines {key} twice; leave one name out")
            merged[key] = value
    return Uncertainty(**merged)
