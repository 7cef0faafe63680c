"""Policies in ONNX files, as ``cablebot export-policy`` writes them (extra ``onnx``)."""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_gym.envs.observation import ObservationLayout, observation_layout
from cablebot_gym.policies.protocol import Array
from cablebot_gym.robots import Robot

FORMAT = "1"
"""Version of the metadata in a file."""

OBSERVATION, ACTION = "observation", "action"
"""Names of the input (N, size) and of the output (N, m) of a file."""


class OnnxPolicy:
    """A policy that ONNX Runtime computes on one core.

    Args:
        file: content of a file.

    Raises:
        ImportError: if ONNX Runtime is missing.
        Exception: if the file is damaged.
    """

    def __init__(self, file: bytes) -> None:
        try:
            import onnxruntime
        except ImportError:
            raise ImportError(
                "an ONNX policy needs onnxruntime: pip install 'cablebot-gym[onnx]'"
            ) from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        self._session = onnxruntime.InferenceSession(
            file, options, providers=["CPUExecutionProvider"]
        )
        self.metadata: dict[str, str] = self._session.get_modelmeta().custom_metadata_map
        """Texts by name, see :func:`metadata`."""

    @property
    def size(self) -> int:
        """Number of components of the observation."""
        return int(self._session.get_inputs()[0].shape[-1])

    def predict(
        self,
        observation: Array,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """The actions, always the deterministic ones, and the state as it was given."""
        rows = np.atleast_2d(np.asarray(observation, float))
        (actions,) = self._session.run([ACTION], {OBSERVATION: rows})
        return (actions if np.ndim(observation) > 1 else actions[0]), state


def metadata(robot: Robot, **texts: str) -> dict[str, str]:
    """The metadata of the file of a policy for a robot, with further texts."""
    return {
        "format": FORMAT,
        "cablebot_gym_version": version("cablebot-gym"),
        "robot": robot.name,
        "observation": _blocks(observation_layout(robot)),
        "action": "torque of each motor over its stall torque, from -1 to 1; positive winds in",
        **texts,
    }


def load_onnx(path: Path, robot: Robot) -> OnnxPolicy:
    """A policy from a file for a nominal robot.

    Raises:
        ImportError: if ONNX Runtime is missing.
        ValueError: if the file is damaged, from another program, or made for another observation.
    """
    subject = f"policy file {str(path)!r}"
    try:
        policy = OnnxPolicy(path.read_bytes())
    except ImportError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200]
        raise ValueError(f"{subject} is damaged, export it again ({reason})") from error
    if policy.metadata.get("format") != FORMAT:
        raise ValueError(
            f"{subject} was not written by this version of `cablebot export-policy`: export its "
            "model again"
        )
    layout = observation_layout(robot)
    if policy.metadata["observation"] != _blocks(layout):
        raise ValueError(
            f"{subject} does not fit robot {robot.name!r}: it reads the observation of "
            f"{policy.metadata['env_id']} ({policy.size} numbers), not that of this robot "
            f"({layout.size} numbers). Train and export a model for its environment"
        )
    return policy


def _blocks(layout: ObservationLayout) -> str:
    """Names, sizes and units of the blocks of an observation as JSON."""
    blocks = [
        {"name": block.name, "size": block.size, "unit": block.unit} for block in layout.blocks
    ]
    return json.dumps(blocks, ensure_ascii=False)
