"""Payloads of the paper under all combinations of the options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import product
from typing import Any

from cablebot_baselines.classical import Composite, FeedbackLinearization, FourthOrder, MotorPD
from cablebot_gym.evaluation import DLCCResult
from cablebot_reproduction.exact import LargestPayload, exact_limit, state_space_limit
from cablebot_reproduction.interpretation import (
    AS_PRINTED,
    Interpretation,
    NoEquilibriumError,
    choices_of,
)
from cablebot_reproduction.judgement import Run
from cablebot_reproduction.part import Jobs, Number, Outcome, Results, Table, job
from cablebot_reproduction.parts.profiles import saturated_motor, violation_text
from cablebot_reproduction.published import LOADS, MOTORS, load_table, within
from cablebot_reproduction.runs import FLEX, PLANAR, SPATIAL, Law, largest_payload
from cablebot_reproduction.texts import kilograms, option_text, relative_difference

_CHOICES = choices_of()
_LINES = _CHOICES["line"]
# A rigid pulley turns with its motor.
_RIGID_LINES = tuple(line for line in _LINES if line != "pulley")

VARIED: dict[str, dict[str, tuple[Any, ...]]] = {
    "spatial": {
        "triangles": _CHOICES["triangles"],
        "sides": _CHOICES["sides"],
        "pulleys": _CHOICES["pulleys"],
        "platform_mass": ("10", "11"),
        "line": _RIGID_LINES,
    },
    "planar": {
        "planar_apex": _CHOICES["planar_apex"],
        "alpha": _CHOICES["alpha"],
        "minimum_tension": (0.0, 5.0),
        "line": _RIGID_LINES,
    },
    "flexible": {
        "eq24": _CHOICES["eq24"],
        "stiffness": ("2", "3"),
        "line": _LINES,
    },
}
"""Options that affect the payload of each robot, and their values."""

_TEXTS = load_table("interpretations.toml")

_CHANGES: dict[str, dict[str, Any]] = _TEXTS["closed"]
"""Changes of one option at a time: ``text`` and ``changes``."""

_FLEXIBLE_LAWS: dict[str, Law] = {"fl4": FourthOrder, "motor-pd": MotorPD, "composite": Composite}

_BRANCHES: dict[str, dict[str, Any]] = {
    "first": {},
    "second": {"trajectory": {"name": "paper-spatial", "duration": 1.0 - 1e-9}},
}
"""Branch of Table 3 at the control instant 0.5 s. The first branch is the printed one, "t ≤ 0.5". A
motion that is 1 ns shorter selects the second branch."""

_NEAR = 0.015
"""Relative difference below which a payload matches a published one within rounding."""

PayloadLimits = dict[Interpretation, LargestPayload | None]
"""Largest payload by interpretation; None if the robot has no equilibrium with positive
tensions."""


def limits(*, interpretation: Interpretation, kind: str) -> PayloadLimits:
    """Payloads of exact tracking for a rigid robot, or of the state space of Eqs. 23–25 for the
    flexible one, for all combinations of the options that affect them."""
    choices = VARIED[kind]
    payloads = {}
    for values in product(*choices.values()):
        variant = interpretation.replace(**dict(zip(choices, values, strict=True)))
        payloads[variant] = _limit(variant, kind)
    return payloads


def _limit(interpretation: Interpretation, kind: str) -> LargestPayload | None:
    if kind == "planar":
        return exact_limit(interpretation, interpretation.planar)
    if not _has_equilibrium(interpretation):
        return None
    if kind == "spatial":
        return exact_limit(interpretation, interpretation.spatial("payload"))
    return state_space_limit(interpretation, interpretation.flexible("payload"))


def _has_equilibrium(interpretation: Interpretation) -> bool:
    """Whether the spatial robot has an equilibrium with positive tensions."""
    try:
        interpretation.spatial("payload")
    except NoEquilibriumError:
        return False
    return True


def jobs(interpretation: Interpretation) -> Jobs:
    """Payloads of all combinations, and of closed loops with one option changed at a time."""
    jobs = {kind: job(limits, interpretation=interpretation, kind=kind) for kind in VARIED}
    payload = partial(job, largest_payload, criterion="paper")
    for name, change in _CHANGES.items():
        options = change["changes"].keys()
        variant = interpretation.replace(**change["changes"])
        if not variant.closed_loop_possible:
            continue
        if options <= VARIED["planar"].keys():
            law = partial(FeedbackLinearization, minimum_tension=variant.minimum_tension)
            robot = variant.closed_loop_robot(variant.planar)
            jobs[f"planar_{name}"] = payload(env_id=PLANAR, law=law, robot=robot, name="fl")
        if options <= VARIED["spatial"].keys() and _has_equilibrium(variant):
            robot = variant.closed_loop_robot(variant.spatial("payload"))
            jobs[f"spatial_{name}"] = payload(
                env_id=SPATIAL, law=FeedbackLinearization, robot=robot, name="fl"
            )
    if interpretation.flexible_loop_possible and _has_equilibrium(interpretation):
        robot = interpretation.closed_loop_robot(interpretation.flexible("payload"))
        for name, flexible_law in _FLEXIBLE_LAWS.items():
            for branch, motion in _BRANCHES.items():
                loop = payload(env_id=FLEX, law=flexible_law, robot=robot, name=name, **motion)
                jobs[f"flex_{name}_{branch}"] = loop
    return jobs


def outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Payloads and limiting motors, and numbers of payloads close to the published ones."""
    numbers: dict[str, Number] = {}
    for kind in VARIED:
        numbers |= _combination_numbers(kind, results[kind])
    platform = interpretation.planar.mass
    close = 0
    for limit in results["planar"].values():
        close += within(limit.payload + platform, LOADS["planar"])
    numbers["planar_as_total_within_5pct"] = close
    rigid_rows, flexible_rows = [], []
    for name, result in results.items():
        if not isinstance(result, DLCCResult):
            continue
        numbers[f"loop_{name}_kg"] = result.payload
        numbers[f"loop_{name}_motor"] = saturated_motor(result)
        kind, option = name.split("_", 1)
        violation = violation_text(result.violation)
        if kind == "flex":
            law, branch = option.rsplit("_", 1)
            flexible_rows.append((law, branch, result.payload, violation))
        else:
            rigid_rows.append(
                (kind, _CHANGES[option]["text"], result.payload, result.total_mass, violation)
            )
    rigid = Table(
        title="Closed loop: `fl` at 500 Hz under the paper criterion, one option changed at a time",
        header=("robot", "option", "payload [kg]", "total mass [kg]", "limiting violation"),
        rows=tuple(rigid_rows),
    )
    flexible = Table(
        title="Joint springs, closed loop under the paper criterion: effect of the branch of Table 3 at 0.5 s",
        header=("law", "branch at 0.5 s", "payload [kg]", "limiting violation"),
        rows=tuple(flexible_rows),
    )
    combinations = [_table(kind, results[kind]) for kind in VARIED]
    return Outcome(numbers=numbers, tables=(*combinations, rigid, flexible))


