"""Policies of reinforcement learning: a trained actor steers ``observing``. They need no torch."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_baselines.entries import DATA
from cablebot_baselines.laws.law import Array
from cablebot_baselines.learned.shipped import WEIGHTS, weights_of
from cablebot_baselines.learned.steering import Memory, Steering
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import Robot
from cablebot_gym.utils.files import atomic_write


class SteeredPolicy(Steering):
    """Policy of a trained actor, without exploration.

    Args:
        robot: nominal robot.
        path: file of :func:`save_policy`. It holds arrays only and runs no code.

    Raises:
        ValueError: if the file cannot be read, or the actor was trained for a robot with other
            observations or actions.
    """

    def __init__(self, robot: Robot, path: str | Path) -> None:
        super().__init__(robot)
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = [file[name].astype(float) for name in file.files]
        except Exception as error:  # of zipfile and numpy
            raise ValueError(f"cannot read the policy in {str(path)!r} ({error})") from error
        self._layers = list(zip(arrays[::2], arrays[1::2], strict=True))
        sizes = (arrays[0].shape[1], len(arrays[-1]))
        if sizes != (self.inputs, robot.coordinates):
            raise ValueError(
                f"the policy has {sizes[0]} inputs and {sizes[1]} actions, but robot {robot.name!r} has "
                f"{self.inputs} and {robot.coordinates}: evaluate it on the robot of its training"
            )

    def act(self, observed: Array) -> Array:
        """The actor's actions, not clipped, (..., n), for observations of a learner, (..., inputs)."""
        *hidden, last = self._layers
        for weight, bias in hidden:
            observed = np.tanh(observed @ weight.T + bias)
        weight, bias = last
        action: Array = observed @ weight.T + bias
        return action

    def respond(
        self, blocks: dict[str, Array], state: Any = None, episode_start: Any = None
    ) -> tuple[Array, Memory]:
        """Actions within ±1 from the blocks of an observation, and the next state."""
        memory = self.started(state, episode_start, blocks["pose"].shape[:-1])
        action = memory.actions[..., -1, :]
        if self.due(memory).any():
            action = self.act(self.observe(blocks, memory))
        return self.steer(blocks, action, memory, episode_start)


def save_policy(model: Any, path: str | Path) -> None:
    """Writes the actor of a PPO model of Stable-Baselines3 for ``--policy FILE``.

    Args:
        model: a model with an ``MlpPolicy`` and ``nn.Tanh``.
        path: the file, ``.zip``.
    """
    policy = model.policy
    parts = (policy.mlp_extractor.policy_net, policy.action_net)
    arrays = [values.detach().numpy() for part in parts for values in part.parameters()]
    buffer = BytesIO()
    np.savez(buffer, *arrays)
    atomic_write(path, lambda temporary: temporary.write_bytes(buffer.getvalue()))


def load_ppo(robot: Robot) -> SteeredPolicy:
    """Loads ``ppo`` for a nominal robot.

    Raises:
        ValueError: if no network is shipped for the robot.
    """
    return SteeredPolicy(robot, weights_of(robot, "ppo"))


PPO = PolicyEntry(factory=load_ppo, files=tuple(sorted(WEIGHTS.glob("ppo-*.zip"))), **DATA["ppo"])
"""The entry of the policy."""
