"""Policies saved by Stable-Baselines3 and sb3-contrib (extra ``sb3``)."""

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
"""Of Stable-Baselines3, those with continuous actions."""

CONTRIB_ALGORITHMS = ("TQC", "CrossQ", "RecurrentPPO", "TRPO", "ARS")
"""Of sb3-contrib."""


def load_sb3(path: Path, robot: Robot) -> Policy:
    """A model from a file, checked to fit the robot.

    Raises:
        ValueError: if it cannot be loaded, or reads or returns something else than the robot's environment takes.
    """
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
