"""``cablebot watch``."""

from __future__ import annotations

from cablebot_gym.cli.options import (
    ConditionOptions,
    FittingEnvId,
    Payload,
    PolicyNames,
    command_again,
    fitting_id,
)
from cablebot_gym.cli.video import Speed, record_episodes
from cablebot_gym.video import SPEED


def watch(
    *,
    env_id: FittingEnvId = None,
    policy: PolicyNames,
    conditions: ConditionOptions,
    payload: Payload = None,
    speed: Speed = SPEED,
) -> None:
    """Show an episode in a window, in a loop.

    Colours show the cable tensions. Bars show the motor torques against their limits and the errors
    against their bounds. Keys: Space pauses and resumes, the arrow keys step by one frame, r
    restarts, q or Esc closes the window. Requires the extra: pip install 'cablebot-gym[render]'.

    Example: cablebot watch CableBot-Spatial-v0 --policy trajopt --payload 7
    """
    from cablebot_gym.rendering.window import NoDisplayError
    from cablebot_gym.video.recording import check_speed, play

    env_id = fitting_id(env_id, conditions.robot)
    check_speed(speed)
    episodes = record_episodes(env_id, policy, payload, conditions)
    try:
        play(episodes, speed=speed)
    except NoDisplayError as error:
        alternative = command_again(
            "video",
            env_id,
            "video.gif",
            conditions=conditions,
            policy=policy,
            payload=payload,
            speed=None if speed == SPEED else speed,
        )
        raise ValueError(
            f"there is no display for a window. Write a video instead: {alternative}"
        ) from error
