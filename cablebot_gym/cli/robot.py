"""``cablebot robot check``."""

from __future__ import annotations

import json
import math
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from cablebot_gym.cli.options import (
    ConditionOptions,
    Json,
    Payload,
    RobotName,
    TrajectoryData,
    command_again,
    counted,
)
from cablebot_gym.utils.console import say

if TYPE_CHECKING:
    from cablebot_gym.bounds.robot_check import MotionCheck, PayloadLimit, RobotCheck
    from cablebot_gym.robots import Robot


def check(
    name: RobotName,
    payload: Payload = None,
    trajectory: TrajectoryData = None,
    out: Annotated[Path | None, "Drawing to write (.svg, .png, .pdf)."] = None,
    as_json: Json = False,
) -> None:
    """Check a robot and its motion.

    The check prints payloads, workspace, modes, physics step, sag, and cables that touch. Nothing
    is simulated. The exit status is 1 if no controller can be expected to carry the payload, and 2
    if the robot or the motion is invalid.

    Examples:

    cablebot robot check my.toml --out my.svg

    cablebot robot check cogiro --payload 300
    """
    if out is not None and out.suffix not in (".svg", ".png", ".pdf"):
        raise ValueError(f"--out must end in .svg, .png or .pdf, not {out.name!r}")
    from cablebot_gym.bounds.robot_check import check_model, check_motion
    from cablebot_gym.robots import find_robot

    model = find_robot(name)
    robot_check = check_model(model, payload=payload)
    if not as_json:  # before the motion, which may be invalid
        print("\n".join(report(robot_check)), flush=True)
    motion = check_motion(model, payload=payload, trajectory=trajectory)
    if as_json:
        print(json.dumps(robot_check.to_dict() | motion.to_dict(), indent=2))
    else:
        law = "composite" if model.flexible else "fl"
        evaluation = command_again(
            "dlcc", policy=law, conditions=ConditionOptions(robot=name, trajectory=trajectory)
        )
        print("\n".join(motion_report(robot_check, motion, evaluation)))
    if out is not None:
        _draw(robot_check, motion, out)
        say(f"wrote {out}")
    if not motion.possible:
        raise typer.Exit(1)


def _draw(check: RobotCheck, motion: MotionCheck, out: Path) -> None:
    from cablebot_gym.plotting.figures import DPI
    from cablebot_gym.plotting.robots import draw_robot
    from cablebot_gym.utils.files import atomic_write

    figure = draw_robot(check, motion)
    atomic_write(out, partial(figure.savefig, dpi=DPI, format=out.suffix[1:]))


def report(check: RobotCheck) -> list[str]:
    """The check without a motion, as lines of text."""
    from cablebot_gym.robots import KIND_TEXTS

    robot = check.robot
    home = check.home
    lines = [
        f"robot      {robot.name}: {KIND_TEXTS[robot.kind]}, {counted(robot.cables, 'cable')}, {robot.springs}",
        f"mass       {_mass(robot)}",
        f"anchors    {_anchors(robot)}",
    ]
    force = float((robot.stall_torque / robot.pulley_radius).min())
    speed = float((robot.stall_torque / robot.speed_slope * robot.pulley_radius).min())
    lines.append(
        f"motors     {force:.4g} N at standstill and {speed:.3g} m/s without load, at the weakest cable"
    )
    if robot.maximum_tension != math.inf:
        lines.append(f"cables     at most {robot.maximum_tension:g} N in each")
    held = "no payload can be held"
    if home.least <= home.largest:
        held = f"holds {_interval(home, robot)}"
    lines += [f"home       {held} at rest:", f"           {home.reason}"]
    lines.append(
        f"workspace  {check.payload:g} kg at rest in {check.workspace:.0%} of it, at the home orientation"
    )
    for locked, text in ((True, "motors locked"), (False, "motors free")):
        # the softest and the stiffest mode, or none
        frequencies = [
            f"{mode.frequency:.3g} Hz ({mode.direction})"
            for mode in check.modes
            if mode.locked == locked
        ]
        if frequencies:
            lines.append(f"modes      {text}: softest {frequencies[0]}, stiffest {frequencies[1]}")
    if not check.modes:
        lines.append("modes      none: the transmission is rigid and the cables do not stretch")
    if check.substeps is None:
        lines.append("step       the springs are too stiff for the default physics step")
    else:
        period = 1e3 / robot.defaults.control_frequency  # [ms]
        step = f"{period / check.substeps:.3g} ms"
        lines.append(
            f"step       {counted(check.substeps, 'physics step')} of {step} in a control period"
        )
    return lines


