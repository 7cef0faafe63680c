"""Networks that answer a turned or mirrored motion with the turned or mirrored answer, as the robot itself does.

A planar robot with equal motors on a regular polygon of anchors is the same robot when it is turned by a corner or
mirrored: along a motion so moved it carries the same payload. A network that knows it learns from each motion what all
its images teach. Each layer's weights are made of those of one image: hidden units are a block for each symmetry, which
symmetries permute (group-equivariant layers: T. Cohen, M. Welling, ICML 2016). What comes out is an ordinary network.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

try:
    import torch
    from torch import Tensor, nn
except ImportError as error:
    raise ImportError("training needs torch: pip install 'cablebot-gym[sb3]'", name=error.name) from error

from cablebot_baselines.classical.law import Array
from cablebot_gym.robots import Robot

_SAME = 1e-9
"""Lengths and motors that differ by no more, relative to their size, are the same."""


def symmetries(robot: Robot) -> Array:
    """Turns and mirror images of the plane about the frame's origin that leave a planar robot what it is.

    Returns:
        (G, 2, 2), orthogonal, the identity first; it is alone where motors differ or the anchors are irregular.

    Raises:
        ValueError: if the robot is spatial: its rotations are not linear in the pose.
    """
    if not robot.planar:
        raise ValueError(f"symmetries are for planar robots, and {robot.name!r} is spatial: leave symmetric out")
    motors = [robot.pulley_radius, robot.pulley_inertia, robot.damping, robot.stall_torque, robot.speed_slope]
    if robot.flexible:
        motors += [robot.stiffness, robot.motor_inertia, robot.motor_damping]
    cables, kinds = robot.base, np.stack(motors, axis=1)
    found = {}
    for places in _permutations(cables):
        left, _, right = np.linalg.svd(cables[list(places)].T @ cables)  # the move that comes nearest to it
        move = left @ right
        there = np.allclose(cables @ move.T, cables[list(places)], rtol=0, atol=_SAME * np.abs(cables).max())
        if there and np.allclose(kinds, kinds[list(places)], rtol=_SAME, atol=0):
            found[places] = move
    return np.array([found[places] for places in sorted(found)])


def _permutations(cables: Array) -> Iterator[tuple[int, ...]]:
    """Whose place each anchor takes in the moves that bring the outermost one to some other's place."""
    angles, radii = np.arctan2(cables[:, 1], cables[:, 0]), np.linalg.norm(cables, axis=1)
    outermost = int(np.argmax(radii))
    for angle in angles:
        for turned in (angles - angles[outermost] + angle, angles[outermost] - angles + angle):
            moved = radii[:, None] * np.stack([np.cos(turned), np.sin(turned)], axis=1)
            places = np.linalg.norm(moved[:, None] - cables, axis=-1).argmin(axis=1)
            if len(set(places.tolist())) == len(cables):
                yield tuple(places.tolist())


class SymmetricLayers:
    """Linear layers to be trained, and the weights that symmetries make of them.

    Args:
        reads: what each symmetry does to the inputs, (G, inputs, inputs), orthogonal; G is 1 without symmetry.
        says: what it does to the outputs, (G, outputs, outputs), orthogonal.
        hidden: units of the layers between, for each symmetry.
    """

    def __init__(self, reads: Array, says: Array, hidden: Sequence[int]) -> None:
        group = len(says)
        quotients = np.einsum("gji,kjl->gkil", says, says)  # g⁻¹ k
        places = np.abs(quotients[:, :, None] - says).sum(axis=(-1, -2)).argmin(axis=-1)
        swaps = np.eye(group)[places]  # block k of what h moves is block h⁻¹ k
        between = [np.array([np.kron(swap, np.eye(units)) for swap in swaps]) for units in hidden]
        self._reads = [torch.tensor(read) for read in (reads, *between)]
        self._says = torch.tensor(says)
        sizes = zip(self._reads, (*hidden, says.shape[-1]), strict=True)
        self.layers = [nn.Linear(read.shape[-1], size, dtype=torch.float64) for read, size in sizes]
        """Weights and biases of one image."""

    def statistics(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of inputs (count, inputs) and all their images, each (inputs,)."""
        images = torch.cat([inputs @ read.T for read in self._reads[0]])
        return images.mean(0), images.std(0)

    def weights(self) -> list[tuple[Tensor, Tensor]]:
        """Weights (out, in) and biases (out,) of the whole layers."""
        # Block g of the units, and what is said about image g, read the inputs as g⁻¹ moves them.
        blocks = [layer.weight @ read.mT for layer, read in zip(self.layers, self._reads, strict=True)]
        biases: list[Tensor] = [layer.bias for layer in self.layers]
        made = [
            (block.flatten(0, 1), bias.repeat(len(block))) for block, bias in zip(blocks[:-1], biases[:-1], strict=True)
        ]
        return [*made, ((self._says @ blocks[-1]).mean(0), self._says.mean(0) @ biases[-1])]
