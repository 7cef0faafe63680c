"""Payload curriculum: the largest payload increases as the policy succeeds with heavy payloads."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.wrappers.layers import (
    CURRICULUM,
    BatchWrapper,
    SingleStep,
    SingleWrapper,
    check_number,
    restart_mask,
)
from cablebot_gym.envs.streams import Purpose, Streams
from cablebot_gym.envs.vector import VectorStep

HEAVY = 2 / 3
"""Fraction of the ceiling above which a payload counts as heavy."""


class _Ceiling:
    """Largest payload of the curriculum at present."""

    def __init__(
        self,
        *,
        heaviest: float,
        power: float,
        start: float | None,
        step: float,
        success: float,
        window: int,
        setback: float,
    ) -> None:
        check_number("heaviest", heaviest, 0.0, above=True)
        check_number("power", power, 0.0, above=True)
        check_number("start", heaviest if start is None else start, 0.0, heaviest)
        check_number("step", step, 0.0, 1.0, above=True)
        check_number("success", success, 0.0, 1.0)
        if not isinstance(window, (int, np.integer)) or isinstance(window, bool) or window < 1:
            raise ValueError(f"window must be a whole number of episodes of at least 1, not {window!r}")
        check_number("setback", setback, 0.0, success)
        self._lowest = float(heaviest if start is None else start)
        self._setback = float(setback)
        self._heaviest, self._power, self._step = float(heaviest), float(power), float(step)
        self._success, self._recent = float(success), deque[bool](maxlen=int(window))
        self.value = self._lowest

    def payloads(self, uniform: Array) -> Array:
        """Payloads [kg] from uniform random numbers in [0, 1)."""
        payload: Array = self.value * uniform**self._power
        return payload

    def count(self, payload: float, succeeded: bool) -> None:
        """Counts an episode; raises the ceiling if enough recent heavy payloads succeeded, lowers it if too few did."""
        recent = self._recent
        if not payload >= HEAVY * self.value:  # also skips NaN
            return
        recent.append(succeeded)
        if len(recent) < (recent.maxlen or 0):
            return
        fraction, step = sum(recent) / len(recent), self._step * self._heaviest
        moved = (
            self.value + step if fraction >= self._success else self.value - step if fraction < self._setback else None
        )
        if moved is not None:
            self.value = min(max(moved, self._lowest), self._heaviest)
            recent.clear()


class _Payloads:
    """Payloads of N environments: drawn at each reset, counted once at the end of each episode."""

    def __init__(self, count: int, ceiling: _Ceiling) -> None:
        self.ceiling = ceiling
        self._streams = Streams(count)
        self._payload = np.full(count, np.nan)
        self._running = np.zeros(count, np.bool_)
        self._all_indices = np.arange(count)
        self._seeded = False

    def draw(self, seeds: Sequence[Any], env_indices: NDArray[np.int64]) -> Array:
        """Draws the payloads of the next episodes of ``env_indices``, (N,) [kg]; 0 for the other environments.

        Invalid seeds are ignored here; the environment rejects them, and :meth:`restore` then undoes the draw.
        """
        streams, whole = self._streams, (int, np.integer)
        if not self._seeded:
            entropy = np.random.SeedSequence().generate_state(len(self._all_indices), np.uint64)
            streams.seed(self._all_indices.tolist(), entropy.tolist())
        valid = {
            env_index: int(seeds[env_index])
            for env_index in env_indices[env_indices < len(seeds)].tolist()
            if isinstance(seeds[env_index], whole)
        }
        valid = {env_index: seed for env_index, seed in valid.items() if seed >= 0}
        streams.seed(list(valid), list(valid.values()))
        streams.start_episode(env_indices)
        payload = np.zeros(len(self._all_indices))
        payload[env_indices] = self.ceiling.payloads(streams.uniform(env_indices, Purpose.PAYLOAD, 1)[:, 0])
        return payload

    def state(self) -> Any:
        """State of the random streams, for :meth:`restore`."""
        return self._streams.state()

    def restore(self, state: Any) -> None:
        """Restores the state of the random streams."""
        self._streams.restore(state)

    def reset(self, env_indices: NDArray[np.int64], payload: Array | None) -> None:
        """Starts the episodes of ``env_indices``; if ``payload`` is None, they do not count for the curriculum."""
        self._payload[env_indices] = np.nan if payload is None else payload[env_indices]
        self._running[env_indices] = self._seeded = True

    def count(self, terminated: NDArray[np.bool_], ended: NDArray[np.bool_]) -> None:
        """Counts the episodes that have just ended."""
        ended = ended & self._running
        if ended.any():
            self._running &= ~ended
            for env_index in np.flatnonzero(ended).tolist():
                self.ceiling.count(float(self._payload[env_index]), not terminated[env_index])


class PayloadCurriculumVector(BatchWrapper):
    """Vector form of :class:`PayloadCurriculum` for N environments with one common ceiling.

    Arguments and errors are the same. Environment i is seeded with ``seed + i``.
    """

    level: ClassVar[int] = CURRICULUM

    def __init__(
        self,
        env: VectorEnv[Array, ArrayLike, Array],
        *,
        heaviest: float,
        power: float = 0.6,
        start: float | None = None,
        step: float = 0.05,
        success: float = 0.8,
        window: int = 64,
        setback: float = 0.0,
    ) -> None:
        super().__init__(env)
        ceiling = _Ceiling(
            heaviest=heaviest, power=power, start=start, step=step, success=success, window=window, setback=setback
        )
        self._payloads = _Payloads(self.num_envs, ceiling)

    @property
    def ceiling(self) -> float:
        """Largest payload at present [kg]."""
        return self._payloads.ceiling.value

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts episodes with drawn payloads, unless ``options`` contains a payload. An invalid call has no effect.

        Raises:
            ValueError: if a seed or an option is invalid.
        """
        one, several = isinstance(seed, (int, np.integer)), isinstance(seed, (Sequence, np.ndarray))
        seeds = [seed + env_index for env_index in range(self.num_envs)] if one else list(seed) if several else []
        marked = restart_mask(options, self.num_envs)
        env_indices = (
            np.flatnonzero(marked) if marked.shape == (self.num_envs,) else np.arange(0)
        )  # the environment rejects a mask of another shape
        before = self._payloads.state()
        payload = self._payloads.draw(seeds, env_indices)
        given = "payload" in (options or {})
        try:
            result = self.env.reset(seed=seed, options=options if given else {**(options or {}), "payload": payload})
        except Exception:
            self._payloads.restore(before)
            raise
        self._payloads.reset(env_indices, None if given else payload)
        return result

    def step(self, actions: ArrayLike, *, past_end: bool = False) -> VectorStep:
        """One control period; an episode counts when it first ends. ``past_end`` as in :class:`CableBotVectorEnv`."""
        result: VectorStep = self.env.step(actions, past_end=past_end)
        self._payloads.count(result[2], result[2] | result[3])
        return result


