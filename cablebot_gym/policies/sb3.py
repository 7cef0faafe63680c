"""Loads policies that Stable-Baselines3 and sb3-contrib saved (extra ``sb3``)."""

from __future__ import annotations

import importlib
import json
import warnings
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from cablebot_gym.envs import ENV_ROBOTS
from cablebot_gym.envs.observation import ObservationLayout, observation_layout
from cablebot_gym.kinematics import Array
from cablebot_gym.policies.protocol import Policy
from cablebot_gym.robots import Robot, find_robot

SB3_ALGORITHMS = ("PPO", "SAC", "TD3", "A2C", "DDPG")
"""Algorithms of Stable-Baselines3 with continuous actions."""

CONTRIB_ALGORITHMS = ("TQC", "CrossQ", "RecurrentPPO", "TRPO", "ARS")
"""Algorithms of sb3-contrib with continuous actions."""


@dataclass(frozen=True, kw_only=True)
class NormalisedPolicy:
    """A model that reads normalised observations, as a policy that reads observations in physical units."""

    model: Any
    """Object with Stable-Baselines3's ``predict``."""
    layout: ObservationLayout
    """Layout of the robot's observation."""

    def predict(
        self, observation: ArrayLike, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[Array, Any]:
        """Actions and the state to pass next time.

        Raises:
            ValueError: if the observation is not that of the layout.
        """
        actions, state = self.model.predict(self.layout.normalise(observation), state, episode_start, deterministic)
        return actions, state


def load_sb3(path: Path, robot: Robot) -> Policy:
    """Loads a model from a file and checks that it fits the robot.

    A model that was trained with ``normalised_observation`` becomes a :class:`NormalisedPolicy`.

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
        return fitted(model, robot, f"policy file {str(path)!r}")
    raise ValueError(
        f"policy file {str(path)!r} is neither a bundle of an installed package nor an SB3 model ({failures[0]})"
    )


def fitted(policy: Policy, robot: Robot, name: str) -> Policy:
    """The policy. A Stable-Baselines3 model is checked first, and is normalised for if its observation space says so.

    Args:
        policy: the policy.
        robot: nominal robot.
        name: subject of the sentence if the model does not fit, such as ``policy 'mine'``.

    Raises:
        ValueError: if the spaces of a model differ from those of the robot's environment.
    """
    modules = {kind.__module__.partition(".")[0] for kind in type(policy).__mro__}
    if modules.isdisjoint({"stable_baselines3", "sb3_contrib"}) or not _check_spaces(policy, name, robot):
        return policy
    return NormalisedPolicy(model=policy, layout=observation_layout(robot))


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


def _check_spaces(model: Any, name: str, robot: Robot) -> bool:
    """Checks that a model reads the observation of this robot and returns its actions.

    Returns whether it reads the normalised observation. The bounds of the slack time tell, because its scale is the
    same for all robots.

    Raises:
        ValueError: if the spaces differ. The message describes both.
    """
    inputs, outputs, layout = model.observation_space, model.action_space, observation_layout(robot)
    slack = layout.slices()["slack_time"]
    bounds = {layout.space(normalised=kind).high[slack].item(): kind for kind in (False, True)}
    if not _fits(model, robot):
        other = next((f", which fits {i}" for i, name in ENV_ROBOTS.items() if _fits(model, find_robot(name))), "")
        difference = f"the model reads {_described(inputs)} and returns {_described(outputs)}{other}"
    elif (high := round(inputs.high[slack].item(), 3)) not in bounds:
        lowest, highest = np.min(inputs.low), np.max(inputs.high)
        difference = f"the model reads an observation that a wrapper rescaled to [{lowest:g}, {highest:g}]"
    elif not (np.all(outputs.low == -1) and np.all(outputs.high == 1)):
        difference = f"the model returns rescaled actions within [{np.min(outputs.low):g}, {np.max(outputs.high):g}]"
    else:
        return bounds[high]
    raise ValueError(
        f"{name} does not fit robot {robot.name!r}: {difference}. The robot has "
        f"{layout.size} observed numbers and {robot.cables} actions within [-1, 1]. Export a model "
        "that was trained inside wrappers as a bundle by `cablebot train`"
    )


def _fits(model: Any, robot: Robot) -> bool:
    sizes = ((model.observation_space, observation_layout(robot).size), (model.action_space, robot.cables))
    return all(isinstance(space, Box) and space.shape == (size,) for space, size in sizes)


def _described(space: Any) -> str:
    return f"{'×'.join(map(str, space.shape))} numbers" if isinstance(space, Box) else str(space)
