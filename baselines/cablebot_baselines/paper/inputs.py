"""Findings on inputs, each read from the robot, motion, uncertainty or law that uses it, and never typed again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields

import numpy as np
from numpy.typing import ArrayLike

from cablebot_baselines.classical.outer_loop import PAPER_GAINS, RobustPD
from cablebot_baselines.paper.exact import paper_circle
from cablebot_baselines.paper.finding import Finder, Finding, Run, Verdict, as_text, command
from cablebot_baselines.paper.published import PUBLISHED, Published, published_value
from cablebot_baselines.paper.readings import Readings, Source
from cablebot_gym.kinematics import Array
from cablebot_gym.robots import ROBOTS, RPM, Robot
from cablebot_gym.task import Limits
from cablebot_gym.uncertainty import UNCERTAINTIES, ExternalWrench, Uncertainty

Read = Callable[[Readings], ArrayLike]
"""Our value, or several that all stand for the published one."""


def _input(
    part: str,
    read: Read,
    evidence: str,
    *,
    readings: tuple[str, ...] = (),
    corrected: str = "",
    expected: float | None = None,
    contradicted: Callable[[Readings], str] | None = None,
) -> Finder:
    """An input that is a number.

    Args:
        part: which runs on it.
        read: our value.
        evidence: where it stands; code if it has no backtick.
        readings: names of those that change it.
        corrected: what had to be put right; empty if nothing.
        expected: the value after that; None: the published one.
        contradicted: says where the paper prints another value; None if nowhere.
    """

    def make(item: Published, run: Run) -> Finding:
        values = np.unique(np.atleast_1d(np.asarray(read(run.readings), float)).round(12))
        goal = published_value(item.key) if expected is None else expected
        verdict: Verdict = "taken, corrected" if corrected else "taken"
        if len(values) != 1 or not np.isclose(values[0], goal, rtol=1e-9, atol=0):
            verdict = "not taken"
        words = [evidence if "`" in evidence else f"`{evidence}`"]
        if corrected:
            words.append(corrected)
        if contradicted is not None:
            verdict = "contradicted"
            words.append(contradicted(run.readings))
        return Finding(
            ours=f"{', '.join(as_text(float(value)) for value in values)} {item.unit}".strip(),
            value=float(values[0]) if len(values) == 1 else None,
            reading=run.used(*readings),
            verdict=verdict,
            evidence="; ".join(words),
            command=command(run.readings, part),
        )

    return Finder(parts=(part,), make=make)


def _constant(value: float) -> Read:
    return lambda readings: value


def _planar(readings: Readings) -> Robot:
    return readings.planar


def _spatial(readings: Readings) -> Robot:
    return readings.spatial("control")


def _flexible(readings: Readings) -> Robot:
    return readings.flexible("control")


def _payload(readings: Readings) -> Robot:
    return readings.spatial("payload")


RobotOf = Callable[[Readings], Robot]


def _of(robot: RobotOf, *names: str) -> Read:
    """The sum of some attributes of a robot."""
    return lambda readings: sum(np.asarray(getattr(robot(readings), name)) for name in names)


# --- counts ---------------------------------------------------------------------------------------------------------

_CABLES, _FREEDOM = "Robot.cables", "Robot.coordinates"


def _counts() -> Iterator[tuple[str, Finder]]:
    rigid = sum(not robot.flexible for robot in ROBOTS.values())
    yield "abstract.robots", _input("fig1", _constant(rigid), "`ROBOTS`, those without springs")
    kinds: tuple[tuple[str, RobotOf, tuple[str, ...], tuple[str, ...]], ...] = (
        (
            "fig1",
            _planar,
            ("abstract.planar-cables", "2.1.cables", "3.1.inputs", "3.1.cables"),
            ("abstract.planar-freedom", "2.1.freedom", "3.1.freedom"),
        ),
        (
            "fig2",
            _spatial,
            ("abstract.spatial-cables", "2.2.cables", "3.2.motors"),
            ("abstract.spatial-freedom", "2.2.freedom"),
        ),
        ("fig3", _flexible, ("2.3.motors", "3.3.motors"), ("2.3.platform",)),
    )
    for part, robot, cables, freedoms in kinds:
        for key in cables:
            yield key, _input(part, _of(robot, "cables"), _CABLES)
        for key in freedoms:
            yield key, _input(part, _of(robot, "coordinates"), _FREEDOM)
    yield "2.3.freedom", _input("fig3", _of(_flexible, "coordinates", "cables"), f"{_FREEDOM} + {_CABLES}")
    yield (
        "3.1.definite",
        _input(
            "fig1",
            _of(_planar, "coordinates"),
            _FREEDOM,
            corrected="one more is free, and by α N of Eq. 11 it belongs to all three cables, not to the third",
        ),
    )
    states: tuple[tuple[str, str, RobotOf, str], ...] = (
        ("3.1.states", "fig5", _planar, "coordinates"),
        ("3.2.states", "fig6", _spatial, "coordinates"),
        ("3.3.platform-states", "fig7", _flexible, "coordinates"),
        ("3.3.motor-states", "fig7", _flexible, "cables"),
        ("3.4.platform-states", "fig8", _flexible, "coordinates"),
    )
    for key, part, robot, name in states:
        yield key, _input(part, _of(robot, name, name), f"2 × Robot.{name}")
    yield (
        "3.4.B",
        _input(
            "fig8",
            _of(_spatial, "coordinates", "coordinates"),
            f"2 × {_FREEDOM}",
            corrected="two for each coordinate, as A and e have; those of one coordinate are printed twice",
            expected=2 * published_value("abstract.spatial-freedom"),
        ),
    )
    bounds = sum(item.name in ("zeta", "phi") for item in fields(RobustPD))
    yield (
        "3.4.assumptions",
        _input(
            "fig8",
            _constant(bounds),
            "`RobustPD.zeta`, `RobustPD.phi`",
            corrected="γ̄ is taken into φ, which then bounds an acceleration",
            expected=2.0,
        ),
    )
    yield "3.4.zeta", Finder(parts=("fig8",), make=_zeta)
    yield "5.1.motors", _input("eq37", _of(_payload, "cables"), "`Robot.cables`; of the planar robot 3")


def _zeta(item: Published, run: Run) -> Finding:
    value = float(RobustPD.zeta)
    return Finding(
        ours=as_text(value),
        value=value,
        reading="",
        verdict="taken" if value < published_value(item.key) else "not taken",
        evidence="`RobustPD.zeta`, which is ours: the paper gives no values of ζ, γ̄, φ and Q",
        command=command(run.readings, "fig8"),
    )


# --- Tables 1 and 3 -------------------------------------------------------------------------------------------------


def _angle(robot: Robot, time: float) -> float:
    """On the circle, from its start [rad]."""
    x, y = paper_circle(robot)(time).position[:2]
    return float(np.arctan2(y, x))


def _exponent(robot: Robot) -> float:
    return float(np.log2(_angle(robot, 0.4) / _angle(robot, 0.2)))


def _radius(robot: Robot) -> float:
    return float(np.linalg.norm(paper_circle(robot)(0.0).position[:2]))


def _jump(robot: Robot) -> float:
    """When the reference's acceleration jumps [s]."""
    circle = paper_circle(robot)
    times = np.linspace(0.0, circle.duration, 2001)
    changes = np.linalg.norm(np.diff(circle(times).acceleration, axis=0), axis=1)
    return float(times[np.argmax(changes)])


