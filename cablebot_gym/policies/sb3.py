"""Models that Stable-Baselines3, sb3-contrib (extra ``sb3``) and SBX saved, and the wrappers of
their training."""

from __future__ import annotations

import importlib
import json
import pickle
import warnings
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from cablebot_gym.policies.adapters import TransformedPolicy, WrappedPolicy
from cablebot_gym.policies.protocol import Policy
from cablebot_gym.policies.wrappers import NORMALISED, Stack, Wrapper, statistics
from cablebot_gym.robots import Robot

SB3_ALGORITHMS = ("PPO", "SAC", "TD3", "A2C", "DDPG")
"""Algorithms of Stable-Baselines3 with continuous actions."""

CONTRIB_ALGORITHMS = ("TQC", "CrossQ", "RecurrentPPO", "TRPO", "ARS")
"""Algorithms of sb3-contrib with continuous actions."""

SBX_ALGORITHMS = ("PPO", "SAC", "TD3", "DDPG", "TQC", "CrossQ")
"""Algorithms of SBX with continuous actions."""


def load_model(path: Path) -> Any:
    """Loads a model from a file.

    Raises:
        ValueError: if no algorithm can load it, or if a package is missing.
    """
    failures = []
    for algorithm in _algorithms(path):
        try:
            with warnings.catch_warnings():
                # a model that cannot be loaded raises an error anyway
                warnings.simplefilter("ignore")
                return algorithm.load(path, device="cpu")
        except Exception as error:
            failures.append(f"{algorithm.__name__}: {' '.join(str(error).split())[:200]}")
    raise ValueError(
        f"policy file {str(path)!r} is neither of an installed package nor an SB3 model ({failures[0]})"
    )


def behind_wrappers(
    policy: Policy, robot: Robot, subject: str, wrappers: Sequence[Wrapper]
) -> Policy:
    """The policy behind its wrappers. A Stable-Baselines3 model is checked first.

    Its observation space tells whether it reads normalised observations. The statistics of a
    ``VecNormalize`` are those of its training environment if it has one, unless the wrappers have
    one already.

    Args:
        policy: the policy.
        robot: nominal robot.
        subject: subject of the sentence if the model does not fit, such as ``policy 'mine'``.
        wrappers: wrappers of the training, the innermost first.

    Raises:
        ValueError: if a wrapper is invalid, or if the spaces of a model differ from those of the
            wrapped environment.
    """
    packages = {kind.__module__.partition(".")[0] for kind in type(policy).__mro__}
    is_model = not packages.isdisjoint({"stable_baselines3", "sb3_contrib"})
    if not is_model and not wrappers:
        return policy
    stack = Stack(wrappers, robot)
    normalised = False
    if is_model:
        model: Any = policy
        training = model.get_vec_normalize_env()
        if training is not None and not stack.normalises:
            stack = Stack([*wrappers, statistics("VecNormalize", pickle.dumps(training))], robot)
        normalised = _check_spaces(model, subject, stack)
    names = stack.names
    if normalised:
        stack = stack.normalised()
        names = names and stack.names
    if stack.layers:
        return WrappedPolicy(policy, stack, names)
    return TransformedPolicy(policy, stack, names) if stack.transforms else policy


def _algorithms(path: Path) -> list[Any]:
    """Candidate algorithms of a file, the likely ones first."""
    try:
        sb3 = importlib.import_module("stable_baselines3")
    except ImportError:
        raise ValueError(
            "an SB3 policy needs Stable-Baselines3: pip install 'cablebot-gym[sb3]'"
        ) from None
    saved_by = _policy_module(path).partition(".")[0]
    if saved_by == "sbx":
        try:
            return _classes(importlib.import_module("sbx"), SBX_ALGORITHMS)
        except ImportError:
            raise ValueError(
                f"policy file {str(path)!r} was saved by SBX: pip install sbx-rl"
            ) from None
    algorithms = _classes(sb3, SB3_ALGORITHMS)
    with suppress(ImportError):
        algorithms += _classes(importlib.import_module("sb3_contrib"), CONTRIB_ALGORITHMS)
    return sorted(algorithms, key=lambda kind: not kind.__module__.startswith(saved_by))


