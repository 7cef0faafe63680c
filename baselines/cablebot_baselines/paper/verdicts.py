"""Verdicts on published items: their rules and templates, evaluated for the numbers of a run."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np

from cablebot_baselines.paper import inputs
from cablebot_baselines.paper.interpretation import AS_PRINTED, Interpretation
from cablebot_baselines.paper.part import Number
from cablebot_baselines.paper.parts.interpretations import VARIED
from cablebot_baselines.paper.published import LOADS, MOTORS, Published, published_value, within
from cablebot_baselines.paper.texts import as_text, kilograms, option_text, relative_difference, short

_COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
    "≈": within,
}

_UNITS = {"kg": "kg", "mm": "mm", "mrad": "mrad", "N": "N", "Nm": "N·m", "s": "s"}
"""Unit of a number by the end of its name."""

_PLACEHOLDER = re.compile(r"\{([^{}:|]+)(?::([^{}|]+))?(?:\|([^{}]+))?\}")
"""``{name}``, ``{name:unit}`` or ``{name|key}``."""


_NEAR = 0.015
"""Relative difference below which a payload matches "about 2.56 kg"."""


class MissingNumber(Exception):
    """A required number is not among the numbers of the run."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """Interpretation and numbers of a run."""

    interpretation: Interpretation
    """Interpretation of the paper."""
    numbers: Mapping[str, Number]
    """All numbers of the run by ``part.name``."""

    def named(self, name: str) -> Any:
        """Value of a name in an expression or a template.

        Raises:
            MissingNumber: if the run did not compute it, or it has no value. A payload and a motor may be None, because
                a robot may fail unloaded and the limiting violation need not be a motor torque.
        """
        if name.startswith("@"):
            return inputs.read(name[1:], self.interpretation)
        value = self._closest(name) if name.startswith("closest.") else self.numbers.get(name)
        may_be_none = name in self.numbers and name.endswith(("_kg", "motor"))
        if value is None and not may_be_none:
            raise MissingNumber(name)
        return value

    def product(self, expression: str, published: float | None) -> Any:
        """Value of an expression; None if a factor is None.

        Raises:
            MissingNumber: if a number has no value.
        """
        factors = []
        for word in expression.split(" * "):
            literal = re.fullmatch(r"[\d.e-]+", word)
            factors.append(published if word == "published" else float(word) if literal else self.named(word))
        return None if any(factor is None for factor in factors) else reduce(operator.mul, factors)

    def holds(self, item: Published) -> bool | None:
        """Whether all comparisons of an item hold; None if a left side is None. A right side that is None is −∞.

        Raises:
            MissingNumber: if a number has no value.
        """
        compared = []
        for comparison in item.holds:
            left, sign, right = re.split(r" (<=|>=|<|>|=|≈) ", comparison)
            first, second = self.product(left, item.value), self.product(right, item.value)
            if first is None:
                return None
            compared.append(_COMPARISONS[sign](first, -math.inf if second is None else second))
        return all(compared)

    def filled(self, template: str, ours: str = "") -> str:
        """Text of a template.

        Its placeholders are ``{name}``, where the end of the name gives the unit; ``{name:unit}``; ``{name:if}``, an
        empty text; ``{name|key}``, which adds the difference from a published value; ``{closest.kind}``, the
        combinations of options closest to a published payload; and ``{ours}``.

        Args:
            template: the template.
            ours: text of our value.

        Returns:
            The text; empty if the run did not compute one of the numbers or an ``if`` is false.
        """

        def text(match: re.Match[str]) -> str:
            name, unit, key = match.groups()
            if name == "ours":
                return ours
            value = self.named(name)
            if (unit == "if" and not value) or (value is None and not name.endswith("_kg")):
                raise MissingNumber(name)
            if unit == "if":
                return ""
            words = quantity_text(value, unit or _UNITS.get(name.rpartition("_")[2], ""))
            return f"{words} ({relative_difference(value, published_value(key))})" if key and value else words

        try:
            return _PLACEHOLDER.sub(text, template)
        except MissingNumber:
            return ""

    def all_filled(self, templates: tuple[str, ...]) -> str:
        """Text of all sentences whose numbers exist."""
        return " ".join(sentence for template in templates if (sentence := self.filled(template)))

    def _closest(self, name: str) -> str | None:
        """Payloads closest to a published one, with their differences and options; None without combinations.

        Only combinations with the published motor count. All payloads that match within rounding are listed, or only
        the closest payload if none matches. ``closest.planar_total`` compares the total mass of platform and load.
        """
        kind, _, total = name.removeprefix("closest.").partition("_")
        prefix, added = f"interpretations.{kind}_", self.interpretation.planar.mass if total else 0.0
        loads = {
            key[len(prefix) : -3]: added + float(load)
            for key, load in self.numbers.items()
            if key.startswith(prefix) and key.endswith("_kg") and isinstance(load, (int, float))
            if self.numbers.get(f"{key[:-3]}_motor") == MOTORS[kind]
        }
        target = LOADS[kind]
        names = sorted(loads, key=lambda name: abs(loads[name] - target))
        near = [name for name in names if abs(loads[name] / target - 1) <= _NEAR] or names[:1]
        texts = (
            f"{kilograms(loads[name])} ({relative_difference(loads[name], target)}) with {_combination(kind, name)}"
            for name in near
        )
        return ", or ".join(texts) or None


def _combination(kind: str, words: str) -> str:
    """Options in the name of a number that differ from the default."""
    default = Interpretation()
    defaults = {
        name: f"{AS_PRINTED[name]['payload']:g}" if name in AS_PRINTED else str(getattr(default, name))
        for name in VARIED[kind]
    }
    choices = zip(defaults, words.split("_"), strict=True)
    texts = [option_text(name, choice) for name, choice in choices if choice != defaults[name]]
    return ", ".join(texts) or "the default interpretation"


def quantity_text(value: Any, unit: str) -> str:
    """Text of a value in a unit with three significant digits, as in the paper. Fractions are printed in percent."""
    if unit == "kg":
        return kilograms(value)
    if isinstance(value, str):
        return value.replace("-", "−")
    return f"{short(100 * value if unit == '%' else value)} {unit}".strip()


def judge(item: Published, run: Run) -> tuple[str, float | None, str]:
    """Our value as text and as a number, and the verdict on a result or claim.

    Raises:
        MissingNumber: if a required number does not exist.
    """
    values = [run.product(expression, item.value) for expression in item.ours]
    holds = run.holds(item)
    verdict = "undecided" if not item.holds else "reproduced" if holds else "not reproduced"
    if holds is None:
        return quantity_text(None, item.unit), None, verdict
    value = (max if item.pick == "max" else min)(values, default=None)
    ours = quantity_text(value, item.unit)
    if item.unit == "kg" and item.kind == "result" and value is not None and item.value is not None:
        ours = f"{ours} ({relative_difference(value, item.value)})"
    scale = 100 if item.unit == "%" else 1
    return run.filled(item.text, ours) or ours, None if value is None else float(scale * value), verdict


def judge_input(item: Published, run: Run) -> tuple[str, float | None, str]:
    """Our value as text and as a number, and the verdict on an input."""
    given = [run.product(expression, item.value) for expression in item.ours]
    if item.value is None:
        return str(given[0]), None, item.verdict
    values = np.unique(np.concatenate([np.atleast_1d(np.asarray(one, float)) for one in given]).round(12))
    same = len(values) == 1 and bool(np.isclose(values[0], item.value, rtol=1e-9, atol=0))
    used = run.holds(item) if item.holds else same
    ours = f"{', '.join(as_text(float(value)) for value in values)} {item.unit}".strip()
    verdict = item.verdict if used or item.verdict == "contradicted" else "replaced"
    return ours, float(values[0]) if len(values) == 1 else None, verdict
