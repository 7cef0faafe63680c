"""Payloads of the paper under all combinations of the options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import product
from typing import Any

from cablebot_baselines.classical import Composite, FeedbackLinearization, FourthOrder, MotorPD
from cablebot_baselines.paper.exact import LargestPayload, exact_limit, state_space_limit
from cablebot_baselines.paper.interpretation import Interpretation, choices_of
from cablebot_baselines.paper.part import Cell, CellResults, Number, Outcome, Part, Table
from cablebot_baselines.paper.parts.profiles import violation_text
from cablebot_baselines.paper.published import LOADS, within
from cablebot_baselines.paper.runs import Law, largest_payload
from cablebot_gym.evaluation import DLCCResult

_LINES = choices_of()["line"]
_RIGID_LINES = tuple(line for line in _LINES if line != "pulley")  # a rigid pulley turns with its motor
_TENSIONS = (0.0, 5.0)

PayloadLimits = dict[Interpretation, LargestPayload | None]
"""Largest payload by interpretation; None if the robot has no equilibrium with positive tensions."""


def _varied(interpretation: Interpretation, **choices: tuple[object, ...]) -> list[Interpretation]:
    """All combinations of these choices; other options as in ``interpretation``."""
    return [interpretation.replace(**dict(zip(choices, values, strict=True))) for values in product(*choices.values())]


def spatial_interpretations(interpretation: Interpretation) -> list[Interpretation]:
    """All combinations of the options that affect the payload of the rigid spatial robot."""
    choices = choices_of()
    return _varied(
        interpretation,
        triangles=choices["triangles"],
        sides=choices["sides"],
        pulleys=choices["pulleys"],
        platform_mass=("10", "11"),
        line=_RIGID_LINES,
    )


def planar_interpretations(interpretation: Interpretation) -> list[Interpretation]:
    """All combinations of the options that affect the payload of the planar robot."""
    choices = choices_of()
    return _varied(
        interpretation,
        planar_apex=choices["planar_apex"],
        alpha=choices["alpha"],
        minimum_tension=_TENSIONS,
        line=_RIGID_LINES,
    )


def flexible_interpretations(interpretation: Interpretation) -> list[Interpretation]:
    """All combinations of the options that affect the payload of the state space with joint springs."""
    return _varied(interpretation, eq24=choices_of()["eq24"], stiffness=("2", "3"), line=_LINES)


def planar_limits(*, interpretation: Interpretation) -> PayloadLimits:
    """Payloads of exact tracking for the planar robot."""
    return {variant: exact_limit(variant, variant.planar) for variant in planar_interpretations(interpretation)}


def spatial_limits(*, interpretation: Interpretation) -> PayloadLimits:
    """Payloads of exact tracking for the rigid spatial robot."""
    return {variant: _spatial_limit(variant) for variant in spatial_interpretations(interpretation)}


def flexible_limits(*, interpretation: Interpretation) -> PayloadLimits:
    """Payloads of the state space of Eqs. 23–25."""
    possible = _has_equilibrium(interpretation)
    return {
        variant: state_space_limit(variant, variant.flexible("payload")) if possible else None
        for variant in flexible_interpretations(interpretation)
    }


def _spatial_limit(interpretation: Interpretation) -> LargestPayload | None:
    return exact_limit(interpretation, interpretation.spatial("payload")) if _has_equilibrium(interpretation) else None


def _has_equilibrium(interpretation: Interpretation) -> bool:
    """Whether the spatial robot has an equilibrium with positive tensions."""
    try:
        interpretation.spatial("payload")
    except ValueError:
        return False
    return True


_CLOSED: dict[str, tuple[str, dict[str, Any]]] = {
    "chosen": ("chosen interpretation", {}),
    "flat": ("torque limits independent of speed", {"line": "flat"}),
    "mass_11": ("platform mass 11 kg", {"platform_mass": "11"}),
    "circumradius": ("a and b are circumradii", {"sides": "circumradius"}),
    "turned": ("both triangles rotated by 180°", {"triangles": "turned"}),
    "table5": ("pulleys of Table 5", {"pulleys": "table5"}),
    "no_tension": ("T_min = 0", {"minimum_tension": 0.0}),
    "apex_left": ("third motor on the left", {"planar_apex": "left"}),
    "apex_down": ("third motor at the bottom", {"planar_apex": "down"}),
    "apex_right": ("third motor on the right", {"planar_apex": "right"}),
}
"""Changes of one option at a time: text and changed option."""

_FLEXIBLE_LAWS: dict[str, Law] = {"fl4": FourthOrder, "motor-pd": MotorPD, "composite": Composite}

_BRANCHES: dict[str, dict[str, Any]] = {
    "first": {},
    "second": {"trajectory": {"name": "paper-spatial", "duration": 1.0 - 1e-9}},
}
"""Branch of Table 3 at the control instant 0.5 s. The first branch is the printed one, "t ≤ 0.5". A motion that is 1 ns
shorter selects the second branch."""

_PLANAR_ONLY, _SPATIAL_ONLY = {"minimum_tension", "planar_apex"}, {"platform_mass", "pulleys", "sides", "triangles"}


def _cells(interpretation: Interpretation) -> dict[str, Cell]:
    cells: dict[str, Cell] = {
        "planar": partial(planar_limits, interpretation=interpretation),
        "spatial": partial(spatial_limits, interpretation=interpretation),
        "flexible": partial(flexible_limits, interpretation=interpretation),
    }
    for name, (_, changes) in _CLOSED.items():
        variant = interpretation.replace(**changes)
        if not variant.closed_loop_possible:
            continue
        if not _SPATIAL_ONLY & set(changes):
            cells[f"planar_{name}"] = partial(
                largest_payload,
                env_id="CableBot-Planar-v0",
                law=partial(FeedbackLinearization, minimum_tension=variant.minimum_tension),
                robot=variant.motors(variant.planar),
                name="fl",
                criterion="paper",
            )
        if not _PLANAR_ONLY & set(changes) and _has_equilibrium(variant):
            cells[f"spatial_{name}"] = partial(
                largest_payload,
                env_id="CableBot-Spatial-v0",
                law=FeedbackLinearization,
                robot=variant.motors(variant.spatial("payload")),
                name="fl",
                criterion="paper",
            )
    if interpretation.flexible_loop_possible and _has_equilibrium(interpretation):
        cells |= {
            f"flex_{name}_{branch}": partial(
                largest_payload,
                env_id="CableBot-FlexSpatial-v0",
                law=law,
                robot=interpretation.motors(interpretation.flexible("payload")),
                name=name,
                criterion="paper",
                **changes,
            )
            for name, law in _FLEXIBLE_LAWS.items()
            for branch, changes in _BRANCHES.items()
        }
    return cells


def _outcome(interpretation: Interpretation, results: CellResults) -> Outcome:
    planar, spatial, flexible = (results[name] for name in ("planar", "spatial", "flexible"))
    numbers: dict[str, Number] = {}
    for kind, limits, fields in (
        ("spatial", spatial, ("triangles", "sides", "pulleys", "platform_mass", "line")),
        ("planar", planar, ("planar_apex", "alpha", "minimum_tension", "line")),
        ("flexible", flexible, ("eq24", "stiffness", "line")),
    ):
        close = 0
        for variant, limit in limits.items():
            name = "_".join(str(getattr(variant, field)) for field in fields)
            numbers[f"{kind}_{name}_kg"] = None if limit is None else limit.payload
            numbers[f"{kind}_{name}_motor"] = None if limit is None else limit.motor
            close += limit is not None and within(limit.payload, LOADS[kind])
        numbers[f"{kind}_within_5pct"] = close
        numbers[f"{kind}_total"] = len(limits)
    totals = (limit.payload + variant.planar.mass for variant, limit in planar.items() if limit is not None)
    numbers["planar_as_total_within_5pct"] = sum(within(total, LOADS["planar"]) for total in totals)
    return Outcome(
        numbers=numbers | _closed_numbers(results),
        tables=(
            _table(
                "Rigid spatial robot, exact tracking: added payload [kg] and limiting motor; published: "
                "2.56 kg, motor 2",
                ("triangles", "sides", "pulleys", "platform_mass"),
                spatial,
            ),
            _table(
                "Planar robot, exact tracking: payload [kg] added to the platform of 1 kg and limiting motor; "
                "published: 2.2 kg, motor 2",
                ("planar_apex", "alpha", "minimum_tension"),
                planar,
            ),
            _table(
                "Joint springs, state space of Eqs. 23–25: added payload [kg] and limiting motor; published: "
                "1.4 kg, motor 2 at K = 3",
                ("eq24", "stiffness"),
                flexible,
            ),
            _closed_table(results),
            _branch_table(results),
        ),
    )


def _table(title: str, fields: tuple[str, ...], limits: PayloadLimits) -> Table:
    """One row for each combination of the fields, one column for each torque-speed line."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for variant, limit in limits.items():
        rows.setdefault(tuple(str(getattr(variant, field)) for field in fields), []).append(_limit_text(limit))
    lines = _LINES if len(next(iter(rows.values()))) == len(_LINES) else _RIGID_LINES
    header = (*(field.replace("_", " ") for field in fields), *(f"line {line}" for line in lines))
    return Table(title=title, header=header, rows=tuple(_merged(rows)))


