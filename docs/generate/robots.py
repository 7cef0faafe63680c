"""A page for each real robot of the library: drawing, check and sources of its values."""

from __future__ import annotations

import re
from pathlib import Path

from cablebot_gym.bounds.robot_check import MotionCheck, RobotCheck, check_model, check_motion
from cablebot_gym.cli.robot import motion_report, report
from cablebot_gym.plotting.figures import DPI
from cablebot_gym.plotting.robots import draw_robot
from cablebot_gym.robots import ELASTIC, find_robot, library
from generate.pages import Pages


def write(pages: Pages) -> None:
    """Writes all pages and their drawings."""
    for name, path in library().items():
        check, motion = shown_checks(name)
        draw_robot(check, motion).savefig(pages.path(f"robots/{name}.png"), dpi=DPI)
        pages.write(f"robots/{name}.md", page(name, path, check, motion))


def page(name: str, path: Path, check: RobotCheck, motion: MotionCheck) -> str:
    """The text of a robot's page."""
    about = re.findall(r"^# (.*)", path.read_text(encoding="utf-8"), re.MULTILINE)
    command = f"cablebot robot check {check.robot.name} --payload {check.payload:g}"
    lines = [f"$ {command}", *report(check), *motion_report(check, motion, "")]
    text = f"# {name}\n\n" + "\n".join(about) + "\n\n"
    text += f"![{name}: plan, elevations and workspace]({name}.png)\n\n"
    text += "```text\n" + "\n".join(lines) + "\n```\n\n"
    text += "| value | range | source |\n| --- | --- | --- |\n"
    for field, source in check.robot.sources.items():
        ends = " to ".join(f"{value:g}" for value in check.robot.ranges.get(field, ()))
        text += f"| `{field}` | {ends} | {re.sub('^assumed', '**assumed**', source)} |\n"
    return text


def shown_checks(name: str) -> tuple[RobotCheck, MotionCheck]:
    """Checks of a robot of the library with elastic cables and about half of the payload that it
    carries."""
    robot = find_robot(ELASTIC + name)
    payload = float(f"{check_motion(robot).limit.largest / 2:.2g}")
    return check_model(robot, payload=payload), check_motion(robot, payload=payload)
