"""What becomes of each published number and claim: our value, the reading, a verdict and what it rests on.

Inputs are read from the robots, motions, uncertainties and laws that the reproduction runs with. Results and claims are
judged by the numbers of the run: one that was not run has no finding yet, and its row names the command that makes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any

from cablebot_baselines.paper import inputs, verdicts
from cablebot_baselines.paper.finding import Absent, Finder, Finding, Run, command
from cablebot_baselines.paper.part import Number
from cablebot_baselines.paper.published import ABOUT, PUBLISHED, Published
from cablebot_baselines.paper.readings import NoRobot, Readings

RULE = f"""\
* An **input** is *taken* if the reproduction uses it as printed; *taken, corrected* if its unit, name or count had to
  be put right; *contradicted* if the paper prints another value elsewhere; *not taken* if a chosen reading replaces it.
* A **result** *reproduces* if ours is within {100 * ABOUT:g} % of it under the reading used; "more than" if ours is
  more; a motor if it is the same one. What other readings give stands in the evidence and changes no verdict.
* A **claim** *reproduces* or *does not* by the numbers in its row. Where the paper says "perfect", "considerable",
  "affects" or "no change" and gives no number, the border is the same {100 * ABOUT:g} %.
* The paper's own laws, equations and criterion decide where they move the robot at all. What other laws do stands in
  the evidence.
* What this project has no model for, or a chosen reading leaves no robot for, *cannot be decided*."""
"""How verdicts are reached: a list in Markdown."""

NOTHING: Mapping[str, str] = MappingProxyType({})
"""No part is impossible."""

FINDERS: dict[str, Finder] = dict([*inputs.finders(), *verdicts.finders()])
"""How each finding is made, by the key of what was published."""


def find(
    item: Published, readings: Readings, numbers: Mapping[str, Number], impossible: Mapping[str, str] = NOTHING
) -> Finding | None:
    """The finding on one published number or claim; None if a part that it needs was not run.

    Args:
        item: what is published.
        readings: how the paper was read.
        numbers: of the run.
        impossible: why the readings do not allow a part, by its name.
    """
    for part in FINDERS[item.key].parts:
        if part in impossible and item.kind != "input":
            return _undecided(item, readings, f"Under these readings: {impossible[part]}.")
    try:
        return FINDERS[item.key].make(item, Run(readings=readings, numbers=numbers))
    except NoRobot as error:
        return _undecided(item, readings, f"Under these readings there is no such robot: {error}")
    except Absent as absent:
        name = str(absent)
        if not any(key.startswith(f"{name.partition('.')[0]}.") for key in numbers):
            return None
        why = f"`{name}` has no value"
        if not readings.springs_play:
            why += f": no motor has the torque-speed line {readings.line}, so that no closed loop can be run"
        return _undecided(item, readings, f"{why}.")


def _undecided(item: Published, readings: Readings, why: str) -> Finding:
    return Finding(
        ours="–",
        value=None,
        reading=readings.words(),
        verdict="cannot be decided",
        evidence=why,
        command=command(readings, *FINDERS[item.key].parts),
    )


def rows(
    readings: Readings, numbers: Mapping[str, Number], impossible: Mapping[str, str] = NOTHING
) -> list[dict[str, Any]]:
    """The page's rows: each published number or claim beside its finding, in the paper's order.

    Without a finding, ``ours``, ``value`` and ``verdict`` are None, and ``command`` is the one that makes it.
    """
    return [_row(item, readings, find(item, readings, numbers, impossible)) for item in PUBLISHED.values()]


def _row(item: Published, readings: Readings, finding: Finding | None) -> dict[str, Any]:
    row: dict[str, Any] = {name: getattr(item, name) for name in ("key", "place", "says", "printed", "kind")}
    if finding is not None:
        return row | {one.name: getattr(finding, one.name) for one in fields(Finding)}
    empty = {"ours": None, "value": None, "reading": "", "verdict": None, "evidence": ""}
    return row | empty | {"command": command(readings, *FINDERS[item.key].parts)}
