"""Loads policies that Stable-Baselines3, sb3-contrib (extra ``sb3``) and SBX saved."""

from __future__ import annotations

import importlib
import json
import pickle
import re
import warnings
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike

from cablebot_gym.envs import ENV_ROBOTS
from cablebot_gym.envs.observation import ObservationLayout
from cablebot_gym.kinematics import Array
from cablebot_gym.policies.protocol import Policy
from cablebot_gym.policies.wrapped import NORMALISED, Stack, WrappedPolicy, Wrapper, say, sizes, statistics
from cablebot_gym.robots import Robot, find_robot

SB3_ALGORITHMS = ("PPO", "SAC", "TD3", "A2C", "DDPG")
"""Algorithms of Stable-Baselines3 with continuous actions."""

CONTRIB_ALGORITHMS = ("TQC", "CrossQ", "RecurrentPPO", "TRPO", "ARS")
"""Algorithms of sb3-contrib with continuous actions."""

SBX_ALGORITHMS = ("PPO", "SAC", "TD3", "DDPG", "TQC", "CrossQ")
"""Algorithms of SBX with continuous actions."""

STATISTICS = ("vecnormalize.pkl", "vec_normalize.pkl")
"""Names of files with the statistics of ``VecNormalize`` that are found beside a model."""


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


