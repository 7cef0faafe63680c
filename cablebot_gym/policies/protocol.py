"""The policy protocol, the entry of an installed policy, and checks of the actions that a policy returns."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from traceback import extract_tb
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.robots import Robot
from cablebot_gym.task import Task

Array = NDArray[Any]


@runtime_checkable
class Policy(Protocol):
    """An object with the method ``predict`` of Stable-Baselines3, for one observation (size,) or a batch (N, size).

    Optional members:

    * ``reset(tasks)`` is called before the first step of a batch with one :class:`~cablebot_gym.task.Task` for each
      observation. A ``reset`` that takes no tasks is called without arguments.
    * ``unsaturated_actions = True`` declares that the policy returns actions beyond ±1 where it requests more torque
      than the motors have. The paper criterion applies to such policies only.
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
    files: tuple[Path, ...] | None = None
    """Data files that the policy reads, such as weights. Benchmark results depend on their content. None stands for all
    files in the folder of the policy's module."""


class PolicyError(RuntimeError):
    """A policy raised an exception or returned an invalid action. The message names the payload and the time."""


class BatchItemError(RuntimeError):
    """A function failed for one observation of a batch. The message gives the reason."""

    def __init__(self, index: int, message: str) -> None:
        super().__init__(message)
        self.index = index
        """Index of the observation in the batch, from 0."""


class CallablePolicy:
    """A policy made from a function ``observation -> action``, which is called for one observation at a time."""

    def __init__(self, function: Callable[[Array], Any]) -> None:
        self._function = function
        self.unsaturated_actions = bool(getattr(function, "unsaturated_actions", False))
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
        actions: list[Array] = []
        for index, item in enumerate(observation):
            try:
                actions.append(_to_floats(self._function(item)))
            except Exception as error:
                raise BatchItemError(
                    index, f"it failed with {type(error).__name__}: {error}{code_line(error)}"
                ) from error
            if actions[index].shape != actions[0].shape:
                raise BatchItemError(index, f"it returned shape {actions[index].shape} after {actions[0].shape}")
        return np.stack(actions), state


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
        PolicyError: if the policy raises, or if its actions are not finite numbers of shape (N, m).
    """

    def failure(cause: str, of: Array = payloads) -> PolicyError:
        least, largest = f"{of.min():g}", f"{of.max():g}"
        loads = f"a payload of {least} kg" if least == largest else f"payloads of {least} to {largest} kg"
        return PolicyError(f"policy {name!r}, at t = {time:.3f} s with {loads}: {cause}")

    try:
        returned = policy.predict(observation, state=state, episode_start=start, deterministic=True)
    except BatchItemError as error:
        raise failure(str(error), payloads[[error.index]]) from error.__cause__
    except Exception as error:
        raise failure(f"it raised {type(error).__name__}: {error}{code_line(error)}") from error
    if not isinstance(returned, tuple) or len(returned) != 2:
        raise failure(f"predict() must return (actions, state), not {type(returned).__name__}")
    raw, state = returned
    try:
        action = _to_floats(raw)
    except ValueError as error:
        raise failure(f"it returned {error}") from error
    if action.shape != (len(payloads), cables):
        raise failure(f"it returned shape {action.shape}; expected {(len(payloads), cables)}")
    if ignored is not None:
        action[ignored] = 0.0
    if not np.isfinite(action).all():
        raise failure("it returned NaN or infinity", payloads[~np.isfinite(action).all(axis=1)][:1])
    return action, state


def reset_policy(policy: Policy, name: str, tasks: Callable[[], tuple[Task, ...]]) -> None:
    """Calls the optional ``reset`` of a policy. Passes the tasks if it takes any, see :class:`Policy`.

    Args:
        policy: the policy.
        name: name of the policy, for messages.
        tasks: function that makes one task for each observation of the batch.

    Raises:
        PolicyError: if ``reset`` raises.
    """
    if (method := getattr(policy, "reset", None)) is None:
        return
    arguments = [tasks()] if _takes_tasks(method) else []
    try:
        method(*arguments)
    except Exception as error:
        cause = f"it raised {type(error).__name__} in reset(): {error}{code_line(error)}"
        raise PolicyError(f"policy {name!r}: {cause}") from error


def _takes_tasks(method: Callable[..., Any]) -> bool:
    """Whether a method has a parameter ``tasks`` or a required positional one."""
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return any(
        parameter.name == "tasks" or (parameter.default is parameter.empty and parameter.kind in positional)
        for parameter in inspect.signature(method).parameters.values()
    )


def _to_floats(returned: Any) -> Array:
    """Copies actions to an array of floats.

    Raises:
        ValueError: if the actions are not real numbers. The message names their type.
    """
    try:
        values = np.asarray(returned)
    except Exception as error:  # rows of different lengths, a tensor with gradients
        raise ValueError(f"{type(returned).__name__} instead of real numbers: {error}") from error
    if values.dtype.kind not in "biuf":
        raise ValueError(f"{type(returned).__name__} of type {values.dtype} instead of real numbers")
    return values.astype(float)


def code_line(error: BaseException) -> str:
    """File and line in the user's code that raised an error, for messages without a traceback."""
    frames = [
        frame
        for frame in extract_tb(error.__traceback__)
        if frame.filename != __file__ and "site-packages" not in frame.filename
    ]
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""


def name_of(policy: Any) -> str:
    """Name of a policy in results and messages: a string itself, its ``name``, or the name of its function or class."""
    if isinstance(policy, str):
        return policy
    return str(getattr(policy, "name", None) or getattr(policy, "__name__", None) or type(policy).__name__)