def _circle(table: str, part: str, robot: RobotOf) -> Iterator[tuple[str, Finder]]:
    reads: dict[str, tuple[Read, str]] = {
        "radius": (lambda readings: _radius(robot(readings)), "radius"),
        "angle": (lambda readings: _angle(robot(readings), 0.2) / (np.pi * 0.2**2), "angle at 0.2 s / (π t²)"),
        "exponent": (lambda readings: _exponent(robot(readings)), "log₂ of angle at 0.4 s / angle at 0.2 s"),
        "switch": (lambda readings: _jump(robot(readings)), "where the acceleration jumps"),
        "end": (lambda readings: paper_circle(robot(readings)).duration, "duration"),
    }
    for name, (read, evidence) in reads.items():
        yield f"{table}.{name}", _input(part, read, f"`PaperCircle`, {evidence}")


def _start(place: int) -> Read:
    return lambda readings: paper_circle(_spatial(readings))(0.0).position[place]


def _motions() -> Iterator[tuple[str, Finder]]:
    yield from _circle("table1", "fig5", _planar)
    yield from _circle("table3", "fig6", _spatial)
    for place, name in enumerate(("z", "psi", "theta", "phi"), 2):
        yield f"table3.{name}", _input("fig6", _start(place), f"`PaperCircle.center[{place}]`")
    yield (
        "4.3.middle",
        _input(
            "fig7",
            lambda readings: _jump(_flexible(readings)) / paper_circle(_flexible(readings)).duration,
            "`PaperCircle`, where the acceleration jumps",
        ),
    )


