"""``cablebot watch``."""

from __future__ import annotations

from cablebot_gym.cli.options import (
    EnvId,
    Frequency,
    Known,
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
    payload_known: Known = True,
    uncertainty: UncertaintyName = None,
    control_frequency: Frequency = 500.0,
    seed: Seed = 0,
) -> None:
    """An episode in a window, again and again: cables by tension, motors against their limits, errors against bounds.

    Space stops and goes on, the arrows go a picture back or on, r starts again, q or Esc ends. Needs the extra: pip
    install 'cablebot-gym[render]'.

    Example: cablebot watch CableBot-Spatial-v0 --policy tube --payload 7
    """
    from cablebot_gym.rendering.window import NoDisplayError
    from cablebot_gym.video.recording import check_speed, play

    each = picture_size(size)
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
    try:
        play(films, speed=speed, size=each)
    except NoDisplayError as error:
        instead = f"cablebot video {env_id} film.gif with the same options"
        raise ValueError(f"no display to open a window on: write a film instead, {instead}") from error
