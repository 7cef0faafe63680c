"""Bundles: the file format of learned policies. A bundle holds plain arrays and JSON; loading it executes no code."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.base import Base, find_base
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.steering import (
    Residual,
    Shift,
    Steering,
    action_mapping_to_jsonable,
    find_action_mapping,
)
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.utils.files import atomic_write

FORMAT = 1
"""Format number of bundles; a newer number is rejected."""

_MEMBER = "bundle"
"""Name of the array that holds the JSON."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bundle:
    """A learned policy: base law, action mapping, features and network.

    Raises:
        ValueError: if these are inconsistent.
    """

    env_id: str
    """Id of the training environment."""
    base: Base
    """Classical law that the network steers."""
    action_mapping: Shift | Residual
    """Mapping from the network's actions to the base law."""
    features: tuple[str, ...]
    """Names of the network's inputs, see :mod:`cablebot_baselines.learned.features`."""
    network: Network
    """Network from features to an action in [−1, 1]ⁿ, including the normalisation of its inputs."""
    card: Mapping[str, Any] = field(default_factory=dict)
    """Training record, JSON-able: command, seed, steps, wall time, versions."""

    def __post_init__(self) -> None:
        steering = self.steering(_trained_on(self.env_id))
        if self.network.inputs != steering.inputs:
            raise ValueError(f"the network has {self.network.inputs} inputs, but its features have {steering.inputs}")
        if self.network.outputs != steering.actions:
            outputs = f"the network has {self.network.outputs} outputs"
            raise ValueError(f"{outputs}, but an action on {self.env_id} has {steering.actions}")
        if not isinstance(self.card, Mapping):
            raise ValueError(f"the card must be a dict, not {self.card!r}")
        try:
            json.dumps(dict(self.card))
        except (TypeError, ValueError) as error:
            raise ValueError(f"the card must be JSON-able: {error}") from error

    def steering(self, robot: Robot) -> Steering:
        """The steered base law for a nominal robot.

        Raises:
            ValueError: if the robot's observation differs from the one that the policy was trained on.
        """
        check_layout(self.env_id, _trained_on(self.env_id), robot)
        return Steering(robot, base=self.base, action_mapping=self.action_mapping, features=self.features)

    def save(self, path: Path) -> None:
        """Writes the bundle atomically.

        Raises:
            OSError: if it cannot be written.
        """
        data = {
            "format": FORMAT,
            "env_id": self.env_id,
            "observation": _layout(_trained_on(self.env_id)),
            "base": asdict(self.base),
            "steering": action_mapping_to_jsonable(self.action_mapping),
            "features": list(self.features),
            "card": dict(self.card),
        }
        buffer = BytesIO()
        arrays: dict[str, Any] = {_MEMBER: np.array(json.dumps(data, ensure_ascii=False)), **self.network.to_arrays()}
        np.savez_compressed(buffer, **arrays)

        def write(temporary: Path) -> None:
            temporary.write_bytes(buffer.getvalue())

        atomic_write(path, write)

    @classmethod
    def load(cls, path: Path) -> Bundle:
        """Loads a bundle.

        Raises:
            ValueError: if the file is not a bundle, is damaged, has a newer format, or was trained on an observation
                that differs from that of its environment in this version.
        """
        if not path.is_file():
            raise ValueError(f"policy file {str(path)!r} does not exist")
        try:
            data, arrays = _read(path)
            env_id = data["env_id"]
            _compare(env_id, data["observation"], "its environment", _layout(_trained_on(env_id)))
            features = data["features"]
            return cls(
                env_id=env_id,
                base=find_base(data["base"]),
                action_mapping=find_action_mapping(data["steering"]),
                features=tuple(features) if isinstance(features, list) else features,
                network=Network.from_arrays(arrays),
                card=data["card"],
            )
        except Exception as error:  # damaged files raise errors of zipfile, its decompressors, numpy and json
            raise ValueError(f"policy bundle {str(path)!r} cannot be used: {_reason(error)}") from error


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Reads the JSON and the network's arrays from a file.

    Raises:
        Exception: of any type if the file is damaged.
    """
    with zipfile.ZipFile(path) as archive:
        if broken := archive.testzip():
            raise ValueError(f"its member {broken!r} is damaged")
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiubU":
            raise ValueError(f"its member {name!r} is not an array of numbers or text")
    data = json.loads(str(arrays.pop(_MEMBER)))
    if not isinstance(data, dict):
        raise ValueError(f"its member {_MEMBER!r} is not a JSON object")
    if not isinstance(data["format"], int) or data["format"] < 1:
        raise ValueError(f"its format must be a whole number from 1 to {FORMAT}, not {data['format']!r}")
    if data["format"] > FORMAT:
        raise ValueError(f"its format {data['format']} is newer than {FORMAT}: upgrade cablebot-gym")
    return data, arrays


def _reason(error: Exception) -> str:
    """The text of an error in one line."""
    words = " ".join(str(error).split())
    if isinstance(error, KeyError):
        return f"{words} is missing"
    return words if isinstance(error, ValueError) else f"it is damaged ({type(error).__name__}: {words})"


def is_bundle(path: Path) -> bool:
    """Whether a file looks like a bundle: a zip with the member that holds the JSON."""
    try:
        with zipfile.ZipFile(path) as file:
            return f"{_MEMBER}.npy" in file.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def check_layout(env_id: str, trained: Robot, robot: Robot) -> None:
    """Checks that a robot has the same observation layout as the robot of the training.

    Raises:
        ValueError: if the layouts differ; the message names both.
    """
    _compare(env_id, _layout(trained), f"robot {robot.name!r}", _layout(robot))


def _trained_on(env_id: str) -> Robot:
    if not isinstance(env_id, str):
        raise ValueError(f"env_id must be the id of an environment, not {env_id!r}")
    return find_robot(env_robot(env_id))


def _layout(robot: Robot) -> list[list[Any]]:
    return [[block.name, block.size] for block in observation_layout(robot).blocks]


def _compare(env_id: str, read: Any, other: str, present: list[list[Any]]) -> None:
    if read == present:
        return
    if not isinstance(read, list) or not all(isinstance(block, list) and len(block) == 2 for block in read):
        raise ValueError(f"its observation must be a list of pairs [name, size], not {read!r}")
    texts = [", ".join(f"{name} {size}" for name, size in layout) for layout in (read, present)]
    raise ValueError(
        f"the policy was trained on {env_id} with observation ({texts[0]}), but {other} has ({texts[1]}): "
        "evaluate it on the environment that it was trained on"
    )
