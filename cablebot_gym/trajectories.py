"""Reference motions with their time derivatives in closed form: the paper's circles, smooth ones, random ones by seed.

A motion of your own is any object with ``name``, ``duration``, ``coordinates`` and ``__call__(times) -> Reference``,
the :class:`Trajectory` protocol. Positions in m, angles in rad, times in s; z points down. Nothing here knows a robot.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from numbers import Integral, Real
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.utils.suggestions import no_such

Array = NDArray[np.float64]

KINDS = {2: "planar", 6: "spatial"}
"""Kind of robot by its number of coordinates: ``(x, y)`` or ``(x, y, z, ψ, θ, φ)``."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """The desired motion at some times; each array has the shape of the times and one more axis, the n coordinates."""

    position: Array
    """X_d, shape (..., n) [m, rad]."""
    velocity: Array
    """First time derivative, shape (..., n) [m/s, rad/s]."""
    acceleration: Array
    """Second time derivative, shape (..., n) [m/s², rad/s²]."""
    jerk: Array
    """Third time derivative, shape (..., n) [m/s³, rad/s³]."""
    snap: Array
    """Fourth time derivative, shape (..., n) [m/s⁴, rad/s⁴]."""


@runtime_checkable
class Trajectory(Protocol):
    """A reference motion from time 0 to ``duration``."""

    @property
    def name(self) -> str:
        """Shown in tables and error messages."""

    @property
    def duration(self) -> float:
        """Length of the motion [s]; > 0 and finite."""

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose: 2 planar, 6 spatial."""

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times`` [s], a number or an array of any shape.

        A time before 0 gives what time 0 gives. A time after ``duration`` gives the last pose at rest; ``duration``
        itself still belongs to the motion.
        """


class _Motion:
    """What the motions below share: how time is clamped, and what a valid duration is."""

    name: str
    duration: float

    def __post_init__(self) -> None:
        _check_positive("duration", self.duration)

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times``, as :class:`Trajectory` says."""
        times = np.asarray(times, float)
        derivatives = self._derivatives(np.clip(times, 0.0, self.duration))
        derivatives[1:, times > self.duration] = 0.0
        position, velocity, acceleration, jerk, snap = derivatives
        return Reference(position=position, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap)

    def _derivatives(self, time: Array) -> Array:
        """Position to snap for times in [0, duration], shape (5, ..., n), an array of its own."""
        raise NotImplementedError

    def _blend(self, time: Array) -> Array:
        """Time derivatives 0 to 4 of :data:`BLEND` stretched over the duration, shape (5, ...)."""
        return _scaled(_unit_blend(time / self.duration), 1 / self.duration)


@dataclass(frozen=True, kw_only=True)
class PaperCircle(_Motion):
    """The paper's circle (Tables 1 and 3): speeds up over one half turn and slows down over the other.

    With u = t / duration: ``(x, y) = radius (cos 4πu², sin 4πu²)`` for u ≤ 0.5, then
    ``radius (cos 4π(1−u)², −sin 4π(1−u)²)``, about ``center``. The angular acceleration jumps from +8π to −8π rad per
    duration² right after u = 0.5, where the first branch still holds, and vanishes at neither end. Only position and
    velocity are continuous, so no robot with flexible joints can follow it exactly.

    Raises:
        ValueError: if a value is no length, time or pose.
    """

    radius: float
    """Radius of the circle [m]; > 0. Table 1: 0.2165, Table 3: 0.1."""
    center: tuple[float, ...]
    """Pose about which x and y turn, (n,); its other coordinates are constant. Table 3: (0, 0, 0.1, 0.1, 0.1, 0.1)."""
    duration: float = 1.0
    """Time of the turn [s]; > 0. Tables 1 and 3: 1 s."""
    name: str = "paper-circle"
    """Shown in tables and error messages."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_positive("radius", self.radius)
        _set_pose(self, "center")

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(self.center)

    def _derivatives(self, time: Array) -> Array:
        u = time / self.duration
        first = u <= 0.5
        from_rest = np.where(first, u, 1 - u)
        acceleration = np.where(first, 8 * np.pi, -8 * np.pi)
        zero = np.zeros_like(u)
        angle = np.stack([acceleration * from_rest**2 / 2, 8 * np.pi * from_rest, acceleration, zero, zero])
        return _circle(self.center, self.radius, _scaled(angle, 1 / self.duration))


@dataclass(frozen=True, kw_only=True)
class SmoothCircle(_Motion):
    """One turn on the paper's circle from the same start, but C⁴: :data:`BLEND` turns the angle from 0 to 2π.

    Raises:
        ValueError: if a value is no length, time or pose.
    """

    radius: float
    """Radius of the circle [m]; > 0."""
    center: tuple[float, ...]
    """Pose about which x and y turn, (n,); its other coordinates are constant."""
    duration: float = 2.0
    """Time of the turn [s]; > 0."""
    name: str = "smooth-circle"
    """Shown in tables and error messages."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _check_positive("radius", self.radius)
        _set_pose(self, "center")

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(self.center)

    def _derivatives(self, time: Array) -> Array:
        return _circle(self.center, self.radius, 2 * np.pi * self._blend(time))


