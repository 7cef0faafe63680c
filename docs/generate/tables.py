"""Reference of the command line, and tables that hand-written pages include."""

from __future__ import annotations

import tomllib
from pathlib import Path

from typer.testing import CliRunner

from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.scores import best_known_payloads
from cablebot_gym.benchmark.tables import task_title
from cablebot_gym.cli.app import add_commands, app, command_points
from cablebot_gym.cli.listing import tables
from generate.pages import RESULTS, Pages, table

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def write(pages: Pages) -> None:
    """Writes all tables."""
    for name, _, rows in tables():
        pages.write(f"{name}.inc", table(rows))
    pages.write("requirements.inc", requirements())
    pages.write("commands.inc", commands())
    pages.write("replays.inc", replays())


def requirements() -> str:
    """Requirements of the package and its extras, from pyproject.toml."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    rows = [["extra", "needs"], ["Python", f"`{project['requires-python']}`"]]
    for extra, needed in {"the package itself": project["dependencies"], **project["optional-dependencies"]}.items():
        rows.append([extra, ", ".join(f"`{one}`" for one in needed)])
    return table(rows)


def replays() -> str:
    """Replays of the best known payloads of the stored leaderboard, with the physics step h and with a tenth of it."""
    rows = [["environment", "motion", "payload [kg]", "step", "least tension [N]", "errors [mm; mrad]", "violation"]]
    records = Results.from_json(RESULTS.read_text(encoding="utf-8")).records
    for best in best_known_payloads(records).values():
        for step, one in zip(("h", "h/10"), best.result.get("replays", []), strict=False):
            errors = f"{1e3 * one['position_peak']:.4f}; {1e3 * one['rotation_peak']:.4f}"
            numbers = [f"{best.result['payload']:.3f}", step, f"{one['least_tension']:.3f}", errors]
            rows.append([best.cell.env_id, task_title(best.cell), *numbers, one["violation"] or "none"])
    return table(rows)


def commands() -> str:
    """The help of every command, those of the baselines included."""
    points = command_points()
    add_commands(points)
    text, runner = "", CliRunner(env={"COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1"})
    for name in points:
        shown = runner.invoke(app, [name, "--help"], prog_name="cablebot", catch_exceptions=False).output
        text += f"\n## cablebot {name}\n\n```text\n{shown.strip()}\n```\n"
    return text
