"""Reference of the command line, and tables that hand-written pages include."""

from __future__ import annotations

import json
import tomllib
from collections import defaultdict
from pathlib import Path

from typer.testing import CliRunner

from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.scores import best_known_payloads
from cablebot_gym.cli.app import add_commands, app, command_points
from cablebot_gym.cli.listing import tables
from generate.pages import RESULTS, Pages, table

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
CLIENTS = Path(__file__).parents[1] / "clients.json"


def write(pages: Pages) -> None:
    """Writes all tables."""
    for name, _, rows in tables():
        pages.write(f"{name}.inc", table(rows))
    pages.write("requirements.inc", requirements())
    pages.write("commands.inc", commands())
    pages.write("replays.inc", replays())
    pages.write("clients.inc", clients())


def requirements() -> str:
    """Requirements of the package and its extras, from pyproject.toml."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    rows = [["extra", "needs"], ["Python", f"`{project['requires-python']}`"]]
    for extra, needed in {
        "the package itself": project["dependencies"],
        **project["optional-dependencies"],
    }.items():
        rows.append([extra, ", ".join(f"`{one}`" for one in needed)])
    return table(rows)


def clients() -> str:
    """Other libraries that work with the environments: what `.ci/clients` ran last, and its figure
    or error."""
    rows = [["client", "script", "version", "Gymnasium", "what it printed", "time [s]"]]
    for name, ran in json.loads(CLIENTS.read_text(encoding="utf-8")).items():
        printed = ran["figure"] if ran["error"] is None else f"**error**: {ran['error']}"
        versions = [ran["version"] or "–", ran.get("gymnasium") or "–"]
        rows.append(
            [ran["client"], f"`use_{name}.py`", *versions, printed, str(ran["seconds"] or "–")]
        )
    return table(rows)


def replays() -> str:
    """Replays of the best known payloads of the stored leaderboard, with the physics step h and
    with a tenth of it.

    The motions of one kind share a row: their least tension, their largest errors and all their
    violations.
    """
    rows = [
        [
            "environment",
            "motions",
            "payload [kg]",
            "step",
            "least tension [N]",
            "errors [mm; mrad]",
            "violations",
        ]
    ]
    kinds = defaultdict(list)
    for best in best_known_payloads(
        Results.from_json(RESULTS.read_text(encoding="utf-8")).records
    ).values():
        kinds[best.cell.env_id, best.cell.trajectory["name"]].append(best.result)
    for (env_id, motion), results in kinds.items():
        least, largest = (f"{pick(one['payload'] for one in results):.3f}" for pick in (min, max))
        payload = least if len(results) == 1 else f"{least} to {largest}"
        for step, replayed in zip(
            ("h", "h/10"), zip(*(one["replays"] for one in results), strict=True), strict=True
        ):
            peaks = [
                1e3 * max(one[name] for one in replayed)
                for name in ("position_peak", "rotation_peak")
            ]
            numbers = [payload, step, f"{min(one['least_tension'] for one in replayed):.3f}"]
            violations = (
                ", ".join(one["violation"] for one in replayed if one["violation"]) or "none"
            )
            title = f"`{motion}`" if len(results) == 1 else f"{len(results)} of `{motion}`"
            rows.append([env_id, title, *numbers, f"{peaks[0]:.4f}; {peaks[1]:.4f}", violations])
    return table(rows)


def commands() -> str:
    """The help of every command, those of the baselines included."""
    points = command_points()
    add_commands(points)
    text = ""
    runner = CliRunner(env={"COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1"})
    for name in points:
        shown = runner.invoke(
            app, [name, "--help"], prog_name="cablebot", catch_exceptions=False
        ).output
        text += f"\n## cablebot {name}\n\n```text\n{shown.strip()}\n```\n"
    return text