@dataclass(frozen=True, kw_only=True)
class Hold(_Motion):
    """Stays at a pose.

    Raises:
        ValueError: if a value is no time or pose.
    """

    pose: tuple[float, ...]
    """The pose, (n,)."""
    duration: float = 1.0
    """How long [s]; > 0."""
    name: str = "hold"
    """Shown in tables and error messages."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _set_pose(self, "pose")

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(self.pose)

    def _derivatives(self, time: Array) -> Array:
        derivatives = np.zeros((5, *time.shape, self.coordinates))
        derivatives[0] = self.pose
        return derivatives


@dataclass(frozen=True, kw_only=True)
class PointToPoint(_Motion):
    """From rest at one pose to rest at another, all coordinates together, C⁴ through :data:`BLEND`.

    Raises:
        ValueError: if a value is no time or pose, or the poses differ in their number of coordinates.
    """

    start: tuple[float, ...]
    """First pose, (n,)."""
    end: tuple[float, ...]
    """Last pose, (n,)."""
    duration: float = 2.0
    """Time of the motion [s]; > 0."""
    name: str = "line"
    """Shown in tables and error messages."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _set_pose(self, "start")
        _set_pose(self, "end")
        if len(self.start) != len(self.end):
            raise ValueError(
                f"start has {len(self.start)} coordinates and end has {len(self.end)}: both are poses of one robot"
            )

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(self.start)

    def _derivatives(self, time: Array) -> Array:
        derivatives = self._blend(time)[..., None] * np.subtract(self.end, self.start)
        derivatives[0] += self.start
        return derivatives


@dataclass(frozen=True, kw_only=True)
class Lemniscate(_Motion):
    """Gerono's figure of eight, once around from its crossing point and C⁴.

    ``(x, y) = (a_x sin α, a_y sin 2α)`` about ``center``; :data:`BLEND` turns α from 0 to 2π.

    Raises:
        ValueError: if a value is no length, time or pose.
    """

    amplitude: tuple[float, float]
    """(a_x, a_y), half width and half height of the figure [m]; > 0."""
    center: tuple[float, ...]
    """Pose of the crossing point, (n,); its coordinates but x and y are constant."""
    duration: float = 3.0
    """Time of the motion [s]; > 0."""
    name: str = "lemniscate"
    """Shown in tables and error messages."""

    def __post_init__(self) -> None:
        super().__post_init__()
        amplitude = _numbers("amplitude", self.amplitude)
        if len(amplitude) != 2 or min(amplitude) <= 0:
            raise ValueError(f"amplitude must hold two lengths (a_x, a_y) greater than 0 in m, not {self.amplitude}")
        object.__setattr__(self, "amplitude", amplitude)
        _set_pose(self, "center")

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(self.center)

    def _derivatives(self, time: Array) -> Array:
        alpha = 2 * np.pi * self._blend(time)
        width, height = self.amplitude
        x = width * _sine_and_on(alpha[0])[:5]
        y = height * _scaled(_sine_and_on(2 * alpha[0])[:5], 2.0)
        return _in_plane(self.center, x, y, alpha)


