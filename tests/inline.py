"""A policy in the process of the tests, in place of one in a process of its own."""

from __future__ import annotations

from typing import Any

from cablebot_gym.policies import PolicyFactory, RealTime, load_policy
from cablebot_gym.policies.protocol import declarations
from cablebot_gym.robots import Robot


class InlinePolicy:
    """Has what the cells of a benchmark use of an
    :class:`~cablebot_gym.isolation.isolated.IsolatedPolicy`."""

    def __init__(self, spec: str, robot: Robot, *, real_time: float | None = None) -> None:
        self._policy = load_policy(spec, robot)
        if real_time is not None:
            self._policy = PolicyFactory(lambda: RealTime(load_policy(spec, robot), real_time))
        self.unsaturated_actions, self.stochastic, _ = declarations(self._policy)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._policy, name)

    def __enter__(self) -> InlinePolicy:
        return self

    def __exit__(self, *error: object) -> None:
        pass
