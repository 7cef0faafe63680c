"""Bundles: the file format of learned policies. A bundle holds plain arrays and JSON; loading it
executes no code."""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_baselines.laws.law import Array
from cablebot_baselines.learned.base import Base, find_base
from cablebot_baselines.learned.network import Network, zero_network
from cablebot_baselines.learned.steering import (
    Shift,
    Steering,
    action_mapping_to_jsonable,
    find_action_mapping,
)
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.task import find_error_bounds
from cablebot_gym.utils.checks import whole
from cablebot_gym.utils.files import atomic_write

FORMAT = 1
"""Format number of bundles; a newer number is rejected."""

SETTLING_ACCELERATION = 0.5
"""Acceleration with which the shift of a base law alone leaves the start pose [m/s²]. A twentieth of
gravity leaves the cables taut."""

_MEMBER = "bundle"
"""Name of the array that holds the JSON."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bundle:
    """A learned policy: a network that steers a base law.

    Raises:
        ValueError: if its parts are inconsistent.
    """

    env_id: str
    """Id of the training environment."""
    base: Base
    """Classical law that the network steers."""
    action_mapping: Shift
    """Meaning of the network's outputs."""
    features: tuple[str, ...]
    """Names of the network's inputs, see :mod:`cablebot_baselines.learned.features`."""
    network: Network
    """Network, including the normalisation of its inputs."""
    card: Mapping[str, Any] = field(default_factory=dict)
    """Training record, JSON-able: command, seed, steps, wall time, versions."""

    def __post_init__(self) -> None:
        robot = _training_robot(self.env_id)
        steering = self.steering(robot)
        object.__setattr__(self, "features", steering.features)
        network_sizes = (self.network.inputs, self.network.outputs)
        steering_sizes = (steering.inputs, steering.actions)
        if network_sizes != steering_sizes:
            raise ValueError(
                f"the network has inputs and outputs {network_sizes}, but features and actions have {steering_sizes}"
            )

    @classmethod
    def of_steering(cls, env_id: str, steering: Steering, network: Network | None = None) -> Bundle:
        """A policy that steers a law; without a network, one with output zero."""
        return cls(
            env_id=env_id,
            base=steering.base,
            action_mapping=steering.action_mapping,
            features=steering.features,
            network=network or zero_network(steering.inputs, steering.actions),
        )

    def steering(self, robot: Robot) -> Steering:
        """The steered base law for a nominal robot.

        Raises:
            ValueError: if the robot's observation differs from the one that the policy was trained
                on.
        """
        training_layout = _layout(_training_robot(self.env_id))
        _check_layout(self.env_id, training_layout, f"robot {robot.name!r}", robot)
        return Steering(
            robot, base=self.base, action_mapping=self.action_mapping, features=self.features
        )

    @property
    def base_alone(self) -> Bundle:
        """The policy without its network: the reference of a base law moves slowly from the start
        pose to that of the task, in a few action periods."""
        offset = find_error_bounds(None, _training_robot(self.env_id)).start_offset
        period = math.sqrt(offset / SETTLING_ACCELERATION)
        mapping = replace(self.action_mapping, action_period=period)
        network = zero_network(self.network.inputs, self.network.outputs)
        return replace(
            self, action_mapping=mapping, network=network, card={"note": "the base law alone"}
        )

    def save(self, path: str | Path) -> None:
        """Writes the bundle atomically.

        Raises:
            OSError: if it cannot be written.
        """
        data = {
            "format": FORMAT,
            "env_id": self.env_id,
            "observation": _layout(_training_robot(self.env_id)),
            "base": asdict(self.base),
            "steering": action_mapping_to_jsonable(self.action_mapping),
            "features": list(self.features),
            "card": dict(self.card),
        }
        text = json.dumps(data, ensure_ascii=False)
        arrays: dict[str, Any] = {_MEMBER: np.array(text), **self.network.to_arrays()}

        def _write(temporary: Path) -> None:
            with temporary.open("wb") as file:
                np.savez_compressed(file, **arrays)

        atomic_write(path, _write)

    @classmethod
    def load(cls, path: str | Path) -> Bundle:
        """Loads a bundle.

        Raises:
            ValueError: if the file is not a bundle, is damaged, has a newer format, or was trained
                on an observation that differs from that of its environment in this version.
        """
        if not Path(path).is_file():
            raise ValueError(f"policy file {str(path)!r} does not exist")
        try:
            data, arrays = _read(path)
            env_id = data["env_id"]
            robot = _training_robot(env_id)
            _check_layout(env_id, data["observation"], "its environment", robot)
            return cls(
                env_id=env_id,
                base=find_base(data["base"]),
                action_mapping=find_action_mapping(data["steering"]),
                features=data["features"],
                network=Network.from_arrays(arrays),
                card=data["card"],
            )
        except KeyError as error:
            raise ValueError(
                f"policy bundle {str(path)!r} cannot be used: {error} is missing"
            ) from error
        # Damaged files raise errors of zipfile, its decompressors, numpy and json.
        except Exception as error:
            raise ValueError(
                f"policy bundle {str(path)!r} cannot be used: {' '.join(str(error).split())}"
            ) from error


def _read(path: str | Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Reads the JSON and the network's arrays from a file.

    Raises:
        Exception: of any type if the file is damaged.
    """
    with zipfile.ZipFile(path) as archive:
        if member := archive.testzip():
            raise ValueError(f"its member {member!r} is damaged")
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    data = json.loads(str(arrays.pop(_MEMBER)))
    if whole("its format", data["format"], least=1) > FORMAT:
        raise ValueError(
            f"its format {data['format']} is newer than {FORMAT}: upgrade cablebot-gym"
        )
    return data, arrays


def is_bundle(path: str | Path) -> bool:
    """Whether a file looks like a bundle: a zip with the member that holds the JSON."""
    try:
        with zipfile.ZipFile(path) as file:
            return f"{_MEMBER}.npy" in file.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def _training_robot(env_id: str) -> Robot:
    return find_robot(env_robot(env_id))


def _layout(robot: Robot) -> list[list[Any]]:
    return [[block.name, block.size] for block in observation_layout(robot).blocks]


def _check_layout(env_id: str, training_layout: Any, subject: str, robot: Robot) -> None:
    """Checks that the robot's observation begins with the blocks of the training; new blocks are
    appended."""
    layout = _layout(robot)
    if training_layout != layout[: len(training_layout)]:
        raise ValueError(
            f"the policy was trained on {env_id} with observation {training_layout}, but {subject} has {layout}: "
            "evaluate it on the environment that it was trained on"
        )