TRAINING_SEEDS = range(10_000)
"""Seeds of :class:`RandomLoop` to train and tune with."""

FIRST_HELD_OUT_SEED = TRAINING_SEEDS.stop
"""Seeds from here on are for scores alone: no policy may be trained, tuned or chosen with them."""


def held_out_seeds(count: int) -> range:
    """The first ``count`` seeds that are for scores alone.

    Raises:
        ValueError: if ``count`` is no whole number of at least 1.
    """
    if isinstance(count, bool) or not isinstance(count, Integral) or count < 1:
        raise ValueError(f"count must be a whole number of at least 1, such as 20, not {count!r}")
    return range(FIRST_HELD_OUT_SEED, FIRST_HELD_OUT_SEED + int(count))


@dataclass(frozen=True, kw_only=True)
class RandomLoop(_Motion):
    """A random closed curve, once around, C⁴ and from rest to rest; the seed is the curve.

    All coordinates are Fourier series of one phase, which :data:`BLEND` turns from 0 to 2π:

        X(φ) = c + Σ_k (a_k cos kφ + b_k sin kφ),   k = 1 … :data:`HARMONICS`.

    The components of a_k and b_k are uniform in ± 1/k². Then each group of coordinates, (x, y), z and (ψ, θ, φ), is
    scaled so that the largest norm of its series is 50 to 100 % of its ``reach``, and c lies off ``center`` by no more
    than what is left: the curve stays within ``reach`` of ``center``. The duration is the shortest with which no group
    accelerates beyond a share of its ``acceleration``, the share between 60 and 100 %, rounded up to 10 ms. The speed
    needs no bound of its own: it stays below √(2 · reach · acceleration) (Landau's inequality).

    The numbers come from the raw bits of numpy's Philox, which do not change from version to version, so that a seed
    means the same curve for ever. Norms and accelerations are sampled, and their peaks met to 0.1 %.

    Raises:
        ValueError: if the seed is no whole number of at least 0, or another value is no length, time or pose.
    """

    seed: int = 0
    """Which curve; ≥ 0. :data:`TRAINING_SEEDS` are for training, those from :data:`FIRST_HELD_OUT_SEED` on for
    scores."""
    center: tuple[float, ...]
    """Pose about which the curve lies, (n,)."""
    reach: tuple[float, ...]
    """How far from ``center`` the curve may go, > 0: (of (x, y) [m],) planar, (of (x, y) [m], of z [m], of (ψ, θ, φ)
    [rad]) spatial; norms."""
    acceleration: tuple[float, ...]
    """Bounds of the accelerations [m/s², rad/s²], > 0, one for each of ``reach``; norms of second derivatives."""
    duration: float = None  # type: ignore[assignment]  # for a moment: then it is what the bounds allow
    """Time of the motion [s]; > 0. None for the one that the seed and ``acceleration`` give; ``dataclasses.replace``
    keeps that one, unless told ``duration=None`` too."""
    name: str = "loop"
    """Shown in tables and error messages."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "seed", _seed(self.seed))
        _set_pose(self, "center")
        for field in ("reach", "acceleration"):
            values = _numbers(field, getattr(self, field))
            if len(values) != len(_GROUPS[self.coordinates]) or min(values) <= 0:
                groups = "(x, y)" if self.coordinates == 2 else "(x, y), one for z and one for the angles"
                raise ValueError(f"{field} must hold one number greater than 0 for {groups}, not {values}")
            object.__setattr__(self, field, values)
        if self.duration is None:
            object.__setattr__(self, "duration", self._shortest_duration())
        super().__post_init__()

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(self.center)

    @cached_property
    def _drawn(self) -> tuple[float, Array, Array]:
        """Share of the acceleration, c (n,), and (a, b) (2, HARMONICS, n)."""
        n, groups = self.coordinates, _GROUPS[self.coordinates]
        # The order of the numbers is part of what a seed means.
        numbers = _uniform(self.seed, 1 + len(groups) + n + 2 * HARMONICS * n)
        share, sizes, offset, waves = np.split(numbers, np.cumsum([1, len(groups), n]))
        waves = (2 * waves.reshape(2, HARMONICS, n) - 1) / _ORDERS[:, None] ** 2
        center = np.array(self.center)
        series = _series(waves, np.linspace(0, 2 * np.pi, _SAMPLES))[0]
        for group, reach, size in zip(groups, self.reach, 0.5 + 0.5 * sizes, strict=True):
            waves[..., group] *= size * reach / np.linalg.norm(series[:, group], axis=1).max()
            dimensions = group.stop - group.start
            center[group] += (1 - size) * reach * (2 * offset[group] - 1) / math.sqrt(dimensions)
        return 0.6 + 0.4 * float(share[0]), center, waves

    def _shortest_duration(self) -> float:
        share, _, waves = self._drawn
        phase = 2 * np.pi * _unit_blend(np.linspace(0, 1, _SAMPLES))
        acceleration = _composed(_series(waves, phase[0]), phase[..., None])[2]
        longest = max(
            math.sqrt(np.linalg.norm(acceleration[:, group], axis=1).max() / (share * bound))
            for group, bound in zip(_GROUPS[self.coordinates], self.acceleration, strict=True)
        )
        return math.ceil(100 * longest) / 100

    def _derivatives(self, time: Array) -> Array:
        _, center, waves = self._drawn
        phase = 2 * np.pi * self._blend(time)
        derivatives = _composed(_series(waves, phase[0]), phase[..., None])
        derivatives[0] += center
        return derivatives


HARMONICS = 3
"""Of a :class:`RandomLoop`."""

_ORDERS = np.arange(1.0, HARMONICS + 1)

_GROUPS = {2: (slice(0, 2),), 6: (slice(0, 2), slice(2, 3), slice(3, 6))}
"""Coordinates that share a bound of :class:`RandomLoop`, by the number of coordinates."""

_SAMPLES = 1001
"""Instants or phases among which :class:`RandomLoop` looks for peaks."""


def _seed(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, Integral) or value < 0:
        raise ValueError(
            f"seed must be a whole number of at least 0, not {value!r}: 0 to {TRAINING_SEEDS[-1]} to train with, "
            f"{FIRST_HELD_OUT_SEED} and on for held-out motions"
        )
    return int(value)


def _uniform(seed: int, count: int) -> Array:
    """Numbers in [0, 1) that depend on the seed alone; numpy promises the bits for ever, but not its distributions."""
    bits = np.random.Philox(np.random.SeedSequence(seed)).random_raw(count)
    return (bits >> np.uint64(11)).astype(float) / 2.0**53


def _series(waves: Array, phase: Array) -> Array:
    """Derivatives 0 to 4 of ``Σ_k (a_k cos kφ + b_k sin kφ)`` by the phase φ (...), shape (5, ..., n)."""
    sines = _sine_and_on(phase[..., None] * _ORDERS)
    factors = [_ORDERS**order for order in range(5)]
    return np.stack(
        [
            (factor * sines[order + 1]) @ waves[0] + (factor * sines[order]) @ waves[1]
            for order, factor in enumerate(factors)
        ]
    )


BLEND = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])
"""s(u), the lowest polynomial from 0 at u = 0 to 1 at u = 1 whose first four derivatives vanish at both: C⁴ motions."""


def _blend_derivatives() -> Array:
    columns = [BLEND.deriv(order).coef for order in range(5)]
    return np.stack([np.pad(column, (0, len(BLEND.coef) - len(column))) for column in columns], axis=1)


_BLEND_DERIVATIVES = _blend_derivatives()
"""Coefficients of s and its derivatives 1 to 4, one column each, shape (10, 5)."""


def _unit_blend(share: Array) -> Array:
    """s and its derivatives 1 to 4 at shares of the duration, shape (5, ...)."""
    return np.asarray(np.polynomial.polynomial.polyval(share, _BLEND_DERIVATIVES), float)


def _scaled(derivatives: Array, factor: float) -> Array:
    """Derivatives 0 to 4 of ``f(factor · t)`` from those of f, first axis the order."""
    return np.stack([derivative * factor**order for order, derivative in enumerate(derivatives)])


def _composed(outer: Array, inner: Array) -> Array:
    """Derivatives 0 to 4 of ``f(φ(t))``: Faà di Bruno's formula.

    Args:
        outer: f and its derivatives by φ at φ(t), shape (5, ...).
        inner: φ and its derivatives by t, shape (5, ...).
    """
    f, f1, f2, f3, f4 = outer
    _, p1, p2, p3, p4 = inner
    return np.stack(
        [
            f,
            f1 * p1,
            f2 * p1**2 + f1 * p2,
            f3 * p1**3 + 3 * f2 * p1 * p2 + f1 * p3,
            f4 * p1**4 + 6 * f3 * p1**2 * p2 + f2 * (3 * p2**2 + 4 * p1 * p3) + f1 * p4,
        ]
    )


def _sine_and_on(angle: Array) -> Array:
    """sin and its derivatives 1 to 5, shape (6, ...); the first five belong to sin, the last five to cos."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.stack([sine, cosine, -sine, -cosine, sine, cosine])


