"""A small network as plain arrays: what ships, and what runs without torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cablebot_baselines.classical.law import Array


def _ball(values: Array) -> Array:
    """x/√(1 + |x|²) of the first three or fewer numbers together, and of each of the others on its own."""
    lines = min(3, values.shape[-1])
    square = values**2
    square[..., :lines] = np.sum(square[..., :lines], axis=-1, keepdims=True)
    squashed: Array = values / np.sqrt(1 + square)
    return squashed


ACTIVATIONS: dict[str, Callable[[Array], Array]] = {"tanh": np.tanh, "relu": lambda values: np.maximum(values, 0.0)}
"""After each layer but the last, by name."""

SQUASHES: dict[str, Callable[[Array], Array]] = {"none": lambda values: values, "tanh": np.tanh, "ball": _ball}
"""After the last layer, by name; ``ball`` keeps a position within the unit ball, and angles within ±1."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Network:
    """Inputs are normalised and cut; layers follow, and a linear one whose outputs may be squashed.

    Raises:
        ValueError: if the shapes of the arrays do not fit each other, or a number is not finite.
    """

    mean: Array
    """Of the inputs, (inputs,)."""
    scale: Array
    """Of the inputs, (inputs,); > 0."""
    weights: tuple[Array, ...]
    """Of each layer, (out, in)."""
    biases: tuple[Array, ...]
    """Of each layer, (out,)."""
    activation: str = "tanh"
    """One of :data:`ACTIVATIONS`."""
    squash: str = "tanh"
    """One of :data:`SQUASHES`."""

    CUT = 10.0
    """Largest normalised input."""

    def __post_init__(self) -> None:
        for name, known in (("activation", ACTIVATIONS), ("squash", SQUASHES)):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} must be one of {', '.join(known)}, not {getattr(self, name)!r}")
        size = len(self.mean)
        fits = self.scale.shape == self.mean.shape == (size,) and len(self.weights) == len(self.biases) > 0
        for weight, bias in zip(self.weights, self.biases, strict=False):
            fits = fits and weight.ndim == 2 and weight.shape[1] == size and bias.shape == (weight.shape[0],)
            size = weight.shape[0]
        if not fits:
            raise ValueError("the layers of the network do not fit each other")
        arrays = (self.mean, self.scale, *self.weights, *self.biases)
        if not all(np.all(np.isfinite(array)) for array in arrays) or not np.all(self.scale > 0):
            raise ValueError("the network's numbers must be finite, and the scale of its inputs greater than 0")

    @property
    def inputs(self) -> int:
        """Size of what it reads."""
        return len(self.mean)

    @property
    def outputs(self) -> int:
        """Size of what it gives."""
        return len(self.biases[-1])

    def __call__(self, values: Array) -> Array:
        """Outputs (..., outputs) for inputs (..., inputs)."""
        values = np.clip((values - self.mean) / self.scale, -self.CUT, self.CUT)
        last = len(self.weights) - 1
        for place, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ weight.T + bias
            if place < last:
                values = ACTIVATIONS[self.activation](values)
        return SQUASHES[self.squash](values)

    def to_arrays(self) -> dict[str, Array]:
        """Everything as arrays by name; :meth:`from_arrays` reads them."""
        layers = {f"weight{place}": values for place, values in enumerate(self.weights)}
        layers |= {f"bias{place}": values for place, values in enumerate(self.biases)}
        names = {"activation": np.array(self.activation), "squash": np.array(self.squash)}
        return {"mean": self.mean, "scale": self.scale, **names, **layers}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> Network:
        """A network from :meth:`to_arrays`, or from a file of them.

        Raises:
            KeyError: if an array is missing.
            ValueError: if they are no network's.
        """
        count = sum(name.startswith("weight") for name in arrays)
        if count == 0:
            raise KeyError("weight0")

        def layers(kind: str) -> Sequence[Array]:
            return [np.asarray(arrays[f"{kind}{place}"], float) for place in range(count)]

        return cls(
            mean=np.asarray(arrays["mean"], float),
            scale=np.asarray(arrays["scale"], float),
            weights=tuple(layers("weight")),
            biases=tuple(layers("bias")),
            activation=str(arrays["activation"]),
            squash=str(arrays["squash"]),
        )