def _classes(package: Any, names: Sequence[str]) -> list[Any]:
    return [getattr(package, name) for name in names if hasattr(package, name)]


def _policy_module(path: Path) -> str:
    """Module of the policy class that an SB3 file names; empty if it names none."""
    try:
        with zipfile.ZipFile(path) as file:
            return str(json.loads(file.read("data"))["policy_class"]["__module__"])
    except (KeyError, TypeError, ValueError):
        return ""


def _check_spaces(model: Any, subject: str, stack: Stack) -> bool:
    """Checks that a model reads the observation of the wrapped environment of a robot and returns
    its actions.

    Returns whether it reads the normalised observation. Its bounds tell: they equal all those of
    one of the two environments, or more than of the other if it was trained for a robot of other
    bounds.

    Raises:
        ValueError: if the spaces differ, the message describes both; or if the last observation of
            the training shows that there were other wrappers.
    """
    inputs = model.observation_space
    outputs = model.action_space
    robot = stack.robot
    equal_bounds = _agreement(inputs, stack.observation_space)
    equal_normalised = 0.0
    if NORMALISED in stack.names:
        equal_bounds = 1.0
    elif equal_bounds < 1:
        equal_normalised = _agreement(inputs, stack.normalised().observation_space)
    normalised = equal_normalised >= equal_bounds and equal_bounds < 1
    is_rescaled = normalised and equal_normalised == equal_bounds
    offered = stack.observation_space
    has_shape = type(inputs) is type(offered) and inputs.shape == offered.shape
    is_returned = _agreement(outputs, stack.action_space) == 1
    is_fitting = has_shape and not is_rescaled and is_returned
    if is_fitting and not stack.normalises and _exceeds(getattr(model, "_last_obs", None), inputs):
        raise ValueError(
            f"{subject} was trained behind VecNormalize or a wrapper like it, because its last observation of the "
            "training exceeds its observation space. Add the statistics of VecNormalize: --wrapper FILE, or "
            "wrappers=[FILE] in Python"
        )
    if is_fitting:
        return normalised
    behind = ""
    if stack.names:
        behind = f" behind {', '.join(stack.names)}"
    raise ValueError(
        f"{subject} does not fit robot {robot.name!r}{behind}: the model reads {_text(inputs)} and returns "
        f"{_text(outputs)}, not {_text(offered)} and {_text(stack.action_space)}. Name the wrappers of the training, "
        "the innermost first: --wrapper file.py:name and --wrapper FILE, or wrappers=[…] in Python"
    )


def _text(space: Any) -> str:
    """A space in words, such as ``3 numbers within [-1, 1]``."""
    if not isinstance(space, Box):
        return str(space)
    shape = "×".join(map(str, space.shape))
    return f"{shape} numbers within [{np.min(space.low):g}, {np.max(space.high):g}]"


def _agreement(space: Any, offered: Any) -> float:
    """Fraction of the bounds of a space that equal those of an offered one."""
    if not (isinstance(space, Box) and isinstance(offered, Box) and space.shape == offered.shape):
        return float(space == offered)
    bounds = np.array([space.low, space.high], float), np.array([offered.low, offered.high], float)
    return float(np.isclose(*bounds, rtol=1e-5, atol=0).all(axis=0).mean())


def _exceeds(observation: Any, space: Any) -> bool:
    """Whether an observation is outside a space by more than rounding."""
    if not isinstance(space, Box) or not isinstance(observation, np.ndarray):
        return False
    tolerance = 1e-4 * np.maximum(1, np.abs(observation))
    return bool(
        ((observation < space.low - tolerance) | (observation > space.high + tolerance)).any()
    )
