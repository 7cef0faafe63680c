"""Inputs, results and claims that the paper prints, read from ``published.toml``."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Literal

Kind = Literal["input", "result", "claim"]
"""Input: a parameter, or a value that follows from the design of the robot. Result: a number that
the paper computed. Claim: a sentence that is true or false."""

ABOUT = 0.05
"""Maximum relative difference between our number and a published number that counts as
reproduced."""


@dataclass(frozen=True, kw_only=True)
class Published:
    """One number or claim of the paper."""

    kind: Kind
    """Input, result or claim."""
    key: str
    """Unique key: the place, a dot, the quantity."""
    statement: str
    """Content of the statement in our words."""
    printed: str = ""
    """Number as printed; empty for a claim without a number."""
    value: float | None = None
    """Number in ``unit``, without "about"; None if there is no number."""
    unit: str = ""
    """Correct unit of the value, which may differ from the printed one; empty if dimensionless."""

    @property
    def place(self) -> str:
        """Section or table."""
        stem = self.key.rpartition(".")[0]
        if stem == "abstract":
            return "Abstract"
        if stem.startswith("table"):
            return f"Table {stem.removeprefix('table')}"
        return f"§{stem}"


@dataclass(frozen=True, kw_only=True)
class Input(Published):
    """A printed parameter and the place of its value in the objects of the runs."""

    part_name: str
    """A part that uses the input."""
    sources: Sequence[str] = ()
    """Paths of the values (:func:`~cablebot_reproduction.inputs.read`), which must be equal.
    Without a path the reproduction reads the published value itself."""
    is_upper_bound: bool = False
    """Whether the published value is an upper bound of ours."""
    corrected: float | None = None
    """Value that replaces a misprinted one."""
    verdict: Literal["used", "used, corrected", "contradicted"] = "used"
    """Verdict if the input is used."""
    option: str = ""
    """Option of the interpretation that affects our value."""
    note: str = ""
    """Remark for the page."""


def load_table(name: str) -> dict[str, Any]:
    """Contents of a TOML file of this package."""
    return tomllib.loads(load_text(name))


def load_text(name: str) -> str:
    """Contents of a text file of this package."""
    return files("cablebot_reproduction").joinpath(name).read_text(encoding="utf-8")


def _load() -> dict[str, Published]:
    tables: Mapping[str, dict[str, dict[str, Any]]] = load_table("published.toml")
    entries: dict[str, Published] = {}
    kinds: Mapping[Kind, type[Published]] = {
        "input": Input,
        "result": Published,
        "claim": Published,
    }
    for kind, entry_class in kinds.items():
        for key, fields in tables[kind].items():
            entries[key] = entry_class(kind=kind, key=key, **fields)
    return entries


PUBLISHED: Mapping[str, Published] = _load()
"""All entries by key: inputs, results and claims, each in the order of the paper."""


def within(ours: float, published: float) -> bool:
    """Whether our number reproduces a published number."""
    return abs(ours - published) <= ABOUT * abs(published)


def published_value(key: str) -> float:
    """Number of an entry.

    Raises:
        ValueError: if the entry has no number.
    """
    value = PUBLISHED[key].value
    if value is None:
        raise ValueError(f"{key!r} has no number: its statement is {PUBLISHED[key].statement}")
    return float(value)  # TOML has integers, too


_SECTIONS = {"planar": "5.2.1", "spatial": "5.2.2", "flexible": "5.2.3"}

LOADS: dict[str, float] = {
    kind: published_value(f"{section}.payload") for kind, section in _SECTIONS.items()
}
"""The published load capacities [kg]."""

MOTORS: dict[str, float] = {
    kind: published_value(f"{section}.motor") for kind, section in _SECTIONS.items()
}
"""Number of the motor that saturates first, as published."""
