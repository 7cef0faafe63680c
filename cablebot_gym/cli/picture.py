"""``cablebot picture``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablebot_gym.cli.options import EnvId, EpisodeOptions, Payload, PolicyNameOrNone
from cablebot_gym.cli.video import Policies, Size, picture_size, record_episodes
from cablebot_gym.utils.console import notes_console


def picture(
    env_id: EnvId,
    out: Annotated[Path, typer.Argument(help="File to write, ending in .png, .jpg or .webp.")],
    episode: EpisodeOptions,
    policy: PolicyNameOrNone = None,
    policies: Policies = None,
    payload: Payload = None,
    time: Annotated[
        float | None,
        typer.Option(help="Time of the picture [s]. The default is the end, with the whole path."),
    ] = None,
    size: Size = None,
) -> None:
    """Write a picture of an episode, with one or more policies side by side; without a policy, of
    the start pose.

    Needs neither a display nor OpenGL. Requires the extra: pip install 'cablebot-gym[render]'.

    Examples:

    cablebot picture CableBot-Spatial-v0 start.png

    cablebot picture CableBot-Spatial-v0 both.png --policies fl,trajopt --payload 6 --time 1.1 --size 480x360
    """
    from cablebot_gym.video.recording import check_picture, note, write_picture

    frame_size = picture_size(size)
    check_picture(out, time)
    start = policy is None and policies is None
    episodes = record_episodes(
        env_id, policy, policies, payload=payload, start=start, episode=episode
    )
    write_picture(out, episodes, time=0.0 if start and time is None else time, size=frame_size)
    if not start:
        for title, rollout in episodes:
            print(
                f"{title}, {rollout.payload:g} kg, task criterion: {note(rollout, len(rollout) - 1)}"
            )
    notes_console().print(f"wrote {out}")
