"""``cablebot picture``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablebot_gym.cli.options import EnvId, EpisodeOptions
from cablebot_gym.cli.video import PictureOptions, print_verdicts, record_episodes
from cablebot_gym.utils.console import say


def picture(
    env_id: EnvId,
    out: Annotated[Path, typer.Argument(help="File to write, ending in .png, .jpg or .webp.")],
    pictures: PictureOptions,
    episode: EpisodeOptions,
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

    cablebot picture CableBot-Spatial-v0 both.png --policies fl,trajopt --payload 6 --time 1.1 --size 480x360
    """
    from cablebot_gym.video.recording import check_picture, write_picture

    size = pictures.pixels
    check_picture(out, time)
    start = pictures.policy is None and pictures.policies is None
    episodes = record_episodes(env_id, pictures, episode, start=start)
    write_picture(out, episodes, time=0.0 if start and time is None else time, size=size)
    if not start:
        print_verdicts(episodes)
    say(f"wrote {out}")
