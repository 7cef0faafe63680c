"""Loads policies that Stable-Baselines3 and sb3-contrib saved (extra ``sb3``)."""

from __future__ import annotations

import importlib
import json
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box

from cablebot_gym.envs import ENV_ROBOTS
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.policies.protocol import Policy
from cablebot_gym.robots import Robot, find_robot

SB3_ALGORITHMS = ("PPO", "SAC", "TD3", "A2C", "DDPG")
"""Algorithms of Stable-Baselines3 with continuous actions."""

CONTRIB_ALGORITHMS = ("TQC", "CrossQ", "RecurrentPPO", "TRPO", "ARS")
"""Algorithms of sb3-contrib with continuous actions."""


def load_sb3(path: Path, robot: Robot) -> Policy:
    """Loads a model from a file and checks that it fits the robot.

    Raises:
        ValueError: if the model cannot be loaded, or if its spaces differ from those of the robot's environment.
    """
    failures = []
    for algorithm in _algorithms(path):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a model that cannot be loaded raises an error anyway
                model = algorithm.load(path, device="cpu")
        except Exception as error:
            failures.append(f"{algorithm.__name__}: {' '.join(str(error).split())[:200]}")
            continue
        _check_spaces(model, path, robot)
        loaded: Policy = model
        return loaded
    raise ValueError(
        f"policy file {str(path)!r} is neither a bundle of an installed package nor an SB3 model ({failures[0]})"
    )


def _algorithms(path: Path) -> list[Any]:
    """Candidate algorithms of a file, the likely ones first."""
    try:
        sb3 = importlib.import_module("stable_baselines3")
    except ImportError:
        raise ValueError("an SB3 policy needs Stable-Baselines3: pip install 'cablebot-gym[sb3]'") from None
    own, others = [getattr(sb3, name) for name in SB3_ALGORITHMS], []
    contributed = _policy_module(path).startswith("sb3_contrib")
    try:
        contrib = importlib.import_module("sb3_contrib")
        others = [getattr(contrib, name) for name in CONTRIB_ALGORITHMS if hasattr(contrib, name)]
    except ImportError:
        if contributed:
            needed = "was saved by sb3-contrib: pip install 'cablebot-gym[sb3]'"
            raise ValueError(f"policy file {str(path)!r} {needed}") from None
    return others + own if contributed else own + others


def _policy_module(path: Path) -> str:
    """Module of the policy class that an SB3 file names; empty if it names none."""
    try:
        with zipfile.ZipFile(path) as file:
            return str(json.loads(file.read("data"))["policy_class"]["__module__"])
    except (KeyError, TypeError, ValueError):
        return ""


def _check_spaces(model: Any, path: Path, robot: Robot) -> None:
    """Checks that a model reads the observation of this robot and returns its actions.

    Raises:
        ValueError: if the spaces differ. The message describes both.
    """
    inputs, outputs = model.observation_space, model.action_space
    if not _fits(model, robot):
        other = next((f", which fits {i}" for i, name in ENV_ROBOTS.items() if _fits(model, find_robot(name))), "")
        difference = f"the model reads {_described(inputs)} and returns {_described(outputs)}{other}"
    elif len(set(inputs.low)) == len(set(inputs.high)) == 1:  # the bounds of a raw observation differ
        difference = f"the model reads a normalised observation within [{inputs.low[0]:g}, {inputs.high[0]:g}]"
    elif not (np.all(outputs.low == -1) and np.all(outputs.high == 1)):
        difference = f"the model returns rescaled actions within [{np.min(outputs.low):g}, {np.max(outputs.high):g}]"
    else:
        return
    raise ValueError(
        f"policy file {str(path)!r} does not fit robot {robot.name!r}: {difference}. The robot has "
        f"{observation_layout(robot).size} observed numbers and {robot.cables} actions within [-1, 1]. Export a model "
        "that was trained inside wrappers as a bundle by `cablebot train`"
    )


def _fits(model: Any, robot: Robot) -> bool:
    sizes = ((model.observation_space, observation_layout(robot).size), (model.action_space, robot.cables))
    return all(isinstance(space, Box) and space.shape == (size,) for space, size in sizes)


def _described(space: Any) -> str:
    return f"{'×'.join(map(str, space.shape))} numbers" if isinstance(space, Box) else str(space)
