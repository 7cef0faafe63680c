"""``cablebot robot export``."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated

from cablebot_gym.cli.options import Payload, RobotName
from cablebot_gym.utils.console import say


def export(
    name: RobotName, out: Annotated[Path, "File to write (.xml)."], payload: Payload = None
) -> None:
    """Export a robot as MJCF for MuJoCo.

    Notes say what the file describes in another way. In the keyframe `home` the robot is at rest
    with its payload.

    Example: cablebot robot export cogiro --payload 300 --out cogiro.xml
    """
    from cablebot_gym.envs.settings import fewest_substeps
    from cablebot_gym.exporters import export_mjcf
    from cablebot_gym.physics import textbook
    from cablebot_gym.robots import find_robot
    from cablebot_gym.utils.checks import number
    from cablebot_gym.utils.files import atomic_write_text, check_new_file

    if out.suffix.lower() != ".xml":
        raise ValueError(f"--out must end in .xml, not {out.name!r}")
    check_new_file(out)
    robot = find_robot(name)
    payload = number("payload", robot.defaults.payload(payload), least=0, unit="kg")
    torques = None
    if not robot.hanging:  # it may swing at home
        torques = textbook.static_torque(robot, robot.mass + payload, robot.home)
    exported = export_mjcf(
        robot,
        payload=payload,
        timestep=1 / robot.defaults.control_frequency / fewest_substeps(robot),
        holding_torques=torques,
    )
    atomic_write_text(out, exported.text)
    for note in exported.notes:
        say(f"note       {note}")
    viewer = f"python -m mujoco.viewer --mjcf={quote(str(out))}"
    say(f"wrote {out}. Look at it with MuJoCo's viewer: {viewer}")
