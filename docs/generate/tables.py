"""Reference of the command line, and tables that hand-written pages include."""

from __future__ import annotations

import tomllib
from collections import defaultdict
from pathlib import Path

from typer.testing import CliRunner

from cablebot_gym.benchmark.scores import rows_of
from cablebot_gym.benchmark.tables import due, markdown_table
from cablebot_gym.cli.app import add_commands, app, command_points
from cablebot_gym.cli.listing import tables
from generate.pages import Pages, ranked

PROJECT = Path(__file__).parents[2] / "pyproject.toml"


def write(pages: Pages) -> None:
    """Writes all tables."""
    for name, _, rows in tables():
        pages.write(f"{name}.inc", markdown_table(rows))
    pages.write("requirements.inc", requirements())
    pages.write("commands.inc", commands())
    pages.write("replays.inc", replays())
    pages.write("due.inc", due_rows())


def requirements() -> str:
    """Requirements of the package and its extras, from pyproject.toml."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    rows = [["extra", "needs"], ["Python", f"`{project['requires-python']}`"]]
    extras = {"the package itself": project["dependencies"], **project["optional-dependencies"]}
    for extra, requirements in extras.items():
        rows.append([extra, ", ".join(f"`{requirement}`" for requirement in requirements)])
    return markdown_table(rows)


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
    for best in rows_of(ranked().rows, "best-known").values():
        kinds[best.conditions.env_id, best.motion].append(best.result)
    for (env_id, motion), results in kinds.items():
        payloads = [result["payload"] for result in results]
        payload = f"{min(payloads):.3f}"
        title = f"`{motion}`"
        if len(results) > 1:
            payload += f" to {max(payloads):.3f}"
            title = f"{len(results)} of {title}"
        for step, replayed in zip(
            ("h", "h/10"), zip(*(result["replays"] for result in results), strict=True), strict=True
        ):
            position = 1e3 * max(replay["position_peak"] for replay in replayed)
            rotation = 1e3 * max(replay["rotation_peak"] for replay in replayed)
            tension = min(replay["least_tension"] for replay in replayed)
            violations = filter(None, (replay["violation"] for replay in replayed))
            errors = f"{position:.4f}; {rotation:.4f}"
            row = [env_id, title, payload, step, f"{tension:.3f}", errors]
            rows.append([*row, ", ".join(violations) or "none"])
    return markdown_table(rows)


def due_rows() -> str:
    """The rows of the leaderboard that other code has computed than that of this documentation."""
    lines = due(ranked().rows) or ["none: all rows are of the present code"]
    return "".join(f"* {line}\n" for line in lines)


def commands() -> str:
    """The help of every command, those of the baselines included."""
    points = command_points()
    add_commands(points)
    text = ""
    runner = CliRunner(env={"COLUMNS": "100", "TERM": "dumb", "NO_COLOR": "1"})
    for name in points:
        shown = runner.invoke(
            app, [*name.split(), "--help"], prog_name="cablebot", catch_exceptions=False
        ).output
        text += f"\n### cablebot {name}\n\n```text\n{shown.strip()}\n```\n"
    return text
