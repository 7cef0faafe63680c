"""Inputs, results and claims that the paper prints, read from ``published.toml``, and the rules that judge them."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib.resources import files
from typing import Any, Literal

Kind = Literal["input", "result", "claim"]
"""Input: a parameter, or a value that follows from the design of the robot. Result: a number that the paper computed.
Claim: a sentence that is true or false."""

ABOUT = 0.05
"""Maximum relative difference between our number and a published number that counts as reproduced."""


@dataclass(frozen=True, kw_only=True)
class Published:
    """One number or claim of the paper, and the rule that judges it.

    ``ours`` and ``holds`` contain expressions: products of literals, of numbers of the run such as
    ``fig10.counted_kg``, of attributes of the inputs such as ``@planar.mass``
    (:data:`~cablebot_baselines.paper.inputs.SOURCES`), and of ``published``, the value of the item. Templates contain
    such names in braces (:meth:`~cablebot_baselines.paper.verdicts.Run.filled`).
    """

    key: str
    """Unique key: the place, a dot, the quantity."""
    kind: Kind
    """Input, result or claim."""
    statement: str
    """Content of the statement in our words."""
    printed: str = ""
    """Number as printed; empty for a claim without a number."""
    value: float | None = None
    """Number in ``unit``, without "about"; None if there is no number."""
    unit: str = ""
    """Correct unit of the value, which may differ from the printed one; empty if dimensionless."""
    times: int
    """Number of occurrences at this place, in digits or words."""
    parts: tuple[str, ...]
    """Parts that compute the required numbers, or a part that uses the input."""
    ours: tuple[str, ...] = ()
    """Expressions of our value. All values of an input must be equal."""
    pick: Literal["max", "min"] = "max"
    """Which of several values of a result or claim is our value."""
    text: str = ""
    """Template of our value; the value with its unit if empty."""
    holds: tuple[str, ...] = ()
    """Comparisons of two expressions by ``<``, ``<=``, ``>``, ``>=``, ``=`` or ``≈`` (equal within :data:`ABOUT`). The
    item is reproduced, or the input is used, if all hold. Without a comparison a result or claim is undecided, and an
    input must equal the published value."""
    evidence: tuple[str, ...] = ()
    """Templates of sentences. The page omits a sentence if the run did not compute one of its numbers."""
    options: tuple[str, ...] = ()
    """Options of the interpretation that affect our value."""
    choice: str = ""
    """Further choices that affect our value."""
    verdict: str = "used"
    """Verdict of an input that is used."""

    @property
    def place(self) -> str:
        """Section or table."""
        stem = self.key.rpartition(".")[0]
        if stem.startswith("table"):
            return f"Table {stem.removeprefix('table')}"
        return "Abstract" if stem == "abstract" else f"§{stem}"


def load_table(name: str) -> dict[str, Any]:
    """Contents of a TOML file of this package."""
    return tomllib.loads(load_text(name))


def load_text(name: str) -> str:
    """Contents of a text file of this package."""
    return files("cablebot_baselines.paper").joinpath(name).read_text(encoding="utf-8")


def _published(key: str, kind: Kind, fields: dict[str, Any]) -> Published:
    given: dict[str, Any] = {"times": 0 if kind == "claim" else 1} | fields
    for name in {"parts", "ours", "holds", "evidence", "options"} & set(given):
        given[name] = (given[name],) if isinstance(given[name], str) else tuple(given[name])
    if "value" not in given and kind != "claim" and given["printed"].replace(".", "").isdigit():
        given["value"] = float(given["printed"])
    return Published(key=key, kind=kind, **given)


_KINDS: tuple[Kind, ...] = ("input", "result", "claim")

PUBLISHED: dict[str, Published] = {
    key: _published(key, kind, fields)
    for table in (load_table("published.toml"),)
    for kind in _KINDS
    for key, fields in table[kind].items()
}
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
    return value


_SECTIONS = {"planar": "5.2.1", "spatial": "5.2.2", "flexible": "5.2.3"}

LOADS: dict[str, float] = {kind: published_value(f"{section}.payload") for kind, section in _SECTIONS.items()}
"""The published load capacities [kg]."""

MOTORS: dict[str, float] = {kind: published_value(f"{section}.motor") for kind, section in _SECTIONS.items()}
"""Number of the motor that saturates first, as published."""
