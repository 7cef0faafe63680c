"""Equivariant networks: rotating or reflecting the motion rotates or reflects the network's action.

A planar robot with equal motors and a regular polygon of anchors is invariant under rotations by a
corner and under reflections, and so is its DLCC along a transformed motion. An equivariant network
learns from each motion what it would learn from all images of the motion. The weights of each layer
derive from those of one image: the hidden units form one block per symmetry, and symmetries permute
the blocks (group-equivariant layers: T. Cohen, M. Welling, ICML 2016). The result is an ordinary
network.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from typing import Any

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
        "load_friction",
    )
    motors = [getattr(robot, name) for name in names]
    if robot.flexible:
        motors += [robot.stiffness, robot.motor_inertia, robot.motor_damping]
    anchors = robot.base
    parameters = np.stack(motors, axis=1)
    tolerance = _TOLERANCE * np.abs(anchors).max()
    transforms = []
    for permutation in permutations(range(robot.cables)):
        order = list(permutation)
        permuted = anchors[order]
        # The closest orthogonal transform.
        left_vectors, _, right_vectors = np.linalg.svd(permuted.T @ anchors)
        transform = left_vectors @ right_vectors
        moved = anchors @ transform.T
        same_anchors = np.allclose(moved, permuted, rtol=0, atol=tolerance)
        same_motors = np.allclose(parameters, parameters[order], rtol=_TOLERANCE, atol=0)
        if same_anchors and same_motors:
            transforms.append(transform)
    return np.array(transforms)


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
        swaps = _block_permutations(output_transforms)
        self._output_transforms = torch.tensor(output_transforms)
        self._input_transforms = [torch.tensor(input_transforms)]
        for units in hidden:
            unit_blocks = np.eye(units)
            transforms = np.array([np.kron(swap, unit_blocks) for swap in swaps])
            self._input_transforms.append(torch.tensor(transforms))
        self.layers: Any = nn.ModuleList()
        """Weights and biases of one image."""
        sizes = (*hidden, output_transforms.shape[-1])
        for layer_transforms, outputs in zip(self._input_transforms, sizes, strict=True):
            inputs = layer_transforms.shape[-1]
            layer = nn.Linear(inputs, outputs, dtype=torch.float64)
            self.layers.append(layer)

    def statistics(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and standard deviation of inputs (count, inputs) and all their images, each
        (inputs,)."""
        input_transforms = self._input_transforms[0]
        images = torch.cat([inputs @ transform.T for transform in input_transforms])
        return images.mean(0), images.std(0)

    def weights(self) -> list[tuple[Tensor, Tensor]]:
        """Weights (out, in) and biases (out,) of the equivariant layers."""
        # Block g of the units, and the output for image g, use the inputs transformed by g⁻¹.
        derived = []
        for layer, transforms in zip(self.layers, self._input_transforms, strict=True):
            blocks = layer.weight @ transforms.mT
            derived.append((blocks, layer.bias))
        blocks, bias = derived.pop()
        weights = []
        for hidden_blocks, hidden_bias in derived:
            weight = hidden_blocks.flatten(0, 1)
            weights.append((weight, hidden_bias.repeat(len(hidden_blocks))))
        output_weight = (self._output_transforms @ blocks).mean(0)
        output_bias = self._output_transforms.mean(0) @ bias
        weights.append((output_weight, output_bias))
        return weights


def _block_permutations(transforms: Array) -> Array:
    """Permutation matrices of the symmetries on the blocks of hidden units, (G, G, G): symmetry h
    maps block h⁻¹ k to block k."""
    quotients = np.einsum("gji,kjl->gkil", transforms, transforms)  # g⁻¹ k
    differences = np.abs(quotients[:, :, None] - transforms)
    distances = differences.sum(axis=(-1, -2))
    block_indices = distances.argmin(axis=-1)
    return np.eye(len(transforms))[block_indices]
