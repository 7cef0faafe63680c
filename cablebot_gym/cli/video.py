"""``cablebot video``, and what ``cablebot watch`` and ``cablebot picture`` share with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablebot_gym.cli.options import (
    ConditionOptions,
    FittingEnvId,
    Payload,
    PolicyNames,
    id_and_file,
    loaded_policies,
    robot_of,
    split_names,
)
from cablebot_gym.utils.console import progress, say
from cablebot_gym.video import SPEED

if TYPE_CHECKING:
    from cablebot_gym.video.recording import Episode

Speed = Annotated[float, typer.Option("--speed", help="Playback speed; 1 is real time.")]
Size = Annotated[
    str | None,
    typer.Option("--size", help="Size of the picture of each policy, such as 1280x960 [pixels]."),
]


def pixels(size: str | None) -> tuple[int, int]:
    """Width and height from ``--size``.

    Raises:
        ValueError: if the size is invalid.
    """
    from cablebot_gym.rendering.painter import SIZE, check_size

    if size is None:
        return SIZE
    width, _, height = size.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(f"--size must be WIDTHxHEIGHT in pixels, such as 640x480, not {size!r}")
    return check_size((int(width), int(height)))


def video(
    policy: PolicyNames,
    conditions: ConditionOptions,
    env_id: FittingEnvId = None,
    out: Annotated[
        Path | None, typer.Argument(metavar="FILE", help="File to write, ending in .mp4 or .gif.")
    ] = None,
    payload: Payload = None,
    size: Size = None,
    speed: Speed = SPEED,
) -> None:
    """Write a video of an episode, with one or more policies side by side.

    Needs neither a display nor OpenGL. Requires the extra: pip install 'cablebot-gym[render]'.

    Examples:

    cablebot video CableBot-Spatial-v0 fl.mp4 --policy fl --payload 4

    cablebot video CableBot-Spatial-v0 both.gif --policy fl,trajopt --payload 6 --size 480x360
    """
    from cablebot_gym.video.recording import check_speed, check_video, write_video

    width_and_height = pixels(size)
    env_id, out = id_and_file(env_id, out, conditions.robot)
    check_video(out)
    check_speed(speed)
    episodes = record_episodes(env_id, policy, payload, conditions)
    with progress("rendering", "frames") as step:
        write_video(out, episodes, speed=speed, size=width_and_height, progress=step)
    print_verdicts(episodes)
    say(f"wrote {out}")


def print_verdicts(episodes: list[Episode]) -> None:
    """Prints whether each payload was carried."""
    from cablebot_gym.video.recording import note

    for title, rollout in episodes:
        print(f"{title}, {rollout.payload:g} kg, task criterion: {note(rollout, len(rollout) - 1)}")


def record_episodes(
    env_id: str, policy: str, payload: float | None, conditions: ConditionOptions
) -> list[Episode]:
    """Records one episode of each policy.

    Args:
        env_id: environment id.
        policy: names of policies, separated by commas.
        payload: payload [kg]; None for the least one of the robot's payload range.
        conditions: conditions of the episode.
    """
    from cablebot_gym.envs import described
    from cablebot_gym.evaluation.rollout import record_rollout
    from cablebot_gym.rendering.painter import import_pygame

    robot = robot_of(env_id, conditions)
    place = described(env_id, robot.name)
    keywords = conditions.keywords() | {"payload": robot.defaults.payload(payload)}
    import_pygame()
    episodes = []
    for loaded in loaded_policies(split_names(policy), robot, conditions.wrappers, isolate=False):
        rollout = record_rollout(loaded, env_id, progress=True, **keywords)
        episodes.append((f"{loaded.name} on {place}", rollout))
    return episodes
