"""``cablebot watch``."""

from __future__ import annotations

from cablebot_gym.cli.options import (
    EnvId,
    Frequency,
    PayloadKnown,
    PolicyNameOrNone,
    Seed,
    TrajectoryName,
    UncertaintyName,
    as_data,
)
from cablebot_gym.cli.video import Payload, Policies, Size, Speed, picture_size, policy_names, record_videos
from cablebot_gym.video import SPEED


def watch(
    env_id: EnvId,
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
    """Show an episode in a window, in a loop.

    Colours show the cable tensions. Bars show the motor torques against their limits and the errors against their
    bounds. Keys: Space pauses and resumes, the arrow keys step by one frame, r restarts, q or Esc closes the window.
    Requires the extra: pip install 'cablebot-gym[render]'.

    Example: cablebot watch CableBot-Spatial-v0 --policy trajopt --payload 7
    """
    from cablebot_gym.rendering.window import NoDisplayError
    from cablebot_gym.video.recording import check_speed, play

    frame_size = picture_size(size)
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
    try:
        play(videos, speed=speed, size=frame_size)
    except NoDisplayError as error:
        alternative = f"cablebot video {env_id} video.gif"
        raise ValueError(
            f"there is no display for a window. Write a video instead, with the same options: {alternative}"
        ) from error
