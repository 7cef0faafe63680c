"""Base classes of the wrappers, the check of their order, and checks of arguments."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.base import is_number
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.envs.vector import CableBotVectorEnv

LIMITS, CURRICULUM, STEERED = range(3)
"""Levels of the wrappers: a wrapper may wrap lower levels and its own level; :data:`STEERED` is always outermost."""

SingleStep = tuple[Array, float, bool, bool, dict[str, Any]]


class SingleWrapper(gym.Wrapper[Array, ArrayLike, Array, ArrayLike], RecordConstructorArgs):
    """Wrapper of a single environment of this package; ``arguments`` are those of the vector form.

    Raises:
        TypeError: if the environment is not one of this package.
        ValueError: if the order of the wrappers is wrong.
    """

    level: ClassVar[int]
    """Level in the order of the wrappers."""

    env: gym.Env[Array, ArrayLike]

    def __init__(self, env: gym.Env[Array, ArrayLike], **arguments: Any) -> None:
        RecordConstructorArgs.__init__(self, **arguments)
        if not isinstance(env, gym.Env) or not isinstance(env.unwrapped, CableBotEnv):
            raise TypeError(f"{type(self).__name__} needs an environment of this package, from gym.make, not {env!r}")
        gym.Wrapper.__init__(self, env)
        _check_order(self)
        self._plant: CableBotEnv = env.unwrapped


class BatchWrapper(VectorWrapper[Array, ArrayLike, Array, ArrayLike, Array]):
    """Wrapper of N environments of this package with autoreset disabled.

    Raises:
        TypeError: if the environment is not a :class:`CableBotVectorEnv`.
        ValueError: if it has another autoreset mode, or the order of the wrappers is wrong.
    """

    level: ClassVar[int]
    """Level in the order of the wrappers."""

    env: Any

    def __init__(self, env: VectorEnv[Array, ArrayLike, Array]) -> None:
        name = type(self).__name__
        if not isinstance(env, VectorEnv) or not isinstance(env.unwrapped, CableBotVectorEnv):
            raise TypeError(f"{name} needs a vector environment of this package, from gym.make_vec, not {env!r}")
        super().__init__(env)
        _check_order(self)
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.DISABLED:
            raise ValueError(
                f"{name} needs autoreset mode DISABLED, not {getattr(mode, 'name', mode)}: use "
                "gym.make_vec(…, autoreset_mode=AutoresetMode.DISABLED), or make_steered_vec"
            )
        self._plant: CableBotVectorEnv = env.unwrapped


def _levels(env: Any) -> Iterator[int]:
    """Levels of an environment's wrappers from the outside in; wrappers of other packages are skipped."""
    while isinstance(env, (gym.Wrapper, VectorWrapper)):
        if isinstance(env, (SingleWrapper, BatchWrapper)):
            yield env.level
        env = env.env


def _check_order(wrapper: SingleWrapper | BatchWrapper) -> None:
    """Checks the order of the wrappers.

    Raises:
        ValueError: if it is wrong; the message names the right order.
    """
    highest = max(_levels(wrapper.env), default=LIMITS)
    if highest == STEERED:
        reason = "must be inside Steered to process every control period"
    elif highest > wrapper.level:
        reason = "must be inside PayloadCurriculum, which counts the episodes that it ends"
    else:
        return
    order = "WithinLimits (innermost), PayloadCurriculum, Steered (outermost)"
    raise ValueError(f"{type(wrapper).__name__} {reason}. The order is {order}")


def restart_mask(options: Mapping[str, Any] | None, count: int) -> NDArray[np.bool_]:
    """Mask of the environments that a reset with these options resets."""
    mask = (options or {}).get("reset_mask")
    return np.ones(count, np.bool_) if mask is None else np.array(mask, np.bool_)


def check_number(name: str, value: Any, low: float, high: float = math.inf, *, above: bool = False) -> None:
    """Checks that a value is a finite number from ``low`` to ``high``; with ``above``, ``low`` itself is invalid.

    Raises:
        ValueError: if not; the message names the bounds.
    """
    if not is_number(value) or not low <= value <= high or (above and value == low):
        least = f"greater than {low:g}" if above else f"of at least {low:g}"
        most = f" and at most {high:g}" if high < math.inf else ""
        raise ValueError(f"{name} must be a number {least}{most}, not {value!r}")
