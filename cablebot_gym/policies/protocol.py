"""The protocol of a policy, a policy that is loaded, and checks of what it returns."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.measurement import POSE
from cablebot_gym.task import Task
from cablebot_gym.utils.user_code import raised

Array = NDArray[Any]


@runtime_checkable
class Policy(Protocol):
    """An object with the method ``predict`` of Stable-Baselines3, for one observation (size,) or a
    batch (N, size).

    Optional members:

    * ``reset(tasks)`` is called before the first step of a batch with one
      :class:`~cablebot_gym.task.Task` for each observation. A ``reset`` that takes no tasks is
      called without arguments.
    * ``unsaturated_actions = True`` declares that the policy returns actions beyond ±1 where it
      requests more torque than the motors have. The paper criterion applies to such policies only.
    * ``stochastic = True`` declares that equal observations may give different actions, also with
      ``deterministic``. Other policies must give equal episodes when they are repeated, in any
      order of the batch.
    * ``measurement = "winches"`` declares that the policy reads the sensors of winches, in an
      environment with this kind of :class:`~cablebot_gym.measurement.Measurement`. Other policies
      read pose and velocity.
    * ``wrap(env)`` returns the environment that the policy acts in, and has it reset: the
      :class:`~cablebot_gym.policies.wrappers.PolicyEnv` of a batch in the wrappers of the training.
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
    """Ids of the environments whose kinds of robots the policy supports. It is not loaded for robots
    of other kinds."""
    factory: Callable[..., Policy]
    """Function that makes the policy from a nominal robot. Its keyword-only parameters are options
    of the name."""
    summary: str
    """Description in one line."""
    unsaturated_actions: bool = False
    """Whether the policy declares ``unsaturated_actions``. A test holds the policies of this project
    to it; the paper criterion marks the results of others as declared."""
    known_robot: bool = False
    """Whether the policy is for a robot that is exactly known: it fails unloaded on some robots of
    ``hardware`` whose payload is unknown."""
    files: tuple[Path, ...] | None = None
    """Data files that the policy reads, such as weights. Benchmark results depend on their content.
    None stands for all files in the folder of the policy's module."""


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


class Declarations(NamedTuple):
    """What a policy declares about itself, see :class:`Policy`."""

    unsaturated_actions: bool
    """Whether it returns actions beyond ±1 where it requests more torque than the motors have."""
    stochastic: bool
    """Whether equal observations may give different actions."""
    measurement: str
    """Kind of measurement that it reads."""


