"""``cablebot video``, and the options and functions that ``cablebot watch`` shares with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from cablebot_gym.cli.options import (
    EnvId,
    EpisodeOptions,
    Payload,
    PolicyNameOrNone,
    loaded_policies,
    robot_of,
    split_names,
)
from cablebot_gym.cli.records import Options
from cablebot_gym.utils.console import progress, say
from cablebot_gym.video import SPEED

if TYPE_CHECKING:
    from cablebot_gym.video.recording import Episode

Speed = Annotated[float, typer.Option("--speed", help="Playback speed; 1 is real time.")]


@dataclass(frozen=True, kw_only=True)
class PictureOptions(Options):
    """What pictures show, and their size."""

    title: ClassVar[str] = "Pictures"

    policy: PolicyNameOrNone = None
    policies: Annotated[
        str | None,
        "Several policies side by side, separated by commas. Replaces --policy.",
    ] = None
    payload: Payload = None
    size: Annotated[
        str | None,
        "Size of the picture of each policy, such as 1280x960 [pixels].",
    ] = None

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height.

        Raises:
            ValueError: if the size is invalid.
        """
        from cablebot_gym.rendering.painter import SIZE, check_size

        if self.size is None:
            return SIZE
        width, _, height = self.size.partition("x")
        if not (width.isdecimal() and height.isdecimal()):
            raise ValueError(
                f"--size must be WIDTHxHEIGHT in pixels, such as 640x480, not {self.size!r}"
            )
        return check_size((int(width), int(height)))


def video(
    env_id: EnvId,
    out: Annotated[Path, typer.Argument(help="File to write, ending in .mp4 or .gif.")],
    pictures: PictureOptions,
    episode: EpisodeOptions,
    speed: Speed = SPEED,
) -> None:
    """Write a video of an episode, with one or more policies side by side.

    Needs neither a display nor OpenGL. Requires the extra: pip install 'cablebot-gym[render]'.

    Examples:

    cablebot video CableBot-Spatial-v0 fl.mp4 --policy fl --payload 4

    cablebot video CableBot-Spatial-v0 both.gif --policies fl,trajopt --payload 6 --size 480x360
    """
    from cablebot_gym.video.recording import check_speed, check_video, write_video

    size = pictures.pixels
    check_video(out)
    check_speed(speed)
    episodes = record_episodes(env_id, pictures, episode)
    with progress("rendering", "frames") as step:
        write_video(out, episodes, speed=speed, size=size, progress=step)
    print_verdicts(episodes)
    say(f"wrote {out}")


def print_verdicts(episodes: list[Episode]) -> None:
    """Prints whether each payload was carried."""
    from cablebot_gym.video.recording import note

    for title, rollout in episodes:
        print(f"{title}, {rollout.payload:g} kg, task criterion: {note(rollout, len(rollout) - 1)}")


def record_episodes(
    env_id: str, pictures: PictureOptions, episode: EpisodeOptions, *, start: bool = False
) -> list[Episode]:
    """Records one episode of the policy in ``--policy`` or of each one in ``--policies``.

    Args:
        env_id: environment id.
        pictures: policies and payload.
        episode: options of the episode.
        start: whether to record an episode without torques instead, for its start.

    Raises:
        ValueError: if both policy options are given, or neither.
    """
    import numpy as np

    from cablebot_gym.envs import described
    from cablebot_gym.evaluation.rollout import record_rollout
    from cablebot_gym.rendering.painter import import_pygame

    robot = robot_of(env_id, episode)
    place = described(env_id, robot.name)
    payload = pictures.payload
    if payload is None:
        payload = robot.defaults.payload(0.0)
    keywords = episode.keywords() | {"payload": payload}
    if start:
        import_pygame()
        at_rest = record_rollout(lambda observation: np.zeros(robot.cables), env_id, **keywords)
        return [(place, at_rest)]
    names = split_names(pictures.policies or pictures.policy)
    if (pictures.policy is None) == (pictures.policies is None) or not names:
        raise ValueError(
            "give either --policy with one name, or --policies with several. Example: --policies fl,trajopt"
        )
    import_pygame()
    episodes = []
    for policy in loaded_policies(names, robot, episode.wrappers):
        rollout = record_rollout(policy, env_id, progress=True, **keywords)
        episodes.append((f"{policy.name} on {place}", rollout))
    return episodes
