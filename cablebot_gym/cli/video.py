"""``cablebot video``, and what it shares with ``cablebot watch``."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cablebot_gym.cli.options import (
    EnvId,
    Frequency,
    Known,
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

    from cablebot_gym.video.recording import Film

Payload = Annotated[float, typer.Option("--payload", help="[kg]")]
Speed = Annotated[float, typer.Option("--speed", help="As a share of the episode's own; 1 is as it happens.")]
Size = Annotated[str | None, typer.Option("--size", help="Of each picture, such as 1280x960 [pixels].")]
Policies = Annotated[
    str | None, typer.Option("--policies", help="Several, separated by commas, side by side: in place of --policy.")
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
    payload_known: Known = True,
    uncertainty: UncertaintyName = None,
    control_frequency: Frequency = 500.0,
    seed: Seed = 0,
) -> None:
    """An episode as a film, of several policies side by side. Neither a display nor OpenGL is needed.

    Needs the extra: pip install 'cablebot-gym[render]'.

    Examples:

    cablebot video CableBot-Spatial-v0 fl.mp4 --policy fl --payload 4

    cablebot video CableBot-Spatial-v0 both.gif --policies fl,tube --payload 6 --size 480x360
    """
    from cablebot_gym.video.recording import check_film, check_speed, write_film

    each = picture_size(size)
    check_film(out)
    check_speed(speed)
    films = record_videos(
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
    with counting(errors, "pictures") as bar:
        task = bar.add_task("filming", total=1)
        write_film(
            out,
            films,
            speed=speed,
            size=each,
            progress=lambda done, expected: bar.update(task, completed=done, total=expected),
        )
    for one in films:
        print(f"{one.scene.title}, {payload:g} kg, task criterion: {one.note(len(one.moments) - 1) or 'not complete'}")
    errors.print(f"wrote {out}")


def policy_names(policy: str | None, policies: str | None) -> list[str]:
    """The names that ``--policy`` or ``--policies`` gives.

    Raises:
        ValueError: if both are given, or neither.
    """
    names = split_names(policies or policy)
    if (policy is None) == (policies is None) or not names:
        raise ValueError("name one policy by --policy, or several by --policies, such as --policies fl,tube")
    return names


def picture_size(text: str | None) -> tuple[int, int]:
    """Width and height from ``--size``.

    Raises:
        ValueError: if it is not a valid size.
    """
    from cablebot_gym.rendering.painter import SIZE, check_size

    if text is None:
        return SIZE
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal()):
        raise ValueError(f"--size must be width x height in pixels, such as 640x480, not {text!r}")
    return check_size((int(width), int(height)))


def record_videos(env_id: str, names: list[str], **keywords: Any) -> list[Film]:
    """An episode of each policy, recorded for a video."""
    from cablebot_gym.envs import env_robot
    from cablebot_gym.policies import load_policy
    from cablebot_gym.rendering.painter import import_pygame
    from cablebot_gym.robots import find_robot
    from cablebot_gym.video.recording import film

    import_pygame()
    robot = find_robot(env_robot(env_id))
    loaded = [load_policy(name, robot) for name in names]
    films = []
    with counting(notes_console(), "steps") as bar:
        for name, policy in zip(names, loaded, strict=True):
            title = f"{name} on {env_id}"
            step = partial(_advance, bar, bar.add_task(title, total=1))
            films.append(film(policy, env_id, title=title, name=name, progress=step, **keywords))
    return films


def _advance(bar: Progress, task: TaskID, done: int, expected: int) -> None:
    bar.update(task, completed=done, total=expected)
