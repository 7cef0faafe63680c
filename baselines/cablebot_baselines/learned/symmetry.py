"""Equivariant networks: rotating or reflecting the motion rotates or reflects the network's action.

A planar robot with equal motors and a regular polygon of anchors is invariant under rotations by a
corner and under reflections, and so is its DLCC along a transformed motion. An equivariant network
learns from each motion what it would learn from all images of the motion. The weights of each layer
derive from those of one image: the hidden units form one block per symmetry, and symmetries permute
the blocks (group-equivariant layers: T. Cohen, M. Welling, ICML 2016). The result is an ordinary
network.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

try:
    import torch
    from torch import Tensor, nn
except ImportError as error:
    raise ImportError(
        "training needs torch: pip install 'cablebot-gym[sb3]'", name=error.name
    ) from error

from cablebot_baselines.classical.law import Array
from cablebot_gym.robots import Robot

_TOLERANCE = 1e-9
"""Relative difference up to which lengths and motor parameters are equal."""


def symmetries(robot: Robot) -> Array:
    """Rotations and reflections of the plane about the frame's origin under which a planar robot is
    invariant.

    Returns:
        Orthogonal matrices (G, 2, 2), the identity first; only the identity if the motors differ or
        the anchors are irregular.

    Raises:
        ValueError: if the robot is spatial: rotations are not linear in its pose.
    """
    if robot.kind != "planar" or not robot.weightless:
        raise ValueError(
            f"symmetric is for planar robots, but {robot.name!r} is spatial: remove symmetric"
        )
    names = (
        "pulley_radius",
        "pulley_inertia",
        "damping",
        "stall_torque",
        "speed_slope",
        "motor_lag",
        "coulomb_friction",
    )
    motors = [getattr(robot, name) for name in names]
    if robot.flexible:
        motors += [robot.stiffness, robot.motor_inertia, robot.motor_damping]
    cables, kinds = robot.base, np.stack(motors, axis=1)
    transforms = {}
    for permutation in _permutations(cables):
        permuted = list(permutation)
        left, _, right = np.linalg.svd(
            cables[permuted].T @ cables
        )  # the closest orthogonal transform
        transform = left @ right
        same_anchors = np.allclose(
            cables @ transform.T, cables[permuted], rtol=0, atol=_TOLERANCE * np.abs(cables).max()
        )
        if same_anchors and np.allclose(kinds, kinds[permuted], rtol=_TOLERANCE, atol=0):
            transforms[permutation] = transform
    return np.array([transforms[permutation] for permutation in sorted(transforms)])


def _permutations(cables: Array) -> Iterator[tuple[int, ...]]:
    """Permutations of the anchors by the transforms that move the outermost anchor onto some
    anchor."""
    angles = np.arctan2(cables[:, 1], cables[:, 0])
    radii = np.linalg.norm(cables, axis=1)
    outermost = int(np.argmax(radii))
    for angle in angles:
        for transformed in (angles - angles[outermost] + angle, angles[outermost] - angles + angle):
            moved = radii[:, None] * np.stack([np.cos(transformed), np.sin(transformed)], axis=1)
            indices = np.linalg.norm(moved[:, None] - cables, axis=-1).argmin(axis=1)
            if len(set(indices.tolist())) == len(cables):
                yield tuple(indices.tolist())


class SymmetricLayers:
    """Trainable linear layers of one image, and the equivariant layers derived from them.

    Args:
        input_transforms: orthogonal matrices of the symmetries on the inputs, (G, inputs, inputs);
            G is 1 without symmetry.
        output_transforms: orthogonal matrices of the symmetries on the outputs, (G, outputs,
            outputs).
        hidden: units of the hidden layers, for each symmetry.
    """

    def __init__(
        self, input_transforms: Array, output_transforms: Array, hidden: Sequence[int]
    ) -> None:
        group = len(output_transforms)
        quotients = np.einsum("gji,kjl->gkil", output_transforms, output_transforms)  # g⁻¹ k
        indices = (
            np.abs(quotients[:, :, None] - output_transforms).sum(axis=(-1, -2)).argmin(axis=-1)
        )
        swaps = np.eye(group)[indices]  # h maps block h⁻¹ k to block k
        between = [np.array([np.kron(swap, np.eye(units)) for swap in swaps]) for units in hidden]
        self._input_transforms = [
            torch.tensor(transforms) for transforms in (input_transforms, *between)
        ]
        self._output_transforms = torch.tensor(output_transforms)
        sizes = zip(self._input_transforms, (*hidden, output_transforms.shape[-1]), strict=True)
        self.layers = [
            nn.Linear(transforms.shape[-1], size, dtype=torch.float64) for transforms, size in sizes
        ]
        """Weights and biases of one image."""

    def statistics(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of inputs (count, inputs) and all their images, each
        (inputs,)."""
        images = torch.cat([inputs @ transform.T for transform in self._input_transforms[0]])
        return images.mean(0), images.std(0)

    def weights(self) -> list[tuple[Tensor, Tensor]]:
        """Weights (out, in) and biases (out,) of the equivariant layers."""
        # Block g of the units, and the output for image g, use the inputs transformed by g⁻¹.
        pairs = zip(self.layers, self._input_transforms, strict=True)
        blocks = [layer.weight @ transforms.mT for layer, transforms in pairs]
        biases: list[Tensor] = [layer.bias for layer in self.layers]
        hidden = [
            (block.flatten(0, 1), bias.repeat(len(block)))
            for block, bias in zip(blocks[:-1], biases[:-1], strict=True)
        ]
        outputs = self._output_transforms
        return [*hidden, ((outputs @ blocks[-1]).mean(0), outputs.mean(0) @ biases[-1])]
