"""Findings: our value, the interpretation, a verdict and the evidence for each published number and
claim."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from string import Template
from typing import Any

from cablebot_reproduction.contents import VERDICTS
from cablebot_reproduction.inputs import judge_input
from cablebot_reproduction.interpretation import Interpretation, NoEquilibriumError, Source
from cablebot_reproduction.judgement import MissingNumberError, Run, Verdict, quantity_text
from cablebot_reproduction.part import Number
from cablebot_reproduction.published import ABOUT, PUBLISHED, Input, Published, load_text
from cablebot_reproduction.texts import command, option_text, relative_difference

RULE = Template(load_text("rules.md")).substitute(percent=f"{100 * ABOUT:g}").strip()
"""Rules of the verdicts: a Markdown list."""

_PAYLOAD_PARTS = ("fig10", "fig11", "fig12", "fig13", "fig14", "fig15")
"""Parts that use the robots of §5.2."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One published item, our value, and the verdict. Without a required part the run has no value
    and no verdict."""

    key: str
    """Key of the published item."""
    place: str
    """Section or table of the paper."""
    statement: str
    """Content of the statement."""
    printed: str
    """Number as printed."""
    kind: str
    """Input, result or claim."""
    ours: str | None = None
    """Text of our value."""
    value: float | None = None
    """Our value, in the unit of the published one."""
    interpretation: str = ""
    """Options that affect our value, as text."""
    verdict: str | None = None
    """Verdict on the item."""
    evidence: str = ""
    """Sentences."""
    command: str
    """Command that computes our value."""


def rows(
    interpretation: Interpretation,
    numbers: Mapping[str, Number],
    impossible: Mapping[str, str] | None = None,
) -> list[dict[str, Any]]:
    """Findings as rows of results.json: inputs, results and claims, each in the order of the paper.

    Args:
        interpretation: interpretation of the paper.
        numbers: numbers of the run.
        impossible: reason for each part that the interpretation does not allow, by part name.
    """
    run = Run(interpretation=interpretation, numbers=numbers)
    return [asdict(find(item, run, impossible or {})) for item in PUBLISHED.values()]


def find(item: Published, run: Run, impossible: Mapping[str, str]) -> Finding:
    """Finding on one published item, see :func:`rows`."""
    if isinstance(item, Input):
        part_names: tuple[str, ...] = (item.part_name,)
    else:
        part_names = VERDICTS[item.key].part_names
    finding = Finding(
        key=item.key,
        place=item.place,
        statement=item.statement,
        printed=item.printed,
        kind=item.kind,
        command=command(run.interpretation, *part_names),
    )
    try:
        if isinstance(item, Input):
            return _input_finding(finding, item, run.interpretation)
        for part_name in part_names:
            if part_name in impossible:
                raise NoEquilibriumError(impossible[part_name])
        return _judged(finding, item, VERDICTS[item.key], run)
    except NoEquilibriumError as error:
        reason = f"Not possible under this interpretation: {error}."
    except MissingNumberError as error:
        (name,) = error.args
        prefix = name.partition(".")[0] + "."
        if not any(key.startswith(prefix) for key in run.numbers):  # the part was not run
            return finding
        reason = _absence(name, run.interpretation)
    interpretation = run.interpretation.text()
    return replace(
        finding, ours="–", verdict="undecided", interpretation=interpretation, evidence=reason
    )


def _input_finding(finding: Finding, item: Input, interpretation: Interpretation) -> Finding:
    value, ours, verdict = judge_input(item, interpretation)
    option = ""
    if item.option:
        option = option_text(item.option, getattr(interpretation, item.option))
    evidence = [f"`{path}`" for path in item.sources]
    if item.note:
        evidence.append(item.note)
    return replace(
        finding,
        ours=ours,
        value=value,
        verdict=verdict,
        interpretation=option,
        evidence="; ".join(evidence),
    )


def _judged(finding: Finding, item: Published, verdict: Verdict, run: Run) -> Finding:
    """Finding on a result or a claim."""
    judgement = verdict.judge(run)
    value, unit = judgement.value, item.unit or verdict.unit
    text = quantity_text(value, unit)
    if value == -math.inf:
        value = None  # the robot fails unloaded
    if item.kind == "result" and unit == "kg" and value is not None:
        assert item.value is not None  # a result has a number
        text = f"{text} ({relative_difference(float(value), item.value)})"
    if judgement.text:
        text = run.sentence(judgement.text, ours=text) or text
    if value is not None:
        value = float(value)
        if unit == "%":
            value = 100 * value
    words = {None: "undecided", True: "reproduced", False: "not reproduced"}
    return replace(
        finding,
        ours=text,
        value=value,
        interpretation=_chosen(verdict, run.interpretation),
        verdict=words[judgement.is_reproduced],
        evidence=run.sentences(judgement.evidence),
    )


def _chosen(verdict: Verdict, interpretation: Interpretation) -> str:
    """Texts of the options and choices that affect our value."""
    source: Source = "control"
    if verdict.part_names[0] in _PAYLOAD_PARTS:
        source = "payload"
    texts = [option_text(name, getattr(interpretation, name), source) for name in verdict.options]
    if verdict.choice:
        texts.append(verdict.choice)
    if "claims" in verdict.part_names and not interpretation.closed_loop_possible:
        texts.append("torque limits from the motor speed, because no motor can have this line")
    return ", ".join(texts)


def _absence(name: str, interpretation: Interpretation) -> str:
    """Reason for a number without value."""
    if interpretation.flexible_loop_possible:
        return f"`{name}` has no value."
    line = interpretation.line
    return f"`{name}` has no value, because no motor can have the torque-speed line {line} in closed loop."
