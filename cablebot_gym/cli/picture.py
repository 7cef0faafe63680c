"""``cablebot picture``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablebot_gym.cli.options import (
    ConditionOptions,
    FittingEnvId,
    Payload,
    id_and_file,
    robot_of,
)
from cablebot_gym.cli.video import Size, pixels, print_verdicts, record_episodes
from cablebot_gym.utils.console import say

if TYPE_CHECKING:
    from cablebot_gym.video.recording import Episode


def picture(
    conditions: ConditionOptions,
    env_id: FittingEnvId = None,
    out: Annotated[
        Path | None,
        typer.Argument(metavar="FILE", help="File to write, ending in .png, .jpg or .webp."),
    ] = None,
    policy: Annotated[
        str | None,
        "Policy as for `dlcc`, or several, separated by commas. The default shows the start pose.",
    ] = None,
    payload: Payload = None,
    size: Size = None,
    time: Annotated[
        float | None,
        "Time of the picture [s]. The default is the end, with the whole path.",
    ] = None,
) -> None:
    """Write a picture of an episode, with one or more policies side by side; without a policy, of
    the start pose.

    Needs neither a display nor OpenGL. Requires the extra: pip install 'cablebot-gym[render]'.

    Examples:

    cablebot picture CableBot-Spatial-v0 start.png

    cablebot picture CableBot-Spatial-v0 both.png --policy fl,trajopt --payload 6 --time 1.1 --size 480x360
    """
    from cablebot_gym.video.recording import check_picture, write_picture

    width_and_height = pixels(size)
    env_id, out = id_and_file(env_id, out, conditions.robot)
    check_picture(out, time)
    if policy is not None:
        episodes = record_episodes(env_id, policy, payload, conditions)
    else:
        episodes = [_at_rest(env_id, payload, conditions)]
        if time is None:
            time = 0.0
    write_picture(out, episodes, time=time, size=width_and_height)
    if policy is not None:
        print_verdicts(episodes)
    say(f"wrote {out}")


def _at_rest(env_id: str, payload: float | None, conditions: ConditionOptions) -> Episode:
    """An episode without torques, for its start."""
    import numpy as np

    from cablebot_gym.envs import described
    from cablebot_gym.evaluation.rollout import record_rollout
    from cablebot_gym.rendering.painter import import_pygame

    import_pygame()
    robot = robot_of(env_id, conditions)
    keywords = conditions.keywords() | {"payload": robot.defaults.payload(payload)}
    rollout = record_rollout(lambda observation: np.zeros(robot.cables), env_id, **keywords)
    return described(env_id, robot.name), rollout
