"""Late actions: a policy whose actions count only if they are computed in time."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from cablebot_gym.policies.protocol import Array, as_policy, measured_kind, name_of, reset_policy
from cablebot_gym.task import Task

WARM_UP = 10
"""Number of first actions that do not count: libraries load and code is compiled there."""


class RealTime:
    """A policy for one episode whose late actions are replaced by the last one, as a real-time controller would.

    ``PolicyFactory(lambda: RealTime(make_policy(), period))`` times the actions of each episode one by one. The times
    differ between runs, so the policy is stochastic. The clock is that of the policy's process, which can change it:
    the times hold for honest policies only.

    Args:
        policy: a policy or a callable ``observation -> action``.
        period: control period [s]; infinite if no action is late.
    """

    stochastic = True

    def __init__(self, policy: Any, period: float) -> None:
        self._policy, self._period = as_policy(policy), period
        self.name = name_of(policy)
        self.unsaturated_actions = bool(getattr(self._policy, "unsaturated_actions", False))
        self.measurement = measured_kind(self._policy)
        self.times: list[float] = []
        """Times of the actions of the present episode [s]."""
        self.reset_time = 0.0
        """Time of the last reset [s]."""
        self._last: Array = np.zeros(0)

    def reset(self, tasks: tuple[Task, ...]) -> None:
        """Resets the policy."""
        self.times = []
        start = time.perf_counter()
        reset_policy(self._policy, self.name, lambda: tasks)
        self.reset_time = time.perf_counter() - start

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Action of the policy, or its last one if it is late. The first :data:`WARM_UP` actions are never late."""
        start = time.perf_counter()
        action, state = self._policy.predict(observation, state, episode_start, deterministic)
        self.times.append(time.perf_counter() - start)
        if len(self.times) <= WARM_UP or self.times[-1] <= self._period:
            self._last = action
        return self._last, state