def _circle(center: tuple[float, ...], radius: float, angle: Array) -> Array:
    """A point on a circle whose angle and the angle's time derivatives are given, shape (5, ..., n)."""
    waves = radius * _sine_and_on(angle[0])
    return _in_plane(center, waves[1:], waves[:5], angle)


def _in_plane(center: tuple[float, ...], x: Array, y: Array, angle: Array) -> Array:
    """``center + (x(φ(t)), y(φ(t)), 0, …)`` from x, y, φ and their derivatives, shape (5, ..., n)."""
    derivatives = np.zeros((*angle.shape, len(center)))
    derivatives[0] = center
    derivatives[..., 0] += _composed(x, angle)
    derivatives[..., 1] += _composed(y, angle)
    return derivatives


def _check_positive(field: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, Real) or not 0 < float(value) < np.inf:
        unit = "s" if field == "duration" else "m"
        raise ValueError(f"{field} must be a finite number greater than 0 in {unit}, not {value!r}")


def _numbers(field: str, values: Any) -> tuple[float, ...]:
    """The values as a tuple of finite floats; lists and arrays are welcome."""
    try:
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        raise ValueError(f"{field} must hold numbers, not {values!r}") from None
    if not np.all(np.isfinite(numbers)):
        raise ValueError(f"{field} must hold finite numbers, not {values!r}")
    return numbers


