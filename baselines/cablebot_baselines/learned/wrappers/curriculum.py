"""Payload curriculum: the payloads become heavier as the policy succeeds with heavy payloads."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from numbers import Integral
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.laws.law import Array
from cablebot_baselines.learned.wrappers.layers import BatchWrapper, SingleWrapper, restart_mask
from cablebot_gym.bounds.robot_check import SAMPLES, payload_limit
from cablebot_gym.envs.streams import Purpose, Streams
from cablebot_gym.envs.vector import VectorStep
from cablebot_gym.utils.checks import number, whole

HEAVY_FRACTION = 2 / 3
"""Fraction of the ceiling from which on a payload counts as heavy."""

EXACT_MULTIPLE = 4.0
"""Default of ``heaviest`` divided by the largest payload with which the motors can follow the
motion exactly. A policy may deviate from the motion up to the error bounds and then carries several
times that payload."""


class PayloadCurriculumVector(BatchWrapper):
    """Vector form of :class:`PayloadCurriculum` for N environments with one common ceiling.

    Arguments and errors are the same. If ``reset(seed=…)`` gets one integer, environment i is
    seeded with ``seed + i``.
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
            default_start = self._exact_payload()
            heaviest = EXACT_MULTIPLE * default_start
        else:
            default_start = heaviest
        self._highest_ceiling = number("heaviest", heaviest, above=0.0, unit="kg")
        self._power = number("power", power, above=0.0)
        if start is None:
            start = default_start
        self._lowest_ceiling = number(
            "start", start, least=0.0, most=self._highest_ceiling, unit="kg"
        )
        step_fraction = number("step", step, above=0.0, most=1.0)
        self._ceiling_change = step_fraction * self._highest_ceiling  # [kg]
        self._raising_fraction = number("success", success, least=0.0, most=1.0)
        self._lowering_fraction = number("setback", setback, least=0.0, most=self._raising_fraction)
        self._window = whole("window", window, least=1)
        self._recent_successes = deque[bool](maxlen=self._window)
        self.ceiling = self._lowest_ceiling
        """Present ceiling: upper end of the drawn payloads [kg]."""
        self._streams = Streams(self.num_envs)
        self._was_reset = False
        # Payloads of the present episodes, (N,) [kg]; NaN: the episode does not count.
        self._payload = np.full(self.num_envs, np.nan)
        # Whether the present episode has started and not ended, (N,). Environments can be stepped on
        # after an end and then report it again; an episode counts once.
        self._running = np.zeros(self.num_envs, np.bool_)

    def _exact_payload(self) -> float:
        """Largest payload with which the motors can follow the motion exactly [kg].

        Raises:
            ValueError: if they cannot follow it with any payload above 0.
        """
        settings = self._base_env.settings
        times = np.linspace(0.0, settings.trajectory.duration, SAMPLES)
        # The payload 0 affects only which instant and reason are reported, not the largest payload.
        limit = payload_limit(settings.robot, times, settings.trajectory(times), payload=0.0)
        if limit.largest <= 0.0:
            raise ValueError(
                f"heaviest must be given in kg: the motors of robot {settings.robot.name!r} cannot follow the motion "
                "exactly with any payload, so there is no default for heaviest"
            )
        return limit.largest

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts episodes with drawn payloads, unless ``options`` contains a payload. An invalid
        call has no effect.

        Raises:
            ValueError: if a seed or an option is invalid.
        """
        restarted = restart_mask(options, self.num_envs)
        env_indices = np.flatnonzero(restarted)
        streams_before = self._streams.state()
        self._seed_streams(env_indices, seed)
        self._streams.start_episode(env_indices)
        payload = self._draw(env_indices)
        env_options = dict(options or {})
        if "payload" in env_options:
            payload[:] = np.nan  # the episode does not count
        else:
            env_options["payload"] = payload
        try:
            observation, info = self.env.reset(seed=seed, options=env_options)
        except Exception:
            self._streams.restore(streams_before)
            raise
        self._payload[restarted] = payload[restarted]
        self._running[restarted] = True
        self._was_reset = True
        return observation, info

    def _seed_streams(self, env_indices: NDArray[np.int64], seed: Any) -> None:
        """Seeds the streams of environments with the ``seed`` of :meth:`reset`.

        Invalid seeds are ignored here: the environment rejects them.
        """
        count = self.num_envs
        if not self._was_reset:
            # Environments that never get a seed draw different payloads in every run.
            entropy = np.random.SeedSequence().generate_state(count, np.uint64)
            self._streams.seed(np.arange(count), entropy.tolist())
        seeds: Any = [None] * count
        if isinstance(seed, Integral):
            seeds = range(int(seed), int(seed) + count)
        elif isinstance(seed, (Sequence, np.ndarray)) and len(seed) == count:
            seeds = seed
        for env_index in env_indices:
            env_seed = seeds[env_index]
            if isinstance(env_seed, Integral) and int(env_seed) >= 0:
                self._streams.seed(np.array([env_index]), [int(env_seed)])

    def _draw(self, env_indices: NDArray[np.int64]) -> Array:
        """Payloads of the present episodes of the environments ``env_indices``, (N,) [kg]; 0 for
        the other environments."""
        payload = np.zeros(self.num_envs)
        uniform = self._streams.uniform(env_indices, Purpose.PAYLOAD, 1)[:, 0]
        payload[env_indices] = self.ceiling * uniform**self._power
        return payload

    def step(self, actions: ArrayLike) -> VectorStep:
        """Advances all environments by one control period.

        ``info["is_success"]``, shape (N,), is true where an episode ends with success. Each episode
        counts once, also if it is stepped on after its end.
        """
        observation, reward, terminated, truncated, info = self.env.step(actions)
        succeeded = truncated & ~terminated & ~info["violated"]
        ended = (terminated | truncated) & self._running
        self._running &= ~ended
        for env_index in np.flatnonzero(ended).tolist():
            self._count(self._payload[env_index], bool(succeeded[env_index]))
        info = info | {"is_success": succeeded}
        return observation, reward, terminated, truncated, info

    def _count(self, payload: float, succeeded: bool) -> None:
        """Counts an episode if its payload [kg] is heavy. With a full window, many successes raise
        the ceiling and few lower it."""
        is_heavy = payload >= HEAVY_FRACTION * self.ceiling  # false for NaN
        if not is_heavy:
            return
        self._recent_successes.append(succeeded)
        if len(self._recent_successes) < self._window:
            return
        fraction = sum(self._recent_successes) / self._window
        if fraction >= self._raising_fraction:
            self.ceiling = min(self.ceiling + self._ceiling_change, self._highest_ceiling)
        elif fraction < self._lowering_fraction:
            self.ceiling = max(self.ceiling - self._ceiling_change, self._lowest_ceiling)
        else:
            return
        self._recent_successes.clear()  # the window begins anew after each decision


class PayloadCurriculum(SingleWrapper):
    """Draws the payload of each episode up to a ceiling, which rises and falls with the success
    rate.

    Each reset draws the payload ``ceiling · U^power`` [kg] and passes it to the environment as the
    option ``payload``. U is uniform in [0, 1), from a stream of the wrapper that ``reset(seed=…)``
    seeds. A payload in the caller's options is used instead, and this episode does not count.

    An episode is heavy if its payload is at least two thirds of the ceiling
    (:data:`HEAVY_FRACTION`). It succeeds if the motion ends and no limit was violated;
    ``info["is_success"]`` is true then. The last ``window`` heavy episodes decide about the
    ceiling:

    * If the fraction of successes is at least ``success``, the ceiling rises by ``step · heaviest``
      to at most ``heaviest``.
    * If it is less than ``setback``, the ceiling falls by the same amount to at least ``start``.

    After each of these decisions a new window begins.

    Args:
        env: single environment of this package.
        heaviest: highest ceiling [kg]; > 0. None: :data:`EXACT_MULTIPLE` times the largest payload
            with which the motors can follow the motion exactly.
        power: exponent; > 0. Below 1, heavy payloads are more frequent than light ones.
        start: initial and lowest ceiling [kg]; from 0 to ``heaviest``. None: ``heaviest``, so that
            the ceiling is constant. If ``heaviest`` is None, too: the largest payload with which
            the motors can follow the motion exactly.
        step: change of the ceiling as a fraction of ``heaviest``; in (0, 1].
        success: fraction of successes from which on the ceiling rises; in [0, 1].
        window: number of last heavy episodes that decide about the ceiling; ≥ 1.
        setback: fraction of successes below which the ceiling falls; from 0 (never) to ``success``.

    Raises:
        TypeError: if the environment is not one of this package.
        ValueError: if an argument is out of its range, or if the environment contains the wrapper
            :class:`~cablebot_baselines.learned.wrappers.steered.Steered`, which must be outermost.
    """

    vector: ClassVar[type[Any]] = PayloadCurriculumVector

    @property
    def ceiling(self) -> float:
        """Present ceiling: upper end of the drawn payloads [kg]."""
        return float(self.batch.ceiling)
