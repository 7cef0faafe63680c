"""Payload curriculum: the largest payload increases as the policy succeeds with heavy payloads."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from numbers import Integral
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.wrappers.layers import BatchWrapper, SingleWrapper, restart_mask
from cablebot_gym.bounds.robot_check import SAMPLES, payload_limit
from cablebot_gym.envs.streams import Purpose, Streams
from cablebot_gym.envs.vector import VectorStep
from cablebot_gym.utils.checks import number, whole

HEAVY = 2 / 3
"""Fraction of the ceiling above which a payload counts as heavy."""

EXACT_MULTIPLE = 4.0
"""Default of ``heaviest``, as a multiple of the largest payload with which the motors can follow
the motion exactly. The error bounds allow several times that payload."""


class PayloadCurriculumVector(BatchWrapper):
    """Vector form of :class:`PayloadCurriculum` for N environments with one common ceiling.

    Arguments and errors are the same. Environment i is seeded with ``seed + i``.
    """

    def __init__(
        self,
        env: VectorEnv[Array, ArrayLike, Array],
        *,
        heaviest: float | None = None,
        power: float = 0.6,
        start: float | None = None,
        step: float = 0.05,
        success: float = 0.8,
        window: int = 64,
        setback: float = 0.0,
    ) -> None:
        super().__init__(env)
        if heaviest is None:
            exact = self._exact_payload()
            heaviest = EXACT_MULTIPLE * exact
            if start is None:
                start = exact
        self._heaviest = number("heaviest", heaviest, above=0.0, unit="kg")
        self._power = number("power", power, above=0.0)
        if start is None:
            start = self._heaviest
        self._lowest = number("start", start, least=0.0, most=self._heaviest, unit="kg")
        self._step = number("step", step, above=0.0, most=1.0) * self._heaviest
        self._success = number("success", success, least=0.0, most=1.0)
        self._setback = number("setback", setback, least=0.0, most=self._success)
        self._window = whole("window", window, least=1)
        self._recent = deque[bool](maxlen=self._window)
        self.ceiling = self._lowest
        """Largest payload at present [kg]."""
        self._streams = Streams(self.num_envs)
        self._started = False
        self._payload = np.full(self.num_envs, np.nan)
        self._running = np.zeros(self.num_envs, np.bool_)

    def _exact_payload(self) -> float:
        """Largest payload with which the motors can follow the motion exactly [kg].

        Raises:
            ValueError: if they cannot follow it with any payload.
        """
        settings = self._plant.settings
        times = np.linspace(0.0, settings.trajectory.duration, SAMPLES)
        exact = payload_limit(
            settings.robot, times, settings.trajectory(times), payload=0.0
        ).largest
        if not exact > 0.0:
            raise ValueError(
                f"heaviest must be given in kg: the motors of robot {settings.robot.name!r} cannot follow the motion "
                "exactly, so it has no default"
            )
        return exact

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts episodes with drawn payloads, unless ``options`` contains a payload. An invalid
        call has no effect.

        Raises:
            ValueError: if a seed or an option is invalid.
        """
        marked = restart_mask(options, self.num_envs)
        streams_before = self._streams.state()
        payload = self._draw(seed, marked)
        options = options or {}
        if "payload" in options:
            payload[:] = np.nan  # the episode does not count
        else:
            options = {**options, "payload": payload}
        try:
            observation, info = self.env.reset(seed=seed, options=options)
        except Exception:
            self._streams.restore(streams_before)
            raise
        self._payload[marked] = payload[marked]
        self._running[marked] = self._started = True
        return observation, info

    def _draw(self, seed: Any, marked: Array) -> Array:
        """Payloads of the next episodes of the marked environments, (N,) [kg]; 0 for the other
        environments.

        The environment rejects invalid seeds, which are ignored here.
        """
        env_indices = np.flatnonzero(marked)
        count = self.num_envs
        if not self._started:
            entropy = np.random.SeedSequence().generate_state(count, np.uint64)
            self._streams.seed(np.arange(count), entropy.tolist())
        if isinstance(seed, Integral):
            seed = range(int(seed), int(seed) + count)
        elif not isinstance(seed, (Sequence, np.ndarray)) or len(seed) != count:
            seed = [None] * count
        seeds: list[int | None] = []
        for env_index in env_indices:
            value = seed[env_index]
            is_valid = isinstance(value, Integral) and int(value) >= 0
            seeds.append(int(value) if is_valid else None)
        self._streams.seed(env_indices, seeds)
        self._streams.start_episode(env_indices)
        payload = np.zeros(count)
        uniform = self._streams.uniform(env_indices, Purpose.PAYLOAD, 1)[:, 0]
        payload[env_indices] = self.ceiling * uniform**self._power
        return payload

    def step(self, actions: ArrayLike) -> VectorStep:
        """One control period; an episode counts when it first ends. Then ``info["is_success"]``
        tells its success."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        succeeded = truncated & ~terminated & ~info["violated"]
        ended = (terminated | truncated) & self._running
        self._running &= ~ended
        for env_index in np.flatnonzero(ended).tolist():
            self._count(self._payload[env_index], bool(succeeded[env_index]))
        return observation, reward, terminated, truncated, info | {"is_success": succeeded}

    def _count(self, payload: float, succeeded: bool) -> None:
        """Counts an episode; raises the ceiling if enough recent heavy payloads succeeded, lowers
        it if too few did."""
        if not payload >= HEAVY * self.ceiling:  # also skips NaN
            return
        self._recent.append(succeeded)
        if len(self._recent) < self._window:
            return
        fraction = sum(self._recent) / self._window
        if fraction >= self._success:
            self.ceiling = min(self.ceiling + self._step, self._heaviest)
        elif fraction < self._setback:
            self.ceiling = max(self.ceiling - self._step, self._lowest)
        else:
            return
        self._recent.clear()


class PayloadCurriculum(SingleWrapper):
    """Draws the payload of each episode; the largest payload (ceiling) follows the success rate.

    Each reset draws ``ceiling · U^power`` [kg], with U uniform in [0, 1) from a separate stream
    that ``reset(seed=…)`` seeds, and passes it on as the option ``payload``. A payload in the
    caller's options replaces the draw for that episode.

    An episode is heavy if its payload is in the upper third of the ceiling. It succeeds if the
    motion ends without a violation of a limit; ``info["is_success"]`` is true then. If at least the
    fraction ``success`` of the last ``window`` heavy episodes succeeds, the ceiling rises by ``step
    · heaviest``. If less than the fraction ``setback`` succeeds, it falls by the same amount, but
    not below ``start``. After each change a new window begins.

    Args:
        env: single environment of this package.
        heaviest: largest ceiling [kg]; > 0. None for :data:`EXACT_MULTIPLE` times the largest
            payload with which the motors can follow the motion exactly, which then is the default
            of ``start``.
        power: exponent; below 1, heavy payloads are more frequent; > 0.
        start: initial ceiling [kg]; None for ``heaviest``, which makes the distribution constant.
        step: change of the ceiling as a fraction of ``heaviest``; in (0, 1].
        success: fraction of successes that raises the ceiling, in [0, 1].
        window: number of episodes; ≥ 1.
        setback: fraction of successes below which the ceiling falls; at most ``success``; 0 for
            never.

    Raises:
        TypeError: if the environment is not one of this package.
        ValueError: if an argument is out of its range, or the environment is already steered.
    """

    vector: ClassVar[type[Any]] = PayloadCurriculumVector

    @property
    def ceiling(self) -> float:
        """Largest payload at present [kg]."""
        return float(self.batch.ceiling)
