"""Findings on inputs. Each value is read from the robot, motion, uncertainty or law that uses it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields

import numpy as np
from numpy.typing import ArrayLike

from cablebot_baselines.classical.outer_loop import PAPER_GAINS, RobustPD
from cablebot_baselines.paper.exact import paper_circle
from cablebot_baselines.paper.finding import Finding, FindingRule, Run, Verdict, as_text, command
from cablebot_baselines.paper.interpretation import Interpretation, Source
from cablebot_baselines.paper.published import PUBLISHED, Published, published_value
from cablebot_gym.kinematics import Array
from cablebot_gym.robots import ROBOTS, RPM, Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.uncertainty import UNCERTAINTIES, ExternalWrench, Uncertainty

Read = Callable[[Interpretation], ArrayLike]
"""Function that reads our value, or several values that must all equal the published one."""


def _input(
    part: str,
    read: Read,
    evidence: str,
    *,
    options: tuple[str, ...] = (),
    corrected: str = "",
    expected: float | None = None,
    contradicted: Callable[[Interpretation], str] | None = None,
) -> FindingRule:
    """Rule for a numeric input.

    Args:
        part: part that uses the input.
        read: function that returns our value.
        evidence: location of the value; formatted as code if it contains no backtick.
        options: names of the options that affect the value.
        corrected: description of the correction; empty if there is none.
        expected: expected value after the correction; None for the published value.
        contradicted: function that describes the contradicting value; None if there is none.
    """

    def evaluate(item: Published, run: Run) -> Finding:
        values = np.unique(np.atleast_1d(np.asarray(read(run.interpretation), float)).round(12))
        goal = published_value(item.key) if expected is None else expected
        verdict: Verdict = "used, corrected" if corrected else "used"
        if len(values) != 1 or not np.isclose(values[0], goal, rtol=1e-9, atol=0):
            verdict = "replaced"
        words = [evidence if "`" in evidence else f"`{evidence}`"]
        if corrected:
            words.append(corrected)
        if contradicted is not None:
            verdict = "contradicted"
            words.append(contradicted(run.interpretation))
        return Finding(
            ours=f"{', '.join(as_text(float(value)) for value in values)} {item.unit}".strip(),
            value=float(values[0]) if len(values) == 1 else None,
            interpretation=run.options_text(*options),
            verdict=verdict,
            evidence="; ".join(words),
            command=command(run.interpretation, part),
        )

    return FindingRule(parts=(part,), evaluate=evaluate)


def _constant(value: float) -> Read:
    return lambda interpretation: value


def _planar(interpretation: Interpretation) -> Robot:
    return interpretation.planar


def _spatial(interpretation: Interpretation) -> Robot:
    return interpretation.spatial("control")


def _flexible(interpretation: Interpretation) -> Robot:
    return interpretation.flexible("control")


def _payload(interpretation: Interpretation) -> Robot:
    return interpretation.spatial("payload")


RobotOf = Callable[[Interpretation], Robot]


def _of(robot: RobotOf, *names: str) -> Read:
    """Reads the sum of attributes of a robot."""
    return lambda interpretation: sum(np.asarray(getattr(robot(interpretation), name)) for name in names)


# --- counts ---------------------------------------------------------------------------------------------------------

_CABLES, _FREEDOM = "Robot.cables", "Robot.coordinates"


def _counts() -> Iterator[tuple[str, FindingRule]]:
    rigid = sum(not robot.flexible for robot in ROBOTS.values())
    yield "abstract.robots", _input("fig1", _constant(rigid), "`ROBOTS` without joint springs")
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
            corrected="one more torque is free; by α N of Eq. 11 it acts on all three cables, not only on the third",
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
            corrected="two rows for each coordinate, as in A and e; the paper prints the rows of one coordinate twice",
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
            corrected="γ̄ is included in φ, which then bounds an acceleration",
            expected=2.0,
        ),
    )
    yield "3.4.zeta", FindingRule(parts=("fig8",), evaluate=_zeta)
    yield "5.1.motors", _input("eq37", _of(_payload, "cables"), "`Robot.cables`; 3 for the planar robot")


def _zeta(item: Published, run: Run) -> Finding:
    value = float(RobustPD.zeta)
    return Finding(
        ours=as_text(value),
        value=value,
        interpretation="",
        verdict="used" if value < published_value(item.key) else "replaced",
        evidence="`RobustPD.zeta`, a choice of this project; the paper gives no values of ζ, γ̄, φ and Q",
        command=command(run.interpretation, "fig8"),
    )


# --- Tables 1 and 3 -------------------------------------------------------------------------------------------------


def _angle(robot: Robot, time: float) -> float:
    """Angle on the circle from its start [rad]."""
    x, y = paper_circle(robot)(time).position[:2]
    return float(np.arctan2(y, x))


def _exponent(robot: Robot) -> float:
    return float(np.log2(_angle(robot, 0.4) / _angle(robot, 0.2)))


def _radius(robot: Robot) -> float:
    return float(np.linalg.norm(paper_circle(robot)(0.0).position[:2]))


def _jump(robot: Robot) -> float:
    """Time at which the reference acceleration jumps [s]."""
    circle = paper_circle(robot)
    times = np.linspace(0.0, circle.duration, 2001)
    changes = np.linalg.norm(np.diff(circle(times).acceleration, axis=0), axis=1)
    return float(times[np.argmax(changes)])


def _circle(table: str, part: str, robot: RobotOf) -> Iterator[tuple[str, FindingRule]]:
    reads: dict[str, tuple[Read, str]] = {
        "radius": (lambda interpretation: _radius(robot(interpretation)), "radius"),
        "angle": (
            lambda interpretation: _angle(robot(interpretation), 0.2) / (np.pi * 0.2**2),
            "angle at 0.2 s / (π t²)",
        ),
        "exponent": (
            lambda interpretation: _exponent(robot(interpretation)),
            "log₂ of angle at 0.4 s / angle at 0.2 s",
        ),
        "switch": (lambda interpretation: _jump(robot(interpretation)), "time of the jump of the acceleration"),
        "end": (lambda interpretation: paper_circle(robot(interpretation)).duration, "duration"),
    }
    for name, (read, evidence) in reads.items():
        yield f"{table}.{name}", _input(part, read, f"`PaperCircle`, {evidence}")


def _start(index: int) -> Read:
    return lambda interpretation: paper_circle(_spatial(interpretation))(0.0).position[index]


def _motions() -> Iterator[tuple[str, FindingRule]]:
    yield from _circle("table1", "fig5", _planar)
    yield from _circle("table3", "fig6", _spatial)
    for index, name in enumerate(("z", "psi", "theta", "phi"), 2):
        yield f"table3.{name}", _input("fig6", _start(index), f"`PaperCircle.center[{index}]`")
    yield (
        "4.3.middle",
        _input(
            "fig7",
            lambda interpretation: _jump(_flexible(interpretation)) / paper_circle(_flexible(interpretation)).duration,
            "`PaperCircle`, time of the jump of the acceleration",
        ),
    )


# --- Tables 2, 4 and 5 ----------------------------------------------------------------------------------------------


def _size(robot: RobotOf, name: str) -> Read:
    """Reads a or b of a triangle under the interpretation [m]."""

    def read(interpretation: Interpretation) -> float:
        anchors: Array = getattr(robot(interpretation), name)
        side = np.linalg.norm(anchors[:, None] - anchors[None], axis=-1).max()
        return float(side / (2.0 if interpretation.sides == "half-side" else np.sqrt(3)))

    return read


def _sides(interpretation: Interpretation) -> ArrayLike:
    """Side lengths of the planar triangle [m]."""
    base = interpretation.planar.base
    return np.linalg.norm(base - np.roll(base, 1, axis=0), axis=1)


def _half(item: Published, run: Run) -> Finding:
    return Finding(
        ours=run.interpretation.sides,
        value=None,
        interpretation=run.options_text("sides"),
        verdict="used",
        evidence="`Interpretation.sides`; the paper does not say which length of the triangle it means",
        command=command(run.interpretation, "interpretations"),
    )


def _mass_contradiction(interpretation: Interpretation) -> str:
    return _contradiction(
        f"{PUBLISHED['table4.m'].printed} kg in Tables 4 and 5, {PUBLISHED['table8.m'].printed} kg in Table 8",
        lambda source: interpretation.spatial(source).mass,
        "kg",
    )


def _stiffness_contradiction(interpretation: Interpretation) -> str:
    return _contradiction(
        f"{PUBLISHED['table5.K'].printed} in Table 5, {PUBLISHED['5.2.3.K'].printed} in §5.2.3, "
        "whose unit must be N·m/rad",
        lambda source: float(interpretation.flexible(source).stiffness[0]),
        "N·m/rad",
    )


def _contradiction(printed: str, value: Callable[[Source], float], unit: str) -> str:
    control, payload = as_text(value("control")), as_text(value("payload"))
    return f"{printed}; the reproduction uses {control} {unit} in §4 and {payload} {unit} in §5.2"


def _gain(kind: str, index: int) -> Read:
    return lambda interpretation: PAPER_GAINS[kind][index]


def _gains(table: str, part: str, kind: str) -> Iterator[tuple[str, FindingRule]]:
    for index, name in enumerate(("K_P", "K_D")):
        yield f"{table}.{name}", _input(part, _gain(kind, index), f'PAPER_GAINS["{kind}"][{index}]')


def _pulley(table: str, part: str, robot: RobotOf) -> Iterator[tuple[str, FindingRule]]:
    radius = _input(
        part, _of(robot, "pulley_radius"), "Transmission.pulley_radius", corrected="it is the radius of the pulley"
    )
    yield f"{table}.r", radius


def _mass(part: str, robot: RobotOf) -> FindingRule:
    return _input(part, _of(robot, "mass"), "Robot.mass", options=("platform_mass",), contradicted=_mass_contradiction)


def _platform(table: str, part: str, robot: RobotOf) -> Iterator[tuple[str, FindingRule]]:
    yield f"{table}.I_xx", _input(part, lambda interpretation: robot(interpretation).inertia[:2], "Robot.inertia[:2]")
    yield f"{table}.I_zz", _input(part, lambda interpretation: robot(interpretation).inertia[2], "Robot.inertia[2]")
    yield f"{table}.half", FindingRule(parts=("interpretations",), evaluate=_half)
    for name, anchors in (("a", "base"), ("b", "platform")):
        read = _size(robot, anchors)
        yield f"{table}.{name}", _input(part, read, f"Robot.{anchors}_anchors", options=("sides",))
    yield from _gains(table, part, "spatial")
    yield from _pulley(table, part, robot)
    yield f"{table}.m", _mass(part, robot)


def _stiffness(part: str, source: Source) -> FindingRule:
    return _input(
        part,
        lambda interpretation: interpretation.flexible(source).stiffness,
        "Transmission.stiffness",
        options=("stiffness",),
        contradicted=_stiffness_contradiction,
    )


def _robots() -> Iterator[tuple[str, FindingRule]]:
    yield from _gains("table2", "fig5", "planar")
    yield from _pulley("table2", "fig5", _planar)
    yield "table2.J", _input("fig5", _of(_planar, "pulley_inertia"), "Transmission.pulley_inertia")
    yield "table2.side", _input("fig5", _sides, "Robot.base_anchors", options=("planar_apex",))
    yield "table2.m", _input("fig5", _of(_planar, "mass"), "Robot.mass")
    yield from _platform("table4", "fig6", _spatial)
    yield (
        "table4.c",
        _input(
            "fig6",
            _of(_spatial, "damping"),
            "Transmission.damping",
            options=("pulleys",),
            corrected="its unit is torque per angular speed; Table 2 has no c, and the reproduction uses 0",
        ),
    )
    inertia = _of(_spatial, "pulley_inertia")
    yield "table4.J", _input("fig6", inertia, "Transmission.pulley_inertia", options=("pulleys",))
    yield from _platform("table5", "fig7", _flexible)
    yield "table5.K", _stiffness("fig7", "control")
    yield (
        "table5.J",
        _input(
            "fig7",
            lambda interpretation: [
                *_flexible(interpretation).motor_inertia,
                *_flexible(interpretation).pulley_inertia,
            ],
            "`Transmission.motor_inertia` and `.pulley_inertia`",
        ),
    )


# --- Table 6 --------------------------------------------------------------------------------------------------------


def _table6(interpretation: Interpretation) -> Uncertainty:
    return UNCERTAINTIES["table6"](_flexible(interpretation))


def _wrench(interpretation: Interpretation) -> ExternalWrench:
    wrench = _table6(interpretation).wrench
    return ExternalWrench() if wrench is None else wrench


def _fraction(name: str) -> Read:
    def read(interpretation: Interpretation) -> ArrayLike:
        spread = _table6(interpretation).parameters[name]
        return [-spread.low, spread.high]

    return read


def _uncertainty() -> Iterator[tuple[str, FindingRule]]:
    where = '`UNCERTAINTIES["table6"]`'
    yield "table6.m", _input("fig9", _fraction("platform_mass"), f"{where}: `platform_mass`, uniform distribution")
    yield (
        "table6.k",
        _input("fig9", _fraction("stiffness"), f"{where}: `stiffness`, uniform distribution, one draw for all joints"),
    )
    yield (
        "table6.mean",
        _input("fig9", lambda interpretation: _wrench(interpretation).force_mean, f"{where}: `wrench.force_mean`"),
    )
    yield (
        "table6.variance",
        _input(
            "fig9",
            lambda interpretation: np.square(_wrench(interpretation).force_std),
            f"{where}: `wrench.force_std`, squared",
            corrected="the unit of a force variance is N²; the paper does not print the duration of a draw",
        ),
    )
    yield (
        "table6.n",
        _input(
            "fig9",
            lambda interpretation: np.abs(np.subtract(_wrench(interpretation).factor, 1)),
            f"{where}: `wrench.factor`",
        ),
    )


# --- Tables 7, 8 and 9 ----------------------------------------------------------------------------------------------


def _guess(item: Published, run: Run) -> Finding:
    robot = "planar_" if item.key.startswith("table7") else ""
    value, spread = published_value(item.key), run.maybe(f"eq37.{robot}literal_spread_kg")
    words = "; other guesses converge to the same load" if spread is not None and spread < 1e-3 else ""
    return Finding(
        ours=f"{as_text(value)} {item.unit}",
        value=value,
        interpretation="",
        verdict="used",
        evidence=f"`iterate_load`, first guess{words}",
        command=command(run.interpretation, "eq37"),
    )


def _free_speed(robot: RobotOf) -> Read:
    """Free speed under the torque-speed line of the interpretation, if a motor can have this line [rpm]."""

    def read(interpretation: Interpretation) -> ArrayLike:
        return np.divide(interpretation.closed_loop_robot(robot(interpretation)).motors.free_speed, RPM)

    return read


def _payload_inputs() -> Iterator[tuple[str, FindingRule]]:
    motors: tuple[tuple[str, str, RobotOf], ...] = (
        ("table7", "fig10", _planar),
        ("table8", "fig12", _payload),
        ("table9", "fig15", lambda interpretation: interpretation.flexible("payload")),
    )
    bound = "ErrorBounds.position"
    for table, part, robot in motors:
        yield f"{table}.R", _input(part, lambda interpretation: ErrorBounds().position, bound)
        yield f"{table}.speed", _input(part, _free_speed(robot), "Motors.free_speed / RPM", options=("line",))
        yield f"{table}.torque", _input(part, _of(robot, "stall_torque"), "Motors.stall_torque")
    yield "5.2.3.R", _input("fig14", lambda interpretation: ErrorBounds().position, bound)
    yield "5.2.3.K", _stiffness("fig15", "payload")
    for table in ("table7", "table8"):
        yield f"{table}.guess", FindingRule(parts=("eq37",), evaluate=_guess)
    yield "table7.m", _input("fig10", _of(_planar, "mass"), "Robot.mass")
    yield "table8.m", _mass("fig12", _payload)


def finding_rules() -> Iterator[tuple[str, FindingRule]]:
    """Yields all rules of inputs with their keys."""
    for group in (_counts, _motions, _robots, _uncertainty, _payload_inputs):
        yield from group()
