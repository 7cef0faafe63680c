"""``cablebot watch``."""

from __future__ import annotations

from typing import Any

from cablebot_gym.cli.options import (
    FittingEnvId,
    Payload,
    PolicyNameOrNone,
    command_again,
    episode_options,
)
from cablebot_gym.cli.video import Policies, Size, Speed, picture_size, record_episodes
from cablebot_gym.video import SPEED


@episode_options()
def watch(
    env_id: FittingEnvId,
    episode: dict[str, Any],
    policy: PolicyNameOrNone = None,
    policies: Policies = None,
    payload: Payload = None,
    speed: Speed = SPEED,
    size: Size = None,
) -> None:
    """Show an episode in a window, in a loop.

    Colours show the cable tensions. Bars show the motor torques against their limits and the errors
    against their bounds. Keys: Space pauses and resumes, the arrow keys step by one frame, r
    restarts, q or Esc closes the window. Requires the extra: pip install 'cablebot-gym[render]'.

    Example: cablebot watch CableBot-Spatial-v0 --policy trajopt --payload 7
    """
    from cablebot_gym.rendering.window import NoDisplayError
    from cablebot_gym.video.recording import check_speed, play

    frame_size = picture_size(size)
    check_speed(speed)
    episodes = record_episodes(env_id, policy, policies, payload=payload, episode=episode)
    try:
        play(episodes, speed=speed, size=frame_size)
    except NoDisplayError as error:
        given = {"policy": policy, "policies": policies, "payload": payload, "size": size}
        given |= {} if speed == SPEED else {"speed": speed}
        alternative = command_again("video", env_id, "video.gif", episode=episode, **given)
        raise ValueError(
            f"there is no display for a window. Write a video instead: {alternative}"
        ) from error
