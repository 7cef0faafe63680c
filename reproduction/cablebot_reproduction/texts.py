"""Texts of numbers, and templates of sentences with numbers of a run."""

from __future__ import annotations

import re
from collections.abc import Mapping

from cablebot_reproduction.outcome import Number

ABOUT = 0.05
"""Largest relative difference between our number and a published one that counts as reproduced."""

PUBLISHED = {"planar_payload_kg": 2.2, "spatial_payload_kg": 2.56, "flexible_payload_kg": 1.4}
"""The load capacities of §5.2 [kg]. The motor that saturates first is always motor 2."""

_UNITS = {"mm": "mm", "mrad": "mrad", "N": "N", "Nm": "N·m", "s": "s"}
"""Unit of a number by the end of its name."""

_FIELD = re.compile(r"{([^{}:]+):?([^{}]*)}")
"""A field of a template: the name of a number, and its form."""

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def within(ours: float, published: float) -> bool:
    """Whether our number reproduces a published number."""
    return abs(ours - published) <= ABOUT * abs(published)


def fill(template: str, numbers: Mapping[str, Number]) -> str:
    """A sentence with numbers of the run.

    ``{fig10.time_s}`` is a number with the unit that its name ends with,
    ``{fig9.sum_reduction_1e-2:%}`` a number in another unit, and ``{fig10.payload_kg:vs 2.2}`` a
    payload with its difference from a published one.

    Raises:
        KeyError: if the run did not compute a number.
    """

    def text(field: re.Match[str]) -> str:
        name, form = field.groups()
        return _number_text(numbers[name], name.rpartition("_")[2], form)

    return _FIELD.sub(text, template)


def _number_text(value: Number, unit: str, form: str) -> str:
    """Text of a number whose name ends with a unit, see :func:`fill`."""
    if unit == "kg":
        text = kilograms(value)
        if not form:
            return text
        ratio = float(value or 0.0) / float(form.removeprefix("vs "))
        difference = f"{round(100 * (ratio - 1)):+d} %".replace("+0 %", "0 %")
        return f"{text} ({difference.replace('-', '−')})"
    if isinstance(value, str):
        return value.replace("-", "−")
    if form == "%":
        value = 100 * float(value or 0.0)
    return f"{as_text(value, 3)} {form or _UNITS.get(unit, '')}".strip()


def as_text(value: Number, digits: int = 4) -> str:
    """Text of a value: significant digits for numbers, yes or no for truth values, a dash for
    None."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if isinstance(value, int):
        return f"{value:d}".replace("-", "−")
    mantissa, _, power = f"{value:.{digits}g}".partition("e")
    mantissa = mantissa.replace("-", "−")
    if not power:
        return mantissa
    return f"{mantissa} · 10{str(int(power)).translate(_RAISED)}"


def kilograms(value: Number) -> str:
    """Text of a payload; None if the robot fails unloaded."""
    if not isinstance(value, float):
        return "fails unloaded"
    text = f"{value:#.3g}".rstrip(".").replace("-", "−")
    return f"{text} kg"
