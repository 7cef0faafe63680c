"""Base class of the wrappers for training, and the layers of a wrapped environment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.laws.law import Array
from cablebot_gym.envs.vector import CableBotVectorEnv

if TYPE_CHECKING:
    _Wrapper = VectorWrapper[Array, ArrayLike, Array, ArrayLike, Array]
else:  # Gymnasium's class is generic from 1.4 on
    _Wrapper = VectorWrapper


def layers(env: Any) -> Iterator[Any]:
    """A vector environment and the environments that it wraps, from the outside in."""
    while isinstance(env, VectorWrapper):
        yield env
        env = env.env
    yield env


class TrainingWrapper(_Wrapper):
    """Wrapper of N environments of this package with autoreset disabled.

    Raises:
        ValueError: if the environment is not such a one, or is already steered.
    """

    env: Any

    def __init__(self, env: VectorEnv[Array, ArrayLike, Array]) -> None:
        name = type(self).__name__
        base_env: Any = getattr(env, "unwrapped", None)
        is_ours = isinstance(base_env, CableBotVectorEnv)
        if not is_ours or base_env.autoreset_mode is not AutoresetMode.DISABLED:
            raise ValueError(
                f"{name} needs an environment of this package from gym.make_vec(…, "
                f"autoreset_mode=AutoresetMode.DISABLED), not {env!r}"
            )
        if any(hasattr(layer, "steering") for layer in layers(env)):
            raise ValueError(
                f"{name} is outside a wrapper that must be outside it: Steered must be outermost"
            )
        super().__init__(env)
        self._base_env: CableBotVectorEnv = base_env


def restart_mask(options: Mapping[str, Any] | None, count: int) -> NDArray[np.bool_]:
    """Mask of the environments that a reset with these options resets; all of them if its shape is
    invalid."""
    mask = np.array((options or {}).get("reset_mask"), np.bool_)
    if mask.shape != (count,):
        return np.ones(count, np.bool_)
    return mask
