"""A small neural network in NumPy arrays, for policies that run without torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from cablebot_baselines.laws.law import Array
from cablebot_gym.utils.checks import choice

ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "relu": lambda values: np.maximum(values, 0.0),
}
"""Activation functions after each layer except the last, by name."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Network:
    """A multilayer perceptron with normalised and clipped inputs, and a linear last layer.

    Raises:
        ValueError: if the shapes of the arrays are inconsistent, or a number is not finite.
    """

    mean: Array
    """Mean of the inputs, (inputs,)."""
    scale: Array
    """Scale of the inputs, (inputs,); > 0."""
    weights: tuple[Array, ...]
    """Weights of each layer, (out, in)."""
    biases: tuple[Array, ...]
    """Biases of each layer, (out,)."""
    activation: str = "tanh"
    """Activation function, one of :data:`ACTIVATIONS`."""

    CUT = 10.0
    """Bound at which normalised inputs are clipped."""

    def __post_init__(self) -> None:
        choice("activation", self.activation, ACTIVATIONS)
        if not self._has_consistent_shapes():
            raise ValueError("the shapes of the network's layers are inconsistent")
        arrays = (self.mean, self.scale, *self.weights, *self.biases)
        is_finite = all(np.isfinite(array).all() for array in arrays)
        if not is_finite or not np.all(self.scale > 0):
            raise ValueError(
                "the network's numbers must be finite, and the scale of its inputs must be above 0"
            )

    def _has_consistent_shapes(self) -> bool:
        if not self.biases or len(self.weights) != len(self.biases):
            return False
        if self.mean.ndim != 1 or self.scale.shape != self.mean.shape:
            return False
        inputs = self.inputs
        for weight, bias in zip(self.weights, self.biases, strict=True):
            if bias.ndim != 1 or weight.shape != (len(bias), inputs):
                return False
            inputs = len(bias)
        return True

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return len(self.mean)

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return len(self.biases[-1])

    def __call__(self, values: Array) -> Array:
        """Outputs (..., outputs) for inputs (..., inputs)."""
        normalised = (values - self.mean) / self.scale
        values = np.clip(normalised, -self.CUT, self.CUT)
        activate = ACTIVATIONS[self.activation]
        *hidden_layers, last_layer = zip(self.weights, self.biases, strict=True)
        for weight, bias in hidden_layers:
            values = activate(values @ weight.T + bias)
        weight, bias = last_layer
        return values @ weight.T + bias

    def to_arrays(self) -> dict[str, Array]:
        """The network as arrays by name, for :meth:`from_arrays`."""
        arrays = {
            "mean": self.mean,
            "scale": self.scale,
            "activation": np.array(self.activation),
        }
        for index, weight in enumerate(self.weights):
            arrays[f"weight{index}"] = weight
        for index, bias in enumerate(self.biases):
            arrays[f"bias{index}"] = bias
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> Network:
        """Creates a network from the arrays of :meth:`to_arrays`.

        Raises:
            KeyError: if an array is missing.
            ValueError: if the arrays are not those of a network.
        """
        count = sum(name.startswith("weight") for name in arrays)
        if count == 0:
            raise KeyError("weight0")

        def floats(name: str) -> Array:
            return np.asarray(arrays[name], float)

        indices = range(count)
        return cls(
            mean=floats("mean"),
            scale=floats("scale"),
            weights=tuple(floats(f"weight{index}") for index in indices),
            biases=tuple(floats(f"bias{index}") for index in indices),
            activation=str(arrays["activation"]),
        )


def zero_network(inputs: int, outputs: int) -> Network:
    """A network with output 0 for every input; its policy is the base law alone."""
    weight = np.zeros((outputs, inputs))
    bias = np.zeros(outputs)
    return Network(
        mean=np.zeros(inputs),
        scale=np.ones(inputs),
        weights=(weight,),
        biases=(bias,),
    )