def _merged(rows: Mapping[tuple[str, ...], list[str]]) -> Iterator[tuple[str, ...]]:
    """Merges rows with the same first column into one row if all their values are equal."""
    values: dict[str, set[str]] = {}
    for key, cells in rows.items():
        values.setdefault(key[0], set()).update(cells)
    written: set[str] = set()
    for (first, *others), cells in rows.items():
        if len(values[first]) > 1:
            yield (first, *others, *cells)
        elif first not in written:
            written.add(first)
            yield (first, *("any" for _ in others), *cells)


def _limit_text(limit: LargestPayload | None) -> str:
    if limit is None:
        return "no equilibrium"
    if limit.payload == float("-inf"):
        return "infeasible"
    return f"{limit.payload:.2f} (motor {limit.motor})".replace("-", "−")


def _closed(results: CellResults) -> dict[str, DLCCResult]:
    """Closed-loop results among the cells."""
    return {name: result for name, result in results.items() if isinstance(result, DLCCResult)}


def _closed_numbers(results: CellResults) -> dict[str, Number]:
    numbers: dict[str, Number] = {}
    for name, result in _closed(results).items():
        numbers[f"loop_{name}_kg"] = result.payload
        numbers[f"loop_{name}_motor"] = (
            result.violation.index if result.violation is not None and result.violation.kind == "torque" else None
        )
    return numbers


