"""The policy protocol, the entry of an installed policy, and checks of the actions that a policy returns."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.measurement import POSE
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.utils.user_code import raised

Array = NDArray[Any]


@runtime_checkable
class Policy(Protocol):
    """An object with the method ``predict`` of Stable-Baselines3, for one observation (size,) or a batch (N, size).

    Optional members:

    * ``reset(tasks)`` is called before the first step of a batch with one :class:`~cablebot_gym.task.Task` for each
      observation. A ``reset`` that takes no tasks is called without arguments.
    * ``unsaturated_actions = True`` declares that the policy returns actions beyond ±1 where it requests more torque
      than the motors have. The paper criterion applies to such policies only.
    * ``stochastic = True`` declares that equal observations may give different actions, also with ``deterministic``.
      Other policies must give equal episodes when they are repeated, in any order of the batch.
    * ``measurement = "winches"`` declares that the policy reads the sensors of winches, in an environment with this
      kind of :class:`~cablebot_gym.measurement.Measurement`. Other policies read pose and velocity.
    """

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Actions (m,) or (N, m), and the state to pass to the next call."""


@dataclass(frozen=True, kw_only=True)
class PolicyEntry:
    """An installed policy, as ``cablebot list`` shows it."""

    name: str
    """Name on the command line."""
    kind: Literal["classical", "optimal", "learned"]
    """Kind of design method."""
    env_ids: tuple[str, ...]
    """Ids of the environments that the policy supports."""
    factory: Callable[[Robot], Policy]
    """Function that makes the policy from a nominal robot."""
    summary: str
    """Description in one line."""
    slow: bool = False
    """Whether an evaluation takes minutes. Most benchmark suites skip slow policies."""
    unsaturated_actions: bool = False
    """Whether a test of this project holds the policy to its declaration ``unsaturated_actions``. The paper criterion
    marks the results of other policies as declared, also of policies of other packages."""
    files: tuple[Path, ...] | None = None
    """Data files that the policy reads, such as weights. Benchmark results depend on their content. None stands for all
    files in the folder of the policy's module."""


class PolicyError(RuntimeError):
    """A policy raised an exception, returned invalid actions, or ended or blocked its process.

    Args:
        message: the whole sentence, with the name of the policy.
        cause: the cause alone, to which a caller adds the name, the payload and the time.
        index: index of the observation in the batch, from 0; None for the whole batch.
    """

    def __init__(self, message: str, *, cause: str | None = None, index: int | None = None) -> None:
        super().__init__(message)
        self.cause, self.index = cause or message, index

    @classmethod
    def of(cls, name: str, cause: str, index: int | None = None) -> PolicyError:
        """The error of a policy with a name."""
        return cls(f"policy {name!r}: {cause}", cause=cause, index=index)


class BatchItemError(RuntimeError):
    """A function failed for one observation of a batch. The message gives the reason."""

    def __init__(self, index: int, message: str) -> None:
        super().__init__(message)
        self.index = index
        """Index of the observation in the batch, from 0."""


class CallablePolicy:
    """A policy made from a function ``observation -> action``, which is called for one observation at a time.

    All episodes of a batch share the function, so it must not remember anything from one call to the next. Use
    :class:`PolicyFactory` for a callable with state.
    """

    def __init__(self, function: Callable[[Array], Any]) -> None:
        self._function = function
        self.unsaturated_actions, self.stochastic = declarations(function)
        self.measurement = measured_kind(function)
        if hasattr(function, "reset"):
            self.reset = function.reset

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Action of the function for each observation.

        Raises:
            BatchItemError: if the function raises, or if its results are not numbers of one shape.
        """
        if observation.ndim == 1:
            return np.asarray(self._function(observation), float), state
        return _stacked(observation, lambda _, item: self._function(item)), state


class PolicyFactory:
    """A policy that makes one instance for each episode of a batch, for controllers that keep their own state.

    ``PolicyFactory(MyController)`` calls ``MyController()`` for every episode. An instance gets the observations of
    its episode alone, so the result does not depend on the other episodes.

    Args:
        factory: function without arguments that returns a policy or a callable ``observation -> action``. It is called
            once at the construction to read the declarations of the policy.
    """

    def __init__(self, factory: Callable[[], Any]) -> None:
        self._factory = factory
        self.name = name_of(factory)
        if isinstance(factory, type) and (missing := required(factory)):
            raise TypeError(
                f"PolicyFactory calls {self.name}(), which needs {', '.join(missing)}: "
                f"PolicyFactory(lambda: {self.name}({', '.join(missing)}))"
            )
        made = self._made()
        self.unsaturated_actions, self.stochastic = declarations(made)
        self.measurement = measured_kind(made)
        self._instances: list[Policy] = []

    def _made(self) -> Policy:
        return as_policy(self._factory())

    def reset(self, tasks: Sequence[Task]) -> None:
        """Makes an instance for each task and resets it."""
        self._instances = [self._made() for _ in tasks]
        for instance, task in zip(self._instances, tasks, strict=True):
            reset_policy(instance, self.name, partial(tuple, [task]))

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Action of each episode's instance; the state is the list of the states of the instances.

        Raises:
            BatchItemError: if an instance raises, or if the actions are not numbers of one shape.
        """
        rows = np.atleast_2d(observation)
        if len(rows) != len(self._instances):
            self._instances = [self._made() for _ in rows]
        states = [None] * len(rows) if state is None else list(state)
        starts = np.zeros(len(rows), np.bool_) if episode_start is None else np.atleast_1d(episode_start)

        def act(index: int, item: Array) -> Any:
            start = starts[index : index + 1]
            actions, states[index] = self._instances[index].predict(item[None], states[index], start, deterministic)
            return np.asarray(actions)[0]

        actions = _stacked(rows, act)
        return actions if observation.ndim > 1 else actions[0], states


