"""What a policy is, and how a name, a file or ``package.module:factory`` becomes one."""

from __future__ import annotations

import importlib
import json
import logging
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from traceback import extract_tb
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from cablebot_gym.choices import no_such
from cablebot_gym.envs import ENV_ROBOTS
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.task import Task

Array = NDArray[Any]

_LOGGER = logging.getLogger("cablebot_gym")

ENTRY_POINT_GROUP = "cablebot_gym.policies"
"""A package adds policies by entry points in this group, each of which names a :class:`PolicyEntry`."""

FILE_ENTRY_POINT_GROUP = "cablebot_gym.policy_files"
"""A package adds kinds of policy files by entry points in this group, each of which names a :data:`FileLoader`."""


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


FileLoader = Callable[[Path, Robot], Policy | None]
"""Makes a policy from a ``.zip`` and a nominal robot, or None if the file is not of its kind. It raises a ValueError in
words if the file is of its kind, but damaged or made for another robot."""


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
                raise LaneError(lane, f"it raised {type(error).__name__}: {error}{_line(error)}") from error
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
        what = f"raised {type(error).__name__} {at} {everyone}: {error}{_line(error)}"
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
        what = f"raised {type(error).__name__} in begin(): {error}{_line(error)}"
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


def _line(error: BaseException) -> str:
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
    """A policy from an installed name, a ``.zip`` file, or ``package.module:factory``.

    A factory is called with the nominal robot. A file is offered to the loaders of :data:`FILE_ENTRY_POINT_GROUP`; one
    that none of them takes is a Stable-Baselines3 model of PPO, SAC, TD3, A2C or DDPG, or with sb3-contrib installed
    of TQC, CrossQ, RecurrentPPO, TRPO or ARS.

    Raises:
        ValueError: if the name is unknown, or what it names cannot be loaded or does not fit the robot; the message
            says what is valid.
    """
    entries = policy_entries()
    if name in entries:
        return entries[name].factory(robot)
    if name.endswith(".zip"):
        return _load_file(Path(name), robot)
    if ":" in name:
        factory = _load_factory(name)
        try:
            made = factory(robot)
        except Exception as error:
            what = f"{type(error).__name__}: {error}{_line(error)}"
            raise ValueError(f"policy {name!r}: the factory raised {what}") from error
        try:
            return as_policy(made)
        except TypeError as error:
            raise ValueError(f"policy {name!r} must be a function robot -> policy, but: {error}") from None
    otherwise = ", a learned bundle or an SB3 file ending in .zip, or package.module:factory"
    raise ValueError(no_such("policy", name, entries, otherwise))


def _load_factory(name: str) -> Callable[[Robot], Any]:
    module_name, _, attribute = name.partition(":")
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        meant = f"; a module is named without .py: {module_name.removesuffix('.py')}:{attribute}"
        hint = meant if module_name.endswith(".py") else ""
        raise ValueError(f"policy {name!r}: cannot import {module_name!r} ({error}){hint}") from error
    if not hasattr(module, attribute):
        raise ValueError(f"policy {name!r}: {module_name!r} has no {attribute!r}")
    factory = getattr(module, attribute)
    if isinstance(factory, PolicyEntry):
        return factory.factory
    if not callable(factory):
        raise ValueError(f"policy {name!r}: {attribute!r} must be a function robot -> policy")
    made: Callable[[Robot], Any] = factory
    return made


def _load_file(path: Path, robot: Robot) -> Policy:
    if not path.is_file():
        raise ValueError(f"policy file {str(path)!r} does not exist")
    _check_zip(path)
    for point in entry_points(group=FILE_ENTRY_POINT_GROUP):
        try:
            loader: FileLoader = point.load()
        except Exception as error:
            _LOGGER.warning("policy files of kind %r are left out: %s raised %s", point.name, point.value, error)
            continue
        try:
            policy = loader(path, robot)
        except ValueError:
            raise
        except Exception as error:
            reason = f"{point.value} raised {type(error).__name__}: {error}"
            raise ValueError(f"policy file {str(path)!r} cannot be loaded: {reason}") from error
        if policy is not None:
            return policy
    return _load_sb3(path, robot)


