"""What a policy is, and how a name, a file or ``package.module:factory`` becomes one."""

from __future__ import annotations

import importlib
import logging
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.robots import Robot
from cablebot_gym.task import Task

Array = NDArray[Any]

_LOGGER = logging.getLogger("cablebot_gym")

ENTRY_POINT_GROUP = "cablebot_gym.policies"
"""A package adds policies by entry points in this group, each of which names a :class:`PolicyEntry`."""


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


class PolicyError(RuntimeError):
    """A policy raised, or returned what is no drive command; the message names the payload and the time."""


class LaneError(RuntimeError):
    """A function failed for one observation of a batch."""

    def __init__(self, lane: int, message: str) -> None:
        super().__init__(message)
        self.lane = lane
        """Which one, from 0."""


class CallablePolicy:
    """A plain ``observation -> action``, called for one observation at a time."""

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
                actions.append(np.asarray(self._function(item), float))
            except Exception as error:
                raise LaneError(lane, f"it raised {type(error).__name__}: {error}") from error
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
        raw, state = policy.predict(observation, state=state, episode_start=start, deterministic=True)
        action = np.array(raw, dtype=float)
    except LaneError as error:
        lane = f"with a payload of {payloads[error.lane]:g} kg"
        raise PolicyError(f"policy {name!r} failed {at} {lane}: {error}") from error.__cause__
    except Exception as error:
        raise PolicyError(f"policy {name!r} raised {type(error).__name__} {at} {everyone}: {error}") from error
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
        raise PolicyError(f"policy {name!r} raised {type(error).__name__} in begin(): {error}") from error


def name_of(policy: Any) -> str:
    """What to call a policy in results and messages: a name itself, its ``name``, its function's or its class's."""
    if isinstance(policy, str):
        return policy
    return str(getattr(policy, "name", None) or getattr(policy, "__name__", None) or type(policy).__name__)


def policy_entries() -> dict[str, PolicyEntry]:
    """Every installed policy by name, sorted; one whose package cannot be imported is left out, with a warning."""
    entries = []
    for point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            entries.append(point.load())
        except Exception as error:
            _LOGGER.warning("policy %r is left out: %s raised %s", point.name, point.value, error)
    return {entry.name: entry for entry in sorted(entries, key=lambda entry: entry.name)}


def load_policy(name: str, robot: Robot) -> Policy:
    """A policy from an installed name, a Stable-Baselines3 ``.zip``, or ``package.module:factory``.

    A factory is called with the nominal robot. An SB3 file is tried as PPO, SAC, TD3, A2C and DDPG.

    Raises:
        ValueError: if the name is unknown, or what it names cannot be loaded; the message says what is valid.
    """
    entries = policy_entries()
    if name in entries:
        return entries[name].factory(robot)
    if name.endswith(".zip"):
        return _load_sb3(Path(name))
    if ":" in name:
        factory = _load_factory(name)
        try:
            made = factory(robot)
        except Exception as error:
            raise ValueError(f"policy {name!r}: the factory raised {type(error).__name__}: {error}") from error
        try:
            return as_policy(made)
        except TypeError as error:
            raise ValueError(f"policy {name!r} must be a function robot -> policy, but: {error}") from None
    raise ValueError(
        f"unknown policy {name!r}; choose one of {', '.join(entries)}, an SB3 file ending in .zip, "
        "or package.module:factory"
    )


def _load_factory(name: str) -> Callable[[Robot], Any]:
    module_name, _, attribute = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        raise ValueError(f"policy {name!r}: cannot import {module_name!r} ({error})") from error
    if not hasattr(module, attribute):
        raise ValueError(f"policy {name!r}: {module_name!r} has no {attribute!r}")
    factory = getattr(module, attribute)
    if isinstance(factory, PolicyEntry):
        return factory.factory
    if not callable(factory):
        raise ValueError(f"policy {name!r}: {attribute!r} must be a function robot -> policy")
    made: Callable[[Robot], Any] = factory
    return made


def _load_sb3(path: Path) -> Policy:
    if not path.is_file():
        raise ValueError(f"policy file {str(path)!r} does not exist")
    try:
        import stable_baselines3 as sb3
    except ImportError:
        raise ValueError("an SB3 policy needs the extra: pip install 'cablebot-gym[sb3]'") from None
    failures = []
    for algorithm in (sb3.PPO, sb3.SAC, sb3.TD3, sb3.A2C, sb3.DDPG):
        try:
            model: Policy = algorithm.load(path, device="cpu")
            return model
        except Exception as error:
            failures.append(f"{algorithm.__name__}: {error}")
    raise ValueError(f"policy file {str(path)!r} is no SB3 model ({failures[0]})")