def _set_pose(trajectory: _Motion, field: str) -> None:
    """Checks that a field is a pose, and makes it a tuple."""
    pose = _numbers(field, getattr(trajectory, field))
    if len(pose) not in KINDS:
        raise ValueError(f"{field} must be (x, y) for a planar robot or (x, y, z, ψ, θ, φ) for a spatial, not {pose}")
    object.__setattr__(trajectory, field, pose)


TRAJECTORIES: dict[str, Callable[..., Trajectory]] = {
    "paper-planar": partial(PaperCircle, name="paper-planar", radius=0.2165, center=(0.0, 0.0)),  # Table 1
    "paper-spatial": partial(
        PaperCircle, name="paper-spatial", radius=0.1, center=(0.0, 0.0, 0.1, 0.1, 0.1, 0.1)
    ),  # Table 3
    "circle-planar": partial(SmoothCircle, name="circle-planar", radius=0.2165, center=(0.0, 0.0)),
    "circle-spatial": partial(SmoothCircle, name="circle-spatial", radius=0.1, center=(0.0, 0.0, 0.1, 0.1, 0.1, 0.1)),
    "hold-planar": partial(Hold, name="hold-planar", pose=(0.0, 0.0)),
    "hold-spatial": partial(Hold, name="hold-spatial", pose=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0)),
    "line-planar": partial(PointToPoint, name="line-planar", start=(-0.1, -0.1), end=(0.1, 0.15)),
    "line-spatial": partial(
        PointToPoint,
        name="line-spatial",
        start=(-0.05, -0.05, 0.1, 0.0, 0.0, 0.0),
        end=(0.05, 0.05, 0.15, 0.05, 0.05, 0.05),
    ),
    "lemniscate-planar": partial(Lemniscate, name="lemniscate-planar", amplitude=(0.2, 0.1), center=(0.0, 0.0)),
    "lemniscate-spatial": partial(
        Lemniscate, name="lemniscate-spatial", amplitude=(0.1, 0.05), center=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0)
    ),
    # Within the radii of the paper's circles, about their centers; at z = 0.1 m the tensions change so fast with depth
    # and tilt that little of either is left. The accelerations, below the 35 and 16 m/s² of those circles, leave the
    # first 2000 training and the first 2000 held-out seeds an exact-tracking payload on all of the paper's robots, with
    # every tension above 5 N: at least 0.6 kg planar and 1.2 kg spatial.
    "loop-planar": partial(RandomLoop, name="loop-planar", center=(0.0, 0.0), reach=(0.2165,), acceleration=(32.0,)),
    "loop-spatial": partial(
        RandomLoop,
        name="loop-spatial",
        center=(0.0, 0.0, 0.1, 0.1, 0.1, 0.1),
        reach=(0.1, 0.01, 0.03),
        acceleration=(9.0, 2.5, 3.0),
    ),
}
"""Makers of the named motions; each takes the fields of its class as keywords and works without any."""


