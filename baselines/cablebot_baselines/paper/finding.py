"""Findings, the numbers that they use, and the texts of numbers and options."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Literal

from cablebot_baselines.paper.interpretation import AS_PRINTED, Interpretation, Source
from cablebot_baselines.paper.part import Number
from cablebot_baselines.paper.published import Published

Verdict = Literal["used", "used, corrected", "replaced", "contradicted", "reproduced", "not reproduced", "undecided"]
"""Verdicts of an input: used as printed, used after a correction, replaced by the interpretation, or contradicted
elsewhere in the paper. Verdicts of a result or claim: the last three."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Outcome for one published number or claim."""

    ours: str
    """Our value as text."""
    value: float | None
    """Our value in the unit of the published value; None if it is not a number."""
    interpretation: str
    """Chosen options that affect the finding; empty if none."""
    verdict: Verdict
    """See :data:`~cablebot_baselines.paper.findings.RULE`."""
    evidence: str
    """Numbers and reasons that support the verdict."""
    command: str
    """Command that reproduces the finding."""


class MissingNumber(Exception):
    """A required number is not among the numbers of the run."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """Interpretation and numbers of a run."""

    interpretation: Interpretation
    """Interpretation of the paper."""
    numbers: Mapping[str, Number]
    """All numbers of the run by ``part.name``."""

    def optional(self, key: str) -> float | None:
        """A number that is None if it does not exist, for example if the robot fails unloaded or no motor saturates.

        Raises:
            MissingNumber: if the run did not compute it.
        """
        if key not in self.numbers:
            raise MissingNumber(key)
        value = self.numbers[key]
        if isinstance(value, str):
            raise TypeError(f"{key} must be a number, not {value!r}")
        return None if value is None or math.isnan(value) else float(value)

    def number(self, key: str) -> float:
        """A number that must exist.

        Raises:
            MissingNumber: if the run did not compute it.
        """
        if (value := self.optional(key)) is None:
            raise MissingNumber(key)
        return value

    def flag(self, key: str) -> bool:
        """A truth value.

        Raises:
            MissingNumber: if the run did not compute it.
        """
        return bool(self.number(key))

    def text(self, key: str) -> str:
        """A value as text.

        Raises:
            MissingNumber: if the run did not compute it.
        """
        if (value := self.numbers.get(key)) is None:
            raise MissingNumber(key)
        return as_text(value)

    def maybe(self, key: str) -> float | None:
        """A number for additional evidence; None if the run did not compute it."""
        return self.optional(key) if key in self.numbers else None

    def options_text(self, *names: str, source: Source | None = None) -> str:
        """Texts of the chosen options; ``source`` selects the values of "as-printed"."""
        words = (option_text(name, getattr(self.interpretation, name), source) for name in names)
        return ", ".join(words)


EvaluateFinding = Callable[[Published, Run], Finding]
"""Function that evaluates a finding. It raises :class:`MissingNumber` if a required number does not exist."""


@dataclass(frozen=True, kw_only=True)
class FindingRule:
    """Rule that evaluates a finding."""

    parts: tuple[str, ...]
    """Parts that compute the required numbers, or a part that uses the input."""
    evaluate: EvaluateFinding
    """Function that evaluates the finding."""


def command(interpretation: Interpretation, *only: str) -> str:
    """Command that runs these parts, or all parts if no name is given, under an interpretation."""
    words = ["cablebot reproduce", *(f"--only {name}" for name in only)]
    words += [f"--{name.replace('_', '-')} {value}" for name, value in _changed(interpretation).items()]
    return " ".join(words)


def _changed(interpretation: Interpretation) -> dict[str, object]:
    """Options that differ from the default."""
    default, given = asdict(Interpretation()), asdict(interpretation)
    return {name: value for name, value in given.items() if value != default[name]}


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


def join_sentences(parts: list[str]) -> str:
    """Joins the sentences that are not empty."""
    return " ".join(part for part in parts if part)


def capitalized(words: str) -> str:
    """Text with a capital first letter."""
    return words[:1].upper() + words[1:]
