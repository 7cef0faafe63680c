"""Findings: our value, the interpretation, a verdict and the evidence for each published number and claim.

Inputs come from the robots, motions, uncertainties and laws of the reproduction. The verdicts on results and claims use
the numbers of the run. Without the required part there is no finding, and the row names the command that computes it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any

from cablebot_baselines.paper import inputs, verdicts
from cablebot_baselines.paper.finding import Finding, FindingRule, MissingNumber, Run, command
from cablebot_baselines.paper.interpretation import Interpretation, NoEquilibriumError
from cablebot_baselines.paper.part import Number
from cablebot_baselines.paper.published import ABOUT, PUBLISHED, Published

RULE = f"""\
* An **input** is *used* if the reproduction uses the printed value. It is *used, corrected* if its unit, name or count
  is corrected. It is *contradicted* if the paper prints a different value elsewhere. It is *replaced* if the
  interpretation replaces it.
* A **result** is *reproduced* if our value differs by at most {100 * ABOUT:g} % under the chosen interpretation. A
  result of the form "more than" is reproduced if our value is larger. A motor is reproduced if it is the same motor.
  The values of other interpretations are evidence and do not change the verdict.
* A **claim** is *reproduced* or *not reproduced* according to the numbers in its row. If the paper writes "perfect",
  "considerable", "affects" or "no change" without a number, the threshold is the same {100 * ABOUT:g} %.
* The laws, equations and criterion of the paper determine the verdict if they move the robot. The values of other laws
  are evidence.
* A verdict is *undecided* if this project has no model for the statement, or if the robot of the chosen interpretation
  has no equilibrium."""
"""Rules of the verdicts: a Markdown list."""

NOTHING: Mapping[str, str] = MappingProxyType({})
"""Default: every part is possible."""

FINDING_RULES: dict[str, FindingRule] = dict([*inputs.finding_rules(), *verdicts.finding_rules()])
"""Rule of each finding by the key of the published item."""


def find(
    item: Published,
    interpretation: Interpretation,
    numbers: Mapping[str, Number],
    impossible: Mapping[str, str] = NOTHING,
) -> Finding | None:
    """Finding for one published number or claim; None if a required part was not run.

    Args:
        item: published number or claim.
        interpretation: interpretation of the paper.
        numbers: numbers of the run.
        impossible: reason for each part that the interpretation does not allow, by part name.
    """
    for part in FINDING_RULES[item.key].parts:
        if part in impossible and item.kind != "input":
            return _undecided(item, interpretation, f"Not possible under this interpretation: {impossible[part]}.")
    try:
        return FINDING_RULES[item.key].evaluate(item, Run(interpretation=interpretation, numbers=numbers))
    except NoEquilibriumError as error:
        return _undecided(item, interpretation, f"Not possible under this interpretation: {error}.")
    except MissingNumber as absent:
        name = str(absent)
        if not any(key.startswith(f"{name.partition('.')[0]}.") for key in numbers):
            return None
        reason = f"`{name}` has no value"
        if not interpretation.flexible_loop_possible:
            reason += f", because no motor can have the torque-speed line {interpretation.line} in closed loop"
        return _undecided(item, interpretation, f"{reason}.")


def _undecided(item: Published, interpretation: Interpretation, reason: str) -> Finding:
    return Finding(
        ours="–",
        value=None,
        interpretation=interpretation.text(),
        verdict="undecided",
        evidence=reason,
        command=command(interpretation, *FINDING_RULES[item.key].parts),
    )


def rows(
    interpretation: Interpretation, numbers: Mapping[str, Number], impossible: Mapping[str, str] = NOTHING
) -> list[dict[str, Any]]:
    """Rows of the page: each published number or claim with its finding, in the order of the paper.

    Without a finding, ``ours``, ``value`` and ``verdict`` are None, and ``command`` computes the finding.
    """
    return [_row(item, interpretation, find(item, interpretation, numbers, impossible)) for item in PUBLISHED.values()]


def _row(item: Published, interpretation: Interpretation, finding: Finding | None) -> dict[str, Any]:
    row: dict[str, Any] = {name: getattr(item, name) for name in ("key", "place", "statement", "printed", "kind")}
    if finding is not None:
        return row | {one.name: getattr(finding, one.name) for one in fields(Finding)}
    empty = {"ours": None, "value": None, "interpretation": "", "verdict": None, "evidence": ""}
    return row | empty | {"command": command(interpretation, *FINDING_RULES[item.key].parts)}
