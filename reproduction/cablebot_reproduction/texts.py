"""Texts of numbers and options, and the command of a finding."""

from __future__ import annotations

import math

from cablebot_gym.utils.console import command_line
from cablebot_reproduction.interpretation import AS_PRINTED, Interpretation, Source
from cablebot_reproduction.part import Number
from cablebot_reproduction.published import load_table


def command(interpretation: Interpretation, *only: str) -> str:
    """Command that runs these parts, or all parts if no name is given, under an interpretation."""
    return command_line("reproduce", only=list(only), **interpretation.changed())


OPTIONS = load_table("options.toml")
"""Options of an interpretation in the order of the command: ``help``, and short ``texts`` of the
choices."""


def option_text(name: str, value: object, source: Source | None = None) -> str:
    """Short text of a chosen option. ``source`` selects the value of "as-printed"; None lists the
    values of both sections."""
    if name == "minimum_tension":
        return f"T_min = {float(str(value)):g} N"
    if value == "as-printed" and source is not None:
        value = f"{AS_PRINTED[name][source]:g}"
    text: str = OPTIONS[name]["texts"].get(str(value), f"{name.replace('_', ' ')} = {value}")
    return text.format(**AS_PRINTED.get(name, {}))


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def as_text(value: Number, digits: int = 4) -> str:
    """Text of a value: significant digits for numbers, yes or no for truth values, a dash for
    None."""
    if value is None:
        return "–"
    if value is True:
        return "yes"
    if value is False:
        return "no"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return f"{value:d}".replace("-", "−")
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "−∞"}.get(value, "–")
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    mantissa = mantissa.replace("-", "−")
    if not power:
        return mantissa
    return f"{mantissa} · 10{str(int(power)).translate(_RAISED)}"


def kilograms(value: float | None) -> str:
    """Text of a payload; None if the robot fails unloaded."""
    if value is None or value == -math.inf:
        return "fails unloaded"
    text = as_text(value, 3)
    if 1e-3 <= abs(value) < 1e3:
        text = f"{value:#.3g}".rstrip(".")
    return f"{text.replace('-', '−')} kg"


def relative_difference(ours: float, published: float) -> str:
    """Relative difference between our number and a published number in percent."""
    text = f"{100 * (ours / published - 1):+.0f} %".replace("-", "−")
    if text in ("+0 %", "−0 %"):
        return "0 %"
    return text
