"""Time that a policy needs for its actions."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from cablebot_gym.evaluation.batch import Batch, EpisodeSpec
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.compiling import compiled_at_once
from cablebot_gym.policies.protocol import Policy, reset_policy
from cablebot_gym.task import Task
from cablebot_gym.utils.checks import number

WARM_UP = 10
"""Number of first actions that belong to the start: libraries load and code is compiled there."""


class TimedPolicy:
    """A policy whose actions are timed. The clock is that of this process.

    Args:
        policy: the policy.
    """

    def __init__(self, policy: Policy) -> None:
        self._policy = policy
        self.times: list[float] = []
        """Times of the actions of the present episode [s]."""
        self.reset_time = 0.0
        """Time of the last reset [s]."""
        if hasattr(policy, "wrap"):
            self.wrap = policy.wrap

    def reset(self, tasks: tuple[Task, ...]) -> None:
        """Resets the policy."""
        self.times = []
        start = time.perf_counter()
        reset_policy(self._policy, "", lambda: tasks)
        self.reset_time = time.perf_counter() - start

    def predict(self, *arguments: Any, **keywords: Any) -> tuple[Array, Any]:
        """Action of the policy."""
        start = time.perf_counter()
        result = self._policy.predict(*arguments, **keywords)
        self.times.append(time.perf_counter() - start)
        return result


@dataclass(frozen=True, kw_only=True)
class ActionTimes:
    """Wall time of the actions of one episode, one observation at a time. It depends on the
    machine."""

    median: float
    """Median time of an action [s]."""
    p99: float
    """99 % quantile [s]."""
    missed: float
    """Fraction of the actions that take longer than the control period."""
    start: float
    """Time of the reset and of the first :data:`WARM_UP` actions together, in which policies plan or
    compile code [s]. The other values are those of the later actions."""
    period: float
    """Control period [s]."""


def time_actions(
    policy: Any, env_id: str, *, payload: float = 0.0, **conditions: Any
) -> ActionTimes:
    """Measures the time of each action in one episode over the full motion, also after a violation.

    Args:
        policy: an object with ``predict``, a callable, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        payload: nominal payload [kg].
        conditions: ``seed``, ``robot`` and keywords of the environment, see
            :class:`~cablebot_gym.evaluation.conditions.Conditions`.

    Raises:
        ValueError: if an argument is invalid, or if the environment terminates the episode within
            the first :data:`WARM_UP` actions.
        cablebot_gym.policies.protocol.PolicyError: if the policy raises or returns anything but
            finite actions.
    """
    with compiled_at_once():
        batch = Batch(policy, Conditions.of(env_id, time_actions, draws=1, **conditions))
        timed = TimedPolicy(batch.policy.policy)
        batch.policy = replace(batch.policy, policy=timed)
        payload = number("payload", payload, least=0, unit="kg")
        batch.run([EpisodeSpec(payload, batch.conditions.seed)], full_motion=True)
    times = np.array(timed.times[WARM_UP:])
    period = 1 / batch.task.control_frequency
    if not times.size:
        raise ValueError(
            f"the episode ends after {len(timed.times)} actions: choose a payload that the policy carries"
        )
    median, p99 = np.quantile(times, [0.5, 0.99]).tolist()
    start = timed.reset_time + sum(timed.times[:WARM_UP])
    return ActionTimes(
        median=median, p99=p99, missed=float((times > period).mean()), start=start, period=period
    )