# --- Tables 2, 4 and 5 ----------------------------------------------------------------------------------------------


def _size(robot: RobotOf, name: str) -> Read:
    """What a or b measures of a triangle, under the reading of it [m]."""

    def read(readings: Readings) -> float:
        anchors: Array = getattr(robot(readings), name)
        side = np.linalg.norm(anchors[:, None] - anchors[None], axis=-1).max()
        return float(side / (2.0 if readings.sides == "half-side" else np.sqrt(3)))

    return read


def _sides(readings: Readings) -> ArrayLike:
    """Of the planar triangle [m]."""
    base = readings.planar.base
    return np.linalg.norm(base - np.roll(base, 1, axis=0), axis=1)


def _half(item: Published, run: Run) -> Finding:
    return Finding(
        ours=run.readings.sides,
        value=None,
        reading=run.used("sides"),
        verdict="taken",
        evidence="`Readings.sides`; which length of the triangle is meant is not said",
        command=command(run.readings, "readings"),
    )


def _mass_elsewhere(readings: Readings) -> str:
    return _elsewhere(
        f"{PUBLISHED['table4.m'].printed} kg in Tables 4 and 5, {PUBLISHED['table8.m'].printed} kg in Table 8",
        lambda source: readings.spatial(source).mass,
        "kg",
    )


def _stiffness_elsewhere(readings: Readings) -> str:
    return _elsewhere(
        f"{PUBLISHED['table5.K'].printed} in Table 5, {PUBLISHED['5.2.3.K'].printed} in §5.2.3, "
        "whose unit has to be N·m/rad",
        lambda source: float(readings.flexible(source).stiffness[0]),
        "N·m/rad",
    )


def _elsewhere(printed: str, value: Callable[[Source], float], unit: str) -> str:
    return (
        f"{printed}; here {as_text(value('control'))} {unit} holds in §4 and {as_text(value('payload'))} {unit} in §5.2"
    )


def _gain(kind: str, place: int) -> Read:
    return lambda readings: PAPER_GAINS[kind][place]


def _gains(table: str, part: str, kind: str) -> Iterator[tuple[str, Finder]]:
    for place, name in enumerate(("K_P", "K_D")):
        yield f"{table}.{name}", _input(part, _gain(kind, place), f'PAPER_GAINS["{kind}"][{place}]')


def _pulley(table: str, part: str, robot: RobotOf) -> Iterator[tuple[str, Finder]]:
    radius = _input(part, _of(robot, "pulley_radius"), "Transmission.pulley_radius", corrected="it is the pulley's")
    yield f"{table}.r", radius


def _mass(part: str, robot: RobotOf) -> Finder:
    return _input(part, _of(robot, "mass"), "Robot.mass", readings=("platform_mass",), contradicted=_mass_elsewhere)


def _platform(table: str, part: str, robot: RobotOf) -> Iterator[tuple[str, Finder]]:
    yield f"{table}.I_xx", _input(part, lambda readings: robot(readings).inertia[:2], "Robot.inertia[:2]")
    yield f"{table}.I_zz", _input(part, lambda readings: robot(readings).inertia[2], "Robot.inertia[2]")
    yield f"{table}.half", Finder(parts=("readings",), make=_half)
    for name, anchors in (("a", "base"), ("b", "platform")):
        read = _size(robot, anchors)
        yield f"{table}.{name}", _input(part, read, f"Robot.{anchors}_anchors", readings=("sides",))
    yield from _gains(table, part, "spatial")
    yield from _pulley(table, part, robot)
    yield f"{table}.m", _mass(part, robot)


def _stiffness(part: str, source: Source) -> Finder:
    return _input(
        part,
        lambda readings: readings.flexible(source).stiffness,
        "Transmission.stiffness",
        readings=("stiffness",),
        contradicted=_stiffness_elsewhere,
    )