def declarations(policy: Any) -> Declarations:
    """The declarations of a policy, with the defaults for those that it does not make."""
    return Declarations(
        unsaturated_actions=bool(getattr(policy, "unsaturated_actions", False)),
        stochastic=bool(getattr(policy, "stochastic", False)),
        measurement=str(getattr(policy, "measurement", POSE.kind)),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class LoadedPolicy:
    """A policy that is ready for evaluations, as :func:`cablebot_gym.policies.spec.load` makes
    it."""

    policy: Policy
    """The policy, behind its wrappers and estimators."""
    name: str
    """Name in results and messages."""
    declarations: Declarations
    """What the policy declares about itself."""
    shipped: bool = False
    """Whether it has only code of this project, see
    :attr:`cablebot_gym.policies.spec.PolicySpec.shipped`."""
    isolated: bool = False
    """Whether it runs in a process of its own."""
    bubblewrap: bool = False
    """Whether this process runs behind bubblewrap, without network and without writing files."""
    wrappers: tuple[str, ...] = ()
    """Names of the wrappers of the training, the innermost first."""

    @property
    def alone(self) -> bool:
        """Whether each episode runs alone, because a wrapper wraps a single environment."""
        return bool(getattr(self.policy, "alone", False))

    @property
    def fallbacks(self) -> float | None:
        """Number of fallbacks that the policy has counted; None if it does not count them."""
        count = getattr(self.policy, "fallbacks", None)
        return None if count is None else float(count)

    def reset(self, tasks: Callable[[], tuple[Task, ...]]) -> None:
        """Resets the policy, see :func:`reset_policy`."""
        reset_policy(self.policy, self.name, tasks)

    def act(
        self,
        observation: Array,
        state: Any,
        start: NDArray[np.bool_],
        *,
        cables: int,
        payloads: Array,
        time: float,
    ) -> tuple[Array, Any]:
        """Calls the policy for a batch of observations, with ``deterministic=True``, and checks its
        actions.

        Args:
            observation: observations, (N, size).
            state: state that the previous call returned; None at the first call.
            start: True at the first step of an episode, (N,).
            cables: number of cables m.
            payloads: true payload of each episode, (N,) [kg], for messages.
            time: time of the control instant [s], for messages.

        Returns:
            Actions (N, m) and the next state of the policy.

        Raises:
            PolicyError: if the policy raises anything but a KeyboardInterrupt, or if its actions
                are not numbers of shape (N, m) that the environment accepts.
        """
        try:
            returned, state = called(self.policy, observation.copy(), state, start.copy())
            return self.checked(returned, len(observation), cables), state
        except PolicyError as error:
            raise self.failure(error, payloads, time) from error.__cause__

    def checked(
        self, returned: Any, rows: int, cables: int, ignored: NDArray[np.bool_] | None = None
    ) -> Array:
        """Checks the actions of a policy.

        Args:
            returned: what it returned as its actions.
            rows: number of observations N.
            cables: number of cables m.
            ignored: True for episodes whose actions no longer matter, (N,). Their actions are set
                to 0.

        Returns:
            The actions, (N, m).

        Raises:
            PolicyError: if they are not numbers of shape (N, m) that the environment accepts. The
                message lacks the name of the policy.
        """
        # slow to import; the environment has imported it
        from cablebot_gym.envs.outcome import LARGEST

        action = shaped(returned, rows, cables)
        if ignored is not None:
            action[ignored] = 0.0
        infinite = ~np.isfinite(action).all(axis=1)
        if infinite.any():
            raise PolicyError("it returned NaN or infinity", index=int(infinite.argmax()))
        excessive = np.abs(action).max(axis=1) >= LARGEST
        if excessive.any():
            largest = action.flat[np.abs(action).argmax()]
            cause = f"it returned the action {largest:g}; actions must be within ± {LARGEST:g}"
            raise PolicyError(cause, index=int(excessive.argmax()))
        return action

    def failure(self, error: PolicyError, payloads: Array, time: float) -> PolicyError:
        """An error with name, time and payload.

        Args:
            error: the error of a control step.
            payloads: true payload of each episode, (N,) [kg].
            time: time of the control instant [s].
        """
        affected = payloads
        if error.index is not None and 0 <= error.index < len(payloads):
            affected = payloads[[error.index]]
        lightest = f"{affected.min():g}"
        heaviest = f"{affected.max():g}"
        text = f"payloads of {lightest} to {heaviest} kg"
        if lightest == heaviest:
            text = f"a payload of {lightest} kg"
        return PolicyError(f"policy {self.name!r}, at t = {time:.3f} s with {text}: {error.cause}")


def called(policy: Policy, observation: Any, state: Any, start: Array) -> tuple[Any, Any]:
    """What a policy returns as its actions, and its next state.

    Raises:
        PolicyError: if the policy raises anything but a KeyboardInterrupt, or returns no pair. The
            message lacks the name of the policy.
    """
    try:
        returned = policy.predict(observation, state=state, episode_start=start, deterministic=True)
    except (KeyboardInterrupt, PolicyError):
        raise
    except BaseException as error:
        raise PolicyError(raised(error)) from error
    if not isinstance(returned, tuple) or len(returned) != 2:
        raise PolicyError(f"predict() must return (actions, state), not {type(returned).__name__}")
    return returned


def shaped(returned: Any, rows: int, cables: int) -> Array:
    """Actions (N, m) as floats, which may be NaN or infinite.

    Raises:
        PolicyError: if they are not numbers of shape (N, m). The message lacks the name of the
            policy.
    """
    try:
        action = to_floats(returned)
    except ValueError as error:
        raise PolicyError(f"it returned {error}") from error
    if action.shape != (rows, cables):
        raise PolicyError(f"it returned shape {action.shape}; expected {(rows, cables)}")
    return action


def reset_policy(policy: Policy, name: str, tasks: Callable[[], tuple[Task, ...]]) -> None:
    """Calls the optional ``reset`` of a policy. Passes the tasks if it takes any, see
    :class:`Policy`.

    Args:
        policy: the policy.
        name: name of the policy, for messages.
        tasks: function that makes one task for each observation of the batch.

    Raises:
        PolicyError: if ``reset`` raises anything but a KeyboardInterrupt.
    """
    method = getattr(policy, "reset", None)
    if method is None:
        return
    # a parameter ``tasks`` or a required positional one
    takes_tasks = "tasks" in inspect.signature(method).parameters or required_arguments(method)
    arguments = (tasks(),) if takes_tasks else ()
    try:
        method(*arguments)
    except (KeyboardInterrupt, PolicyError):
        raise
    except BaseException as error:
        raise PolicyError.of(name, raised(error, where=" in reset()")) from error


def required_arguments(function: Callable[..., Any]) -> list[str]:
    """Names of the positional arguments that a function or a class needs."""
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return [
        parameter.name
        for parameter in inspect.signature(function).parameters.values()
        if parameter.kind in positional and parameter.default is parameter.empty
    ]


def to_floats(returned: Any) -> Array:
    """Copies actions to an array of floats.

    Raises:
        ValueError: if the actions are not real numbers, such as text or booleans. The message names
            their type.
    """
    try:
        values = np.asarray(returned)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # rows of different lengths, a tensor with gradients
        cause = raised(error, "its conversion raised")
        raise ValueError(f"{type(returned).__name__} instead of real numbers: {cause}") from error
    if values.dtype.kind not in "iuf":
        raise ValueError(
            f"{type(returned).__name__} of type {values.dtype} instead of real numbers"
        )
    return values.astype(float)


def name_of(policy: Any) -> str:
    """Name of a policy in results and messages: a string itself, its ``name``, or the name of its
    function or class."""
    if isinstance(policy, str):
        return policy
    return str(
        getattr(policy, "name", None) or getattr(policy, "__name__", None) or type(policy).__name__
    )
