"""Heavier payloads step by step, as the heavy ones are carried."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.wrappers.layers import CURRICULUM, Many, Single, SingleStep, check_number, restarted
from cablebot_gym.envs.streams import Purpose, Streams
from cablebot_gym.envs.vector import VectorStep

HEAVY = 2 / 3
"""Share of the ceiling from which a payload counts for raising it."""


class _Ceiling:
    """How heavy payloads may be by now."""

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
        self._success, self._lately = float(success), deque[bool](maxlen=int(window))
        self.value = self._lowest

    def drawn(self, uniform: Array) -> Array:
        """Payloads [kg] for numbers in [0, 1)."""
        payload: Array = self.value * uniform**self._power
        return payload

    def count(self, payload: float, carried: bool) -> None:
        """Raises the ceiling if enough of the last heavy payloads were carried, and lowers it if too few were."""
        lately = self._lately
        if not payload >= HEAVY * self.value:  # NaN is not
            return
        lately.append(carried)
        if len(lately) < (lately.maxlen or 0):
            return
        share, step = sum(lately) / len(lately), self._step * self._heaviest
        moved = self.value + step if share >= self._success else self.value - step if share < self._setback else None
        if moved is not None:
            self.value = min(max(moved, self._lowest), self._heaviest)
            lately.clear()


class _Payloads:
    """Payloads of N lanes: seeded, drawn at each reset, counted once at each end."""

    def __init__(self, count: int, ceiling: _Ceiling) -> None:
        self.ceiling = ceiling
        self._streams = Streams(count)
        self._payload = np.full(count, np.nan)
        self._running = np.zeros(count, np.bool_)
        self._everyone = np.arange(count)
        self._begun = False

    def drawn(self, seeds: Sequence[Any], lanes: NDArray[np.int64]) -> Array:
        """Moves ``lanes`` on to their next episodes and draws for them, (N,) [kg]; 0 for the others.

        Seeds that no environment takes are left for it to refuse; afterwards :meth:`restore` takes all back.
        """
        streams, whole = self._streams, (int, np.integer)
        if not self._begun:
            entropy = np.random.SeedSequence().generate_state(len(self._everyone), np.uint64)
            streams.seed(self._everyone.tolist(), entropy.tolist())
        sane = {lane: int(seeds[lane]) for lane in lanes[lanes < len(seeds)].tolist() if isinstance(seeds[lane], whole)}
        sane = {lane: seed for lane, seed in sane.items() if seed >= 0}
        streams.seed(list(sane), list(sane.values()))
        streams.begin(lanes)
        payload = np.zeros(len(self._everyone))
        payload[lanes] = self.ceiling.drawn(streams.uniform(lanes, Purpose.PAYLOAD, 1)[:, 0])
        return payload

    def standing(self) -> Any:
        """Where the streams stand, for :meth:`restore`."""
        return self._streams.standing()

    def restore(self, standing: Any) -> None:
        """Puts the streams back to where they stood."""
        self._streams.restore(standing)

    def begin(self, lanes: NDArray[np.int64], payload: Array | None) -> None:
        """The episodes of ``lanes`` have begun; of payloads that were not drawn, None, nothing is learnt."""
        self._payload[lanes] = np.nan if payload is None else payload[lanes]
        self._running[lanes] = self._begun = True

    def count(self, terminated: NDArray[np.bool_], ended: NDArray[np.bool_]) -> None:
        """Counts the episodes that have just ended."""
        ended = ended & self._running
        if ended.any():
            self._running &= ~ended
            for lane in np.flatnonzero(ended).tolist():
                self.ceiling.count(float(self._payload[lane]), not terminated[lane])


class PayloadCurriculumVector(Many):
    """N :class:`PayloadCurriculum` under one ceiling; arguments and errors as there. Lane i is seeded ``seed + i``."""

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
        """The heaviest payload by now [kg]."""
        return self._payloads.ceiling.value

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts episodes with payloads drawn, unless ``options`` have one; what it refuses changes nothing.

        Raises:
            ValueError: if a seed or an option is not valid.
        """
        one, several = isinstance(seed, (int, np.integer)), isinstance(seed, (Sequence, np.ndarray))
        seeds = [seed + lane for lane in range(self.num_envs)] if one else list(seed) if several else []
        marked = restarted(options, self.num_envs)
        lanes = np.flatnonzero(marked) if marked.shape == (self.num_envs,) else np.arange(0)  # the other is refused
        before = self._payloads.standing()
        payload = self._payloads.drawn(seeds, lanes)
        given = "payload" in (options or {})
        try:
            result = self.env.reset(seed=seed, options=options if given else {**(options or {}), "payload": payload})
        except Exception:
            self._payloads.restore(before)
            raise
        self._payloads.begin(lanes, None if given else payload)
        return result

    def step(self, actions: ArrayLike, *, past_end: bool = False) -> VectorStep:
        """One control period; an episode counts when it first ends. ``past_end`` is :class:`CableBotVectorEnv`'s."""
        result: VectorStep = self.env.step(actions, past_end=past_end)
        self._payloads.count(result[2], result[2] | result[3])
        return result


class PayloadCurriculum(Single):
    """Draws the payload of each episode, and heavier ones as the heavy ones are carried.

    Each reset draws ``ceiling · U^power`` [kg], U uniform in [0, 1) from a stream of its own that ``reset(seed=…)``
    seeds, and passes it on as the option ``payload``; one that the caller gives counts instead, and for that episode
    only. The ceiling rises by ``step · heaviest`` when at least the share ``success`` of the last ``window`` episodes
    with payloads in the ceiling's upper third ended without terminating, and falls by as much, not below ``start``,
    where less than the share ``setback`` did; each move takes a window of its own.

    Args:
        env: a single environment of this package; within :class:`WithinLimits`, if that is used.
        heaviest: the last ceiling [kg]; > 0.
        power: below 1, heavy payloads are commoner; > 0.
        start: the first ceiling [kg]; None for ``heaviest``, a distribution that never changes.
        step: of the ceiling, as a share of ``heaviest``; in (0, 1].
        success: share that has to be carried, in [0, 1].
        window: number of episodes; ≥ 1.
        setback: share of successes below which the ceiling falls; 0 for never, at most ``success``.

    Raises:
        TypeError: if the environment is none of this package's.
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
        self._lane = np.zeros(1, np.int64)

    @property
    def ceiling(self) -> float:
        """The heaviest payload by now [kg]."""
        return self._payloads.ceiling.value

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode with a payload drawn, unless ``options`` have one; what it refuses changes nothing.

        Raises:
            ValueError: if the seed or an option is not valid.
        """
        before = self._payloads.standing()
        payload = self._payloads.drawn([seed], self._lane)
        given = "payload" in (options or {})
        asked = options if given else {**(options or {}), "payload": float(payload[0])}
        try:
            result = self.env.reset(seed=seed, options=asked)
        except Exception:
            self._payloads.restore(before)
            raise
        self._payloads.begin(self._lane, None if given else payload)
        return result

    def step(self, action: ArrayLike) -> SingleStep:
        """One control period; an episode counts when it first ends."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._payloads.count(np.array([terminated]), np.array([terminated or truncated]))
        return observation, float(reward), terminated, truncated, info