def trajectory_names(coordinates: int | None = None) -> list[str]:
    """Names in :data:`TRAJECTORIES`.

    Args:
        coordinates: only those of a robot with this many coordinates; None: all.
    """
    return [name for name, make in TRAJECTORIES.items() if coordinates is None or make().coordinates == coordinates]


def find_trajectory(trajectory: str | dict[str, Any] | Trajectory, coordinates: int) -> Trajectory:
    """A trajectory for a robot from a name, a name with fields, or itself.

    Args:
        trajectory: a name of :func:`trajectory_names`, JSON-able data such as ``{"name": "circle-spatial", "duration":
            1.5}``, or an object that satisfies :class:`Trajectory`.
        coordinates: the robot's number of coordinates n, 2 planar or 6 spatial.

    Raises:
        ValueError: if the name, a field or a value is not valid, or the trajectory is for another kind of robot.
    """
    if isinstance(trajectory, str):
        found = _make({"name": trajectory}, coordinates)
    elif isinstance(trajectory, dict):
        found = _make(trajectory, coordinates)
    elif isinstance(trajectory, Trajectory) and not isinstance(trajectory, type):
        found = trajectory
    else:
        raise ValueError(
            f"{trajectory!r} is no trajectory: pass {_choices(coordinates)}, a dict with one of these as 'name', "
            "or an object with name, duration, coordinates and a call by times"
        )
    _check_positive("duration", found.duration)
    if found.coordinates != coordinates:
        raise ValueError(
            f"trajectory {found.name!r} has {found.coordinates} coordinates and the robot has {coordinates}; "
            f"choose {_choices(coordinates)}"
        )
    return found


def _make(data: dict[str, Any], coordinates: int) -> Trajectory:
    if "name" not in data:
        raise ValueError(f"a trajectory's dict needs a 'name': {_choices(coordinates)}")
    name, fields = data["name"], {key: value for key, value in data.items() if key != "name"}
    if name not in trajectory_names():
        raise ValueError(no_such("trajectory", name, trajectory_names(coordinates)))
    if TRAJECTORIES[name]().coordinates != coordinates:
        raise ValueError(f"trajectory {name!r} is not for {coordinates} coordinates; choose {_choices(coordinates)}")
    known = [key for key in inspect.signature(TRAJECTORIES[name]).parameters if key != "name"]
    for key in fields:
        if key not in known:
            raise ValueError(f"trajectory {name!r} has no field {key!r}; its fields are {', '.join(known)}")
    return TRAJECTORIES[name](**fields)


def _choices(coordinates: int) -> str:
    return f"one of {', '.join(trajectory_names(coordinates))}"
