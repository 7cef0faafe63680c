"""A policy in the process of the tests, in place of one in a process of its own."""

from cablebot_gym.policies import load_policy
from cablebot_gym.policies.protocol import declarations


class InlinePolicy:
    """Has what the cells of a benchmark use of an
    :class:`~cablebot_gym.isolation.isolated.IsolatedPolicy`."""

    def __init__(self, spec, robot):
        self._policy = load_policy(spec, robot)
        self.unsaturated_actions, self.stochastic, _ = declarations(self._policy)

    def __getattr__(self, name):
        return getattr(self._policy, name)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass
