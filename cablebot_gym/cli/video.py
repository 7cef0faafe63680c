"""``cablebot video``, and the options and functions that ``cablebot watch`` shares with it."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cablebot_gym.cli.options import (
    EnvId,
    Frequency,
    PayloadKnown,
    PolicyNameOrNone,
    Seed,
    TrajectoryName,
    UncertaintyName,
    as_data,
    split_names,
)
from cablebot_gym.utils.console import counting, notes_console
from cablebot_gym.video import SPEED

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from cablebot_gym.video.recording import Video

Payload = Annotated[float, typer.Option("--payload", help="Payload [kg].")]
Speed = Annotated[float, typer.Option("--speed", help="Playback speed; 1 is real time.")]
Size = Annotated[
    str | None, typer.Option("--size", help="Size of the picture of each policy, such as 1280x960 [pixels].")
]
Policies = Annotated[
    str | None,
    typer.Option("--policies", help="Several policies side by side, separated by commas. Replaces --policy."),
]


def video(
    env_id: EnvId,
    out: Annotated[Path, typer.Argument(help="File to write, ending in .mp4 or .gif.")],
    policy: PolicyNameOrNone = None,
    policies: Policies = None,
    payload: Payload = 1.0,
    speed: Speed = SPEED,
    size: Size = None,
    trajectory: TrajectoryName = None,
    payload_known: PayloadKnown = True,
    uncertainty: UncertaintyName = None,
    control_frequency: Frequency = 500.0,
    seed: Seed = 0,
) -> None:
    """Write a video of an episode, with one or more policies side by side.

    Needs neither a display nor OpenGL. Requires the extra: pip install 'cablebot-gym[render]'.

    Examples:

    cablebot video CableBot-Spatial-v0 fl.mp4 --policy fl --payload 4

    cablebot video CableBot-Spatial-v0 both.gif --policies fl,trajopt --payload 6 --size 480x360
    """
    from cablebot_gym.video.recording import check_speed, check_video, write_video

    frame_size = picture_size(size)
    check_video(out)
    check_speed(speed)
    videos = record_videos(
        env_id,
        policy_names(policy, policies),
        payload=payload,
        trajectory=as_data("--trajectory", trajectory),
        payload_known=payload_known,
        uncertainty=as_data("--uncertainty", uncertainty),
        control_frequency=control_frequency,
        seed=seed,
    )
    errors = notes_console()
    with counting(errors, "frames") as bar:
        task = bar.add_task("rendering", total=1)
        write_video(
            out,
            videos,
            speed=speed,
            size=frame_size,
            progress=lambda done, expected: bar.update(task, completed=done, total=expected),
        )
    for one in videos:
        print(f"{one.scene.title}, {payload:g} kg, task criterion: {one.note(len(one.moments) - 1) or 'incomplete'}")
    errors.print(f"wrote {out}")


def policy_names(policy: str | None, policies: str | None) -> list[str]:
    """Policy names from ``--policy`` or ``--policies``.

    Raises:
        ValueError: if both are given, or neither.
    """
    names = split_names(policies or policy)
    if (policy is None) == (policies is None) or not names:
        raise ValueError(
            "give either --policy with one name, or --policies with several. Example: --policies fl,trajopt"
        )
    return names


def picture_size(text: str | None) -> tuple[int, int]:
    """Width and height from ``--size``.

    Raises:
        ValueError: if the size is invalid.
    """
    from cablebot_gym.rendering.painter import SIZE, check_size

    if text is None:
        return SIZE
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(f"--size must be WIDTHxHEIGHT in pixels, such as 640x480, not {text!r}")
    return check_size((int(width), int(height)))


def record_videos(env_id: str, names: list[str], **keywords: Any) -> list[Video]:
    """Records one episode of each policy for a video."""
    from cablebot_gym.envs import env_robot
    from cablebot_gym.policies import load_policy
    from cablebot_gym.rendering.painter import import_pygame
    from cablebot_gym.robots import find_robot
    from cablebot_gym.video.recording import record_video

    import_pygame()
    robot = find_robot(env_robot(env_id))
    loaded = [load_policy(name, robot) for name in names]
    videos = []
    with counting(notes_console(), "steps") as bar:
        for name, policy in zip(names, loaded, strict=True):
            title = f"{name} on {env_id}"
            step = partial(_advance, bar, bar.add_task(title, total=1))
            videos.append(record_video(policy, env_id, title=title, name=name, progress=step, **keywords))
    return videos


def _advance(bar: Progress, task: TaskID, done: int, expected: int) -> None:
    bar.update(task, completed=done, total=expected)
