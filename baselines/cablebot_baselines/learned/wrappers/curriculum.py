"""Payload curriculum: the payloads become heavier as the policy succeeds with heavy payloads."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import ArrayLike

from cablebot_baselines.laws.law import Array
from cablebot_baselines.learned.wrappers.layers import TrainingWrapper, restart_mask
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


class PayloadCurriculum(TrainingWrapper):
    """Draws the payload of each episode up to a ceiling, which all N environments share and which
    rises and falls with the success rate.

    Each reset draws the payload ``ceiling · U^power`` [kg] and passes it to the environment as the
    option ``payload``. U is uniform in [0, 1), from a stream of the wrapper that ``reset(seed=…)``
    seeds with ``seed + i`` for environment i. A payload in the caller's options is used instead,
    and these episodes do not count.

    An episode is heavy if its payload is at least two thirds of the ceiling
    (:data:`HEAVY_FRACTION`). It succeeds if the motion ends and no limit was violated;
    ``info["is_success"]``, shape (N,), is true then. The last ``window`` heavy episodes decide
    about the ceiling:

    * If the fraction of successes is at least ``success``, the ceiling rises by ``step · heaviest``
      to at most ``heaviest``.
    * If it is less than ``setback``, the ceiling falls by the same amount to at least ``start``.

    After each of these decisions a new window begins.

    Args:
        env: vector environment of this package with autoreset disabled.
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
        ValueError: if the environment is not such a one, if an argument is out of its range, or if
            the environment contains the wrapper
            :class:`~cablebot_baselines.learned.wrappers.steered.Steered`, which must be outermost.
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
        # Environments that never get a seed draw different payloads in every run.
        entropy = np.random.SeedSequence().generate_state(self.num_envs, np.uint64)
        self._streams.seed(np.arange(self.num_envs), entropy.tolist())
        # Payloads of the present episodes, (N,) [kg]; NaN: the episode does not count, or has.
        self._payload = np.full(self.num_envs, np.nan)

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
            ValueError: if the seed is neither None nor an integer ≥ 0, or an option is invalid.
        """
        restarted = restart_mask(options, self.num_envs)
        env_indices = np.flatnonzero(restarted)
        streams_before = self._streams.state()
        if seed is not None:
            first_seed = whole("seed", seed)
            self._streams.seed(env_indices, (first_seed + env_indices).tolist())
        self._streams.start_episode(env_indices)
        payload = np.zeros(self.num_envs)
        uniform = self._streams.uniform(env_indices, Purpose.PAYLOAD, 1)[:, 0]
        payload[env_indices] = self.ceiling * uniform**self._power
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
        return observation, info

    def step(self, actions: ArrayLike) -> VectorStep:
        """Advances all environments by one control period. An episode counts once, also if it is
        stepped on after its end."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        succeeded = truncated & ~terminated & ~info["violated"]
        ended = terminated | truncated
        for env_index in np.flatnonzero(ended).tolist():
            self._count(self._payload[env_index], bool(succeeded[env_index]))
        self._payload[ended] = np.nan
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