def required(factory: type) -> list[str]:
    """Names of the arguments that a class needs."""
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    parameters = inspect.signature(factory).parameters.values()
    return [one.name for one in parameters if one.kind in positional and one.default is one.empty]


def declarations(policy: Any) -> tuple[bool, bool]:
    """Whether a policy declares ``unsaturated_actions``, and whether it declares ``stochastic``."""
    return bool(getattr(policy, "unsaturated_actions", False)), bool(getattr(policy, "stochastic", False))


def measured_kind(policy: Any) -> str:
    """Kind of measurement that a policy reads: ``pose``, unless it declares another one."""
    return str(getattr(policy, "measurement", POSE.kind))


def _stacked(observation: Array, act: Callable[[int, Array], Any]) -> Array:
    """Actions of a function of index and observation, (N, m).

    Raises:
        BatchItemError: if the function raises, or if its results are not numbers of one shape.
    """
    actions: list[Array] = []
    for index, item in enumerate(observation):
        try:
            actions.append(to_floats(act(index, item)))
        except KeyboardInterrupt:
            raise
        except BatchItemError as error:
            raise BatchItemError(index, str(error)) from error.__cause__
        except BaseException as error:
            raise BatchItemError(index, raised(error, "it failed with")) from error
        if actions[index].shape != actions[0].shape:
            raise BatchItemError(index, f"it returned shape {actions[index].shape} after {actions[0].shape}")
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
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """The next action for each observation; the state is the number of past steps."""
        step = state or 0
        action = self._actions[step]
        return np.broadcast_to(action, (*observation.shape[:-1], len(action))), step + 1


def as_policy(policy: Any) -> Policy:
    """Returns a policy unchanged, and wraps a callable as a policy.

    Raises:
        TypeError: if the object is neither a policy nor a callable.
    """
    if isinstance(policy, type):
        raise TypeError(f"a policy must be an object, not the class {policy.__name__}: pass {policy.__name__}(…)")
    if isinstance(policy, Policy):
        return policy
    if callable(policy):
        return CallablePolicy(policy)
    raise TypeError(
        f"a policy must have predict() or be a callable observation -> action; {type(policy).__name__} is neither"
    )