class PayloadCurriculum(SingleWrapper):
    """Draws the payload of each episode; the largest payload (ceiling) follows the success rate.

    Each reset draws ``ceiling · U^power`` [kg], with U uniform in [0, 1) from a separate stream that ``reset(seed=…)``
    seeds, and passes it on as the option ``payload``. A payload in the caller's options replaces the draw for that
    episode.

    An episode is heavy if its payload is in the upper third of the ceiling; it succeeds if it ends without
    terminating. If at least the fraction ``success`` of the last ``window`` heavy episodes succeeds, the ceiling rises
    by ``step · heaviest``. If less than the fraction ``setback`` succeeds, it falls by the same amount, but not below
    ``start``. After each change a new window begins.

    Args:
        env: single environment of this package, wrapped in :class:`WithinLimits` if that is used.
        heaviest: largest ceiling [kg]; > 0.
        power: exponent; below 1, heavy payloads are more frequent; > 0.
        start: initial ceiling [kg]; None for ``heaviest``, which makes the distribution constant.
        step: change of the ceiling as a fraction of ``heaviest``; in (0, 1].
        success: fraction of successes that raises the ceiling, in [0, 1].
        window: number of episodes; ≥ 1.
        setback: fraction of successes below which the ceiling falls; at most ``success``; 0 for never.

    Raises:
        TypeError: if the environment is not one of this package.
        ValueError: if an argument is out of its range, or the environment is already steered.
    """

    level: ClassVar[int] = CURRICULUM
    vector: ClassVar[type[PayloadCurriculumVector]] = PayloadCurriculumVector

    def __init__(
        self,
        env: gym.Env[Array, ArrayLike],
        *,
        heaviest: float,
        power: float = 0.6,
        start: float | None = None,
        step: float = 0.05,
        success: float = 0.8,
        window: int = 64,
        setback: float = 0.0,
    ) -> None:
        rule: dict[str, Any] = {"heaviest": heaviest, "power": power, "start": start, "step": step}
        rule |= {"success": success, "window": window, "setback": setback}
        super().__init__(env, **rule)
        self._payloads = _Payloads(1, _Ceiling(**rule))
        self._env_index = np.zeros(1, np.int64)

    @property
    def ceiling(self) -> float:
        """Largest payload at present [kg]."""
        return self._payloads.ceiling.value

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode with a drawn payload, unless ``options`` contains a payload. An invalid call has no effect.

        Raises:
            ValueError: if the seed or an option is invalid.
        """
        before = self._payloads.state()
        payload = self._payloads.draw([seed], self._env_index)
        given = "payload" in (options or {})
        options = options if given else {**(options or {}), "payload": float(payload[0])}
        try:
            result = self.env.reset(seed=seed, options=options)
        except Exception:
            self._payloads.restore(before)
            raise
        self._payloads.reset(self._env_index, None if given else payload)
        return result

    def step(self, action: ArrayLike) -> SingleStep:
        """One control period; an episode counts when it first ends."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._payloads.count(np.array([terminated]), np.array([terminated or truncated]))
        return observation, float(reward), terminated, truncated, info
