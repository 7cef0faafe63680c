"""Inputs, results and claims that the paper prints. This module is their only definition in this project.

A quantity has one entry for each table or section that prints it; ``times`` is the number of occurrences there. The
list excludes the numbers of equations, figures, tables, sections and references. It also excludes words that count
items within a sentence, such as "these two equations" or "the first saturation".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["input", "result", "claim"]
"""Input: a parameter, or a value that follows from the design of the robot. Result: a number that the paper computed.
Claim: a sentence that is true or false."""

ABOUT = 0.05
"""Maximum relative difference between our number and a published number that counts as reproduced."""


@dataclass(frozen=True, kw_only=True)
class Published:
    """One number or claim of the paper."""

    key: str
    """Unique key: the place, a dot, the quantity."""
    place: str
    """Section or table."""
    statement: str
    """Content of the statement in our words."""
    printed: str
    """Number as printed; empty for a claim without a number."""
    kind: Kind
    """Input, result or claim."""
    value: float | None = None
    """Number in ``unit``, without "about"; None if there is no number."""
    unit: str = ""
    """Correct unit of ``value``, which may differ from the printed one; empty if dimensionless."""
    times: int = 1
    """Number of occurrences at this place, in digits or words."""


def within(ours: float, published: float) -> bool:
    """Whether our number reproduces a published number."""
    return abs(ours - published) <= ABOUT * abs(published)


def _input(
    key: str, place: str, statement: str, printed: str, value: float | None = None, unit: str = "", *, times: int = 1
) -> Published:
    return Published(
        key=key, place=place, statement=statement, printed=printed, kind="input", value=value, unit=unit, times=times
    )


def _result(
    key: str, place: str, statement: str, printed: str, value: float, unit: str = "", *, times: int = 1
) -> Published:
    return Published(
        key=key, place=place, statement=statement, printed=printed, kind="result", value=value, unit=unit, times=times
    )


def _claim(key: str, place: str, statement: str, printed: str = "", *, times: int = 0) -> Published:
    return Published(key=key, place=place, statement=statement, printed=printed, kind="claim", times=times)


def _circle(table: str, radius: float) -> tuple[Published, ...]:
    """Entries that Tables 1 and 3 have in common."""
    key = table.lower().replace(" ", "")
    return (
        _input(f"{key}.radius", table, "radius of the circle", f"{radius:g}", radius, "m", times=4),
        _input(f"{key}.angle", table, "angle on the circle, in t²", "4π", 4.0, "π rad/s²", times=4),
        _input(f"{key}.exponent", table, "power of the time in the angle", "2", 2.0, times=4),
        _input(f"{key}.switch", table, "time at which the second branch replaces the first", "0.5", 0.5, "s", times=2),
        _input(f"{key}.end", table, "end of the motion", "1", 1.0, "s", times=3),
    )


def _platform(table: str) -> tuple[Published, ...]:
    """Entries that Tables 4 and 5 have in common."""
    key = table.lower().replace(" ", "")
    return (
        _input(f"{key}.I_xx", table, "moments of inertia I_xx = I_yy of the platform", "0.58", 0.58, "kg·m²"),
        _input(f"{key}.I_zz", table, "moment of inertia I_zz of the platform", "1.16", 1.16, "kg·m²"),
        _input(f"{key}.half", table, "meaning of a and b: half of the triangle", "half"),
        _input(f"{key}.a", table, "a of the base triangle", "0.47", 0.47, "m"),
        _input(f"{key}.b", table, "b of the platform triangle", "0.148", 0.148, "m"),
        _input(f"{key}.K_D", table, "velocity gain K_D", "20", 20.0, "1/s"),
        _input(f"{key}.K_P", table, "position gain K_P", "30", 30.0, "1/s²"),
        _input(f"{key}.r", table, "radius r, called the radius of the motor", "0.05", 0.05, "m"),
        _input(f"{key}.m", table, "mass m of the platform", "11", 11.0, "kg"),
    )


def _motors(table: str, torque: float) -> tuple[Published, ...]:
    """Entries that Tables 7, 8 and 9 have in common."""
    key = table.lower().replace(" ", "")
    return (
        _input(f"{key}.R", table, "error bound R", "0.01", 0.01, "m"),
        _input(f"{key}.speed", table, "free running speed ω_n of the motors", "1,000 rpm", 1000.0, "rpm"),
        _input(f"{key}.torque", table, "stall torque τ_s of the motors", f"{torque:g}", torque, "N·m"),
    )


_ROBOTS = (
    _input("abstract.robots", "Abstract", "rigid robots that are simulated", "two", 2.0),
    _input("abstract.planar-cables", "Abstract", "cables of the planar robot", "three", 3.0),
    _input("abstract.planar-freedom", "Abstract", "degrees of freedom of the planar robot", "2", 2.0),
    _input("abstract.spatial-cables", "Abstract", "cables of the spatial robot", "six", 6.0),
    _input("abstract.spatial-freedom", "Abstract", "degrees of freedom of the spatial robot", "6", 6.0),
    _claim("abstract.accuracy", "Abstract", "feedback linearization gives a perfect accuracy"),
    _claim("abstract.stability", "Abstract", "it is stable because its gains place the poles arbitrarily"),
    _claim("1.tension", "§1", "no tension is negative in the workspace of the paper"),
    _claim("1.elasticity", "§1", "elasticity matters in two places, joints and cables", "two", times=1),
    _claim("1.controller", "§1", "a controller suppresses vibration and so improves accuracy and payload"),
    _input("2.1.cables", "§2.1", "cables of the planar robot", "three", 3.0),
    _input("2.1.freedom", "§2.1", "degrees of freedom of the planar robot", "2", 2.0),
    _input("2.2.cables", "§2.2", "cables of the spatial robot", "six", 6.0),
    _input("2.2.freedom", "§2.2", "degrees of freedom of the spatial robot", "6", 6.0),
    _input("2.3.freedom", "§2.3", "degrees of freedom with joint springs", "12", 12.0),
    _input("2.3.platform", "§2.3", "degrees of freedom of the platform among these", "6", 6.0),
    _input("2.3.motors", "§2.3", "degrees of freedom of the motors among these", "6", 6.0),
    _claim("2.3.constraint", "§2.3", "a joint spring is a kind of non-holonomic constraint"),
)

_CONTROL = (
    _input("3.1.freedom", "§3.1", "degrees of freedom of the planar robot", "2", 2.0, times=2),
    _input("3.1.inputs", "§3.1", "control inputs of the planar robot", "three", 3.0),
    _input(
        "3.1.definite",
        "§3.1",
        "torques that the law determines; the third one keeps the cables taut",
        "two",
        2.0,
        times=2,
    ),
    _input("3.1.cables", "§3.1", "cables that must be taut", "three", 3.0),
    _input("3.1.states", "§3.1", "states of Eqs. 9 and 12", "z₁ … z₄", 4.0, times=0),
    _claim("3.1.poles", "§3.1", "the planar error has the poles of Eq. 14, which can be placed arbitrarily"),
    _input("3.2.states", "§3.2", "states of Eqs. 15 and 17", "1, …, 12", 12.0, times=0),
    _input("3.2.motors", "§3.2", "tensions and torques of Eqs. 16 and 18", "1, …, 6", 6.0, times=0),
    _claim("3.2.poles", "§3.2", "the spatial error has the poles of Eq. 19, which can be placed arbitrarily"),
    _input("3.3.platform-states", "§3.3", "states of the platform, the first of Eqs. 21 and 23", "12", 12.0, times=2),
    _input("3.3.motor-states", "§3.3", "states of the motors, the last of Eqs. 21 and 23", "12", 12.0),
    _input("3.3.motors", "§3.3", "tensions and torques of Eq. 22", "1, …, 6", 6.0),
    _claim("3.3.linear", "§3.3", "under Eq. 22 the platform's error obeys Eq. 19, as without springs"),
    _claim("3.3.bounded", "§3.3", "the motor angles stay stable unless H excites their natural frequency (Eq. 25)"),
    _claim("3.3.robust", "§3.3", "the robust term stabilises them otherwise"),
    _input("3.4.platform-states", "§3.4", "states that Eq. 26 linearises", "12", 12.0),
    _input("3.4.assumptions", "§3.4", "assumptions of the robust term, with γ̄, ζ and φ", "three", 3.0),
    _input("3.4.zeta", "§3.4", "upper bound of ζ", "ζ < 1", 1.0, times=2),
    _input("3.4.B", "§3.4", "rows of B (Eq. 36)", "14", 14.0, times=0),
    _claim("3.4.uncontrollable", "§3.4", "joint springs make the robot uncontrollable: fewer inputs than coordinates"),
    _claim("3.4.lyapunov", "§3.4", "Eq. 35 has a positive definite P for the A of Eq. 36"),
    _claim("3.4.stability", "§3.4", "Δv of Eq. 34 ensures stability under uncertainty"),
)

_SIMULATION = (
    *_circle("Table 1", 0.2165),
    _input("table2.K_D", "Table 2", "velocity gain K_D", "10", 10.0, "1/s"),
    _input("table2.K_P", "Table 2", "position gain K_P", "2000", 2000.0, "1/s²"),
    _input("table2.r", "Table 2", "radius r, called the radius of the motor", "0.05", 0.05, "m"),
    _input("table2.J", "Table 2", "inertia J of the pulley", "0.0008", 8e-4, "kg·m²"),
    _input("table2.m", "Table 2", "mass m of the platform", "1", 1.0, "kg"),
    _input("table2.side", "Table 2", "side of the triangle", "1", 1.0, "m"),
    _claim("4.1.tension", "§4.1", "the tensions of the planar cables remain positive (Fig. 5)"),
    *_circle("Table 3", 0.1),
    _input("table3.z", "Table 3", "z", "0.1", 0.1, "m"),
    _input("table3.psi", "Table 3", "ψ", "0.1", 0.1, "rad"),
    _input("table3.theta", "Table 3", "Θ", "0.1", 0.1, "rad"),
    _input("table3.phi", "Table 3", "φ", "0.1", 0.1, "rad"),
    *_platform("Table 4"),
    _input("table4.c", "Table 4", "damping c", "0.01 N.m/rad", 0.01, "N·m·s/rad"),
    _input("table4.J", "Table 4", "inertia J of the pulley", "0.0008", 8e-4, "kg·m²"),
    *_platform("Table 5"),
    _input("table5.K", "Table 5", "stiffness K of the joints", "2", 2.0, "N·m/rad"),
    _input("table5.J", "Table 5", "inertia J′ of the motor and inertia J of the pulley", "0.0004", 4e-4, "kg·m²"),
    _input("4.3.middle", "§4.3", "time of the input change: the middle of the motion", "middle", 0.5, "of the motion"),
    _claim(
        "4.3.vibration", "§4.3", "with joint springs the torques vibrate strongly only when the input changes (Fig. 7)"
    ),
    _input("table6.m", "Table 6", "mass, ±", "0.1 m", 0.1, "of the mass"),
    _input("table6.k", "Table 6", "stiffness, ±", "0.1 k", 0.1, "of the stiffness"),
    _input("table6.mean", "Table 6", "mean of the disturbance", "0.5", 0.5, "N"),
    _input("table6.variance", "Table 6", "variance of the disturbance", "0.2 N", 0.2, "N²"),
    _input("table6.n", "Table 6", "disturbance, ±", "0.1 n", 0.1, "of the disturbance"),
    _result(
        "4.4.sum",
        "§4.4",
        "reduction of the summed tracking error by the robust term (Fig. 9)",
        "more than 60%",
        60.0,
        "%",
    ),
    _result(
        "4.4.max",
        "§4.4",
        "reduction of the largest tracking error by the robust term (Fig. 9)",
        "more than 60%",
        60.0,
        "%",
        times=0,
    ),
)

_PAYLOAD = (
    _input("5.1.motors", "§5.1", "motors over which Eq. 39 takes the minimum", "1, 2, …, 6", 6.0),
    _claim("5.1.linear-spatial", "§5.1", "the motor torques of the spatial robot are linear in the load"),
    _claim("5.1.linear-planar", "§5.1", "the motor torques of the planar robot are linear in the load (Eqs. 40, 41)"),
    _claim("5.1.converges", "§5.1", "the guess and the result converge to the same value (step 7b)"),
    _claim("5.1.answer", "§5.1", "the product of load coefficient and load is the payload (Eqs. 37–39)"),
    _claim("5.1.accuracy", "§5.1", "the accuracy coefficient can be neglected in closed loop"),
    *_motors("Table 7", 5.0),
    _input("table7.m", "Table 7", "mass m_n of the platform", "1", 1.0, "kg"),
    _input("table7.guess", "Table 7", "predicted guess m_l of the load", "2", 2.0, "kg"),
    _result("5.2.1.payload", "§5.2.1", "load capacity of the planar robot", "about 2.2 kg", 2.2, "kg"),
    _result("5.2.1.motor", "§5.2.1", "motor that saturates first (Fig. 10)", "second", 2.0),
    _claim("5.2.1.path", "§5.2.1", "the planar path stays within its bounds (Fig. 11)"),
    *_motors("Table 8", 10.0),
    _input("table8.m", "Table 8", "mass m_n of the platform", "10", 10.0, "kg"),
    _input("table8.guess", "Table 8", "predicted guess m_l of the load", "5", 5.0, "kg"),
    _result("5.2.2.payload", "§5.2.2", "load capacity of the spatial robot", "about 2.56 kg", 2.56, "kg"),
    _result("5.2.2.motor", "§5.2.2", "motor that saturates first (Fig. 12)", "second", 2.0),
    _claim("5.2.2.path", "§5.2.2", "the spatial path stays within its bounds (Fig. 13; the text does not mention it)"),
    _input("5.2.3.R", "§5.2.3", "error bound R", "0.01", 0.01, "m"),
    _claim("5.2.3.stable", "§5.2.3", "the responses with joint springs are stable (Fig. 14)"),
    _claim("5.2.3.path", "§5.2.3", "the responses with joint springs do not violate R (Fig. 14)"),
    *_motors("Table 9", 10.0),
    _input("5.2.3.K", "§5.2.3", "stiffness K of the joints", "3 N/rad", 3.0, "N·m/rad"),
    _result("5.2.3.payload", "§5.2.3", "load capacity with joint springs", "1.4 kg", 1.4, "kg"),
    _result("5.2.3.rigid", "§5.2.3", "load capacity of the rigid robot (repeated)", "2.56 kg", 2.56, "kg"),
    _claim(
        "5.2.3.less", "§5.2.3", "load capacity with joint springs is considerably less than that of the rigid robot"
    ),
    _result("5.2.3.motor", "§5.2.3", "motor that saturates first (Fig. 15)", "second", 2.0),
    _claim("6.torque", "§6", "elasticity changes the torques when the input changes"),
    _result("6.drop", "§6", "reduction of the payload by joint springs", "about 30%", 30.0, "%"),
    _claim("6.uncertainty", "§6", "uncertainty affects the tracking of the robot with joint springs"),
    _result(
        "6.robust", "§6", "improvement of the tracking of that robot by the robust term", "more than 60%", 60.0, "%"
    ),
    _claim("6.open-tracking", "§6", "tracking in closed loop is better than in open loop"),
    _claim("6.open-payload", "§6", "the payload in closed loop is larger than in open loop"),
)

PUBLISHED: dict[str, Published] = {
    item.key: item for part in (_ROBOTS, _CONTROL, _SIMULATION, _PAYLOAD) for item in part
}
"""All entries by key, in the order of the paper."""


def published_value(key: str) -> float:
    """Number of an entry.

    Raises:
        ValueError: if the entry has no number.
    """
    value = PUBLISHED[key].value
    if value is None:
        raise ValueError(f"{key!r} has no number: its statement is {PUBLISHED[key].statement}")
    return value


LOADS: dict[str, float] = {
    "planar": published_value("5.2.1.payload"),
    "spatial": published_value("5.2.2.payload"),
    "flexible": published_value("5.2.3.payload"),
}
"""The published load capacities [kg]."""
