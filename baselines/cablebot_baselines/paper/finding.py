"""What a finding is, and what the functions that make one may look at."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Literal

from cablebot_baselines.paper.part import Number
from cablebot_baselines.paper.published import Published
from cablebot_baselines.paper.readings import AS_PRINTED, Readings, Source

Verdict = Literal[
    "taken", "taken, corrected", "not taken", "contradicted", "reproduces", "does not", "cannot be decided"
]
"""Of an input: used as printed, used after a correction, replaced by a reading, or printed otherwise elsewhere in the
paper. Of a result or claim: the last three."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """What came of one published number or claim."""

    ours: str
    """Our value in words."""
    value: float | None
    """Our value in the published one's unit; None where it is no number."""
    reading: str
    """The readings that it depends on, as they were chosen; empty if none."""
    verdict: Verdict
    """See :data:`~cablebot_baselines.paper.findings.RULE`."""
    evidence: str
    """What it rests on."""
    command: str
    """What gives it."""


class Absent(Exception):
    """A number that the run has not made."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """What a finding may look at."""

    readings: Readings
    """How the paper was read."""
    numbers: Mapping[str, Number]
    """All numbers of the run, ``part.name``."""

    def optional(self, key: str) -> float | None:
        """A number that may be None for a good reason: no payload is carried, no motor is at its limit.

        Raises:
            Absent: if it was not made.
        """
        if key not in self.numbers:
            raise Absent(key)
        value = self.numbers[key]
        if isinstance(value, str):
            raise TypeError(f"{key} should be a number, not {value!r}")
        return None if value is None or math.isnan(value) else float(value)

    def number(self, key: str) -> float:
        """A number without which nothing can be said.

        Raises:
            Absent: if it was not made.
        """
        if (value := self.optional(key)) is None:
            raise Absent(key)
        return value

    def flag(self, key: str) -> bool:
        """Whether something holds.

        Raises:
            Absent: if it was not made.
        """
        return bool(self.number(key))

    def text(self, key: str) -> str:
        """Something in words.

        Raises:
            Absent: if it was not made.
        """
        if (value := self.numbers.get(key)) is None:
            raise Absent(key)
        return as_text(value)

    def maybe(self, key: str) -> float | None:
        """A number that only adds to the evidence."""
        return self.optional(key) if key in self.numbers else None

    def used(self, *names: str, source: Source | None = None) -> str:
        """The readings of these names, as they were chosen; "as printed" is what ``source`` prints."""
        words = (reading_words(name, getattr(self.readings, name), source) for name in names)
        return ", ".join(words)


Make = Callable[[Published, Run], Finding]
"""Makes a finding; raises :class:`Absent` if a number that it needs was not made."""


@dataclass(frozen=True, kw_only=True)
class Finder:
    """How a finding is made."""

    parts: tuple[str, ...]
    """The parts whose numbers it needs, or one that runs on the input."""
    make: Make
    """Makes it."""


def command(readings: Readings, *only: str) -> str:
    """What runs these parts, or all for none, under some readings."""
    words = ["cablebot reproduce", *(f"--only {name}" for name in only)]
    words += [f"--{name.replace('_', '-')} {value}" for name, value in _changed(readings).items()]
    return " ".join(words)


def _changed(readings: Readings) -> dict[str, object]:
    """The readings that are not the default."""
    default, given = asdict(Readings()), asdict(readings)
    return {name: value for name, value in given.items() if value != default[name]}


_READINGS: dict[str, dict[str, str]] = {
    "payload": {"added": "load added to the platform", "total": "load and platform together"},
    "line": {
        "physical": "limits by the motor's speed in rad/s",
        "pulley": "limits by the pulley's speed in rad/s",
        "flat": "flat limits",
        "cable": "limits by the cable's rate in m/s",
        "reversed": "limits by the speed with its sign reversed",
    },
    "platform_mass": {
        "as-printed": "platform mass as printed, {control:g} kg in §4, {payload:g} kg in §5.2",
        "10": "platform 10 kg",
        "11": "platform 11 kg",
    },
    "triangles": {
        "inverted": "platform's triangle inverted",
        "turned": "both triangles turned",
        "aligned": "triangles aligned",
    },
    "sides": {"half-side": "a and b half sides", "circumradius": "a and b circumradii"},
    "pulleys": {"table4": "pulleys of Table 4", "table5": "pulleys of Table 5"},
    "planar_apex": {
        "up": "third planar motor above",
        "left": "third planar motor on the left",
        "down": "third planar motor below",
        "right": "third planar motor on the right",
    },
    "stiffness": {
        "as-printed": "K as printed, {control:g} N·m/rad in §4, {payload:g} N·m/rad in §5.2",
        "2": "K = 2 N·m/rad",
        "3": "K = 3 N·m/rad",
    },
    "minimum_tension": {},
    "alpha": {"least": "least α at each instant", "constant": "one constant α"},
    "eq24": {"corrected": "Eqs. 24 and 25 over J′", "verbatim": "Eqs. 24 and 25 over 1 + J′"},
    "eq37": {"corrected": "Eqs. 37–39 corrected", "literal": "Eqs. 37–39 as printed"},
}
"""What the choices of each reading mean, in a few words."""


def reading_words(name: str, value: object, source: Source | None = None) -> str:
    """A reading as it was chosen, in a few words, where need be as ``source`` prints it."""
    if name == "minimum_tension":
        return f"T_min = {float(str(value)):g} N"
    if value == "as-printed" and source is not None:
        value = f"{AS_PRINTED[name][source]:g}"
    words = _READINGS.get(name, {}).get(str(value), f"{name.replace('_', ' ')} = {value}")
    return words.format(**AS_PRINTED[name]) if name in AS_PRINTED else words


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def as_text(value: Number, digits: int = 4) -> str:
    """A number with some significant digits, yes or no, a dash for None; words as they are."""
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
    """A number as a sentence needs it: three significant digits, as the paper prints."""
    return as_text(value, 3)


def kilograms(value: float | None) -> str:
    """A payload; None: not even zero is carried."""
    if value is None or value == -math.inf:
        return "nothing"
    words = f"{value:#.3g}".rstrip(".") if 1e-3 <= abs(value) < 1e3 else short(value)
    return f"{words.replace('-', '−')} kg"


def off(ours: float, published: float) -> str:
    """How far a number of ours is from a published one."""
    return f"{100 * (ours / published - 1):+.0f} %".replace("-", "−").replace("+0 %", "0 %").replace("−0 %", "0 %")


def listed(parts: list[str]) -> str:
    """Sentences, those that are empty left out."""
    return " ".join(part for part in parts if part)


def sentence(words: str) -> str:
    """Its first letter large."""
    return words[:1].upper() + words[1:]
