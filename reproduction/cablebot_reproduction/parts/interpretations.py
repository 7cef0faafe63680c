"""Payloads under other interpretations of what the paper leaves open."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any

from cablebot_baselines.laws import FeedbackLinearization, MotorPD
from cablebot_gym.motions import find_trajectory
from cablebot_gym.robots import PLANAR, Robot
from cablebot_reproduction.exact import LargestPayload, exact_limit, state_space_limit
from cablebot_reproduction.fourth_order import FourthOrder
from cablebot_reproduction.outcome import Number, Numbers, Outcome, Table
from cablebot_reproduction.profiles import limiting_violation, saturated_motor, violation_text
from cablebot_reproduction.robots import (
    APEXES,
    LINES,
    PULLEYS,
    SIDES,
    TRIANGLES,
    flexible_robot,
    planar_robot,
    spatial_robot,
    without_speed_limit,
)
from cablebot_reproduction.simulation import composite, largest_payload
from cablebot_reproduction.texts import PUBLISHED, within

# A rigid pulley turns with its motor.
_RIGID_LINES = [line for line in LINES if line != "pulley"]

OPTIONS: dict[str, dict[str, Any]] = {
    "spatial": {
        "triangles": TRIANGLES,
        "sides": SIDES,
        "pulleys": PULLEYS,
        "mass": (10, 11),
        "line": _RIGID_LINES,
    },
    "planar": {
        "apex": APEXES,
        "alpha": ("least", "constant"),
        "minimum_tension": (0.0, 5.0),
        "line": _RIGID_LINES,
    },
    "flexible": {"eq24": ("corrected", "verbatim"), "stiffness": (2, 3), "line": LINES},
}
"""Options that affect the payload of each robot without simulation, and their values."""

_TITLES = {
    "spatial": "Rigid spatial robot, exact tracking: added payload [kg] and limiting motor; "
    "published: 2.56 kg, motor 2",
    "planar": "Planar robot, exact tracking: payload [kg] added to the platform of 1 kg and limiting motor; published: "
    "2.2 kg, motor 2",
    "flexible": "Joint springs, state space of Eqs. 23–25: added payload [kg] and limiting motor; published: 1.4 kg, "
    "motor 2 at K = 3",
}

_CLOSED_LOOPS = (
    ("planar_chosen", "chosen interpretation", PLANAR),
    ("spatial_chosen", "chosen interpretation", spatial_robot()),
    ("planar_flat", "torque limits independent of speed", without_speed_limit(PLANAR)),
    ("spatial_flat", "torque limits independent of speed", without_speed_limit(spatial_robot())),
    ("spatial_mass_11", "platform mass 11 kg", spatial_robot(mass=11.0)),
    ("spatial_circumradius", "a and b are circumradii", spatial_robot(sides="circumradius")),
    ("spatial_turned", "both triangles rotated by 180°", spatial_robot(triangles="turned")),
    ("spatial_table5", "pulleys of Table 5", spatial_robot(pulleys="table5")),
    ("planar_no_tension", "T_min = 0", PLANAR),
    ("planar_apex_left", "third motor on the left", planar_robot("left")),
    ("planar_apex_down", "third motor at the bottom", planar_robot("down")),
    ("planar_apex_right", "third motor on the right", planar_robot("right")),
)
"""Closed loops with one option changed at a time."""

_SECOND_BRANCH = {"name": "paper-spatial", "duration": 1.0 - 1e-9}
"""The first branch of Table 3 at the control instant 0.5 s is the printed one, "t ≤ 0.5". A motion
that is 1 ns shorter selects the second branch."""


def limits(kind: str) -> Iterator[tuple[dict[str, Any], LargestPayload | None]]:
    """Payloads for all combinations of the options of a robot; None without equilibrium."""
    options = OPTIONS[kind]
    for values in product(*options.values()):
        chosen = dict(zip(options, values, strict=True))
        yield chosen, _limit(kind, **chosen)


def _limit(kind: str, line: str, **options: Any) -> LargestPayload | None:
    if kind == "planar":
        return exact_limit(planar_robot(options.pop("apex")), line, **options)
    if kind == "flexible":
        robot = flexible_robot(stiffness=float(options["stiffness"]))
        return state_space_limit(robot, line, eq24=options["eq24"])
    if options["triangles"] == "aligned":
        return None
    return exact_limit(spatial_robot(**options), line)


def interpretations() -> Outcome:
    """Payloads and limiting motors, and numbers of payloads close to the published ones."""
    numbers: Numbers = {}
    tables = [_combinations(kind, numbers) for kind in OPTIONS]
    tables.append(_closed_loops(numbers))
    tables.append(_branches(numbers))
    return Outcome(numbers=numbers, tables=tables)


def _combinations(kind: str, numbers: Numbers) -> Table:
    """One row for each combination of the other options, one column for each torque-speed line."""
    load = PUBLISHED[f"{kind}_payload_kg"]
    *options, _ = OPTIONS[kind]
    rows: dict[str, list[Number]] = {}
    close = total = close_total = 0
    for chosen, limit in limits(kind):
        total += 1
        if limit is None:
            continue
        name = "_".join(str(value) for value in chosen.values())
        numbers[f"{kind}_{name}_kg"] = limit.payload
        numbers[f"{kind}_{name}_motor"] = limit.motor
        close += within(limit.payload, load)
        close_total += within(limit.payload + PLANAR.mass, load)
        others = [str(chosen[option]) for option in options]
        text = f"{limit.payload:.2f} (motor {limit.motor})".replace("-", "−")
        rows.setdefault("_".join(others), list(others)).append(text)
    numbers[f"{kind}_within_5pct"] = close
    numbers[f"{kind}_total"] = total
    if kind == "planar":
        numbers["planar_as_total_within_5pct"] = close_total
    header = [option.replace("_", " ") for option in options]
    header += [f"line {line}" for line in OPTIONS[kind]["line"]]
    return Table(title=_TITLES[kind], header=header, rows=list(rows.values()))


def fl_without_tension(robot: Robot) -> FeedbackLinearization:
    """Feedback linearization with T_min = 0."""
    return FeedbackLinearization(robot, minimum_tension=0.0)


def _closed_loops(numbers: Numbers) -> Table:
    rows = []
    for name, text, robot in _CLOSED_LOOPS:
        law: Any = FeedbackLinearization
        if name == "planar_no_tension":
            law = fl_without_tension
        result = largest_payload(law, robot, criterion="paper")
        numbers[f"loop_{name}_kg"] = result.payload
        numbers[f"loop_{name}_motor"] = saturated_motor(limiting_violation(result))
        violation = violation_text(limiting_violation(result))
        rows.append((robot.kind, text, result.payload, result.total_mass, violation))
    return Table(
        title="Closed loop: `fl` at 500 Hz under the paper criterion, one option changed at a time",
        header=("robot", "option", "payload [kg]", "total mass [kg]", "limiting violation"),
        rows=rows,
    )


def _branches(numbers: Numbers) -> Table:
    robot = flexible_robot()
    laws = {"fl4": FourthOrder, "motor-pd": MotorPD, "composite": composite}
    branches: Mapping[str, dict[str, Any]] = {
        "first": {},
        "second": {"trajectory": find_trajectory(_SECOND_BRANCH, robot.coordinates)},
    }
    rows = []
    for (name, law), (branch, motion) in product(laws.items(), branches.items()):
        result = largest_payload(law, robot, criterion="paper", **motion)
        numbers[f"loop_flex_{name}_{branch}_kg"] = result.payload
        numbers[f"loop_flex_{name}_{branch}_motor"] = saturated_motor(limiting_violation(result))
        rows.append((name, branch, result.payload, violation_text(limiting_violation(result))))
    return Table(
        title="Joint springs, closed loop under the paper criterion: effect of the branch of Table 3 at 0.5 s",
        header=("law", "branch at 0.5 s", "payload [kg]", "limiting violation"),
        rows=rows,
    )
