"""Writes the tables and the figure of the pages in winches/docs that come from code or from stored
results. A table stands between two comments with its name.

PYTHONPATH=scripts python winches/scripts/winches_pages.py
"""

from __future__ import annotations

import argparse
import re
import runpy
from contextlib import chdir
from dataclasses import fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_type_hints

import published_numbers
import real_robots
from matplotlib.figure import Figure

from cablebot_gym.benchmark.tables import markdown_table
from cablebot_gym.plotting.figures import DPI
from cablebot_gym.robots import find_robot
from cablebot_winches.hardware.limits import DriveLimits
from cablebot_winches.identification import identify, read_log
from cablebot_winches.identification.figures import draw_identification

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "winches" / "docs"
PAGES = (DOCS / "drive.md", DOCS / "reality.md")
"""Pages with tables."""

FIGURE = DOCS / "figures" / "identify.png"

_BLOCK = re.compile(
    r"(<!-- (.+?): written by winches/scripts/winches_pages\.py -->\n)(.*?)(<!-- end of \2 -->)",
    re.DOTALL,
)


def block(name: str) -> str:
    """The text of a table with its surroundings."""
    if name == "drive limits":
        return drive_limits()
    if name == "published numbers":
        return published_numbers.table()
    if name == "friction and stiffness":
        return published_numbers.effects_table()
    return real_robots.study_text(name.removeprefix("reality "))


def drive_limits() -> str:
    """Limits of `cablebot drive`."""
    rows = [["option", "default", "meaning"]]
    hints = get_type_hints(DriveLimits, include_extras=True)
    for field in fields(DriveLimits):
        default = "–"
        if field.default is not None:
            default = f"{field.default:g}"
        option = field.name.replace("_", "-")
        rows.append([f"`--{option}`", default, hints[field.name].__metadata__[0]])
    return f"\n{markdown_table(rows)}\n"


def figure() -> Figure:
    """Measured and modelled torques of the logs of the example."""
    robot = find_robot(str(ROOT / "examples" / "square.toml"))
    with TemporaryDirectory() as folder, chdir(folder):
        runpy.run_path(str(ROOT / "winches" / "examples" / "identify_winch.py"))
        logs = [read_log(Path("lifts") / name, robot) for name in ("2kg.csv", "6kg.csv")]
    return draw_identification(identify(robot, logs))["torques"]


def blocks(page: Path) -> dict[str, str]:
    """The tables of a page by name, as they stand."""
    return {name: body for _, name, body, _ in _BLOCK.findall(page.read_text(encoding="utf-8"))}


def main() -> None:
    """Writes the tables of all pages, and the figure."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0]).parse_args()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        text = _BLOCK.sub(lambda match: match[1] + block(match[2]) + match[4], text)
        page.write_text(text, encoding="utf-8")
    figure().savefig(FIGURE, dpi=DPI, metadata={"Software": None})


if __name__ == "__main__":
    main()
