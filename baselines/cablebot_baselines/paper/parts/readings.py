"""What each reading of the paper makes of its payloads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import product
from typing import Any

from cablebot_baselines.classical import Composite, FeedbackLinearization, FourthOrder, MotorPD
from cablebot_baselines.paper.exact import Heaviest, exact_limit, state_space_limit
from cablebot_baselines.paper.part import Cell, Found, Number, Outcome, Part, Table
from cablebot_baselines.paper.parts.profiles import first_limit
from cablebot_baselines.paper.published import LOADS, within
from cablebot_baselines.paper.readings import Readings, choices_of
from cablebot_baselines.paper.runs import Law, largest_payload
from cablebot_gym.evaluation import DLCCResult

_LINES = choices_of()["line"]
_RIGID_LINES = tuple(line for line in _LINES if line != "pulley")  # rigid motors turn with their pulleys
_TENSIONS = (0.0, 5.0)

Limits = dict[Readings, Heaviest | None]
"""By the reading; None where no positive tensions hold the robot."""


def _varied(readings: Readings, **choices: tuple[object, ...]) -> list[Readings]:
    """Every combination of these choices, all else as in ``readings``."""
    return [readings.replace(**dict(zip(choices, values, strict=True))) for values in product(*choices.values())]


def spatial_readings(readings: Readings) -> list[Readings]:
    """Every combination that decides the rigid spatial robot's payload."""
    open_ = choices_of()
    return _varied(
        readings,
        triangles=open_["triangles"],
        sides=open_["sides"],
        pulleys=open_["pulleys"],
        platform_mass=("10", "11"),
        line=_RIGID_LINES,
    )


def planar_readings(readings: Readings) -> list[Readings]:
    """Every combination that decides the planar robot's payload."""
    open_ = choices_of()
    return _varied(
        readings,
        planar_apex=open_["planar_apex"],
        alpha=open_["alpha"],
        minimum_tension=_TENSIONS,
        line=_RIGID_LINES,
    )


def flexible_readings(readings: Readings) -> list[Readings]:
    """Every combination that decides the payload of the state space with joint springs."""
    return _varied(readings, eq24=choices_of()["eq24"], stiffness=("2", "3"), line=_LINES)


def planar_limits(*, readings: Readings) -> Limits:
    """Exact tracking of the planar robot."""
    return {one: exact_limit(one, one.planar) for one in planar_readings(readings)}


def spatial_limits(*, readings: Readings) -> Limits:
    """Exact tracking of the rigid spatial robot."""
    return {one: _possible(one) for one in spatial_readings(readings)}


def flexible_limits(*, readings: Readings) -> Limits:
    """The state space of Eqs. 23–25."""
    hangs = _hangs(readings)
    return {
        one: state_space_limit(one, one.flexible("payload")) if hangs else None for one in flexible_readings(readings)
    }


def _possible(readings: Readings) -> Heaviest | None:
    return exact_limit(readings, readings.spatial("payload")) if _hangs(readings) else None


def _hangs(readings: Readings) -> bool:
    """Whether positive tensions hold the spatial robot."""
    try:
        readings.spatial("payload")
    except ValueError:
        return False
    return True


_CLOSED: dict[str, tuple[str, dict[str, Any]]] = {
    "chosen": ("as chosen", {}),
    "flat": ("flat limits", {"line": "flat"}),
    "mass_11": ("platform mass 11 kg", {"platform_mass": "11"}),
    "circumradius": ("a and b are circumradii", {"sides": "circumradius"}),
    "turned": ("both triangles turned", {"triangles": "turned"}),
    "table5": ("pulleys of Table 5", {"pulleys": "table5"}),
    "no_tension": ("T_min = 0", {"minimum_tension": 0.0}),
    "apex_left": ("third motor on the left", {"planar_apex": "left"}),
    "apex_down": ("third motor below", {"planar_apex": "down"}),
    "apex_right": ("third motor on the right", {"planar_apex": "right"}),
}
"""One reading at a time, the rest as chosen: in words, and the change."""

_FLEXIBLE_LAWS: dict[str, Law] = {"fl4": FourthOrder, "motor-pd": MotorPD, "composite": Composite}