def _check_zip(path: Path) -> None:
    """Refuses what is no zip file, and one whose checksums do not hold."""
    try:
        with zipfile.ZipFile(path) as file:
            broken = file.testzip()
    except Exception as error:  # besides zipfile's own those of the decompressors
        reason = str(error) or type(error).__name__
        raise ValueError(
            f"policy file {str(path)!r} is no zip file, or damaged or cut short ({reason}): save or copy it again"
        ) from error
    if broken is not None:
        raise ValueError(f"policy file {str(path)!r} is damaged (its part {broken!r}): save or copy it again")


SB3_ALGORITHMS = ("PPO", "SAC", "TD3", "A2C", "DDPG")
"""Of Stable-Baselines3, those with continuous actions."""

CONTRIB_ALGORITHMS = ("TQC", "CrossQ", "RecurrentPPO", "TRPO", "ARS")
"""Of sb3-contrib."""


def _load_sb3(path: Path, robot: Robot) -> Policy:
    failures = []
    for algorithm in _algorithms(path):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what matters of a model that does not load follows as an error
                model = algorithm.load(path, device="cpu")
        except Exception as error:
            failures.append(f"{algorithm.__name__}: {' '.join(str(error).split())[:200]}")
            continue
        _check_spaces(model, path, robot)
        loaded: Policy = model
        return loaded
    raise ValueError(f"policy file {str(path)!r} is no SB3 model ({failures[0]}), nor a bundle of an installed package")


def _algorithms(path: Path) -> list[Any]:
    """Algorithms that a file may be of, likely ones first."""
    try:
        sb3 = importlib.import_module("stable_baselines3")
    except ImportError:
        raise ValueError("an SB3 policy needs the extra: pip install 'cablebot-gym[sb3]'") from None
    own = [getattr(sb3, name) for name in SB3_ALGORITHMS]
    needed = _policy_module(path).startswith("sb3_contrib")
    try:
        contrib = importlib.import_module("sb3_contrib")
    except ImportError:
        if needed:
            raise ValueError(
                f"policy file {str(path)!r} was saved by sb3-contrib: pip install 'cablebot-gym[sb3]'"
            ) from None
        return own
    others = [getattr(contrib, name) for name in CONTRIB_ALGORITHMS if hasattr(contrib, name)]
    return others + own if needed else own + others


def _policy_module(path: Path) -> str:
    """Where the class of an SB3 file's policy is defined; empty if it does not say."""
    try:
        with zipfile.ZipFile(path) as file:
            return str(json.loads(file.read("data"))["policy_class"]["__module__"])
    except (KeyError, TypeError, ValueError):
        return ""


def _check_spaces(model: Any, path: Path, robot: Robot) -> None:
    """Refuses a model that reads something else than this robot's observation, or gives something else than commands.

    Raises:
        ValueError: with both layouts.
    """
    reads, gives, layout = model.observation_space, model.action_space, observation_layout(robot)
    if not _fits(model, robot):
        other = next((f", as on {i}" for i, name in ENV_ROBOTS.items() if _fits(model, find_robot(name))), "")
        difference = f"it reads {_described(reads)} and gives {_described(gives)}{other}"
    elif len(set(reads.low)) == len(set(reads.high)) == 1:  # of a robot's own observation bounds differ
        difference = f"it reads normalised components, all in [{reads.low[0]:g}, {reads.high[0]:g}]"
    elif not (np.all(gives.low == -1) and np.all(gives.high == 1)):
        difference = f"it gives rescaled commands in [{np.min(gives.low):g}, {np.max(gives.high):g}]"
    else:
        return
    blocks = ", ".join(f"{block.name} {block.size}" for block in layout.blocks)
    raise ValueError(
        f"policy file {str(path)!r} does not fit robot {robot.name!r}: {difference}; the robot gives {layout.size} "
        f"numbers ({blocks}) and takes {robot.cables} drive commands in [-1, 1]: evaluate a model on the environment "
        "it was trained on, and export one trained inside wrappers as a bundle by `cablebot train`"
    )


def _fits(model: Any, robot: Robot) -> bool:
    sizes = ((model.observation_space, observation_layout(robot).size), (model.action_space, robot.cables))
    return all(isinstance(space, Box) and space.shape == (size,) for space, size in sizes)


def _described(space: Any) -> str:
    return f"{'×'.join(map(str, space.shape))} numbers" if isinstance(space, Box) else str(space)
