"""N environments as one batch within the wrappers."""

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

_NAMES = ", ".join(made.__name__ for made in (WithinLimits, PayloadCurriculum, Steered))


def make_steered_vec(
    env_id: str,
    n_envs: int,
    *,
    wrappers: Sequence[tuple[type[Any], Mapping[str, Any]]],
    seed: int | None = None,
    **keywords: Any,
) -> SteeredVector:
    """N environments of one id as one compiled batch, within the twins of single wrappers.

    ``CableBotVecEnv(make_steered_vec(…))`` is what Stable-Baselines3 trains on.

    Args:
        env_id: out of :data:`cablebot_gym.ENV_IDS`.
        n_envs: N.
        wrappers: classes and their arguments, the first one innermost, the last one :class:`Steered`.
        seed: environment i is reset with ``seed + i``, and the action space is seeded; later resets go on from there.
        keywords: the environment's, see ``help(gym.make(env_id).unwrapped)``, and ``max_episode_steps``.

    Raises:
        gymnasium.error.Error: if the id is unknown.
        ValueError: if the last wrapper is not :class:`Steered`, their order is wrong, one of them has no twin, or an
            argument is unknown, missing or not valid.
    """
    for made, arguments in wrappers:
        _check_arguments(made, arguments)
    if not wrappers or wrappers[-1][0] is not Steered:
        names = ", ".join(made.__name__ for made, _ in wrappers) or "nothing"
        raise ValueError(f"the last of wrappers, the outermost, must be Steered: there is {names}")
    env: Any = gym.make_vec(env_id, num_envs=n_envs, autoreset_mode=AutoresetMode.DISABLED, **keywords)
    try:
        for made, arguments in wrappers:
            env = made.vector(env, **arguments)
        if seed is not None:
            env.reset(seed=seed)
            env.action_space.seed(seed)
    except BaseException:
        env.close()
        raise
    steered: SteeredVector = env
    return steered


def _check_arguments(made: type[Any], arguments: Mapping[str, Any]) -> None:
    """Refuses wrappers without a twin, and arguments that they do not have, or lack.

    Raises:
        ValueError: naming those there are.
    """
    name = getattr(made, "__name__", repr(made))
    if not hasattr(made, "vector"):
        raise ValueError(f"wrappers: {name} has no twin for batches, an attribute 'vector'; there are {_NAMES}")
    known = {key: value for key, value in inspect.signature(made).parameters.items() if key != "env"}
    if unknown := [key for key in arguments if key not in known]:
        raise ValueError(f"wrappers: {name} has no argument {unknown[0]!r}; it takes {', '.join(known)}")
    if missing := [key for key, value in known.items() if value.default is value.empty and key not in arguments]:
        raise ValueError(f"wrappers: {name} needs {', '.join(missing)} too")
