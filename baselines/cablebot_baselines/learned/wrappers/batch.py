"""N wrapped environments as one batch."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
from gymnasium.vector import AutoresetMode

import cablebot_gym  # noqa: F401 - registers the ids
from cablebot_baselines.learned.wrappers.curriculum import PayloadCurriculum
from cablebot_baselines.learned.wrappers.limits import WithinLimits
from cablebot_baselines.learned.wrappers.steered import Steered, SteeredVector

_NAMES = ", ".join(wrapper.__name__ for wrapper in (WithinLimits, PayloadCurriculum, Steered))


def make_steered_vec(
    env_id: str,
    n_envs: int,
    *,
    wrappers: Sequence[tuple[type[Any], Mapping[str, Any]]],
    seed: int | None = None,
    **keywords: Any,
) -> SteeredVector:
    """Makes N environments of one id as one compiled batch, with the vector forms of the given wrappers.

    Stable-Baselines3 trains on ``CableBotVecEnv(make_steered_vec(…))``.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        n_envs: number of environments N.
        wrappers: wrapper classes and their arguments, innermost first; the last one is :class:`Steered`.
        seed: environment i is reset with ``seed + i``, and the action space is seeded; later resets continue the
            random streams.
        keywords: keyword arguments of the environment, see ``help(gym.make(env_id).unwrapped)``, and
            ``max_episode_steps``.

    Raises:
        gymnasium.error.Error: if the id is unknown.
        ValueError: if the last wrapper is not :class:`Steered`, the order is wrong, a wrapper has no vector form, or an
            argument is unknown, missing or invalid.
    """
    for wrapper, arguments in wrappers:
        _check_arguments(wrapper, arguments)
    if not wrappers or wrappers[-1][0] is not Steered:
        names = ", ".join(wrapper.__name__ for wrapper, _ in wrappers) or "empty"
        raise ValueError(f"the last (outermost) wrapper must be Steered, but wrappers is {names}")
    env: Any = gym.make_vec(env_id, num_envs=n_envs, autoreset_mode=AutoresetMode.DISABLED, **keywords)
    try:
        for wrapper, arguments in wrappers:
            env = wrapper.vector(env, **arguments)
        if seed is not None:
            env.reset(seed=seed)
            env.action_space.seed(seed)
    except BaseException:
        env.close()
        raise
    steered: SteeredVector = env
    return steered


def _check_arguments(wrapper: type[Any], arguments: Mapping[str, Any]) -> None:
    """Checks that a wrapper has a vector form and that its arguments are known and complete.

    Raises:
        ValueError: if not; the message names the valid ones.
    """
    name = getattr(wrapper, "__name__", repr(wrapper))
    if not hasattr(wrapper, "vector"):
        raise ValueError(f"wrappers: {name} has no vector form (attribute 'vector'); choose from {_NAMES}")
    known = {key: value for key, value in inspect.signature(wrapper).parameters.items() if key != "env"}
    if unknown := [key for key in arguments if key not in known]:
        raise ValueError(f"wrappers: {name} has no argument {unknown[0]!r}; it takes {', '.join(known)}")
    if missing := [key for key, value in known.items() if value.default is value.empty and key not in arguments]:
        raise ValueError(f"wrappers: {name} requires {', '.join(missing)}")
