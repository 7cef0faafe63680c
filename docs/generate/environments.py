"""A page for each environment: the docstring of its class with the tables of this id."""

from __future__ import annotations

import inspect
import re
from typing import Any

import gymnasium as gym
import numpy as np
from PIL import Image

from cablebot_gym import ENV_IDS
from cablebot_gym.benchmark.tables import motion_title
from cablebot_gym.envs import ENV_ROBOTS
from cablebot_gym.envs.settings import DEFAULT_WEIGHTS, Settings
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.evaluation.evaluator import PAYLOAD_MAX
from cablebot_gym.policies import PolicyEntry, load_policy, policy_entries
from cablebot_gym.robots import RPM, Robot
from cablebot_gym.trajectories import trajectory_names
from generate.folder import Folder, number, numbers, table
from generate.results import all_leaderboards, env_link, env_rows

PICTURED = 0.3, 0.5
"""Fraction of the motion at which the picture is taken, and of the payload that the policy carries there [kg]."""


def write(folder: Folder) -> None:
    """Writes all pages, their pictures, and the table that lists them."""
    rows = [["id", "cables", "coordinates", "platform mass [kg]", "joints", "observation size", "action size"]]
    for env_id in ENV_IDS:
        env = gym.make(env_id, render_mode="rgb_array")
        plain: Any = env.unwrapped
        robot: Robot = plain.settings.robot
        sizes = (str(plain.layout.size), str(robot.cables))
        rows.append(
            [env_link(env_id), str(robot.cables), str(robot.coordinates), number(robot.mass), robot.joints, *sizes]
        )
        picture(env, env_id).save(folder.path(f"environments/{env_id}.png"))
        folder.write(f"environments/{env_id}.md", page(env_id, plain))
        env.close()
    folder.write("environments.inc", table(rows))


def page(env_id: str, env: CableBotEnv) -> str:
    """The text of an environment's page."""
    lead, sections = manual()
    sections["Action space"] += _motors(env.settings.robot)
    sections["Observation space"] = _with_table(sections["Observation space"], env.layout.table())
    sections["Reward"] += f"\n\nWeights by default:\n\n{_weights(env.settings.robot)}"
    history = {"Version history": sections.pop("Version history")}
    parts = {
        "At a glance": _facts(env_id, env.settings),
        "Robot": _robot(env.settings.robot),
        "Equations": _equations(env.settings.robot),
        **sections,
        "Policies": _policies(env_id),
        **history,
    }
    text = "".join(f"\n## {title}\n\n{body.strip()}\n" for title, body in parts.items())
    return f"# {env_id}\n\n![{env_id}, rendered]({env_id}.png)\n\n{lead}\n{text}"


def manual() -> tuple[str, dict[str, str]]:
    """The docstring of the class: its lead, and its sections by title."""
    text = inspect.getdoc(CableBotEnv) or ""
    text = re.sub(r":(class|func|data|meth):`", r"{py:\1}`", text)  # roles as Markdown has them
    lead, *rest = re.split(r"^## ", text, flags=re.MULTILINE)
    return lead.strip(), {title: body.strip() for title, _, body in (part.partition("\n") for part in rest)}


def picture(env: gym.Env[Any, Any], env_id: str) -> Image.Image:
    """A rendered picture of an episode with the first classical law for the environment."""
    observation, _ = env.reset(seed=0, options={"payload": PICTURED[1]})
    task = env.get_wrapper_attr("task")
    policy = load_policy(made_for(env_id)[0].name, task.robot)
    for _ in range(round(PICTURED[0] * task.steps)):
        observation, *_ = env.step(policy.predict(observation)[0])
    return Image.fromarray(np.asarray(env.render()))


def made_for(env_id: str) -> list[PolicyEntry]:
    """The policies for an environment, classical ones first."""
    entries = [entry for entry in policy_entries().values() if env_id in entry.env_ids]
    return sorted(entries, key=lambda entry: (entry.kind != "classical", entry.kind != "optimal"))


def _facts(env_id: str, settings: Settings) -> str:
    robot, spec = settings.robot, gym.spec(env_id)
    steps = spec.max_episode_steps or 0
    rotation = "" if robot.planar else f", rotation {number(1e3 * settings.error_bounds.rotation)} mrad"
    motion = settings.trajectory
    others = ", ".join(f"`{name}`" for name in trajectory_names(robot.coordinates) if name != motion.name)
    highest = PAYLOAD_MAX["planar" if robot.planar else "spatial"]
    rows = [
        ("", ""),
        ("constructor", f'`gym.make("{env_id}")`, `gym.make_vec("{env_id}", num_envs=N)`'),
        ("robot", f"`{ENV_ROBOTS[env_id]}`: `cablebot_gym.robots.{robot.name.upper().replace('-', '_')}`"),
        ("reference motion", f"`{motion.name}`, {number(motion.duration)} s; by name also {others}"),
        ("error bounds", f"position {number(1e3 * settings.error_bounds.position)} mm{rotation}"),
        (
            "control",
            f"{number(settings.control_frequency)} Hz, {settings.substeps} physics steps of "
            f"{number(1e3 * settings.physics_step)} ms in each control period",
        ),
        ("time limit", f"{steps} steps, {number(steps * settings.period)} s"),
        (
            "termination",
            f"position error above {number(1e3 * settings.termination_radius)} mm, "
            f"or slack for {settings.slack_time:g} s",
        ),
        ("cables", settings.cable),
        ("payloads tried", f"0 to {number(highest)} kg, see [DLCC](/dlcc.md)"),
    ]
    return table(rows)