def _combination_numbers(kind: str, payloads: PayloadLimits) -> dict[str, Number]:
    numbers: dict[str, Number] = {}
    close = 0
    for variant, limit in payloads.items():
        name = "_".join(str(getattr(variant, option)) for option in VARIED[kind])
        numbers[f"{kind}_{name}_kg"] = None
        numbers[f"{kind}_{name}_motor"] = None
        if limit is not None:
            numbers[f"{kind}_{name}_kg"] = limit.payload
            numbers[f"{kind}_{name}_motor"] = limit.motor
            close += within(limit.payload, LOADS[kind])
    return numbers | {f"{kind}_within_5pct": close, f"{kind}_total": len(payloads)}


def _table(kind: str, payloads: PayloadLimits) -> Table:
    """One row for each combination of the other options, one column for each torque-speed line."""
    *options, line = VARIED[kind]
    rows: dict[tuple[str, ...], list[str]] = {}
    for variant, limit in payloads.items():
        combination = tuple(str(getattr(variant, option)) for option in options)
        rows.setdefault(combination, []).append(_limit_text(limit))
    header = [option.replace("_", " ") for option in options]
    header += [f"{line} {value}" for value in VARIED[kind][line]]
    return Table(title=_TEXTS["titles"][kind], header=tuple(header), rows=tuple(merged_rows(rows)))


