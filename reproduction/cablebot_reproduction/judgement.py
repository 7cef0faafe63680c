"""Verdicts on results and claims: what a verdict function reads, and what it returns.

Each verdict function stands beside the part that computes its numbers. :func:`verdict` registers
it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.part import Number
from cablebot_reproduction.published import published_value
from cablebot_reproduction.texts import as_text, kilograms, relative_difference

_UNITS = {"kg": "kg", "mm": "mm", "mrad": "mrad", "N": "N", "Nm": "N·m", "s": "s"}
"""Unit of a number by the end of its name."""


_FIELD = re.compile(r"{([^{}:]+):?([^{}]*)}")
"""A field of a sentence: its name and its format."""


class MissingNumberError(KeyError):
    """A required number is not among the numbers of the run; the argument is its name."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """Interpretation and numbers of a run."""

    interpretation: Interpretation
    """Interpretation of the paper."""
    numbers: Mapping[str, Number]
    """All numbers of the run by ``part.name``."""

    def number(self, name: str) -> Any:
        """A number of the run, for example ``fig10.time_s``.

        Raises:
            MissingNumberError: if the run did not compute it, or if it has no value. A payload and
                a motor may be None, because a robot may fail unloaded and the limiting violation
                need not be a motor torque.
        """
        value = self.numbers.get(name)
        may_be_none = name in self.numbers and name.endswith(("_kg", "motor"))
        if value is None and not may_be_none:
            raise MissingNumberError(name)
        return value

    def payload(self, name: str) -> float:
        """A payload of the run [kg]; −∞ if the robot fails unloaded.

        Raises:
            MissingNumberError: if the run did not compute it.
        """
        payload = self.number(name)
        if payload is None:
            return -math.inf
        return float(payload)

    def sentence(self, template: str, **values: str) -> str:
        """A sentence with numbers of the run; empty if one of them is missing.

        ``{fig10.time_s}`` is a number with the unit that its name ends with,
        ``{fig9.sum_reduction_1e-2:%}`` a number in another unit, and ``{fig10.payload_kg:vs
        5.2.1.payload}`` a number with its difference from a published one.

        Args:
            template: format string.
            values: further texts by name.
        """

        def text(field: re.Match[str]) -> str:
            name, form = field.groups()
            if name in values:
                return values[name]
            return self._number_text(name, form)

        try:
            return _FIELD.sub(text, template)
        except MissingNumberError:
            return ""

    def _number_text(self, name: str, form: str) -> str:
        """Text of a number, see :meth:`sentence`."""
        value = self.number(name)
        if value is None and not name.endswith("_kg"):
            raise MissingNumberError(name)
        unit = _UNITS.get(name.rpartition("_")[2], "")
        published = form.removeprefix("vs ")
        if published == form:
            return quantity_text(value, form or unit)
        text = quantity_text(value, unit)
        if not value:
            return text
        return f"{text} ({relative_difference(value, published_value(published))})"

    def sentences(self, templates: Iterable[str], **values: str) -> str:
        """All sentences without missing numbers."""
        sentences = [self.sentence(template, **values) for template in templates]
        return " ".join(filter(None, sentences))

    def sentence_if(self, condition: str, template: str) -> str:
        """A sentence that holds only if a truth value of the run is true; otherwise empty."""
        if not self.numbers.get(condition):
            return ""
        return self.sentence(template)


def quantity_text(value: Any, unit: str) -> str:
    """Text of a value in a unit with three significant digits, as in the paper. Fractions are
    printed in percent."""
    if unit == "kg":
        return kilograms(value)
    if isinstance(value, str):
        return value.replace("-", "−")
    if unit == "%":
        value = 100 * value
    return f"{as_text(value, 3)} {unit}".strip()


@dataclass(frozen=True)
class Judgement:
    """What a verdict function returns."""

    value: Number
    """Our value; None if the robot fails unloaded, or if the finding is not a number."""
    is_reproduced: bool | None
    """Whether our value reproduces the result or the claim; None if this project has no model for
    it."""
    evidence: Iterable[str] = ()
    """Templates of sentences (:meth:`Run.sentence`). The page omits a sentence if one of its
    numbers is missing."""
    text: str = ""
    """Template of the text of our value, which is ``{ours}``; that text itself if empty."""


@dataclass(frozen=True)
class Verdict:
    """A verdict function and what the page says about its numbers."""

    judge: Callable[[Run], Judgement]
    """The verdict function."""
    part_names: tuple[str, ...]
    """Parts that compute the required numbers."""
    unit: str
    """Unit of our value on a claim; a result has the published unit."""
    options: tuple[str, ...]
    """Options of the interpretation that affect our value."""
    choice: str
    """Further choices that affect our value."""


VERDICTS: dict[str, Verdict] = {}
"""Verdict functions by the key of the published item. The modules of ``parts`` fill it."""


def verdict(
    key: str, *part_names: str, unit: str = "", options: tuple[str, ...] = (), choice: str = ""
) -> Callable[[Callable[[Run], Judgement]], Callable[[Run], Judgement]]:
    """Registers the verdict function of a published item; the arguments are the fields of
    :class:`Verdict`."""

    def register(judge: Callable[[Run], Judgement]) -> Callable[[Run], Judgement]:
        VERDICTS[key] = Verdict(judge, part_names, unit, options, choice)
        return judge

    return register
