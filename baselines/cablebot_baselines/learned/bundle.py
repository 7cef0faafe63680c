"""What a learned policy is kept in: plain arrays and JSON in one file, nothing in which is ever run."""

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
from cablebot_baselines.learned.steering import Residual, Shift, Steering, find_way, way_to_plain
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.utils.files import write_whole

FORMAT = 1
"""Of bundles; one that is newer is refused."""

_MEMBER = "bundle"
"""Array that holds the JSON."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Bundle:
    """All that a learned policy is.

    Raises:
        ValueError: if the parts do not fit each other.
    """

    env_id: str
    """Environment that it was trained for."""
    base: Base
    """The classical law that is steered."""
    way: Shift | Residual
    """How the network's actions steer it."""
    features: tuple[str, ...]
    """What the network reads, see :mod:`cablebot_baselines.learned.features`."""
    network: Network
    """From features to an action in [−1, 1]ⁿ; its normalisation is part of it."""
    card: Mapping[str, Any] = field(default_factory=dict)
    """How it was made, JSON-able: command, seed, steps, wall time, versions."""

    def __post_init__(self) -> None:
        steering = self.steering(_trained_on(self.env_id))
        if self.network.inputs != steering.inputs:
            raise ValueError(f"the network reads {self.network.inputs} numbers, its features are {steering.inputs}")
        if self.network.outputs != steering.actions:
            given = f"the network gives {self.network.outputs} numbers"
            raise ValueError(f"{given}, an action on {self.env_id} has {steering.actions}")
        if not isinstance(self.card, Mapping):
            raise ValueError(f"the card must be a dict, not {self.card!r}")
        try:
            json.dumps(dict(self.card))
        except (TypeError, ValueError) as error:
            raise ValueError(f"the card must be JSON-able: {error}") from error

    def steering(self, robot: Robot) -> Steering:
        """What the network steers, on a nominal robot.

        Raises:
            ValueError: if the robot has another observation than the policy was trained on.
        """
        check_layout(self.env_id, _trained_on(self.env_id), robot)
        return Steering(robot, base=self.base, way=self.way, features=self.features)

    def save(self, path: Path) -> None:
        """Writes the bundle, whole or not at all.

        Raises:
            OSError: if it cannot be written.
        """
        data = {
            "format": FORMAT,
            "env_id": self.env_id,
            "observation": _layout(_trained_on(self.env_id)),
            "base": asdict(self.base),
            "steering": way_to_plain(self.way),
            "features": list(self.features),
            "card": dict(self.card),
        }
        buffer = BytesIO()
        arrays: dict[str, Any] = {_MEMBER: np.array(json.dumps(data, ensure_ascii=False)), **self.network.to_arrays()}
        np.savez_compressed(buffer, **arrays)

        def write(temporary: Path) -> None:
            temporary.write_bytes(buffer.getvalue())

        write_whole(path, write)

    @classmethod
    def load(cls, path: Path) -> Bundle:
        """A bundle that was saved.

        Raises:
            ValueError: if the file is no bundle, is damaged, is newer than this package, or was made for another
                observation than its environment gives now.
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
                way=find_way(data["steering"]),
                features=tuple(features) if isinstance(features, list) else features,
                network=Network.from_arrays(arrays),
                card=data["card"],
            )
        except Exception as error:  # damage brings up errors of zipfile, its decompressors, numpy and json
            raise ValueError(f"policy bundle {str(path)!r} cannot be used: {_reason(error)}") from error


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """The description in a file, of a format that is known, and the network's arrays.

    Raises:
        Exception: whatever a damaged file brings about.
    """
    with zipfile.ZipFile(path) as whole:
        if broken := whole.testzip():
            raise ValueError(f"its part {broken!r} is damaged")
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiubU":
            raise ValueError(f"its part {name!r} is no array of numbers or text")
    data = json.loads(str(arrays.pop(_MEMBER)))
    if not isinstance(data, dict):
        raise ValueError(f"its part {_MEMBER!r} is no JSON object")
    if not isinstance(data["format"], int) or data["format"] < 1:
        raise ValueError(f"its format is {data['format']!r}, no whole number from 1 to {FORMAT}")
    if data["format"] > FORMAT:
        raise ValueError(f"its format {data['format']} is newer than this package reads, {FORMAT}: upgrade")
    return data, arrays


def _reason(error: Exception) -> str:
    """An error's words in one line."""
    words = " ".join(str(error).split())
    if isinstance(error, KeyError):
        return f"{words} is missing"
    return words if isinstance(error, ValueError) else f"it is damaged ({type(error).__name__}: {words})"


def is_bundle(path: Path) -> bool:
    """Whether a file claims to be a bundle: a zip with the member that holds its JSON."""
    try:
        with zipfile.ZipFile(path) as file:
            return f"{_MEMBER}.npy" in file.namelist()
    except (OSError, zipfile.BadZipFile):
        return False


def check_layout(env_id: str, trained: Robot, robot: Robot) -> None:
    """Refuses a robot whose observation is laid out otherwise than that of the robot trained on.

    Raises:
        ValueError: with both layouts.
    """
    _compare(env_id, _layout(trained), f"robot {robot.name!r}", _layout(robot))


def _trained_on(env_id: str) -> Robot:
    if not isinstance(env_id, str):
        raise ValueError(f"env_id must be the name of an environment, not {env_id!r}")
    return find_robot(env_robot(env_id))


def _layout(robot: Robot) -> list[list[Any]]:
    return [[block.name, block.size] for block in observation_layout(robot).blocks]


def _compare(env_id: str, read: Any, other: str, present: list[list[Any]]) -> None:
    if read == present:
        return
    if not isinstance(read, list) or not all(isinstance(block, list) and len(block) == 2 for block in read):
        raise ValueError(f"its observation must be pairs of a name and a size, not {read!r}")
    texts = [", ".join(f"{name} {size}" for name, size in layout) for layout in (read, present)]
    raise ValueError(
        f"the policy was trained on {env_id} and reads ({texts[0]}), but {other} gives ({texts[1]}): "
        "evaluate it on the environment that it was trained on"
    )
