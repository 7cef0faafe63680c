"""What all wrappers share: where they may stand, and checks of what they are given."""

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
"""Levels of wrappers: each goes around lower ones or its own, but nothing around :data:`STEERED`."""

SingleStep = tuple[Array, float, bool, bool, dict[str, Any]]


class Single(gym.Wrapper[Array, ArrayLike, Array, ArrayLike], RecordConstructorArgs):
    """Around a single environment of this package; ``arguments`` are those of the vector twin.

    Raises:
        TypeError: if the environment is none.
        ValueError: if the wrappers beneath are in the wrong order.
    """

    level: ClassVar[int]
    """Where among the others it stands."""

    env: gym.Env[Array, ArrayLike]

    def __init__(self, env: gym.Env[Array, ArrayLike], **arguments: Any) -> None:
        RecordConstructorArgs.__init__(self, **arguments)
        if not isinstance(env, gym.Env) or not isinstance(env.unwrapped, CableBotEnv):
            raise TypeError(f"{type(self).__name__} needs an environment of this package, from gym.make, not {env!r}")
        gym.Wrapper.__init__(self, env)
        _check_order(self)
        self._plant: CableBotEnv = env.unwrapped


class Many(VectorWrapper[Array, ArrayLike, Array, ArrayLike, Array]):
    """Around N environments of this package, which do not restart on their own.

    Raises:
        TypeError: if the environment is no :class:`CableBotVectorEnv`.
        ValueError: if it has another autoreset mode, or the wrappers beneath are in the wrong order.
    """

    level: ClassVar[int]
    """Where among the others it stands."""

    env: Any

    def __init__(self, env: VectorEnv[Array, ArrayLike, Array]) -> None:
        name = type(self).__name__
        if not isinstance(env, VectorEnv) or not isinstance(env.unwrapped, CableBotVectorEnv):
            raise TypeError(f"{name} needs N environments of this package as one batch, from gym.make_vec, not {env!r}")
        super().__init__(env)
        _check_order(self)
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.DISABLED:
            raise ValueError(
                f"{name} needs environments that do not restart on their own, not {getattr(mode, 'name', mode)}: "
                "make them by gym.make_vec(…, autoreset_mode=AutoresetMode.DISABLED), or all by make_steered_vec"
            )
        self._plant: CableBotVectorEnv = env.unwrapped


def _levels(env: Any) -> Iterator[int]:
    """Of an environment and its wrappers, from the outside in; wrappers of others have none."""
    while isinstance(env, (gym.Wrapper, VectorWrapper)):
        if isinstance(env, (Single, Many)):
            yield env.level
        env = env.env


def _check_order(wrapper: Single | Many) -> None:
    """Refuses what a wrapper cannot stand around.

    Raises:
        ValueError: naming the right order.
    """
    highest = max(_levels(wrapper.env), default=LIMITS)
    if highest == STEERED:
        why = "has to see every control period"
    elif highest > wrapper.level:
        why = "ends episodes of which PayloadCurriculum has to hear"
    else:
        return
    raise ValueError(
        f"{type(wrapper).__name__} {why}: "
        "the order is WithinLimits, PayloadCurriculum, Steered, the first one innermost"
    )


def restarted(options: Mapping[str, Any] | None, count: int) -> NDArray[np.bool_]:
    """The environments that a reset with these options has restarted."""
    mask = (options or {}).get("reset_mask")
    return np.ones(count, np.bool_) if mask is None else np.array(mask, np.bool_)


def check_number(name: str, value: Any, low: float, high: float = math.inf, *, above: bool = False) -> None:
    """Refuses a value that is no finite number from ``low`` to ``high``, or, ``above``, beyond the lower one.

    Raises:
        ValueError: naming the bounds.
    """
    if not is_number(value) or not low <= value <= high or (above and value == low):
        least = f"greater than {low:g}" if above else f"of at least {low:g}"
        most = f" and at most {high:g}" if high < math.inf else ""
        raise ValueError(f"{name} must be a number {least}{most}, not {value!r}")
