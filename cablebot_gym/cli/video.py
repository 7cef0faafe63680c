"""``cablebot video``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cablebot_gym.cli.options import (
    ConditionOptions,
    FittingEnvId,
    Payload,
    PolicyNames,
    fitting_id,
    loaded_policies,
    robot_of,
    split_names,
)
from cablebot_gym.utils.console import progress, say
from cablebot_gym.video import SPEED

if TYPE_CHECKING:
    from cablebot_gym.video.recording import Episode


def _pixels(size: str | None) -> tuple[int, int]:
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
    *,
    env_id: FittingEnvId = None,
    policy: PolicyNames,
    out: Annotated[
        Path, "File to write, ending in .mp4 or .gif for a video, in .png for a picture."
    ],
    conditions: ConditionOptions,
    payload: Payload = None,
    size: Annotated[
        str | None, "Size of the picture of each policy, such as 1280x960 [pixels]."
    ] = None,
    speed: Annotated[float, "Playback speed; 1 is real time."] = SPEED,
    time: Annotated[
        float | None,
        "Time of a picture [s]; 0 shows the start pose. The default is the end, with the whole path.",
    ] = None,
) -> None:
    """Write a video or a picture of an episode, with one or more policies side by side.

    Needs neither a display nor OpenGL. Requires the extra: pip install 'cablebot-gym[render]'.

    Examples:

    cablebot video CableBot-Spatial-v0 --out fl.mp4 --policy fl --payload 4

    cablebot video CableBot-Spatial-v0 --out both.gif --policy fl,trajopt --payload 6 --size 480x360

    cablebot video CableBot-Spatial-v0 --out fl.png --policy fl --payload 6 --time 0.65
    """
    from cablebot_gym.video.recording import check_video, note, write_picture, write_video

    width_and_height = _pixels(size)
    env_id = fitting_id(env_id, conditions.robot)
    check_video(out, speed)
    if time is not None and out.suffix != ".png":
        raise ValueError(f"--time is for a picture: name a .png file, not {str(out)!r}")
    episodes = _record_episodes(env_id, policy, payload, conditions)
    if out.suffix == ".png":
        write_picture(out, episodes, time=time, size=width_and_height)
    else:
        with progress("rendering", "frames") as step:
            write_video(out, episodes, speed=speed, size=width_and_height, progress=step)
    for title, rollout in episodes:
        print(f"{title}, {rollout.payload:g} kg, task criterion: {note(rollout, len(rollout) - 1)}")
    say(f"wrote {out}")


def _record_episodes(
    env_id: str, policy: str, payload: float | None, conditions: ConditionOptions
) -> list[Episode]:
    """Records one episode of each policy."""
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
