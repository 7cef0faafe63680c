"""A page for each environment: the docstring of its class with the tables of this id."""

from __future__ import annotations

import inspect
import json
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from PIL import Image

from cablebot_gym import ENV_IDS
from cablebot_gym.benchmark.tables import leaderboard_rows, markdown_table
from cablebot_gym.cli.listing import tables
from cablebot_gym.env_ids import ENV_ROBOTS
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.motions import trajectory_names
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import Robot
from generate.pages import Pages, all_leaderboards

EQUATIONS = Path(__file__).parents[1] / "equations.inc"
"""Sections of the equations of platforms, joints, motors and cables."""

PICTURED = 0.3, 0.5
"""Fraction of the motion at which the picture is taken, and of the payload that the policy carries
there [kg]."""


def write(pages: Pages) -> None:
    """Writes all pages and their pictures."""
    for env_id in ENV_IDS:
        env = gym.make(env_id, render_mode="rgb_array")
        plain: Any = env.unwrapped
        picture(env).save(pages.path(f"environments/{env_id}.png"))
        pages.write(f"environments/{env_id}.md", page(env_id, plain))
        env.close()


def page(env_id: str, env: CableBotEnv) -> str:
    """The text of an environment's page."""
    lead, sections = manual()
    robot = env.task.robot
    layout = sections["Observation space"].splitlines()
    marks = [index for index, line in enumerate(layout) if line.startswith("|")]
    # The table of this robot replaces that of all robots.
    sections["Observation space"] = "\n".join(
        [*layout[: marks[0]], env.layout.table(), *layout[marks[-1] + 1 :]]
    )
    fields = []
    for name, value in robot.to_dict().items():
        fields.append(f' "{name}": {json.dumps(value)}')
    values = ",\n".join(fields)
    chapters = {
        "Robot": f"`{ENV_ROBOTS[env_id]}`, with these nominal values (SI, radians):\n\n"
        f"```json\n{{\n{values}\n}}\n```\n\n"
        "The keyword `robot` takes [another robot](/your-own/robot.md).",
        "Equations": _equations(robot),
        **sections,
        "Reference motions": _motions(robot),
        "Policies": _policies(env_id),
    }
    text = f"# {env_id}\n\n![{env_id}, rendered]({env_id}.png)\n\n{lead}\n"
    for title, body in chapters.items():
        text += f"\n## {title}\n\n{body.strip()}\n"
    return text


def manual() -> tuple[str, dict[str, str]]:
    """The docstring of the class: its lead, and its sections by title."""
    text = inspect.getdoc(CableBotEnv) or ""
    text = re.sub(r":(class|func|data|meth):`", r"{py:\1}`", text)  # roles as Markdown has them
    lead, *chapters = re.split(r"^## ", text, flags=re.MULTILINE)
    sections = {}
    for chapter in chapters:
        title, _, body = chapter.partition("\n")
        sections[title] = body.strip()
    return lead.strip(), sections


def picture(env: gym.Env[Any, Any]) -> Image.Image:
    """A rendered picture of an episode with a classical law."""
    observation, _ = env.reset(seed=0, options={"payload": PICTURED[1]})
    task = env.get_wrapper_attr("task")
    law = "fl"
    if task.robot.flexible:
        law = "composite"
    policy = load_policy(law, task.robot)
    for _ in range(round(PICTURED[0] * task.steps)):
        observation, *_ = env.step(policy.predict(observation)[0])
    return Image.fromarray(np.asarray(env.render()))


def _equations(robot: Robot) -> str:
    """The equations of the robot, and the modules with their code."""
    text = (
        "Symbols and equation numbers are the paper's, with corrected misprints; "
        "each number links to its correction.\n"
    )
    page = EQUATIONS.read_text(encoding="utf-8").replace("](paper.md", "](/paper.md")
    sections = dict(section.split("\n", 1) for section in page.split("\n## "))
    headings = {
        "Platform": robot.kind,
        "Joints": robot.joints,
        "Motors": "motors",
        "Cables": "cables",
    }
    if robot.elastic:
        headings = {"Platform": robot.kind, "Motors": "motors", "Cables": "elastic"}
    for title, name in headings.items():
        text += f"\n### {title}\n\n{sections[name].strip()}\n"
    readable = "Readable code: {py:mod}`cablebot_gym.physics.textbook`."
    return f"{text}\n{readable} Compiled code: `cablebot_gym/physics/kernel/`."


def _motions(robot: Robot) -> str:
    """The named motions of the kind of the robot, with their fields."""
    head, *rows = {key: rows for key, _, rows in tables()}["trajectories"]
    names = trajectory_names(robot.kind)
    shown = [head]
    name = ""
    for row in rows:
        name = row[0] or name  # a name stands in the row of its first field
        if name in names:
            shown.append([row[0] and f"`{name}`", *row[1:]])
    return (
        "`trajectory` takes a name or a dict with fields, and [your own motion]"
        f"(/your-own/robot.md#your-own-motion):\n\n{markdown_table(shown)}"
    )


def _policies(env_id: str) -> str:
    boards = [board for board in all_leaderboards() if board.env_id == env_id]
    if not boards:
        return "The [leaderboard](/leaderboard.md) has no board for this environment yet.\n"
    text = (
        "Payload [kg] and its fraction of the optimum, from the [leaderboard](/leaderboard.md).\n"
    )
    for board in boards:
        text += f"\n{markdown_table(leaderboard_rows(board))}"
    return text