def motion_report(check: RobotCheck, motion: MotionCheck, evaluation: str) -> list[str]:
    """The check of a motion, as lines of text. ``evaluation`` is the command that evaluates a
    controller on it."""
    from cablebot_gym.bounds.robot_check import two_digits

    robot = check.robot
    limit = motion.limit
    place = f"at t = {limit.time:.2f} s, pose ({_numbers(limit.pose)})"
    heading = f"motion     {motion.trajectory.name}, {motion.trajectory.duration:g} s"
    if limit.largest < limit.least:
        lines = [f"{heading}: exact tracking carries no payload"]
    else:
        lines = [f"{heading}: exact tracking carries {_interval(limit, robot)}"]
    lines += [f"           limit {place}:", f"           {limit.reason}"]
    if motion.payload_range is not None:
        payloads = two_digits(*motion.payload_range)
        values = counted(len(robot.ranges), "value")
        lines.append(f"           {payloads} kg over the ranges of {values}")
    if motion.payload > 0 and motion.held:
        lines.append(f"           {motion.payload:g} kg is carried exactly")
    elif motion.payload > 0 and motion.possible:
        bounds = f"{1e3 * motion.error_bounds.position:g} mm"
        if not robot.point_mass:
            bounds += f" and {1e3 * motion.error_bounds.rotation:g} mrad"
        lines.append(
            f"           {motion.payload:g} kg is beyond exact tracking; controllers may carry it within the"
        )
        lines.append(f"           error bounds of {bounds}. This command tells for one of them:")
        lines.append(f"           {evaluation}")
    elif not motion.possible:
        lines.append(
            f"           {motion.payload:g} kg cannot be carried: {_why_impossible(motion)}"
        )
    return [
        *lines,
        *_sag_lines(check, motion),
        *(f"question   {question}" for question in motion.questions),
    ]


def _numbers(pose: tuple[float, ...]) -> str:
    """Coordinates as text; + 0.0 makes 0 of −0."""
    return ", ".join(f"{round(value, 6) + 0.0:.4g}" for value in pose)


def _why_impossible(motion: MotionCheck) -> str:
    if motion.payload < motion.limit.least:
        return "see the limit"
    if math.isfinite(motion.ceiling):
        return f"at the start pose the motors and cables hold {motion.ceiling:.4g} kg"
    return "the motors cannot hold the platform at the start pose"


def _interval(limit: PayloadLimit, robot: Robot) -> str:
    """Range of payloads as text."""
    from cablebot_gym.physics.statics import HEAVIEST

    if limit.largest >= HEAVIEST * robot.mass:
        return f"every payload from {limit.least:.4g} kg on"
    if limit.least > 0:
        return f"payloads from {limit.least:.4g} to {limit.largest:.4g} kg"
    return f"up to {limit.largest:.4g} kg"


def _mass(robot: Robot) -> str:
    """Mass, moments of inertia, and radii of gyration, which reveal a wrong unit of the others."""
    if robot.point_mass:
        return f"{robot.mass:g} kg"
    moments = ", ".join(f"{moment:.3g}" for moment in robot.moments)
    radii = ", ".join(f"{math.sqrt(moment / robot.mass):.3g}" for moment in robot.moments)
    return f"{robot.mass:g} kg; inertia {moments} kg·m², radius of gyration {radii} m"


def _anchors(robot: Robot) -> str:
    """Size of the base, and which axis points down."""
    sides = robot.base.max(axis=0) - robot.base.min(axis=0)
    size = " × ".join(f"{side:.3g}" for side in sides)
    text = f"base of {size} m"
    if robot.weightless:
        return text
    axis = "y" if robot.planar else "z"
    return f"{text}; {axis} points down"


def _sag_lines(check: RobotCheck, motion: MotionCheck) -> list[str]:
    """Lines of the sag at the least tensions of the motion."""
    if not motion.cables:
        why = "the cables have no mass; set cable_density"
        if np.any(check.robot.cable_density):
            why = "the motion is not held"
        return [f"sag        not checked: {why}"]
    lines = []
    start = "sag        "
    for number, cable in enumerate(motion.cables, 1):
        text = f"sag {1e3 * cable.sag:.4g} mm, {1e3 * cable.extra_length:.3g} mm longer"
        if cable.stiffness_factor is not None:
            text += f", stiffness × {cable.stiffness_factor:.2f}"
        lines.append(
            f"{start}cable {number}, {cable.length:.3g} m, at {cable.tension:.4g} N or more: {text}"
        )
        start = " " * 11
    return lines
