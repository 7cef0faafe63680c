"""Random loops and their seeds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.motions.base import Motion, unit_blend
from cablebot_gym.motions.derivatives import (
    composed,
    scaled,
    sine_derivatives,
    turn_from_rest,
)
from cablebot_gym.utils.checks import whole

TRAINING_SEEDS = range(10_000)
"""Seeds of :class:`RandomLoop` for training and tuning."""

FIRST_HELD_OUT_SEED = TRAINING_SEEDS.stop
"""First held-out seed. No policy may be trained, tuned or selected with this seed or a larger
one."""


def held_out_seeds(count: int) -> range:
    """The first ``count`` held-out seeds.

    Raises:
        ValueError: if ``count`` is not a whole number of at least 1.
    """
    return range(FIRST_HELD_OUT_SEED, FIRST_HELD_OUT_SEED + whole("count", count, least=1))


@dataclass(frozen=True, kw_only=True)
class RandomLoop(Motion):
    """A random closed curve, traversed once from rest to rest. The seed determines the curve, and
    whether it is even or odd the motion along it.

    All coordinates are Fourier series of one phase φ, which goes from 0 to 2π:

        X(φ) = c + Σ_k (a_k cos kφ + b_k sin kφ),   k = 1 … :data:`HARMONICS`.

    The components of a_k and b_k are uniform in ± 1/k³. The coordinates form groups: (x, y), z and
    (ψ, θ, φ), or (x, y) and φ in a plane.

    * Size: each group is scaled so that the largest norm of its series is 50 to 100 % of its
      ``reach``.
    * Center: the offset of c from ``center`` uses at most the rest of ``reach``, so the curve stays
      within ``reach``.
    * Start: the pose of the curve that is nearest to ``start``, in units of ``reach``.
    * Phase: an even seed goes along :data:`~cablebot_gym.motions.base.BLEND`, and the motion
      is C⁴. An odd seed goes as :class:`~cablebot_gym.motions.curves.PaperCircle`: φ̈ is
      constant over the first half of the duration and negative over the second. The acceleration
      jumps at the start, at half time and at the end, and φ has no higher derivatives.
    * Duration: the shortest one, rounded up to 10 ms, for which no group exceeds a random fraction
      (:data:`LEAST_FRACTION` to 100 %) of its ``acceleration``. The speed then stays below √(2 ·
      reach · acceleration) by Landau's inequality.

    The random numbers are raw bits of numpy's Philox generator. They do not change between versions
    of numpy, so a seed always gives the same curve. Norms and accelerations are sampled; their
    peaks are accurate to 0.1 %.

    Raises:
        ValueError: if the seed is not a whole number of at least 0, or another value is invalid.
    """

    seed: int = 0
    """Seed of the curve; ≥ 0. :data:`TRAINING_SEEDS` are for training, seeds from
    :data:`FIRST_HELD_OUT_SEED` on for scores only."""
    center: tuple[float, ...]
    """Center pose of the curve, shape (n,)."""
    start: tuple[float, ...]
    """Pose near which the curve starts, shape (n,): one where a robot at rest holds more than along
    the curve."""
    reach: tuple[float, ...]
    """Largest distance of the curve from ``center``, one norm per group; > 0: one each for (x, y)
    [m], z [m] and (ψ, θ, φ) [rad], or for (x, y) [m] and φ [rad] in a plane."""
    acceleration: tuple[float, ...]
    """Bound of the norm of the acceleration [m/s², rad/s²], one per group as in ``reach``; > 0."""
    duration: float = None  # type: ignore[assignment]  # __post_init__ replaces None
    """Duration of the motion [s]; > 0. None: computed from the seed and ``acceleration``.
    ``dataclasses.replace`` keeps the computed value; pass ``duration=None`` to compute it again."""
    name: str = "loop"
    """Name shown in tables and error messages."""
    _POSES = ("center", "start")

    def __post_init__(self) -> None:
        object.__setattr__(self, "seed", whole("seed", self.seed))
        is_computed = self.duration is None
        if is_computed:
            object.__setattr__(self, "duration", 1.0)  # any valid one, until the curve is known
        super().__post_init__()
        if len(self.start) != len(self.center):
            raise ValueError(
                f"start has {len(self.start)} coordinates and center has {len(self.center)}"
            )
        groups = len(_GROUPS[self.coordinates])
        for field in ("reach", "acceleration"):
            self._set_numbers(
                field, shapes=[(groups,)], form=f"{groups} numbers, one per group", above=0
            )
        if is_computed:
            object.__setattr__(self, "duration", self._shortest_duration())

    @property
    def jumps(self) -> bool:
        """Whether the acceleration jumps, as on the paper's circle: the seed is odd."""
        return self.seed % 2 == 1

    @cached_property
    def _curve(self) -> tuple[float, Array, Array]:
        """Fraction of the acceleration, c of shape (n,), and (a, b) of shape (2, HARMONICS, n)."""
        n = self.coordinates
        groups = _GROUPS[self.coordinates]
        # Numbers in [0, 1): numpy keeps the raw bits stable, but not its distributions. 53 bits fill
        # the mantissa of a float. Changing the order of the numbers would change the curve of every
        # seed.
        generator = np.random.Philox(np.random.SeedSequence(self.seed))
        bits = generator.random_raw(1 + len(groups) + n + 2 * HARMONICS * n)
        numbers = (bits >> np.uint64(11)).astype(float) / 2.0**53
        fraction, sizes, offset, waves = np.split(numbers, np.cumsum([1, len(groups), n]))
        waves = (2 * waves.reshape(2, HARMONICS, n) - 1) / _ORDERS[:, None] ** 3
        center = np.array(self.center)
        phases = np.linspace(0, 2 * np.pi, _SAMPLES)
        # Size and offset share the reach, so that the curve stays within it.
        series = _series(waves, phases)[0]
        distance = np.zeros(_SAMPLES)
        for group, reach, size in zip(groups, self.reach, 0.5 + 0.5 * sizes, strict=True):
            scale = size * reach / np.linalg.norm(series[:, group], axis=1).max()
            waves[..., group] *= scale
            dimensions = group.stop - group.start
            center[group] += (1 - size) * reach * (2 * offset[group] - 1) / math.sqrt(dimensions)
            to_start = center[group] + scale * series[:, group] - self.start[group]
            distance += np.sum(to_start**2, axis=1) / reach**2
        phase = phases[np.argmin(distance)]  # where the curve begins
        cosine = np.cos(phase * _ORDERS)[:, None]
        sine = np.sin(phase * _ORDERS)[:, None]
        along, across = waves
        waves = np.stack([along * cosine + across * sine, across * cosine - along * sine])
        return LEAST_FRACTION + (1 - LEAST_FRACTION) * float(fraction[0]), center, waves

    def _phase(self, fraction: Array) -> Array:
        """The phase and its derivatives 1 to 4 at fractions of the duration, shape (5, ...)."""
        if self.jumps:
            return turn_from_rest(fraction)
        return 2 * np.pi * unit_blend(fraction)

    def _shortest_duration(self) -> float:
        fraction, _, waves = self._curve
        # Both accelerations count where they jump: at half time and right after it.
        times = np.append(np.linspace(0, 1, _SAMPLES), np.nextafter(0.5, 1.0))
        phase = self._phase(times)
        acceleration = composed(_series(waves, phase[0]), phase[..., None])[2]
        shortest = 0.0
        for group, bound in zip(_GROUPS[self.coordinates], self.acceleration, strict=True):
            largest = np.linalg.norm(acceleration[:, group], axis=1).max()
            shortest = max(shortest, math.sqrt(largest / (fraction * bound)))
        return math.ceil(100 * shortest) / 100

    def _derivatives(self, time: Array) -> Array:
        _, center, waves = self._curve
        phase = scaled(self._phase(time / self.duration), 1 / self.duration)
        derivatives = composed(_series(waves, phase[0]), phase[..., None])
        derivatives[0] += center
        return derivatives


LEAST_FRACTION = 0.8
"""Least fraction of its ``acceleration`` that a :class:`RandomLoop` reaches."""

HARMONICS = 2
"""Number of harmonics of a :class:`RandomLoop`."""

_ORDERS = np.arange(1.0, HARMONICS + 1)

_GROUPS = {
    2: (slice(0, 2),),
    3: (slice(0, 2), slice(2, 3)),
    6: (slice(0, 2), slice(2, 3), slice(3, 6)),
}
"""Groups of coordinates of :class:`RandomLoop` that share a bound, by number of coordinates."""

_SAMPLES = 1001
"""Number of times or phases at which :class:`RandomLoop` samples its peaks."""


def _series(waves: Array, phase: Array) -> Array:
    """Derivatives 0 to 4 of ``Σ_k (a_k cos kφ + b_k sin kφ)`` with respect to the phase φ (...),
    shape (5, ..., n)."""
    sines = sine_derivatives(phase[..., None] * _ORDERS)
    derivatives = []
    for order in range(5):
        factor = _ORDERS**order
        cosines = (factor * sines[order + 1]) @ waves[0]
        derivatives.append(cosines + (factor * sines[order]) @ waves[1])
    return np.stack(derivatives)