def _robots() -> Iterator[tuple[str, Finder]]:
    yield from _gains("table2", "fig5", "planar")
    yield from _pulley("table2", "fig5", _planar)
    yield "table2.J", _input("fig5", _of(_planar, "pulley_inertia"), "Transmission.pulley_inertia")
    yield "table2.side", _input("fig5", _sides, "Robot.base_anchors", readings=("planar_apex",))
    yield "table2.m", _input("fig5", _of(_planar, "mass"), "Robot.mass")
    yield from _platform("table4", "fig6", _spatial)
    yield (
        "table4.c",
        _input(
            "fig6",
            _of(_spatial, "damping"),
            "Transmission.damping",
            readings=("pulleys",),
            corrected="its unit is that of a torque per speed; Table 2 has no c, and 0 is taken",
        ),
    )
    inertia = _of(_spatial, "pulley_inertia")
    yield "table4.J", _input("fig6", inertia, "Transmission.pulley_inertia", readings=("pulleys",))
    yield from _platform("table5", "fig7", _flexible)
    yield "table5.K", _stiffness("fig7", "control")
    yield (
        "table5.J",
        _input(
            "fig7",
            lambda readings: [*_flexible(readings).motor_inertia, *_flexible(readings).pulley_inertia],
            "`Transmission.motor_inertia` and `.pulley_inertia`",
        ),
    )


# --- Table 6 --------------------------------------------------------------------------------------------------------


def _table6(readings: Readings) -> Uncertainty:
    return UNCERTAINTIES["table6"](_flexible(readings))


def _wrench(readings: Readings) -> ExternalWrench:
    wrench = _table6(readings).wrench
    return ExternalWrench() if wrench is None else wrench


def _share(name: str) -> Read:
    def read(readings: Readings) -> ArrayLike:
        spread = _table6(readings).parameters[name]
        return [-spread.low, spread.high]

    return read


def _uncertainty() -> Iterator[tuple[str, Finder]]:
    where = '`UNCERTAINTIES["table6"]`'
    yield "table6.m", _input("fig9", _share("platform_mass"), f"{where}: `platform_mass`, uniform")
    yield "table6.k", _input("fig9", _share("stiffness"), f"{where}: `stiffness`, uniform, one draw for all joints")
    yield "table6.mean", _input("fig9", lambda readings: _wrench(readings).force_mean, f"{where}: `wrench.force_mean`")
    yield (
        "table6.variance",
        _input(
            "fig9",
            lambda readings: np.square(_wrench(readings).force_std),
            f"{where}: `wrench.force_std`, squared",
            corrected="a variance of a force is in N²; how long a draw lasts is not printed",
        ),
    )
    yield (
        "table6.n",
        _input(
            "fig9",
            lambda readings: np.abs(np.subtract(_wrench(readings).factor, 1)),
            f"{where}: `wrench.factor`",
        ),
    )


# --- Tables 7, 8 and 9 ----------------------------------------------------------------------------------------------


def _guess(item: Published, run: Run) -> Finding:
    robot = "planar_" if item.key.startswith("table7") else ""
    value, spread = published_value(item.key), run.maybe(f"eq37.{robot}literal_spread_kg")
    words = "; other guesses end at the same load" if spread is not None and spread < 1e-3 else ""
    return Finding(
        ours=f"{as_text(value)} {item.unit}",
        value=value,
        reading="",
        verdict="taken",
        evidence=f"`iterate_load`: its first guess{words}",
        command=command(run.readings, "eq37"),
    )


def _free_speed(robot: RobotOf) -> Read:
    """Under the reading's torque-speed line, where a motor can have it [rpm]."""

    def read(readings: Readings) -> ArrayLike:
        return np.divide(readings.moved(robot(readings)).motors.free_speed, RPM)

    return read


def _limits() -> Iterator[tuple[str, Finder]]:
    motors: tuple[tuple[str, str, RobotOf], ...] = (
        ("table7", "fig10", _planar),
        ("table8", "fig12", _payload),
        ("table9", "fig15", lambda readings: readings.flexible("payload")),
    )
    bound = "Limits.position"
    for table, part, robot in motors:
        yield f"{table}.R", _input(part, lambda readings: Limits().position, bound)
        yield f"{table}.speed", _input(part, _free_speed(robot), "Motors.free_speed / RPM", readings=("line",))
        yield f"{table}.torque", _input(part, _of(robot, "stall_torque"), "Motors.stall_torque")
    yield "5.2.3.R", _input("fig14", lambda readings: Limits().position, bound)
    yield "5.2.3.K", _stiffness("fig15", "payload")
    for table in ("table7", "table8"):
        yield f"{table}.guess", Finder(parts=("eq37",), make=_guess)
    yield "table7.m", _input("fig10", _of(_planar, "mass"), "Robot.mass")
    yield "table8.m", _mass("fig12", _payload)


def finders() -> Iterator[tuple[str, Finder]]:
    """By key."""
    for some in (_counts, _motions, _robots, _uncertainty, _limits):
        yield from some()