def _motors(robot: Robot) -> str:
    rows = [["component", "low", "high", "motor", "stall torque τ_s [N·m]", "free speed ω_n [rad/s]", "[rpm]"]]
    speeds = robot.per_motor(robot.motors.free_speed)
    for index, (torque, speed) in enumerate(zip(robot.stall_torque, speeds, strict=True)):
        values = (torque, speed, speed / RPM)
        rows.append([str(index), "−1", "1", f"winds cable {index + 1}", *map(number, values)])
    return f"\n\n{table(rows)}"


def _with_table(section: str, layout: str) -> str:
    """A section with the table of all robots replaced by that of this robot."""
    lines = section.splitlines()
    marks = [index for index, line in enumerate(lines) if line.startswith("|")]
    return "\n".join([*lines[: marks[0]], layout, *lines[marks[-1] + 1 :]])


def _weights(robot: Robot) -> str:
    names = [name for name in DEFAULT_WEIGHTS if name != "rotation" or not robot.planar]
    return table([["term", "weight"], *([f"`{name}`", number(DEFAULT_WEIGHTS[name])] for name in names)])


def _robot(robot: Robot) -> str:
    anchors = [["cable", "base anchor A [m]", *([] if robot.planar else ["platform anchor b [m]"])]]
    for index in range(robot.cables):
        points = (robot.base,) if robot.planar else (robot.base, robot.platform)
        anchors.append([str(index + 1), *(numbers(point[index]) for point in points)])
    rows = [
        ["quantity", "value"],
        ["platform's mass, without payload", f"{number(robot.mass)} kg"],
        *([] if robot.planar else [["moments of inertia I", f"{numbers(robot.inertia)} kg·m²"]]),
        *([] if robot.planar else [["gravity g, along +z", f"{number(robot.gravity)} m/s²"]]),
        ["pulley radius r", f"{number(robot.pulley_radius[0])} m"],
        ["pulley inertia J", f"{number(robot.pulley_inertia[0])} kg·m²"],
        ["friction c", f"{number(robot.damping[0])} N·m·s/rad"],
    ]
    if robot.flexible:
        rows += [
            ["joint springs K", f"{number(robot.stiffness[0])} N·m/rad"],
            ["motor inertia J′", f"{number(robot.motor_inertia[0])} kg·m²"],
            ["motor friction c′", f"{number(robot.motor_damping[0])} N·m·s/rad"],
        ]
    low, high = robot.pose_bounds
    units = "m" if robot.planar else "m, rad"
    rows += [
        [f"home pose X₀ [{units}]", numbers(robot.home)],
        [f"workspace [{units}]", f"{numbers(low)} to {numbers(high)}"],
    ]
    source = "`cablebot_gym/robots.py` names the table of the paper for each value."
    return f"{table(rows)}\n{table(anchors)}\n{source} The keyword `robot` takes [another one](/your-own/robot.md)."


def _equations(robot: Robot) -> str:
    """The equations of the robot, and the modules with their code."""
    parts = ["planar" if robot.planar else "spatial", robot.joints, "motors", "cables"]
    titles = {"motors": "Motors", "cables": "Cables"}
    text = (
        "Symbols and equation numbers are the paper's, with corrected misprints; each number links to its correction.\n"
    )
    for part in parts:
        title = titles.get(part, "Platform" if part == parts[0] else "Joints")
        text += f"\n### {title}\n\n```{{include}} /parts/{part}.md\n```\n"
    return (
        text
        + "\nReadable code: {py:mod}`cablebot_gym.physics.textbook`. Compiled code: `cablebot_gym/physics/kernel.py`."
    )


def _policies(env_id: str) -> str:
    text = (
        "Payload [kg] and its fraction of the best known payload, task criterion unless noted. The whole table is on "
    )
    text += "the [leaderboard](/leaderboard.md).\n"
    for leaderboard in all_leaderboards():
        if leaderboard.env_id == env_id:
            title = motion_title(leaderboard)
            text += f"\n{title[0].upper() + title[1:]}:\n\n{table(env_rows(leaderboard))}"
    return text
