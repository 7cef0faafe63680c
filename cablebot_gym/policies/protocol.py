"""What a policy is: its protocol, its entry among the installed ones, and checks of what it returns."""

from __future__ import annotations

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
    """Stable-Baselines3's ``predict``, on one observation (size,) or on a batch (N, size).

    Optional: ``begin(tasks)``, called with one :class:`~cablebot_gym.task.Task` for each observation of a batch before
    its first step; ``unclipped = True``, which declares that commands beyond ±1 are what the law asks for, so that the
    paper's criterion means something.
    """

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Drive commands (m,) or (N, m), and the state to pass next time."""


@dataclass(frozen=True, kw_only=True)
class PolicyEntry:
    """A policy by name, as ``cablebot list`` shows it."""

    name: str
    """What to type."""
    kind: Literal["classical", "optimal", "learned"]
    """How it came about."""
    env_ids: tuple[str, ...]
    """Environments that it is made for."""
    factory: Callable[[Robot], Policy]
    """Makes the policy from a nominal robot."""
    summary: str
    """One line."""
    slow: bool = False
    """Whether an evaluation takes minutes: then most parts of a benchmark do without."""
    files: tuple[Path, ...] | None = None
    """The data that it reads, such as weights: a benchmark's result is of these. None for all beside its module."""


class PolicyError(RuntimeError):
    """A policy raised, or returned what is no drive command; the message names the payload and the time."""


class LaneError(RuntimeError):
    """A function failed for one observation of a batch, that of a lane; the message says how."""

    def __init__(self, lane: int, message: str) -> None:
        super().__init__(message)
        self.lane = lane
        """Which one, from 0."""


class CallablePolicy:
    """A plain function ``observation -> action``, called for one observation at a time."""

    unclipped = False

    def __init__(self, function: Callable[[Array], Any]) -> None:
        self._function = function
        self.unclipped = bool(getattr(function, "unclipped", False))
        if hasattr(function, "begin"):
            self.begin = function.begin

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """The function's action for each observation.

        Raises:
            LaneError: if the function raises, or returns anything but numbers of one shape.
        """
        if observation.ndim == 1:
            return np.asarray(self._function(observation), float), state
        actions: list[Array] = []
        for lane, item in enumerate(observation):
            try:
                returned = self._function(item)
            except Exception as error:
                raise LaneError(lane, f"it raised {type(error).__name__}: {error}{code_line(error)}") from error
            try:
                actions.append(_numbers(returned))
            except ValueError as error:
                raise LaneError(lane, f"it returned {error}") from error
            if actions[lane].shape != actions[0].shape:
                raise LaneError(lane, f"it returned shape {actions[lane].shape} after {actions[0].shape}")
        return np.stack(actions), state


def as_policy(policy: Any) -> Policy:
    """The policy itself, or a callable as one.

    Raises:
        TypeError: if it is neither.
    """
    if isinstance(policy, type):
        raise TypeError(f"a policy is an object, not the class {policy.__name__}: make one, {policy.__name__}(…)")
    if isinstance(policy, Policy):
        return policy
    if callable(policy):
        return CallablePolicy(policy)
    raise TypeError(
        f"a policy has predict() or is a callable observation -> action; {type(policy).__name__} is neither"
    )


def commands(
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
    """The policy's drive commands (N, m) for a batch of observations, checked, and its next state.

    Args:
        policy: asked with ``deterministic=True``.
        name: of the policy, for messages.
        observation: (N, size).
        state: what the policy returned last time, None at first.
        start: (N,) True at an episode's first step.
        cables: m.
        payloads: true payload of each episode, (N,) [kg], for messages.
        time: [s], for messages.
        ignored: (N,) episodes whose commands no longer matter; they become 0.

    Raises:
        PolicyError: if the policy raises, or returns anything but finite numbers of that shape.
    """
    at, everyone = f"at t = {time:.3f} s", f"with payloads of {payloads.min():g} to {payloads.max():g} kg"
    if len(payloads) == 1:
        everyone = f"with a payload of {payloads[0]:g} kg"
    try:
        returned = policy.predict(observation, state=state, episode_start=start, deterministic=True)
    except LaneError as error:
        lane = f"with a payload of {payloads[error.lane]:g} kg"
        raise PolicyError(f"policy {name!r} failed {at} {lane}: {error}") from error.__cause__
    except Exception as error:
        what = f"raised {type(error).__name__} {at} {everyone}: {error}{code_line(error)}"
        raise PolicyError(f"policy {name!r} {what}") from error
    if not isinstance(returned, tuple) or len(returned) != 2:
        what = f"{len(returned)} things" if isinstance(returned, tuple) else f"one {type(returned).__name__}"
        raise PolicyError(f"policy {name!r} returned {what} {at}: predict() has to return (commands, state)")
    raw, state = returned
    try:
        action = _numbers(raw)
    except ValueError as error:
        raise PolicyError(f"policy {name!r} returned {error} {at} {everyone}") from error
    if action.shape != (len(payloads), cables):
        expected = (len(payloads), cables)
        raise PolicyError(f"policy {name!r} returned shape {action.shape} {at} {everyone}; needed: {expected}")
    if ignored is not None:
        action[ignored] = 0.0
    if not np.all(np.isfinite(action)):
        lane = f"with a payload of {payloads[np.argmin(np.isfinite(action).all(axis=1))]:g} kg"
        raise PolicyError(f"policy {name!r} returned NaN or infinity {at} {lane}")
    return action, state


def begin(policy: Policy, name: str, tasks: tuple[Task, ...]) -> None:
    """Tells a policy that plans what is coming, see :class:`Policy`.

    Raises:
        PolicyError: if it raises.
    """
    if not hasattr(policy, "begin"):
        return
    try:
        policy.begin(tasks)
    except Exception as error:
        what = f"raised {type(error).__name__} in begin(): {error}{code_line(error)}"
        raise PolicyError(f"policy {name!r} {what}") from error


def _numbers(returned: Any) -> Array:
    """Drive commands as floats of their own.

    Raises:
        ValueError: if they are not real numbers; the message says what they are.
    """
    kind = type(returned).__name__
    try:
        values = np.asarray(returned)
    except Exception as error:  # rows of different lengths, a tensor with gradients
        raise ValueError(f"{kind} instead of real numbers: {error}") from error
    if values.dtype.kind not in "biuf":
        raise ValueError(f"{'complex' if values.dtype.kind == 'c' else kind} instead of real numbers")
    return values.astype(float)


def code_line(error: BaseException) -> str:
    """Where somebody's own code raised, for those who see no traceback."""
    frames = [
        frame
        for frame in extract_tb(error.__traceback__)
        if frame.filename != __file__ and "site-packages" not in frame.filename
    ]
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""


def name_of(policy: Any) -> str:
    """What to call a policy in results and messages: a name itself, its ``name``, its function's or its class's."""
    if isinstance(policy, str):
        return policy
    return str(getattr(policy, "name", None) or getattr(policy, "__name__", None) or type(policy).__name__)
