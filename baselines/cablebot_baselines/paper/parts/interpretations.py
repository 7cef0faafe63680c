"""Payloads of the paper under all combinations of the options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import product
from typing import Any

from cablebot_baselines.classical import Composite, FeedbackLinearization, FourthOrder, MotorPD
from cablebot_baselines.paper.exact import LargestPayload, exact_limit, state_space_limit
from cablebot_baselines.paper.interpretation import Interpretation, choices_of
from cablebot_baselines.paper.part import Jobs, Number, Outcome, Results, Table, job
from cablebot_baselines.paper.parts.profiles import saturated_motor, violation_text
from cablebot_baselines.paper.published import LOADS, load_table, within
from cablebot_baselines.paper.runs import FLEX, PLANAR, SPATIAL, Law, largest_payload
from cablebot_gym.evaluation import DLCCResult

_CHOICES = choices_of()
_LINES = _CHOICES["line"]
_RIGID_LINES = tuple(line for line in _LINES if line != "pulley")  # a rigid pulley turns with its motor

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
    "flexible": {"eq24": _CHOICES["eq24"], "stiffness": ("2", "3"), "line": _LINES},
}
"""Options that affect the payload of each robot, and their values."""

_TEXTS = load_table("interpretations.toml")

PayloadLimits = dict[Interpretation, LargestPayload | None]
"""Largest payload by interpretation; None if the robot has no equilibrium with positive tensions."""


def varied(interpretation: Interpretation, kind: str) -> list[Interpretation]:
    """All combinations of the options that affect the payload of a robot; other options as in ``interpretation``."""
    choices = VARIED[kind]
    return [interpretation.replace(**dict(zip(choices, values, strict=True))) for values in product(*choices.values())]


def limits(*, interpretation: Interpretation, kind: str) -> PayloadLimits:
    """Payloads of exact tracking for a rigid robot, or of the state space of Eqs. 23–25 for the flexible one."""
    return {variant: _limit(variant, kind) for variant in varied(interpretation, kind)}


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
    except ValueError:
        return False
    return True


_CLOSED: dict[str, dict[str, Any]] = _TEXTS["closed"]
"""Changes of one option at a time: ``text`` and changed option."""

_FLEXIBLE_LAWS: dict[str, Law] = {"fl4": FourthOrder, "motor-pd": MotorPD, "composite": Composite}

_BRANCHES: dict[str, dict[str, Any]] = {
    "first": {},
    "second": {"trajectory": {"name": "paper-spatial", "duration": 1.0 - 1e-9}},
}
"""Branch of Table 3 at the control instant 0.5 s. The first branch is the printed one, "t ≤ 0.5". A motion that is 1 ns
shorter selects the second branch."""


def jobs(interpretation: Interpretation) -> Jobs:
    """Payloads of all combinations, and of closed loops with one option changed at a time."""
    made = {kind: job(limits, interpretation=interpretation, kind=kind) for kind in VARIED}
    payload = partial(job, largest_payload, criterion="paper")
    for name, changed in _CLOSED.items():
        changes = changed["changes"]
        variant = interpretation.replace(**changes)
        if not variant.closed_loop_possible:
            continue
        if changes.keys() <= VARIED["planar"].keys():
            law = partial(FeedbackLinearization, minimum_tension=variant.minimum_tension)
            robot = variant.motors(variant.planar)
            made[f"planar_{name}"] = payload(env_id=PLANAR, law=law, robot=robot, name="fl")
        if changes.keys() <= VARIED["spatial"].keys() and _has_equilibrium(variant):
            robot = variant.motors(variant.spatial("payload"))
            made[f"spatial_{name}"] = payload(env_id=SPATIAL, law=FeedbackLinearization, robot=robot, name="fl")
    if interpretation.flexible_loop_possible and _has_equilibrium(interpretation):
        robot = interpretation.motors(interpretation.flexible("payload"))
        for (name, flexible_law), (branch, changes) in product(_FLEXIBLE_LAWS.items(), _BRANCHES.items()):
            one = payload(env_id=FLEX, law=flexible_law, robot=robot, name=name, **changes)
            made[f"flex_{name}_{branch}"] = one
    return made


def outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Payloads and limiting motors, and numbers of payloads close to the published ones."""
    numbers: dict[str, Number] = {}
    for kind, choices in VARIED.items():
        found: PayloadLimits = results[kind]
        for variant, limit in found.items():
            name = "_".join(str(getattr(variant, field)) for field in choices)
            numbers[f"{kind}_{name}_kg"] = None if limit is None else limit.payload
            numbers[f"{kind}_{name}_motor"] = None if limit is None else limit.motor
        close = [limit is not None and within(limit.payload, LOADS[kind]) for limit in found.values()]
        numbers |= {f"{kind}_within_5pct": sum(close), f"{kind}_total": len(found)}
    totals = (limit.payload + variant.planar.mass for variant, limit in results["planar"].items() if limit is not None)
    numbers["planar_as_total_within_5pct"] = sum(within(total, LOADS["planar"]) for total in totals)
    closed, branches = [], []
    for name, result in results.items():
        if isinstance(result, DLCCResult):
            numbers |= {f"loop_{name}_kg": result.payload, f"loop_{name}_motor": saturated_motor(result)}
            kind, option = name.split("_", 1)
            violation = violation_text(result.violation)
            if kind == "flex":
                branches.append((*option.rsplit("_", 1), result.payload, violation))
            else:
                closed.append((kind, _CLOSED[option]["text"], result.payload, result.total_mass, violation))
    closed_title = "Closed loop: `fl` at 500 Hz under the paper criterion, one option changed at a time"
    branch_title = "Joint springs, closed loop under the paper criterion: effect of the branch of Table 3 at 0.5 s"
    return Outcome(
        numbers=numbers,
        tables=(
            *(_table(kind, results[kind]) for kind in VARIED),
            Table(
                title=closed_title,
                header=("robot", "option", "payload [kg]", "total mass [kg]", "limiting violation"),
                rows=tuple(closed),
            ),
            Table(
                title=branch_title,
                header=("law", "branch at 0.5 s", "payload [kg]", "limiting violation"),
                rows=tuple(branches),
            ),
        ),
    )


def _table(kind: str, found: PayloadLimits) -> Table:
    """One row for each combination of the other options, one column for each torque-speed line."""
    *fields, line = VARIED[kind]
    rows: dict[tuple[str, ...], list[str]] = {}
    for variant, limit in found.items():
        rows.setdefault(tuple(str(getattr(variant, field)) for field in fields), []).append(_limit_text(limit))
    header = (*(field.replace("_", " ") for field in fields), *(f"{line} {value}" for value in VARIED[kind][line]))
    return Table(title=_TEXTS["titles"][kind], header=header, rows=tuple(merged_rows(rows)))


def merged_rows(rows: Mapping[tuple[str, ...], list[str]]) -> Iterator[tuple[str, ...]]:
    """Merges rows with the same first column into one row if all their values are equal."""
    values: dict[str, set[str]] = {}
    for key, cells in rows.items():
        values.setdefault(key[0], set()).update(cells)
    merged = {key: key if len(values[key[0]]) > 1 else (key[0], *("any" for _ in key[1:])) for key in rows}
    yield from {(*merged[key], *cells): None for key, cells in rows.items()}


def _limit_text(limit: LargestPayload | None) -> str:
    if limit is None:
        return "no equilibrium"
    if limit.payload == float("-inf"):
        return "infeasible"
    return f"{limit.payload:.2f} (motor {limit.motor})".replace("-", "−")
