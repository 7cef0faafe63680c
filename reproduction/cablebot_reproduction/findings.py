"""Verdicts on the results and claims of the paper, with our values and the evidence."""

from __future__ import annotations

import math
import operator
import tomllib
from collections.abc import Callable, Iterator, Mapping
from importlib.resources import files
from typing import Any

from cablebot_reproduction.outcome import Number
from cablebot_reproduction.texts import fill, within

FILES = files("cablebot_reproduction")
"""Data files of this package."""

_COMPARISONS: dict[str, Callable[[Any, float], bool]] = {
    "<": operator.lt,
    "≤": operator.le,
    "=": operator.eq,
    "≥": operator.ge,
    ">": operator.gt,
    "≈": within,
}


def rows(numbers: Mapping[str, Number]) -> Iterator[dict[str, str]]:
    """Results and claims in the order of the paper, without those whose parts were not run."""
    items = tomllib.loads(FILES.joinpath("published.toml").read_text(encoding="utf-8"))
    for kind in ("result", "claim"):
        for key, item in items[kind].items():
            try:
                ours = fill(item["ours"], numbers)
                verdict = _verdict(item.get("reproduced_if"), numbers)
            except KeyError:
                continue
            section, _, _ = key.rpartition(".")
            yield {
                "key": key,
                "kind": kind,
                "place": f"§{section}".replace("§abstract", "Abstract"),
                "statement": item["statement"],
                "printed": item.get("printed", ""),
                "ours": ours,
                "conditions": item.get("conditions", ""),
                "verdict": verdict,
                "evidence": " ".join(_sentences(item["evidence"], numbers)),
            }


def _verdict(conditions: list[str] | None, numbers: Mapping[str, Number]) -> str:
    """Reproduced if all conditions hold; undecided without conditions, because this project has no
    model for the item."""
    if conditions is None:
        return "undecided"
    for condition in conditions:
        name, comparison, *factors = condition.split()
        value = math.prod(_value(factor, numbers) for factor in factors)
        if not _COMPARISONS[comparison](numbers[name], value):
            return "not reproduced"
    return "reproduced"


def _value(text: str, numbers: Mapping[str, Number]) -> Any:
    """A number of the run by its name, or a number."""
    if text in numbers:
        return numbers[text]
    try:
        return float(text)
    except ValueError:
        raise KeyError(text) from None


def _sentences(templates: list[str], numbers: Mapping[str, Number]) -> Iterator[str]:
    """The sentences whose numbers were computed."""
    for template in templates:
        try:
            yield fill(template, numbers)
        except KeyError:
            continue
