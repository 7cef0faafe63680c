"""Computes the main table of the board for the present policies, on its first motions.

    python scripts/main_table.py --workers 2

The leaderboard ranks the policies of its time. This table has those of today, on the same
motions and robots, beside what the board has. Finished cells are kept in the folder ``--out``, so
that the same command resumes. ``docs/main-table/results.json`` keeps the results.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from markdown_table import markdown_table

from cablebot_gym.benchmark.cells import BestKnownCell, Cell, DrawnCell, SurveyCell, TimingCell
from cablebot_gym.benchmark.engine import local, run_cells
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.records import Record
from cablebot_gym.benchmark.scores import Leaderboard, best_known_payloads, leaderboards
from cablebot_gym.benchmark.store import Store
from cablebot_gym.benchmark.tables import entry_text, policy_text, timing_text
from cablebot_gym.benchmark.yardstick import yardsticks
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.envs import env_robot
from cablebot_gym.policies import policy_entries
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import find_trajectory
from cablebot_gym.utils.console import notes_console, progress
from cablebot_gym.utils.files import atomic_write_text

DOCS = Path(__file__).resolve().parents[1] / "docs"

BOARD = DOCS / "leaderboard" / "results.json"
RESULTS = DOCS / "main-table" / "results.json"

MOTIONS = 20
"""Number of motions: those of which the board has every policy."""


def read(path: Path) -> Results:
    """Stored results."""
    return Results.from_json(path.read_text(encoding="utf-8"))


def surveys(board: Results) -> dict[str, SurveyCell]:
    """A cell of the main table by environment, on its first motions."""
    found = {}
    for record in board.records:
        cell = record.cell
        if isinstance(cell, SurveyCell) and cell.uncertainty:
            seeds = list(cell.trajectory["seed"])[:MOTIONS]
            found[cell.env_id] = replace(cell, trajectory={**cell.trajectory, "seed": seeds})
    return found


def cells(board: Results, policies: Sequence[str], env_ids: Sequence[str]) -> dict[str, Cell]:
    """Cells of policies in their environments, by key."""
    chosen: list[Cell] = []
    for env_id, survey in surveys(board).items():
        for name in policies:
            if env_id in env_ids and env_id in policy_entries()[name].env_ids:
                chosen.append(replace(survey, policy=name))
                chosen.append(
                    TimingCell(env_id=env_id, trajectory=_circle(board, env_id), policy=name)
                )
    return {cell.key: cell for cell in chosen}


def _circle(board: Results, env_id: str) -> dict[str, object]:
    """The motion on which the board measures computing times."""
    timings = [record.cell for record in board.records if isinstance(record.cell, TimingCell)]
    return next(dict(cell.trajectory) for cell in timings if cell.env_id == env_id)


def present(board: Results, results: Results) -> list[Leaderboard]:
    """Tables of the stored policies, with the yardsticks of the board."""
    references = [
        record for record in board.records if isinstance(record.cell, (BestKnownCell, DrawnCell))
    ]
    return leaderboards([*results.records, *references])


def exact_tracking(board: Results, env_id: str) -> float:
    """The payload with which motors of a known robot track the motions of the main table exactly, as
    a mean fraction of what a planner could hope for."""
    robot = find_robot(env_robot(env_id))
    best_known = best_known_payloads(board.records)
    survey = surveys(board)[env_id]
    yardstick = yardsticks(board.records)[env_id, str(survey.uncertainty)]
    fractions = []
    for part in survey.parts:
        hoped = best_known[part.motion_key].payload
        if hoped:
            motion = find_trajectory(dict(part.trajectory), robot.kind)
            fractions.append(exact_payload(robot, motion).payload / hoped)
    return float(np.mean(fractions)) / yardstick.quantile


def table(board: Results, results: Results) -> str:
    """One table for each environment: present policies, and the entry of the board before."""
    before = {table.env_id: table for table in leaderboards(board.records) if table.is_main}
    text = ""
    for now in present(board, results):
        earlier = before[now.env_id]
        rows = [
            [
                "policy",
                "kind",
                f"fraction on {now.motions(now.columns[0])} motions",
                "on the board",
                "median, p99 [ms], late, start [s]",
            ]
        ]
        for name in now.policies:
            rows.append(
                [
                    policy_text(name),
                    policy_entries()[name].kind,
                    entry_text(now, name, now.columns[0]),
                    entry_text(earlier, name, earlier.columns[0]),
                    timing_text(now.timings.get(name)),
                ]
            )
        tracked = exact_tracking(board, now.env_id)
        rows.append(["exact tracking, robot known", "–", f"{tracked:.1%}", "–", "–"])
        text += f"\n### {now.env_id}\n\n{markdown_table(rows, right=3)}"
    return text + "\n"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--policies", help="separated by commas (default: all that are stored)")
    parser.add_argument("--ids", help="separated by commas (default: those of the board)")
    parser.add_argument("--workers", type=int, default=1, help="default: %(default)s")
    parser.add_argument("--out", type=Path, default=Path("main-table"), help="default: %(default)s")
    arguments = parser.parse_args()
    board = read(BOARD)
    stored: list[Record] = list(read(RESULTS).records) if RESULTS.is_file() else []
    policies = sorted({record.cell.to_dict()["policy"] for record in stored})
    if arguments.policies:
        policies = arguments.policies.split(",")
    env_ids = arguments.ids.split(",") if arguments.ids else list(surveys(board))
    say = notes_console().print
    with progress("main table", "cells") as step:
        records = run_cells(
            cells(board, policies, env_ids),
            Store(arguments.out, say=say),
            local(arguments.workers),
            progress=step,
            say=say,
        )
    computed = {record.cell.key for record in records}
    records += [record for record in stored if record.cell.key not in computed]
    order = [*surveys(board)]
    records.sort(key=lambda record: (order.index(record.cell.env_id), record.cell.key))
    results = Results(suite="ranked", command="python scripts/main_table.py", records=records)
    RESULTS.parent.mkdir(exist_ok=True)
    atomic_write_text(RESULTS, results.to_json())


if __name__ == "__main__":
    main()
