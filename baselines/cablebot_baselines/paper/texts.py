"""Texts of numbers and options, and the command of a finding."""

from __future__ import annotations

import math

from cablebot_baselines.paper.interpretation import AS_PRINTED, Interpretation, Source
from cablebot_baselines.paper.part import Number


def command(interpretation: Interpretation, *only: str) -> str:
    """Command that runs these parts, or all parts if no name is given, under an interpretation."""
    words = ["cablebot reproduce", *(f"--only {name}" for name in only)]
    words += [f"--{name.replace('_', '-')} {value}" for name, value in interpretation.changed().items()]
    return " ".join(words)


_OPTION_TEXTS: dict[str, dict[str, str]] = {
    "payload": {
        "added": "payload is the load added to the platform",
        "total": "payload is the total mass of platform and load",
    },
    "line": {
        "physical": "torque limits from the motor speed in rad/s",
        "pulley": "torque limits from the pulley speed in rad/s",
        "flat": "torque limits independent of speed",
        "cable": "torque limits from the cable speed in m/s",
        "reversed": "torque limits from the motor speed with reversed sign",
    },
    "platform_mass": {
        "as-printed": "platform mass as printed: {control:g} kg in §4, {payload:g} kg in §5.2",
        "10": "platform mass 10 kg",
        "11": "platform mass 11 kg",
    },
    "triangles": {
        "inverted": "platform triangle inverted",
        "turned": "both triangles rotated by 180°",
        "aligned": "triangles aligned",
    },
    "sides": {"half-side": "a and b are half sides", "circumradius": "a and b are circumradii"},
    "pulleys": {"table4": "pulleys of Table 4", "table5": "pulleys of Table 5"},
    "planar_apex": {
        "up": "third planar motor at the top",
        "left": "third planar motor on the left",
        "down": "third planar motor at the bottom",
        "right": "third planar motor on the right",
    },
    "stiffness": {
        "as-printed": "K as printed: {control:g} N·m/rad in §4, {payload:g} N·m/rad in §5.2",
        "2": "K = 2 N·m/rad",
        "3": "K = 3 N·m/rad",
    },
    "minimum_tension": {},
    "alpha": {"least": "smallest α at each instant", "constant": "constant α"},
    "eq24": {"corrected": "divisor J′ in Eqs. 24 and 25", "verbatim": "divisor 1 + J′ in Eqs. 24 and 25"},
    "eq37": {"corrected": "Eqs. 37–39 corrected", "literal": "Eqs. 37–39 as printed"},
}
"""Short text of each choice of each option."""


def option_text(name: str, value: object, source: Source | None = None) -> str:
    """Short text of a chosen option. ``source`` selects the value of "as-printed"; None lists the values of both
    sections."""
    if name == "minimum_tension":
        return f"T_min = {float(str(value)):g} N"
    if value == "as-printed" and source is not None:
        value = f"{AS_PRINTED[name][source]:g}"
    words = _OPTION_TEXTS.get(name, {}).get(str(value), f"{name.replace('_', ' ')} = {value}")
    return words.format(**AS_PRINTED[name]) if name in AS_PRINTED else words


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def as_text(value: Number, digits: int = 4) -> str:
    """Text of a value: significant digits for numbers, yes or no for truth values, a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return f"{value:d}".replace("-", "−")
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞" if value > 0 else "−∞"
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    mantissa = mantissa.replace("-", "−")
    return f"{mantissa} · 10{str(int(power)).translate(_RAISED)}" if power else mantissa


def short(value: Number) -> str:
    """Number with three significant digits, as in the paper."""
    return as_text(value, 3)


def kilograms(value: float | None) -> str:
    """Text of a payload; None if the robot fails unloaded."""
    if value is None or value == -math.inf:
        return "fails unloaded"
    words = f"{value:#.3g}".rstrip(".") if 1e-3 <= abs(value) < 1e3 else short(value)
    return f"{words.replace('-', '−')} kg"


def relative_difference(ours: float, published: float) -> str:
    """Relative difference between our number and a published number in percent."""
    return f"{100 * (ours / published - 1):+.0f} %".replace("-", "−").replace("+0 %", "0 %").replace("−0 %", "0 %")


def capitalized(words: str) -> str:
    """Text with a capital first letter."""
    return words[:1].upper() + words[1:]