def _closed_table(results: CellResults) -> Table:
    rows: list[tuple[Number, ...]] = []
    for name, result in _closed(results).items():
        kind, option = name.split("_", 1)
        if kind != "flex":
            rows.append((kind, _CLOSED[option][0], result.payload, result.total_mass, violation_text(result.violation)))
    return Table(
        title="Closed loop: `fl` at 500 Hz under the paper criterion, one option changed at a time",
        header=("robot", "option", "payload [kg]", "total mass [kg]", "limiting violation"),
        rows=tuple(rows),
    )


def _branch_table(results: CellResults) -> Table:
    rows: list[tuple[Number, ...]] = []
    for name, result in _closed(results).items():
        kind, _, rest = name.partition("_")
        if kind == "flex":
            law, branch = rest.rsplit("_", 1)
            rows.append((law, branch, result.payload, violation_text(result.violation)))
    return Table(
        title="Joint springs, closed loop under the paper criterion: effect of the branch of Table 3 at 0.5 s",
        header=("law", "branch at 0.5 s", "payload [kg]", "limiting violation"),
        rows=tuple(rows),
    )


PARTS: tuple[Part, ...] = (
    Part(
        name="interpretations",
        title="Payloads under other interpretations",
        text=(
            "Each choice in the interpretation of the paper is an option of `cablebot reproduce`. The tables combine "
            "all choices if the payload has a closed form. If a closed loop must be simulated, they change one option "
            "at a time. A negative payload is the excess mass of the platform alone. The columns are the choices of "
            "the speed in U± of Eq. 37: motor speed in rad/s (physical), pulley speed, none (flat), cable speed in m/s "
            "(cable), or motor speed with reversed sign.\n\n"
            "The rigid robot with the pulleys of Table 5 (half the inertia, no damping) is closest to the "
            f"{LOADS['spatial']:g} kg of §5.2.2, if q̇ of Eq. 37 is taken literally as the rate of the cable length in "
            "m/s, or if the torque limits are independent of speed, which is nearly the same. The difference is about "
            "one percent, and motor 2 is the limiting motor. With the same q̇ the planar robot is also closest with "
            "motor 2 as the limiting motor, if its third motor is on the left and T_min is 0. This is an indication "
            "and not a proof: the scan below finds many other geometries with the same payload, and no motor has a "
            "torque that depends on a speed in m/s.\n\n"
            "The last table is for the robot with joint springs. Tables 1 and 3 define two accelerations at 0.5 s, "
            "which is a control instant. The choice of the branch at this single instant changes the payload under the "
            "paper criterion, because the motors are closest to their limits there."
        ),
        cells=_cells,
        outcome=_outcome,
    ),
)
