"""A small neural network in NumPy arrays, for policies that run without torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from cablebot_baselines.classical.law import Array
from cablebot_gym.utils.checks import choice


def _ball(values: Array) -> Array:
    """Squashes the first (at most three) numbers as one vector, x/√(1 + |x|²), and each other
    number on its own."""
    square = values**2
    square[..., :3] = np.sum(square[..., :3], axis=-1, keepdims=True)
    squashed: Array = values / np.sqrt(1 + square)
    return squashed


ACTIVATIONS: dict[str, Callable[[Array], Array]] = {
    "tanh": np.tanh,
    "relu": lambda values: np.maximum(values, 0.0),
}
"""Activation functions after each layer except the last, by name."""

SQUASHES: dict[str, Callable[[Array], Array]] = {
    "none": lambda values: values,
    "tanh": np.tanh,
    "ball": _ball,
}
"""Functions after the last layer, by name; ``ball`` keeps a position within the unit ball, and
angles within ±1."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Network:
    """A multilayer perceptron with normalised and clipped inputs, and a linear last layer with an
    optional squash.

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
    squash: str = "tanh"
    """Function after the last layer, one of :data:`SQUASHES`."""

    CUT = 10.0
    """Bound at which normalised inputs are clipped."""

    def __post_init__(self) -> None:
        for name, known in (("activation", ACTIVATIONS), ("squash", SQUASHES)):
            choice(name, getattr(self, name), known)
        sizes = (self.mean.size, *(bias.size for bias in self.biases))
        vectors = (self.mean, *self.biases)
        if (
            not self.biases
            or self.scale.shape != self.mean.shape
            or [vector.shape for vector in vectors] != [(size,) for size in sizes]
            or [weight.shape for weight in self.weights] != [*zip(sizes[1:], sizes, strict=False)]
        ):
            raise ValueError("the shapes of the network's layers are inconsistent")
        arrays = (self.mean, self.scale, *self.weights, *self.biases)
        if not all(np.all(np.isfinite(array)) for array in arrays) or not np.all(self.scale > 0):
            raise ValueError(
                "the network's numbers must be finite, and the scale of its inputs must be above 0"
            )

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
        values = np.clip((values - self.mean) / self.scale, -self.CUT, self.CUT)
        *hidden, (weight, bias) = zip(self.weights, self.biases, strict=True)
        for hidden_weight, hidden_bias in hidden:
            values = ACTIVATIONS[self.activation](values @ hidden_weight.T + hidden_bias)
        return SQUASHES[self.squash](values @ weight.T + bias)

    def to_arrays(self) -> dict[str, Array]:
        """The network as arrays by name, for :meth:`from_arrays`."""
        layers = {f"weight{index}": values for index, values in enumerate(self.weights)}
        layers |= {f"bias{index}": values for index, values in enumerate(self.biases)}
        names = {"activation": np.array(self.activation), "squash": np.array(self.squash)}
        return {"mean": self.mean, "scale": self.scale, **names, **layers}

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

        def layers(kind: str) -> tuple[Array, ...]:
            return tuple(np.asarray(arrays[f"{kind}{index}"], float) for index in range(count))

        return cls(
            mean=np.asarray(arrays["mean"], float),
            scale=np.asarray(arrays["scale"], float),
            weights=layers("weight"),
            biases=layers("bias"),
            activation=str(arrays["activation"]),
            squash=str(arrays["squash"]),
        )


def zero_network(inputs: int, outputs: int) -> Network:
    """A network with output 0 for every input; its policy is the base law alone."""
    zeros = (np.zeros((outputs, inputs)),)
    return Network(
        mean=np.zeros(inputs), scale=np.ones(inputs), weights=zeros, biases=(np.zeros(outputs),)
    )
