"""Policies made of functions, factories, sequences of actions, and policies behind wrappers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from cablebot_gym.policies.protocol import (
    Array,
    Policy,
    PolicyError,
    declarations,
    name_of,
    reset_policy,
    to_floats,
)
from cablebot_gym.policies.wrappers import PolicyEnv, Stack
from cablebot_gym.task import Task
from cablebot_gym.utils.user_code import raised


def as_policy(policy: Any) -> Policy:
    """Returns a policy unchanged, and a callable ``observation -> action`` as a policy.

    Raises:
        TypeError: if the object is neither a policy nor a callable.
    """
    if isinstance(policy, type):
        raise TypeError(
            f"a policy must be an object, not the class {policy.__name__}: pass {policy.__name__}(…)"
        )
    if isinstance(policy, Policy):
        return policy
    if callable(policy):
        return CallablePolicy(policy)
    raise TypeError(
        f"a policy must have predict() or be a callable observation -> action; {type(policy).__name__} is neither"
    )


class CallablePolicy:
    """A policy made from a function ``observation -> action``, which is called for one observation
    at a time.

    All episodes of a batch share the function, so it must not remember anything from one call to
    the next. Use :class:`PolicyFactory` for a callable with state.
    """

    def __init__(self, function: Callable[[Array], Any]) -> None:
        self._function = function
        self.unsaturated_actions, self.stochastic, self.measurement = declarations(function)
        if hasattr(function, "reset"):
            self.reset = function.reset

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Action of the function for each observation.

        Raises:
            PolicyError: if the function raises, or if its results are not numbers of one shape.
        """
        if observation.ndim == 1:
            return np.asarray(self._function(observation), float), state
        return _stacked(observation, lambda _, row: self._function(row)), state


class PolicyFactory:
    """A policy that makes one instance for each episode of a batch, for controllers that keep their
    own state.

    ``PolicyFactory(MyController)`` calls ``MyController()`` for every episode. An instance gets the
    observations of its episode alone, so the result does not depend on the other episodes.

    Args:
        factory: function without arguments that returns a policy or a callable ``observation ->
            action``. It is called once at the construction to read the declarations of the policy.
    """

    def __init__(self, factory: Callable[[], Any]) -> None:
        self.name = name_of(factory)
        self._factory = factory
        self.unsaturated_actions, self.stochastic, self.measurement = declarations(self._make())
        self._instances: list[Policy] = []

    def _make(self) -> Policy:
        return as_policy(self._factory())

    def reset(self, tasks: Sequence[Task]) -> None:
        """Makes an instance for each task and resets it."""
        self._instances = [self._make() for _ in tasks]
        for instance, task in zip(self._instances, tasks, strict=True):
            reset_policy(instance, self.name, partial(tuple, [task]))  # (task,)

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Action of each episode's instance; the state is the list of the states of the instances.

        Raises:
            PolicyError: if an instance raises, or if the actions are not numbers of one shape.
        """
        rows = np.atleast_2d(observation)
        if len(rows) != len(self._instances):
            self._instances = [self._make() for _ in rows]
        states = [None] * len(rows)
        if state is not None:
            states = list(state)
        starts = np.zeros(len(rows), np.bool_)
        if episode_start is not None:
            starts = np.atleast_1d(episode_start)

        def act(index: int, row: Array) -> Any:
            start = starts[index : index + 1]
            actions, states[index] = self._instances[index].predict(
                row[None], states[index], start, deterministic
            )
            return np.asarray(actions)[0]

        actions = _stacked(rows, act)
        if observation.ndim < 2:
            actions = actions[0]
        return actions, states


def _stacked(observation: Array, act: Callable[[int, Array], Any]) -> Array:
    """Actions that ``act`` returns for the index and the row of each observation, (N, m).

    Raises:
        PolicyError: if the function raises, or if its results are not numbers of one shape.
    """
    actions: list[Array] = []
    for index, row in enumerate(observation):
        try:
            action = to_floats(act(index, row))
        except KeyboardInterrupt:
            raise
        except PolicyError as error:  # of an instance, whose batch has one observation
            raise PolicyError(error.cause, index=index) from error.__cause__
        except BaseException as error:
            raise PolicyError(raised(error, "it failed with"), index=index) from error
        actions.append(action)
        if action.shape != actions[0].shape:
            cause = f"it returned shape {action.shape} after {actions[0].shape}"
            raise PolicyError(cause, index=index)
    return np.stack(actions)


class OpenLoop:
    """A policy that returns given actions one after the other.

    Args:
        actions: action of every control step, (steps, m).
    """

    def __init__(self, actions: Array) -> None:
        self._actions = actions

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """The next action for each observation; the state is the number of past steps."""
        step = state or 0
        action = self._actions[step]
        return np.broadcast_to(action, (*observation.shape[:-1], len(action))), step + 1


class TransformedPolicy:
    """A policy that reads functions of the observation, such as the normalised one.

    Args:
        policy: the policy.
        stack: wrappers whose transforms are these functions.
        wrappers: names of the wrappers.
    """

    def __init__(self, policy: Policy, stack: Stack, wrappers: tuple[str, ...] = ()) -> None:
        self.policy = policy
        self.stack = stack
        self.wrappers = wrappers
        self.unsaturated_actions, self.stochastic, _ = declarations(policy)

    @property
    def fallbacks(self) -> Any:
        """The fallbacks of the policy.

        Raises:
            AttributeError: if it does not count them.
        """
        return self.policy.fallbacks  # type: ignore[attr-defined]

    def reset(self, tasks: Sequence[Task]) -> None:
        """Resets the policy."""
        reset_policy(self.policy, "", lambda: tuple(tasks))

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Actions and the state to pass next time."""
        for transform in self.stack.transforms:
            observation = transform.function(observation)
        return self.policy.predict(observation, state, episode_start, deterministic)


class WrappedPolicy(TransformedPolicy):
    """A policy that acts in a wrapped environment, which :meth:`wrap` makes.

    Its arguments are those of :class:`TransformedPolicy`, with all wrappers in the stack.
    """

    is_in_env = False
    """Whether an environment has been wrapped."""

    @property
    def alone(self) -> bool:
        """Whether each episode runs alone, because a wrapper wraps a single environment."""
        return self.stack.alone

    def wrap(self, env: PolicyEnv) -> Any:
        """An environment in new wrappers of the policy."""
        self.is_in_env = True
        return self.stack.wrap(env)

    def predict(self, observation: Any, *arguments: Any, **keywords: Any) -> tuple[Array, Any]:
        """Actions for the wrappers, and the state to pass next time. The observation is that of the
        wrapped environment.

        Raises:
            RuntimeError: before the first :meth:`wrap`.
        """
        if not self.is_in_env:
            raise RuntimeError(
                f"a policy behind {', '.join(self.wrappers)} reads wrapped observations: pass it "
                "to an evaluation, such as evaluate_dlcc, which wraps the environment"
            )
        return super().predict(observation, *arguments, **keywords)