def checked_actions(
    policy: Policy,
    name: str,
    observation: Array,
    state: Any,
    start: NDArray[np.bool_],
    *,
    cables: int,
    payloads: Array,
    time: float,
    ignored: NDArray[np.bool_] | None = None,
) -> tuple[Array, Any]:
    """Calls a policy for a batch of observations and checks its actions.

    Args:
        policy: the policy, called with ``deterministic=True``.
        name: name of the policy, for messages.
        observation: observations, (N, size).
        state: state that the previous call returned; None at the first call.
        start: True at the first step of an episode, (N,).
        cables: number of cables m.
        payloads: true payload of each episode, (N,) [kg], for messages.
        time: time of the control instant [s], for messages.
        ignored: True for episodes whose actions no longer matter, (N,). Their actions are set to 0.

    Returns:
        Actions (N, m) and the next state of the policy.

    Raises:
        PolicyError: if the policy raises anything but a KeyboardInterrupt, or if its actions are not numbers of shape
            (N, m) that the environment accepts.
    """
    from cablebot_gym.envs.outcome import LARGEST  # slow to import; the environment has imported it

    def failure(cause: str, of: Array = payloads) -> PolicyError:
        least, largest = f"{of.min():g}", f"{of.max():g}"
        loads = f"a payload of {least} kg" if least == largest else f"payloads of {least} to {largest} kg"
        return PolicyError(f"policy {name!r}, at t = {time:.3f} s with {loads}: {cause}")

    try:
        action, state = predicted(policy, observation.copy(), state, start.copy(), cables)
    except PolicyError as error:
        of = payloads if error.index is None or not 0 <= error.index < len(payloads) else payloads[[error.index]]
        raise failure(error.cause, of) from error.__cause__
    if ignored is not None:
        action[ignored] = 0.0
    if (wrong := ~np.isfinite(action).all(axis=1)).any():
        raise failure("it returned NaN or infinity", payloads[wrong].min(keepdims=True))
    if (wrong := np.abs(action).max(axis=1) >= LARGEST).any():
        largest = f"the action {action.flat[np.abs(action).argmax()]:g}; actions must be within ± {LARGEST:g}"
        raise failure(f"it returned {largest}", payloads[wrong].min(keepdims=True))
    return action, state


def predicted(policy: Policy, observation: Array, state: Any, start: Array, cables: int) -> tuple[Array, Any]:
    """Actions (N, m) of a policy as floats, which may be NaN or infinite, and its next state.

    Raises:
        PolicyError: if the policy raises anything but a KeyboardInterrupt, or if its actions are not numbers of shape
            (N, m). The message lacks the name of the policy.
    """
    try:
        returned = policy.predict(observation, state=state, episode_start=start, deterministic=True)
    except (KeyboardInterrupt, PolicyError):
        raise
    except BatchItemError as error:
        raise PolicyError(str(error), index=error.index) from error.__cause__
    except BaseException as error:
        raise PolicyError(raised(error)) from error
    if not isinstance(returned, tuple) or len(returned) != 2:
        raise PolicyError(f"predict() must return (actions, state), not {type(returned).__name__}")
    raw, state = returned
    try:
        action = to_floats(raw)
    except ValueError as error:
        raise PolicyError(f"it returned {error}") from error
    if action.shape != (expected := (len(observation), cables)):
        raise PolicyError(f"it returned shape {action.shape}; expected {expected}")
    return action, state


def reset_policy(policy: Policy, name: str, tasks: Callable[[], tuple[Task, ...]]) -> None:
    """Calls the optional ``reset`` of a policy. Passes the tasks if it takes any, see :class:`Policy`.

    Args:
        policy: the policy.
        name: name of the policy, for messages.
        tasks: function that makes one task for each observation of the batch.

    Raises:
        PolicyError: if ``reset`` raises anything but a KeyboardInterrupt.
    """
    if (method := getattr(policy, "reset", None)) is None:
        return
    arguments = [tasks()] if _takes_tasks(method) else []
    try:
        method(*arguments)
    except (KeyboardInterrupt, PolicyError):
        raise
    except BaseException as error:
        raise PolicyError.of(name, raised(error, where=" in reset()")) from error


def _takes_tasks(method: Callable[..., Any]) -> bool:
    """Whether a method has a parameter ``tasks`` or a required positional one."""
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return any(
        parameter.name == "tasks" or (parameter.default is parameter.empty and parameter.kind in positional)
        for parameter in inspect.signature(method).parameters.values()
    )


def to_floats(returned: Any) -> Array:
    """Copies actions to an array of floats.

    Raises:
        ValueError: if the actions are not real numbers. The message names their type.
    """
    try:
        values = np.asarray(returned)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # rows of different lengths, a tensor with gradients
        cause = raised(error, "its conversion raised")
        raise ValueError(f"{type(returned).__name__} instead of real numbers: {cause}") from error
    if values.dtype.kind not in "biuf":
        raise ValueError(f"{type(returned).__name__} of type {values.dtype} instead of real numbers")
    return values.astype(float)


def name_of(policy: Any) -> str:
    """Name of a policy in results and messages: a string itself, its ``name``, or the name of its function or class."""
    if isinstance(policy, str):
        return policy
    return str(getattr(policy, "name", None) or getattr(policy, "__name__", None) or type(policy).__name__)