_BRANCHES: dict[str, dict[str, Any]] = {
    "first": {},
    "second": {"trajectory": {"name": "paper-spatial", "duration": 1.0 - 1e-9}},
}
"""Which branch of Table 3 holds at 0.5 s sharp, where a command is given: the first as printed, "t ≤ 0.5", or the
second, which a motion a nanosecond shorter makes of it."""

_PLANAR_ONLY, _SPATIAL_ONLY = {"minimum_tension", "planar_apex"}, {"platform_mass", "pulleys", "sides", "triangles"}


def _cells(readings: Readings) -> dict[str, Cell]:
    cells: dict[str, Cell] = {
        "planar": partial(planar_limits, readings=readings),
        "spatial": partial(spatial_limits, readings=readings),
        "flexible": partial(flexible_limits, readings=readings),
    }
    for name, (_, changes) in _CLOSED.items():
        one = readings.replace(**changes)
        if not one.plays:
            continue
        if not _SPATIAL_ONLY & set(changes):
            cells[f"planar_{name}"] = partial(
                largest_payload,
                env_id="CableBot-Planar-v0",
                law=partial(FeedbackLinearization, minimum_tension=one.minimum_tension),
                robot=one.motors(one.planar),
                name="fl",
                criterion="paper",
            )
        if not _PLANAR_ONLY & set(changes) and _hangs(one):
            cells[f"spatial_{name}"] = partial(
                largest_payload,
                env_id="CableBot-Spatial-v0",
                law=FeedbackLinearization,
                robot=one.motors(one.spatial("payload")),
                name="fl",
                criterion="paper",
            )
    if readings.springs_play and _hangs(readings):
        cells |= {
            f"flex_{name}_{branch}": partial(
                largest_payload,
                env_id="CableBot-FlexSpatial-v0",
                law=law,
                robot=readings.motors(readings.flexible("payload")),
                name=name,
                criterion="paper",
                **changes,
            )
            for name, law in _FLEXIBLE_LAWS.items()
            for branch, changes in _BRANCHES.items()
        }
    return cells


def _outcome(readings: Readings, found: Found) -> Outcome:
    planar, spatial, flexible = (found[name] for name in ("planar", "spatial", "flexible"))
    numbers: dict[str, Number] = {}
    for kind, limits, fields in (
        ("spatial", spatial, ("triangles", "sides", "pulleys", "platform_mass", "line")),
        ("planar", planar, ("planar_apex", "alpha", "minimum_tension", "line")),
        ("flexible", flexible, ("eq24", "stiffness", "line")),
    ):
        close = 0
        for one, limit in limits.items():
            name = "_".join(str(getattr(one, field)) for field in fields)
            numbers[f"{kind}_{name}_kg"] = None if limit is None else limit.payload
            numbers[f"{kind}_{name}_motor"] = None if limit is None else limit.motor
            close += limit is not None and within(limit.payload, LOADS[kind])
        numbers[f"{kind}_within_5pct"] = close
        numbers[f"{kind}_total"] = len(limits)
    totals = (limit.payload + one.planar.mass for one, limit in planar.items() if limit is not None)
    numbers["planar_as_total_within_5pct"] = sum(within(total, LOADS["planar"]) for total in totals)
    return Outcome(
        numbers=numbers | _closed_numbers(found),
        tables=(
            _table(
                "Rigid spatial robot, exact tracking: payload added [kg] and motor at its limit, published: "
                "2.56 kg, motor 2",
                ("triangles", "sides", "pulleys", "platform_mass"),
                spatial,
            ),
            _table(
                "Planar robot, exact tracking: payload added [kg] to the platform's 1 kg and motor at its limit, "
                "published: 2.2 kg, motor 2",
                ("planar_apex", "alpha", "minimum_tension"),
                planar,
            ),
            _table(
                "Joint springs, state space of Eqs. 23–25: payload added [kg] and motor at its limit, published: "
                "1.4 kg, motor 2 at K = 3",
                ("eq24", "stiffness"),
                flexible,
            ),
            _closed_table(found),
            _branch_table(found),
        ),
    )