def load_sb3(path: Path, robot: Robot, wrappers: Sequence[Wrapper] = ()) -> Policy:
    """Loads a model from a file and checks that it fits the robot.

    A model that was trained with ``normalised_observation`` becomes a :class:`NormalisedPolicy`, one that was trained
    behind wrappers a :class:`~cablebot_gym.policies.wrapped.WrappedPolicy`. See :func:`statistics_beside`.

    Raises:
        ValueError: if the model cannot be loaded, or if its spaces differ from those of the robot's environment behind
            the wrappers.
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
        return fitted(model, robot, f"policy file {str(path)!r}", wrappers, statistics_beside(path))
    raise ValueError(
        f"policy file {str(path)!r} is neither a bundle of an installed package nor an SB3 model ({failures[0]})"
    )


def statistics_beside(path: Path) -> Path | None:
    """File with the statistics of ``VecNormalize`` of a model; None if there is none.

    It is looked for where Stable-Baselines3's ``CheckpointCallback`` saves it, beside the model, and in a folder with
    the name of the model. RL-Zoo has a single such folder for its best model and its checkpoints.
    """
    checkpoint = re.fullmatch(r"(.+)_(\d+)_steps", path.stem)
    found = [path.parent / name for name in STATISTICS] + [path.with_suffix("") / name for name in STATISTICS]
    if checkpoint is not None:
        found.insert(0, path.parent / f"{checkpoint[1]}_vecnormalize_{checkpoint[2]}_steps.pkl")
    if checkpoint is not None or path.stem == "best_model":
        folders = sorted(path.parent.glob(f"*/{STATISTICS[0]}"))
        found += folders if len(folders) == 1 else []
    return next((file for file in found if file.is_file()), None)


def fitted(
    policy: Policy, robot: Robot, name: str, wrappers: Sequence[Wrapper] = (), beside: Path | None = None
) -> Policy:
    """The policy behind its wrappers. A Stable-Baselines3 model is checked first.

    Its observation space tells whether it reads normalised observations. The statistics of a ``VecNormalize`` are those
    of its training environment if it has one, else those of ``beside``, unless the wrappers have one already.

    Args:
        policy: the policy.
        robot: nominal robot.
        name: subject of the sentence if the model does not fit, such as ``policy 'mine'``.
        wrappers: wrappers of the training, the innermost first.
        beside: file with the statistics of a ``VecNormalize`` that was found; None if there is none.

    Raises:
        ValueError: if a wrapper is invalid, or if the spaces of a model differ from those of the wrapped environment.
    """
    modules = {kind.__module__.partition(".")[0] for kind in type(policy).__mro__}
    if modules.isdisjoint({"stable_baselines3", "sb3_contrib"}):
        return WrappedPolicy(policy, Stack(wrappers, robot)) if wrappers else policy
    model: Any = policy
    stack, note = Stack(wrappers, robot), ""
    if not stack.normalises:
        if (training := model.get_vec_normalize_env()) is not None:
            stack = stack.with_last(statistics("VecNormalize", pickle.dumps(training)))
            note = f"{name} gets observations normalised by the VecNormalize of its training environment"
        elif beside is not None:
            stack = stack.with_last(beside)
            note = f"{name} gets observations normalised by {str(beside)!r}, which was found beside it"
    normalised = _check_spaces(model, name, stack)
    if note:
        say(note)
    if not stack.wrappers:
        return NormalisedPolicy(model=model, layout=stack.layout) if normalised else policy
    return WrappedPolicy(policy, stack.with_first(NORMALISED) if normalised else stack, note)


def _algorithms(path: Path) -> list[Any]:
    """Candidate algorithms of a file, the likely ones first."""
    try:
        sb3 = importlib.import_module("stable_baselines3")
    except ImportError:
        raise ValueError("an SB3 policy needs Stable-Baselines3: pip install 'cablebot-gym[sb3]'") from None
    own, others = [getattr(sb3, name) for name in SB3_ALGORITHMS], []
    saved_by = _policy_module(path).partition(".")[0]
    if saved_by == "sbx":
        try:
            sbx = importlib.import_module("sbx")
        except ImportError:
            raise ValueError(f"policy file {str(path)!r} was saved by SBX: pip install sbx-rl") from None
        return [getattr(sbx, name) for name in SBX_ALGORITHMS if hasattr(sbx, name)]
    contributed = saved_by == "sb3_contrib"
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


def _check_spaces(model: Any, name: str, stack: Stack) -> bool:
    """Checks that a model reads the observation of the wrapped environment of a robot and returns its actions.

    Returns whether it reads the normalised observation. Its bounds tell: they equal all those of one of the two
    environments, or more than of the other if it was trained for a robot of other bounds.

    Raises:
        ValueError: if the spaces differ, the message describes both; or if the last observation of the training shows
            that there were other wrappers.
    """
    inputs, outputs, robot = model.observation_space, model.action_space, stack.robot
    known = NORMALISED in stack.names
    candidates = [stack, *([] if known else [stack.with_first(NORMALISED)])]
    agreements = [_agreement(inputs, candidate.observation_space) for candidate in candidates]
    plain = agreements[0] == 1 or known or agreements[0] > agreements[1]
    if not _fits(model, stack.observation_space, stack.action_space):
        difference = f"the model reads {sizes(inputs)} and returns {sizes(outputs)}"
        for env_id, other in () if stack.wrappers else ENV_ROBOTS.items():
            bare = Stack((), find_robot(other))
            if _fits(model, bare.observation_space, bare.action_space):
                difference += f", which fits {env_id}"
                break
    elif not plain and agreements[0] == agreements[1] < 1:
        lowest, highest = np.min(inputs.low), np.max(inputs.high)
        difference = f"the model reads an observation that a wrapper rescaled to [{lowest:g}, {highest:g}]"
    elif not np.array_equal([outputs.low, outputs.high], [stack.action_space.low, stack.action_space.high]):
        difference = f"the model returns rescaled actions within [{np.min(outputs.low):g}, {np.max(outputs.high):g}]"
    elif not stack.normalises and _exceeds(getattr(model, "_last_obs", None), inputs):
        raise ValueError(
            f"{name} was trained behind VecNormalize or a wrapper like it, because its last observation of the "
            "training exceeds its observation space. Add the statistics of VecNormalize: --normalize FILE, or "
            "wrappers=[FILE] in Python"
        )
    else:
        return not plain
    given = f" Behind {', '.join(stack.names)} it has {_described(stack)}." if stack.wrappers else ""
    raise ValueError(
        f"{name} does not fit robot {robot.name!r}: {difference}. The robot has {_described(Stack((), robot))}.{given} "
        "Name the wrappers of the training, the innermost first: --wrapper file.py:name and --normalize FILE, or "
        "wrappers=[…] in Python"
    )


def _described(stack: Stack) -> str:
    actions = stack.action_space
    reads = f"{'×'.join(map(str, stack.observation_space.shape or ()))} observed numbers"
    if not isinstance(actions, Box):
        return f"{reads} and actions {actions}"
    low, high = np.min(actions.low), np.max(actions.high)
    return f"{reads} and {'×'.join(map(str, actions.shape))} actions within [{low:g}, {high:g}]"


def _fits(model: Any, observation: Any, action: Any) -> bool:
    pairs = ((model.observation_space, observation), (model.action_space, action))
    return all(type(one) is type(other) and one.shape == other.shape for one, other in pairs)


def _agreement(space: Any, other: Any) -> float:
    """Fraction of the bounds of a space that equal those of another one."""
    if not (isinstance(space, Box) and isinstance(other, Box) and space.shape == other.shape):
        return float(space == other)
    bounds = np.array([space.low, space.high], float), np.array([other.low, other.high], float)
    return float(np.isclose(*bounds, rtol=1e-5, atol=0).all(axis=0).mean())


def _exceeds(observation: Any, space: Any) -> bool:
    """Whether an observation is outside a space by more than rounding."""
    if not isinstance(space, Box) or not isinstance(observation, np.ndarray):
        return False
    tolerance = 1e-4 * np.maximum(1, np.abs(observation))
    return bool(((observation < space.low - tolerance) | (observation > space.high + tolerance)).any())