def merged_rows(rows: Mapping[tuple[str, ...], list[str]]) -> Iterator[tuple[str, ...]]:
    """Merges rows with the same first column into one row if all their values are equal."""
    values: dict[str, set[str]] = {}
    for (option, *_), cells in rows.items():
        values.setdefault(option, set()).update(cells)
    merged = set()
    for options, cells in rows.items():
        option = options[0]
        if len(values[option]) > 1:
            yield (*options, *cells)
        elif option not in merged:
            merged.add(option)
            yield (option, *["any"] * (len(options) - 1), *cells)


def _limit_text(limit: LargestPayload | None) -> str:
    if limit is None:
        return "no equilibrium"
    if limit.payload == float("-inf"):
        return "infeasible"
    return f"{limit.payload:.2f} (motor {limit.motor})".replace("-", "−")


# --- evidence for the published payloads ------------------------------------------------------------------------------


def evidence_of_combinations(run: Run, kind: str) -> list[str]:
    """Sentences on the payloads of all combinations for a verdict on a published payload."""
    sentences = []
    closest = closest_payload(run, kind)
    if closest:
        sentences.append(f"Closest combination of options with the published motor: {closest}.")
    closest_total = kind == "planar" and closest_payload(
        run, kind, platform=run.interpretation.planar.mass
    )
    if closest_total:
        sentences.append(f"Closest total mass of platform and load: {closest_total}.")
    count = f"{{interpretations.{kind}_within_5pct}} of {{interpretations.{kind}_total}}"
    return [*sentences, f"{count} combinations are within 5 %, for any limiting motor."]


def closest_payload(run: Run, kind: str, *, platform: float = 0.0) -> str:
    """Payloads closest to a published one, with their differences and options; empty without
    combinations.

    Only combinations with the published motor count. All payloads that match within rounding are
    listed, or only the closest payload if none matches. ``platform`` is added to the payloads [kg].
    """
    prefix, target = f"interpretations.{kind}_", LOADS[kind]
    payloads = {}
    for key, payload in run.numbers.items():
        stem = key.removesuffix("_kg")
        if not key.startswith(prefix) or stem == key or not isinstance(payload, (int, float)):
            continue
        if run.numbers.get(f"{stem}_motor") == MOTORS[kind]:
            payloads[stem.removeprefix(prefix)] = platform + payload
    ordered = sorted(payloads, key=lambda name: abs(payloads[name] - target))
    near = [name for name in ordered if abs(payloads[name] / target - 1) <= _NEAR]
    texts = []
    for name in near or ordered[:1]:
        difference = relative_difference(payloads[name], target)
        texts.append(
            f"{kilograms(payloads[name])} ({difference}) with {_combination_text(kind, name)}"
        )
    return ", or ".join(texts)


def _combination_text(kind: str, name: str) -> str:
    """Options in the name of a number that differ from the default."""
    texts = []
    for option, choice in zip(VARIED[kind], name.split("_"), strict=True):
        default = str(getattr(Interpretation(), option))
        if option in AS_PRINTED:
            default = f"{AS_PRINTED[option]['payload']:g}"
        if choice != default:
            texts.append(option_text(option, choice))
    return ", ".join(texts) or "the default interpretation"