def _table(title: str, fields: tuple[str, ...], limits: Limits) -> Table:
    """One row for each combination of the fields, one column for each torque-speed line."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for one, limit in limits.items():
        rows.setdefault(tuple(str(getattr(one, field)) for field in fields), []).append(_words(limit))
    lines = _LINES if len(next(iter(rows.values()))) == len(_LINES) else _RIGID_LINES
    header = (*(field.replace("_", " ") for field in fields), *(f"line {line}" for line in lines))
    return Table(title=title, header=header, rows=tuple(_joined(rows)))


def _joined(rows: Mapping[tuple[str, ...], list[str]]) -> Iterator[tuple[str, ...]]:
    """The rows, one in place of all that begin alike where nothing but the same words is in them."""
    alike: dict[str, set[str]] = {}
    for key, cells in rows.items():
        alike.setdefault(key[0], set()).update(cells)
    written: set[str] = set()
    for (first, *others), cells in rows.items():
        if len(alike[first]) > 1:
            yield (first, *others, *cells)
        elif first not in written:
            written.add(first)
            yield (first, *("any" for _ in others), *cells)


def _words(limit: Heaviest | None) -> str:
    if limit is None:
        return "no positive tensions"
    if limit.payload == float("-inf"):
        return "no mass"
    return f"{limit.payload:.2f} (motor {limit.motor})".replace("-", "−")


def _closed(found: Found) -> dict[str, DLCCResult]:
    """The closed loops among the cells."""
    return {name: result for name, result in found.items() if isinstance(result, DLCCResult)}


def _closed_numbers(found: Found) -> dict[str, Number]:
    numbers: dict[str, Number] = {}
    for name, result in _closed(found).items():
        numbers[f"loop_{name}_kg"] = result.payload
        numbers[f"loop_{name}_motor"] = result.limit.index if result.limit.kind == "torque" else None
    return numbers


def _closed_table(found: Found) -> Table:
    rows: list[tuple[Number, ...]] = []
    for name, result in _closed(found).items():
        kind, which = name.split("_", 1)
        if kind != "flex":
            rows.append((kind, _CLOSED[which][0], result.payload, result.total_mass, first_limit(result.limit)))
    return Table(
        title="Closed loop: `fl` at 500 Hz under the paper criterion, one reading changed at a time",
        header=("robot", "reading", "payload [kg]", "total mass [kg]", "first limit"),
        rows=tuple(rows),
    )


def _branch_table(found: Found) -> Table:
    rows: list[tuple[Number, ...]] = []
    for name, result in _closed(found).items():
        kind, _, rest = name.partition("_")
        if kind == "flex":
            law, branch = rest.rsplit("_", 1)
            rows.append((law, branch, result.payload, first_limit(result.limit)))
    return Table(
        title="Joint springs, closed loop under the paper criterion: which branch of Table 3 holds at 0.5 s sharp",
        header=("law", "branch at 0.5 s", "payload [kg]", "first limit"),
        rows=tuple(rows),
    )


PARTS: tuple[Part, ...] = (
    Part(
        name="readings",
        title="Readings and what they give",
        text=(
            "Each way to read the paper is an option of `cablebot reproduce`. The tables combine all of them where a "
            "payload has a closed form, and change one at a time where a loop has to be simulated. A payload below "
            "zero says that the platform alone is too heavy by as much. The columns are the speed that U± of Eq. 37 "
            "takes: the motor's in rad/s (physical), the pulley's, none (flat), the cable's in m/s (cable), or the "
            "motor's with its sign reversed.\n\n"
            f"Closest to the {LOADS['spatial']:g} kg of §5.2.2 comes the rigid robot with the pulleys of Table 5 (half "
            "the inertia, no damping) and with q̇ of Eq. 37 taken literally, as the rate of the cable's length in m/s, "
            "or with flat limits, which is nearly the same: to about one percent, motor 2 first. With that q̇ the "
            "planar robot comes closest with motor 2 first, too, if its third motor is on the left and T_min is 0. "
            "This is a hint and no proof: the scan below finds many other geometries that give the number, and a "
            "torque that depends on metres per second is that of no motor.\n\n"
            "The last table is for the robot with joint springs. Tables 1 and 3 give two accelerations at 0.5 s, and a "
            "command falls on that instant. Which of the two a law takes there, for one command, already moves its "
            "payload under the paper criterion, since it is there that the motors are nearest to their limits."
        ),
        cells=_cells,
        outcome=_outcome,
    ),
)
