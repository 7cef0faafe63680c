"""Rows of the page: our value, the interpretation, a verdict and the evidence for each published number and claim."""

from __future__ import annotations

from collections.abc import Mapping
from string import Template
from typing import Any

from cablebot_baselines.paper.interpretation import Interpretation, NoEquilibriumError, Source
from cablebot_baselines.paper.part import Number
from cablebot_baselines.paper.published import ABOUT, PUBLISHED, Published, load_text
from cablebot_baselines.paper.texts import command, option_text
from cablebot_baselines.paper.verdicts import MissingNumber, Run, judge, judge_input

RULE = Template(load_text("rules.md")).substitute(percent=f"{100 * ABOUT:g}").strip()
"""Rules of the verdicts: a Markdown list."""

_PAYLOAD_PARTS = ("fig10", "fig11", "fig12", "fig13", "fig14", "fig15")
"""Parts that use the robots of §5.2."""


def rows(
    interpretation: Interpretation, numbers: Mapping[str, Number], impossible: Mapping[str, str] | None = None
) -> list[dict[str, Any]]:
    """Rows of the page: inputs, results and claims, each in the order of the paper.

    Without a required part, ``ours``, ``value`` and ``verdict`` are None, and ``command`` computes them.

    Args:
        interpretation: interpretation of the paper.
        numbers: numbers of the run.
        impossible: reason for each part that the interpretation does not allow, by part name.
    """
    run = Run(interpretation=interpretation, numbers=numbers)
    return [finding(item, run, impossible or {}) for item in PUBLISHED.values()]


def finding(item: Published, run: Run, impossible: Mapping[str, str]) -> dict[str, Any]:
    """Row of one published item, see :func:`rows`."""
    ours: str | None = None
    value: float | None = None
    verdict: str | None = None
    chosen, evidence = "", ""
    forbidden = [impossible[part] for part in item.parts if part in impossible and item.kind != "input"]
    try:
        if forbidden:
            raise NoEquilibriumError(forbidden[0])
        ours, value, verdict = (judge_input if item.kind == "input" else judge)(item, run)
        chosen, evidence = _chosen(item, run.interpretation), _evidence(item, run)
    except NoEquilibriumError as error:
        ours, verdict = "–", "undecided"
        chosen, evidence = run.interpretation.text(), f"Not possible under this interpretation: {error}."
    except MissingNumber as absent:
        part = str(absent).partition(".")[0]
        if any(key.startswith(f"{part}.") for key in run.numbers):
            ours, verdict = "–", "undecided"
            chosen, evidence = run.interpretation.text(), _absence(str(absent), run.interpretation)
    return {
        "key": item.key,
        "place": item.place,
        "statement": item.statement,
        "printed": item.printed,
        "kind": item.kind,
        "ours": ours,
        "value": value,
        "interpretation": chosen,
        "verdict": verdict,
        "evidence": evidence,
        "command": command(run.interpretation, *item.parts),
    }


def _chosen(item: Published, interpretation: Interpretation) -> str:
    """Texts of the options that affect our value."""
    source: Source | None = None
    if item.kind != "input":
        source = "payload" if item.parts[0] in _PAYLOAD_PARTS else "control"
    texts = [option_text(name, getattr(interpretation, name), source) for name in item.options]
    if item.choice:
        texts.append(item.choice)
    if "claims" in item.parts and not interpretation.closed_loop_possible:
        texts.append("torque limits from the motor speed, because no motor can have this line")
    return ", ".join(texts)


def _evidence(item: Published, run: Run) -> str:
    """Sentences of the evidence; for an input the paths of its values and remarks."""
    if item.kind != "input":
        return run.all_filled(item.evidence)
    paths = [f"`{expression.replace('@', '')}`" for expression in item.ours if expression != "published"]
    return "; ".join([*paths, *item.evidence])


def _absence(name: str, interpretation: Interpretation) -> str:
    """Reason for a number without value."""
    reason = ""
    if not interpretation.flexible_loop_possible:
        reason = f", because no motor can have the torque-speed line {interpretation.line} in closed loop"
    return f"`{name}` has no value{reason}."
