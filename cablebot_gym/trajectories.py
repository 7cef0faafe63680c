"""Reference motions with time derivatives in closed form: the paper's circles, smooth motions,
chains, random loops.

Most named motions are :class:`BetweenDwells`: the robot rests at the start pose first and at the
end pose last.

A custom motion is any object with ``name``, ``duration``, ``coordinates`` and ``__call__(times) ->
Reference``, see the :class:`Trajectory` protocol. Positions are in m, angles in rad and times in s;
z points down.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property, partial
from numbers import Real
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.robots import COORDINATE_NAMES, Kind
from cablebot_gym.utils.checks import mapping, number, numbers, unknown_name_error, whole
from cablebot_gym.utils.files import check_not_a_file
from cablebot_gym.utils.imports import import_object
from cablebot_gym.utils.user_code import raised
from cablebot_gym.waypoints import is_waypoint_file, read_waypoints

Array = NDArray[np.float64]

COORDINATES: dict[Kind, int] = {"planar": 2, "planar-platform": 3, "point": 3, "spatial": 6}
"""Number of coordinates by kind of robot: ``(x, y)``, ``(x, y, φ)``, ``(x, y, z)`` or ``(x, y, z,
ψ, θ, φ)``."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Reference:
    """The reference motion at given times. Each array has the shape of the times plus a last axis
    of n coordinates."""

    position: Array
    """Reference pose X_d, shape (..., n) [m, rad]."""
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
        """Name shown in tables and error messages."""

    @property
    def duration(self) -> float:
        """Duration of the motion [s]; > 0 and finite."""

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose, see :data:`COORDINATES`."""

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times`` [s], a number or an array of any shape.

        A time before 0 is treated as 0. A time after ``duration`` gives the last pose at rest.
        ``duration`` itself still belongs to the motion.
        """


def _checked_times(times: ArrayLike) -> Array:
    """Times as an array; infinite ones are before or after the motion.

    Raises:
        ValueError: if a time is NaN.
    """
    checked = np.asarray(times, float)
    if np.isnan(checked).any():
        raise ValueError("times must be numbers, without NaN")
    return checked


class _Motion:
    """Base of the motions in this module: clamps the time and checks the duration and the poses."""

    name: str
    duration: float
    _POSES: ClassVar[tuple[str, ...]] = ("center",)
    """Names of the fields that are poses."""

    def __post_init__(self) -> None:
        number("duration", self.duration, above=0, unit="s")
        for field in self._POSES:
            form = "(x, y), (x, y, φ), (x, y, z) or (x, y, z, ψ, θ, φ), by the kind of robot"
            self._set_numbers(
                field, shapes=[(n,) for n in sorted(set(COORDINATES.values()))], form=form
            )

    def _set_numbers(self, field: str, **form: Any) -> None:
        """Checks the numbers of a field and converts them to a tuple."""
        object.__setattr__(
            self, field, tuple(numbers(field, getattr(self, field), **form).tolist())
        )

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(getattr(self, self._POSES[0]))

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times`` [s], see :class:`Trajectory`."""
        times = _checked_times(times)
        derivatives = self._derivatives(np.clip(times, 0.0, self.duration))
        derivatives[1:, times > self.duration] = 0.0
        position, velocity, acceleration, jerk, snap = derivatives
        return Reference(
            position=position, velocity=velocity, acceleration=acceleration, jerk=jerk, snap=snap
        )

    def _derivatives(self, time: Array) -> Array:
        """Position to snap for times in [0, duration], shape (5, ..., n), in a new array."""
        raise NotImplementedError

    def _blend(self, time: Array) -> Array:
        """Time derivatives 0 to 4 of :data:`BLEND`, scaled to the duration, shape (5, ...)."""
        return _scaled(_unit_blend(time / self.duration), 1 / self.duration)


@dataclass(frozen=True, kw_only=True)
class PaperCircle(_Motion):
    """The paper's circle (Tables 1 and 3). The motion accelerates over one half turn and
    decelerates over the other.

    With u = t / duration: ``(x, y) = radius (cos 4πu², sin 4πu²)`` for u ≤ 0.5, then ``radius (cos
    4π(1−u)², −sin 4π(1−u)²)``, about ``center``. The angular acceleration jumps from +8π to −8π rad
    per duration² right after u = 0.5, where the first branch is still valid. It is not zero at
    either end. Only position and velocity are continuous, so no robot with flexible joints can
    follow the circle exactly.

    Raises:
        ValueError: if a length, time or pose is invalid.
    """

    radius: float
    """Radius of the circle [m]; > 0. Table 1: 0.2165, Table 3: 0.1."""
    center: tuple[float, ...]
    """Center pose, shape (n,); all coordinates except x and y stay constant. Table 3: (0, 0, 0.1,
    0.1, 0.1, 0.1)."""
    duration: float = 1.0
    """Duration of the turn [s]; > 0. Tables 1 and 3: 1 s."""
    name: str = "paper-circle"
    """Name shown in tables and error messages."""

    def __post_init__(self) -> None:
        super().__post_init__()
        number("radius", self.radius, above=0, unit="m")

    def _derivatives(self, time: Array) -> Array:
        u = time / self.duration
        first = u <= 0.5
        from_rest = np.where(first, u, 1 - u)
        acceleration = np.where(first, 8 * np.pi, -8 * np.pi)
        zero = np.zeros_like(u)
        angle = np.stack(
            [acceleration * from_rest**2 / 2, 8 * np.pi * from_rest, acceleration, zero, zero]
        )
        return _circle(self.center, self.radius, _scaled(angle, 1 / self.duration))


@dataclass(frozen=True, kw_only=True)
class SmoothCircle(_Motion):
    """One C⁴ turn on the paper's circle from the same start. The angle goes from 0 to 2π along
    :data:`BLEND`.

    Raises:
        ValueError: if a length, time or pose is invalid.
    """

    radius: float
    """Radius of the circle [m]; > 0."""
    center: tuple[float, ...]
    """Center pose, shape (n,); all coordinates except x and y stay constant."""
    duration: float = 2.0
    """Duration of the turn [s]; > 0."""
    name: str = "smooth-circle"
    """Name shown in tables and error messages."""

    def __post_init__(self) -> None:
        super().__post_init__()
        number("radius", self.radius, above=0, unit="m")

    def _derivatives(self, time: Array) -> Array:
        return _circle(self.center, self.radius, 2 * np.pi * self._blend(time))


@dataclass(frozen=True, kw_only=True)
class Dwell(_Motion):
    """A dwell: the robot rests at one pose.

    Raises:
        ValueError: if the duration or the pose is invalid.
    """

    pose: tuple[float, ...]
    """The pose, shape (n,)."""
    duration: float = 1.0
    """Duration of the dwell [s]; > 0."""
    name: str = "dwell"
    """Name shown in tables and error messages."""
    _POSES = ("pose",)

    def _derivatives(self, time: Array) -> Array:
        derivatives = np.zeros((5, *time.shape, self.coordinates))
        derivatives[0] = self.pose
        return derivatives


@dataclass(frozen=True, kw_only=True)
class PointToPoint(_Motion):
    """A C⁴ motion from rest at one pose to rest at another; all coordinates follow :data:`BLEND`.

    Raises:
        ValueError: if the duration or a pose is invalid, or the poses differ in their number of
            coordinates.
    """

    start: tuple[float, ...]
    """First pose, shape (n,)."""
    end: tuple[float, ...]
    """Last pose, shape (n,)."""
    duration: float = 2.0
    """Duration of the motion [s]; > 0."""
    name: str = "line"
    """Name shown in tables and error messages."""
    _POSES = ("start", "end")

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.start) != len(self.end):
            raise ValueError(f"start has {len(self.start)} coordinates and end has {len(self.end)}")

    def _derivatives(self, time: Array) -> Array:
        derivatives = self._blend(time)[..., None] * np.subtract(self.end, self.start)
        derivatives[0] += self.start
        return derivatives


@dataclass(frozen=True, kw_only=True)
class Lemniscate(_Motion):
    """Gerono's lemniscate, traversed once from its crossing point; the motion is C⁴.

    ``(x, y) = (a_x sin α, a_y sin 2α)`` about ``center``. The angle α goes from 0 to 2π along
    :data:`BLEND`.

    Raises:
        ValueError: if a length, time or pose is invalid.
    """

    amplitude: tuple[float, float]
    """(a_x, a_y), half width and half height of the lemniscate [m]; > 0."""
    center: tuple[float, ...]
    """Pose of the crossing point, shape (n,); all coordinates except x and y stay constant."""
    duration: float = 3.0
    """Duration of the motion [s]; > 0."""
    name: str = "lemniscate"
    """Name shown in tables and error messages."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._set_numbers(
            "amplitude", shapes=[(2,)], form="two lengths (a_x, a_y)", above=0, unit="m"
        )

    def _derivatives(self, time: Array) -> Array:
        alpha = 2 * np.pi * self._blend(time)
        width, height = self.amplitude
        x = width * _sine_derivatives(alpha[0])[:5]
        y = height * _scaled(_sine_derivatives(2 * alpha[0])[:5], 2.0)
        return _in_plane(self.center, x, y, alpha)


SPLINE_DEGREE = 5
"""Degree of the spline of :class:`Waypoints`: the least one with a continuous snap, which swings
the least."""

SPLINE_ERROR = 1e-7
"""Largest distance of the spline from a waypoint, as a fraction of the largest coordinate or of
1."""


@dataclass(frozen=True, kw_only=True)
class Waypoints(_Motion):
    """A spline through waypoints, from rest at the first one to rest at the last one; the motion is
    C⁴.

    Between waypoints the spline may swing, the more the less evenly they are spaced.

    Raises:
        ValueError: if there are fewer than two waypoints, a number is not finite, or the times do
            not increase from 0.
    """

    times: tuple[float, ...]
    """Times of the waypoints [s]; the first one is 0."""
    poses: tuple[tuple[float, ...], ...]
    """Poses of the waypoints, shape (k, n)."""
    name: str = "waypoints"
    """Name shown in tables and error messages."""
    duration: float = dataclasses.field(init=False)
    """Time of the last waypoint [s]."""
    _POSES = ()

    def __post_init__(self) -> None:
        times = numbers("times", self.times)
        if times.ndim != 1 or len(times) < 2 or times[0] != 0 or np.any(np.diff(times) <= 0):
            raise ValueError("times must be at least two numbers that increase from 0")
        shapes = [(len(times), n) for n in sorted(set(COORDINATES.values()))]
        poses = numbers("poses", self.poses, shapes=shapes, form="one pose per time")
        object.__setattr__(self, "times", tuple(times.tolist()))
        object.__setattr__(self, "poses", tuple(map(tuple, poses.tolist())))
        object.__setattr__(self, "duration", float(times[-1]))
        super().__post_init__()
        missed = np.max(np.abs(self._spline(times / self.duration) - poses))
        if not missed <= SPLINE_ERROR * max(1.0, float(np.max(np.abs(poses)))):
            raise ValueError(
                "no smooth curve was found: the waypoints are spaced too unevenly in time; leave some out"
            )

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return len(self.poses[0])

    @cached_property
    def _spline(self) -> Any:
        """The spline over the fraction of the duration, of which equations are better conditioned
        than over time."""
        from scipy.interpolate import make_interp_spline  # slow to import

        at_rest: Any = [(order, np.zeros(self.coordinates)) for order in range(1, 5)]
        fractions = np.array(self.times) / self.duration
        # The spline has a knot at each waypoint. Rest at both ends takes four more, two near each
        # end.
        inner = fractions[1:-1]
        if len(inner):
            thirds = np.array([1.0, 2.0]) / 3
            inner = np.concatenate([inner[0] * thirds, inner, inner[-1] + (1 - inner[-1]) * thirds])
        else:
            inner = np.linspace(0.0, 1.0, 6)[1:-1]
        ends = np.ones(SPLINE_DEGREE + 1)
        knots = np.concatenate([0 * ends, inner, ends])
        return make_interp_spline(
            fractions, self.poses, SPLINE_DEGREE, t=knots, bc_type=(at_rest, at_rest)
        )

    def _derivatives(self, time: Array) -> Array:
        fraction = time / self.duration
        derivatives = np.stack(
            [self._spline(fraction, nu=order) / self.duration**order for order in range(5)]
        )
        derivatives[1:, (time <= 0) | (time >= self.duration)] = (
            0.0  # exactly at rest, without rounding
        )
        return derivatives


DWELL = 0.3
"""Default length of each dwell of :class:`BetweenDwells` [s]."""


@dataclass(frozen=True, kw_only=True)
class BetweenDwells:
    """A motion between two dwells: the robot rests at the first pose, moves, and rests at the last
    pose.

    A robot that leaves its last pose soon after the motion fails in the second dwell. A robot that
    no motor can hold at rest fails in the first one. The dwells do not change the motion: if it
    starts with a jump of acceleration, as :class:`PaperCircle` does, the jump occurs at time
    ``dwell``.

    Raises:
        ValueError: if ``motion`` is not a :class:`Trajectory` or has dwells already, or if
            ``dwell`` is negative.
    """

    motion: Trajectory
    """The motion between the dwells."""
    dwell: float = DWELL
    """Length of each dwell [s]; ≥ 0."""

    def __post_init__(self) -> None:
        if not isinstance(self.motion, Trajectory) or isinstance(self.motion, type):
            raise ValueError(f"motion must be a Trajectory, not {self.motion!r}")
        if isinstance(self.motion, BetweenDwells):
            raise ValueError(
                "motion has dwells already: change their length with dataclasses.replace(motion, dwell=…)"
            )
        number("dwell", self.dwell, least=0, unit="s")

    @property
    def name(self) -> str:
        """Name of the motion."""
        return self.motion.name

    @property
    def duration(self) -> float:
        """Duration of the motion and both dwells [s]."""
        return self.motion.duration + 2 * self.dwell

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return self.motion.coordinates

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times`` [s], see :class:`Trajectory`."""
        since = _checked_times(times) - self.dwell
        reference = self.motion(np.clip(since, 0.0, self.motion.duration))
        moves = ((since >= 0) & (since <= self.motion.duration))[..., None]
        rates = {order: np.where(moves, getattr(reference, order), 0.0) for order in _RATES}
        return Reference(position=reference.position, **rates)


_RATES = ("velocity", "acceleration", "jerk", "snap")

MEETING_TOLERANCE = 1e-9
"""Largest distance between the end of a part of :class:`Chain` and the start of the next part [m,
rad]."""

REST_TOLERANCE = 1e-6
"""Largest rate of a part of :class:`Chain` at its ends, up to snap [m, rad, and per sᵏ]; rounding
leaves less."""


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Motions one after the other, such as to pick, dwell and place. Each starts and ends at rest,
    so the chain is C⁴.

    Raises:
        ValueError: if there is no motion, a part is not a :class:`Trajectory`, moves at one of its
            ends, or does not start where the part before it ends.
    """

    motions: tuple[Trajectory, ...]
    """The parts in their order. A number among them is a dwell of this length [s] at the pose where
    the robot is."""
    name: str = "chain"
    """Name shown in tables and error messages."""

    def __post_init__(self) -> None:
        given = self.motions
        if not isinstance(given, (list, tuple)) or not given or isinstance(given[0], Real):
            raise ValueError(f"motions must be a list that starts with a motion, not {given!r}")
        parts: list[Trajectory] = []
        for index, part in enumerate(given, 1):
            if isinstance(part, Real):
                end = parts[-1](parts[-1].duration).position
                length = number(f"motions: dwell {index}", part, above=0, unit="s")
                kinds = [kind for kind, n in COORDINATES.items() if n == len(end)]
                kind = next(
                    (kind for kind in kinds if parts[0].name.endswith(f"-{kind}")), kinds[0]
                )
                part = Dwell(name=f"dwell-{kind}", pose=tuple(end.tolist()), duration=length)
            if not isinstance(part, Trajectory) or isinstance(part, type):
                raise ValueError(
                    f"motions: part {index} must be a Trajectory or the length of a dwell, not {part!r}"
                )
            self._check_part(index, part, parts[-1] if parts else None)
            parts.append(part)
        object.__setattr__(self, "motions", tuple(parts))

    @staticmethod
    def _check_part(index: int, part: Trajectory, before: Trajectory | None) -> None:
        """Checks that a part starts and ends at rest, where the part before it ends."""
        label = f"motions: part {index}, {part.name!r},"
        for time, verb in ((0.0, "starts"), (part.duration, "ends")):
            reference = part(time)
            for order in _RATES:
                if (rate := float(np.max(np.abs(getattr(reference, order))))) > REST_TOLERANCE:
                    remedy = (
                        ', or give it "dwell": 0.3'
                        if part.name in TRAJECTORIES
                        else ", or put it in BetweenDwells"
                    )
                    raise ValueError(
                        f"{label} {verb} with a nonzero {order} ({rate:.3g}): use a motion from rest to rest{remedy}"
                    )
        if before is None:
            return
        if part.coordinates != before.coordinates:
            raise ValueError(
                f"{label} has {part.coordinates} coordinates and the part before it {before.coordinates}"
            )
        start = part(0.0).position
        end = before(before.duration).position
        if np.max(np.abs(start - end)) > MEETING_TOLERANCE:
            raise ValueError(
                f"{label} starts at {start.tolist()}, but {before.name!r} before it ends at {end.tolist()}: change one "
                "of the poses, or add a line between them"
            )

    @property
    def duration(self) -> float:
        """Duration of all parts [s]."""
        return float(self._starts[-1])

    @property
    def coordinates(self) -> int:
        """Number of coordinates n of the pose."""
        return self.motions[0].coordinates

    @cached_property
    def _starts(self) -> Array:
        """Start time of each part, then the end of the last one [s]."""
        return np.cumsum([0.0, *(part.duration for part in self.motions)])

    def __call__(self, times: ArrayLike) -> Reference:
        """The motion at ``times`` [s], see :class:`Trajectory`."""
        times = _checked_times(times)
        index = np.clip(
            np.searchsorted(self._starts, times, side="right") - 1, 0, len(self.motions) - 1
        )
        orders = {
            order: np.zeros((*times.shape, self.coordinates)) for order in ("position", *_RATES)
        }
        for number_of, part in enumerate(self.motions):
            chosen = index == number_of
            reference = part(times[chosen] - self._starts[number_of])
            for order, values in orders.items():
                values[chosen] = getattr(reference, order)
        return Reference(**orders)


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
class RandomLoop(_Motion):
    """A random closed curve, traversed once from rest to rest; the motion is C⁴. The seed
    determines the curve.

    All coordinates are Fourier series of one phase φ, which goes from 0 to 2π along :data:`BLEND`:

        X(φ) = c + Σ_k (a_k cos kφ + b_k sin kφ),   k = 1 … :data:`HARMONICS`.

    The components of a_k and b_k are uniform in ± 1/k². The coordinates form groups: (x, y), z and
    (ψ, θ, φ), or (x, y) and φ in a plane.

    * Size: each group is scaled so that the largest norm of its series is 50 to 100 % of its
      ``reach``.
    * Center: the offset of c from ``center`` uses at most the rest of ``reach``, so the curve stays
      within ``reach``.
    * Duration: the shortest one, rounded up to 10 ms, for which no group exceeds a random fraction
      (60 to 100 %) of its ``acceleration``. The speed then stays below √(2 · reach · acceleration)
      by Landau's inequality.

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

    def __post_init__(self) -> None:
        object.__setattr__(self, "seed", whole("seed", self.seed))
        given = self.duration
        object.__setattr__(self, "duration", 1.0 if given is None else given)
        super().__post_init__()
        groups = len(_GROUPS[self.coordinates])
        for field in ("reach", "acceleration"):
            self._set_numbers(
                field, shapes=[(groups,)], form=f"{groups} numbers, one per group", above=0
            )
        if given is None:
            object.__setattr__(self, "duration", self._shortest_duration())

    @cached_property
    def _curve(self) -> tuple[float, Array, Array]:
        """Fraction of the acceleration, c of shape (n,), and (a, b) of shape (2, HARMONICS, n)."""
        n, groups = self.coordinates, _GROUPS[self.coordinates]
        # Changing the order of the numbers would change the curve of every seed.
        numbers = _uniform(self.seed, 1 + len(groups) + n + 2 * HARMONICS * n)
        fraction, sizes, offset, waves = np.split(numbers, np.cumsum([1, len(groups), n]))
        waves = (2 * waves.reshape(2, HARMONICS, n) - 1) / _ORDERS[:, None] ** 2
        center = np.array(self.center)
        series = _series(waves, np.linspace(0, 2 * np.pi, _SAMPLES))[0]
        for group, reach, size in zip(groups, self.reach, 0.5 + 0.5 * sizes, strict=True):
            waves[..., group] *= size * reach / np.linalg.norm(series[:, group], axis=1).max()
            dimensions = group.stop - group.start
            center[group] += (1 - size) * reach * (2 * offset[group] - 1) / math.sqrt(dimensions)
        return 0.6 + 0.4 * float(fraction[0]), center, waves

    def _shortest_duration(self) -> float:
        fraction, _, waves = self._curve
        phase = 2 * np.pi * _unit_blend(np.linspace(0, 1, _SAMPLES))
        acceleration = _composed(_series(waves, phase[0]), phase[..., None])[2]
        longest = max(
            math.sqrt(np.linalg.norm(acceleration[:, group], axis=1).max() / (fraction * bound))
            for group, bound in zip(_GROUPS[self.coordinates], self.acceleration, strict=True)
        )
        return math.ceil(100 * longest) / 100

    def _derivatives(self, time: Array) -> Array:
        _, center, waves = self._curve
        phase = 2 * np.pi * self._blend(time)
        derivatives = _composed(_series(waves, phase[0]), phase[..., None])
        derivatives[0] += center
        return derivatives


HARMONICS = 3
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


def _uniform(seed: int, count: int) -> Array:
    """Numbers in [0, 1) that depend on the seed only. numpy keeps the raw bits stable, but not its
    distributions."""
    bits = np.random.Philox(np.random.SeedSequence(seed)).random_raw(count)
    return (bits >> np.uint64(11)).astype(float) / 2.0**53


def _series(waves: Array, phase: Array) -> Array:
    """Derivatives 0 to 4 of ``Σ_k (a_k cos kφ + b_k sin kφ)`` with respect to the phase φ (...),
    shape (5, ..., n)."""
    sines = _sine_derivatives(phase[..., None] * _ORDERS)
    factors = [_ORDERS**order for order in range(5)]
    return np.stack(
        [
            (factor * sines[order + 1]) @ waves[0] + (factor * sines[order]) @ waves[1]
            for order, factor in enumerate(factors)
        ]
    )


BLEND = np.polynomial.Polynomial([0, 0, 0, 0, 0, 126, -420, 540, -315, 70])
"""Blend polynomial s(u) of C⁴ motions: the polynomial of lowest degree with s(0) = 0 and s(1) = 1
whose first four derivatives are zero at both ends."""


def _blend_derivatives() -> Array:
    columns = [BLEND.deriv(order).coef for order in range(5)]
    return np.stack(
        [np.pad(column, (0, len(BLEND.coef) - len(column))) for column in columns], axis=1
    )


_BLEND_DERIVATIVES = _blend_derivatives()
"""Coefficients of s and of its derivatives 1 to 4, one column each, shape (10, 5)."""


def _unit_blend(fraction: Array) -> Array:
    """s and its derivatives 1 to 4 at fractions of the duration, shape (5, ...)."""
    return np.asarray(np.polynomial.polynomial.polyval(fraction, _BLEND_DERIVATIVES), float)


def _scaled(derivatives: Array, factor: float) -> Array:
    """Derivatives 0 to 4 of ``f(factor · t)`` from those of f; the first axis is the order."""
    return np.stack([derivative * factor**order for order, derivative in enumerate(derivatives)])


def _composed(outer: Array, inner: Array) -> Array:
    """Derivatives 0 to 4 of ``f(φ(t))`` by Faà di Bruno's formula.

    Args:
        outer: f and its derivatives with respect to φ at φ(t), shape (5, ...).
        inner: φ and its time derivatives, shape (5, ...).
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


def _sine_derivatives(angle: Array) -> Array:
    """sin and its derivatives 1 to 5, shape (6, ...). Rows 0 to 4 are those of sin, rows 1 to 5
    those of cos."""
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.stack([sine, cosine, -sine, -cosine, sine, cosine])


def _circle(center: tuple[float, ...], radius: float, angle: Array) -> Array:
    """Motion on a circle from the angle and its time derivatives, shape (5, ..., n)."""
    waves = radius * _sine_derivatives(angle[0])
    return _in_plane(center, waves[1:], waves[:5], angle)


def _in_plane(center: tuple[float, ...], x: Array, y: Array, angle: Array) -> Array:
    """Derivatives of ``center + (x(φ(t)), y(φ(t)), 0, …)`` from x, y, φ and their derivatives,
    shape (5, ..., n)."""
    derivatives = np.zeros((*angle.shape, len(center)))
    derivatives[0] = center
    derivatives[..., 0] += _composed(x, angle)
    derivatives[..., 1] += _composed(y, angle)
    return derivatives


def _between_dwells(make: Callable[..., Trajectory], **fields: Any) -> Callable[..., BetweenDwells]:
    """Factory of a motion between dwells. It accepts ``dwell`` and the fields of the motion as
    optional keywords."""
    make = partial(make, **fields)

    def between_dwells(*, dwell: float = DWELL, **fields: Any) -> BetweenDwells:
        return BetweenDwells(motion=make(**fields), dwell=dwell)

    own = inspect.signature(make)
    extra = inspect.Parameter(
        "dwell", inspect.Parameter.KEYWORD_ONLY, default=DWELL, annotation=float
    )
    between_dwells.__signature__ = own.replace(parameters=[*own.parameters.values(), extra])  # type: ignore[attr-defined]
    return between_dwells


def _chain(kind: Kind, *motions: Any) -> Callable[..., BetweenDwells]:
    """Factory of a chain between dwells. Named parts have no dwells of their own unless ``dwell``
    is given."""

    def part(motion: Any) -> Any:
        if isinstance(motion, Mapping):
            motion = (
                {"dwell": 0.0, **motion} if "dwell" in _fields_of(motion.get("name")) else motion
            )
        return motion if isinstance(motion, Real) else find_trajectory(motion, kind)

    def chain(*, motions: Any = motions, name: str = f"chain-{kind}") -> Chain:
        return Chain(
            motions=tuple(map(part, motions)) if isinstance(motions, (list, tuple)) else motions,
            name=name,
        )

    return _between_dwells(chain)


def _fields_of(name: Any) -> set[str]:
    """Fields of a named motion; empty if there is none of this name."""
    if is_waypoint_file(name):
        return {"duration", "dwell", "times", "poses"}
    return (
        set(inspect.signature(TRAJECTORIES[name]).parameters) - {"name"}
        if name in TRAJECTORIES
        else set()
    )


def _motions_of(
    kind: Kind,
    *,
    center: tuple[float, ...],
    size: float,
    out: tuple[float, ...],
    reach: tuple[float, ...],
    pace: float,
) -> dict[str, Callable[..., Trajectory]]:
    """Named motions of a kind about a center: half width ``size`` [m] and duration about ``pace``
    [s].

    Lines run from ``center − (size, size/2) − out`` to the opposite pose. Loops take about as long
    as other motions.
    """
    across = np.array(out) + np.pad([size, size / 2], (0, len(out) - 2))
    start = tuple((center - across).tolist())
    end = tuple((center + across).tolist())
    line = {"start": start, "end": end, "duration": pace}
    circle = {"radius": size, "center": center, "duration": pace}
    acceleration = tuple(30.0 * value / pace**2 for value in reach)
    makers: dict[str, Any] = {
        "circle": (PaperCircle, circle),
        "smooth-circle": (SmoothCircle, circle | {"duration": 2 * pace}),
        "line": (PointToPoint, line),
        "lemniscate": (
            Lemniscate,
            {"amplitude": (size, size / 2), "center": center, "duration": 2 * pace},
        ),
        "loop": (RandomLoop, {"center": center, "reach": reach, "acceleration": acceleration}),
    }
    made = {
        f"{name}-{kind}": _between_dwells(make, name=f"{name}-{kind}", **fields)
        for name, (make, fields) in makers.items()
    }
    back = {"name": f"line-{kind}", "start": end, "end": start}
    made[f"chain-{kind}"] = _chain(kind, {"name": f"line-{kind}"}, DWELL, back)
    return {**made, f"dwell-{kind}": partial(Dwell, name=f"dwell-{kind}", pose=center)}


_PLANAR_CIRCLE: dict[str, Any] = {"radius": 0.2165, "center": (0.0, 0.0)}  # Table 1
_SPATIAL_CIRCLE: dict[str, Any] = {
    "radius": 0.1,
    "center": (0.0, 0.0, 0.1, 0.1, 0.1, 0.1),
}  # Table 3

TRAJECTORIES: dict[str, Callable[..., Trajectory]] = {
    "circle-planar": _between_dwells(PaperCircle, name="circle-planar", **_PLANAR_CIRCLE),
    "circle-spatial": _between_dwells(PaperCircle, name="circle-spatial", **_SPATIAL_CIRCLE),
    "paper-planar": partial(PaperCircle, name="paper-planar", **_PLANAR_CIRCLE),
    "paper-spatial": partial(PaperCircle, name="paper-spatial", **_SPATIAL_CIRCLE),
    "smooth-circle-planar": _between_dwells(
        SmoothCircle, name="smooth-circle-planar", **_PLANAR_CIRCLE
    ),
    "smooth-circle-spatial": _between_dwells(
        SmoothCircle, name="smooth-circle-spatial", **_SPATIAL_CIRCLE
    ),
    "dwell-planar": partial(Dwell, name="dwell-planar", pose=(0.0, 0.0)),
    "dwell-spatial": partial(Dwell, name="dwell-spatial", pose=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0)),
    "line-planar": _between_dwells(
        PointToPoint, name="line-planar", start=(-0.1, -0.1), end=(0.1, 0.15)
    ),
    "line-spatial": _between_dwells(
        PointToPoint,
        name="line-spatial",
        start=(-0.05, -0.05, 0.1, 0.0, 0.0, 0.0),
        end=(0.05, 0.05, 0.15, 0.05, 0.05, 0.05),
    ),
    "lemniscate-planar": _between_dwells(
        Lemniscate, name="lemniscate-planar", amplitude=(0.2, 0.1), center=(0.0, 0.0)
    ),
    "lemniscate-spatial": _between_dwells(
        Lemniscate,
        name="lemniscate-spatial",
        amplitude=(0.1, 0.05),
        center=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0),
    ),
    # The loops stay within the radii of the paper's circles, about the same centers. At z = 0.1 m
    # the tensions change fast with depth and tilt, so the reach in these coordinates is small. The
    # accelerations are below those of the circles (35 and 16 m/s²). With them the first 2000
    # training seeds and the first 2000 held-out seeds have an exact-tracking payload of at least
    # 0.6 kg (planar) and 1.2 kg (spatial) on all robots of the paper, with all tensions above 5 N.
    "loop-planar": _between_dwells(
        RandomLoop, name="loop-planar", center=(0.0, 0.0), reach=(0.2165,), acceleration=(32.0,)
    ),
    "loop-spatial": _between_dwells(
        RandomLoop,
        name="loop-spatial",
        center=(0.0, 0.0, 0.1, 0.1, 0.1, 0.1),
        reach=(0.1, 0.01, 0.03),
        acceleration=(9.0, 2.5, 3.0),
    ),
    # Pick, dwell and place: out and back along the named lines.
    "chain-planar": _chain(
        "planar",
        {"name": "line-planar", "duration": 1.0},
        DWELL,
        {"name": "line-planar", "start": (0.1, 0.15), "end": (-0.1, -0.1), "duration": 1.0},
    ),
    "chain-spatial": _chain(
        "spatial",
        {"name": "line-spatial", "duration": 1.0},
        DWELL,
        {
            "name": "line-spatial",
            "start": (0.05, 0.05, 0.15, 0.05, 0.05, 0.05),
            "end": (-0.05, -0.05, 0.1, 0.0, 0.0, 0.0),
            "duration": 1.0,
        },
    ),
    # Sized for the robots of the environments, stadium-camera and ttk4900.
    **_motions_of(
        "point",
        center=(0.0, 0.0, -12.0),
        size=10.0,
        out=(0.0, 0.0, -2.0),
        reach=(10.0, 2.0),
        pace=10.0,
    ),
    **_motions_of(
        "planar-platform",
        center=(0.0, 0.0, 0.0),
        size=0.15,
        out=(0.0, 0.0, 0.05),
        reach=(0.15, 0.05),
        pace=4.0,
    ),
}
"""Factories of the named motions. Each accepts the fields of its class as optional keywords, and
``dwell`` if the motion is :class:`BetweenDwells`: all except ``paper-…``, the paper's circles as
printed, and ``dwell-…``."""


def trajectory_names(kind: Kind | int | None = None) -> list[str]:
    """Names in :data:`TRAJECTORIES`.

    Args:
        kind: restricts the names to this kind of robot, or to robots with this number of
            coordinates; None for all.
    """
    return [name for name in TRAJECTORIES if kind is None or _kinds_of(name) & set(_kinds(kind))]


def _kinds_of(name: str) -> set[Kind]:
    """Kinds of robots of a named motion: the longest kind that ends its name, else those with its
    coordinates."""
    ending = [kind for kind in COORDINATES if name.endswith(f"-{kind}")]
    return {max(ending, key=len)} if ending else set(_kinds(TRAJECTORIES[name]().coordinates))


def _kinds(kind: Kind | int) -> list[Kind]:
    """The kind, or the kinds with this number of coordinates."""
    return [name for name, n in COORDINATES.items() if kind in (name, n)]


def find_trajectory(
    trajectory: str | Path | Mapping[str, Any] | Trajectory, kind: Kind | int
) -> Trajectory:
    """A trajectory for a robot from a name, from a dict with a name and fields, or from a
    trajectory object.

    Args:
        trajectory: a name of :func:`trajectory_names`, JSON-able data such as ``{"name":
            "circle-spatial", "duration": 1.5, "dwell": 0.5}``, where ``duration`` is that of the
            motion between the dwells, an object that satisfies :class:`Trajectory`, or the place of
            one: ``file.py:name`` or ``package.module:name``. The object there may also be a
            function or a class that makes the trajectory without arguments. ``file.csv`` has
            waypoints, see :class:`Waypoints`, with dwells as the named motions; its columns are
            ``t`` [s] and the coordinates [m, rad]. Without ``t`` it needs a duration: ``{"name":
            "file.csv", "duration": 4.0}``.
        kind: the robot's kind, or its number of coordinates n.

    Raises:
        ValueError: if the name, a field or a value is invalid, or the trajectory is for another
            kind of robot.
    """
    kinds = _kinds(kind)
    coordinates = COORDINATES[kinds[0]]
    if isinstance(trajectory, Path):
        trajectory = str(trajectory)
    if isinstance(trajectory, str):
        trajectory = (
            _imported(trajectory)
            if ":" in trajectory or trajectory.endswith(".py")
            else {"name": trajectory}
        )
    if isinstance(trajectory, Mapping):
        trajectory = _named(dict(trajectory), kinds)
    elif not isinstance(trajectory, Trajectory) or isinstance(trajectory, type):
        other = ", a dict with one of these as 'name', or pass a Trajectory"
        raise unknown_name_error("trajectory", trajectory, trajectory_names(kind), other)
    number("duration", trajectory.duration, above=0, unit="s")
    if trajectory.coordinates != coordinates:
        raise ValueError(
            f"{trajectory.name!r} has {trajectory.coordinates} coordinates and the robot has {coordinates}"
        )
    return trajectory


def _named(fields: dict[str, Any], kinds: list[Kind]) -> Trajectory:
    """The motion with the name and the fields in a dict, for one of the kinds.

    Raises:
        ValueError: if the name, a field or a value is invalid, or the motion is for another kind.
    """
    name = fields.pop("name", None)
    if is_waypoint_file(name):
        return _between_waypoints(
            str(name), kinds, **mapping("trajectory", fields, sorted(_fields_of(name)))
        )
    if isinstance(name, str) and name in TRAJECTORIES and _kinds_of(name) & set(kinds):
        motion = TRAJECTORIES[name](**mapping("trajectory", fields, sorted(_fields_of(name))))
        if motion.coordinates == COORDINATES[kinds[0]]:
            return motion
    check_not_a_file(
        "trajectory", name, "file.py:name, or a .csv file; of a .json file, pass the data in Python"
    )
    names = [valid for kind in kinds for valid in trajectory_names(kind)]
    raise unknown_name_error("trajectory", name, dict.fromkeys(names))


def _between_waypoints(
    name: str,
    kinds: list[Kind],
    *,
    duration: float | None = None,
    dwell: float = DWELL,
    times: Any = None,
    poses: Any = None,
) -> BetweenDwells:
    """The spline through the waypoints of a file between dwells, or through ``poses``, so that
    stored data suffice.

    The duration scales the times of the file.
    """
    if poses is None:
        times, poses = read_waypoints(Path(name), [COORDINATE_NAMES[kind] for kind in kinds])
        if times is None and duration is None:
            raise ValueError(
                f'trajectory file {name!r} has no column t. Add it, or give a duration: {{"name": "{name}", '
                '"duration": 4}'
            )
        fractions = np.linspace(0.0, 1.0, len(poses)) if times is None else times / times[-1]
        times = (
            times
            if duration is None
            else fractions * number("duration", duration, above=0, unit="s")
        )
    return BetweenDwells(
        motion=Waypoints(name=Path(name).name, times=times, poses=poses), dwell=dwell
    )


@cache
def _imported(place: str) -> Trajectory:
    """The trajectory at ``file.py:name`` or ``package.module:name``; the same object in all calls.

    Raises:
        ValueError: if there is no such object, its code raises, or it neither is nor makes a
            trajectory.
    """
    try:
        found = import_object(place)
        ready = isinstance(found, Trajectory) and not isinstance(found, type)
        made = found if ready or not callable(found) else found()
    except (ValueError, ImportError, KeyboardInterrupt):
        raise
    except BaseException as error:
        remedy = "Name a Trajectory, or a function without arguments that returns one"
        raise ValueError(f"trajectory {place!r}: {raised(error)}. {remedy}") from error
    if not isinstance(made, Trajectory) or isinstance(made, type):
        raise ValueError(
            f"trajectory {place!r} gives {made!r}, which is no Trajectory: an object with name, duration, coordinates "
            "and a call that returns a Reference"
        )
    sampled(made, np.array([0.0, made.duration]), ORDERS[:3])
    return made


ORDERS = ("position", *_RATES)
"""Orders of a motion: position and its time derivatives."""


def sampled(trajectory: Trajectory, times: Array, orders: tuple[str, ...] = ORDERS) -> list[Array]:
    """The ``orders`` of a motion at times (k,) [s], each (k, n). A custom motion may return
    anything: it is checked.

    Raises:
        ValueError: if the motion does not return a :class:`Reference`, or a shape is wrong, or a
            number is not finite.
    """
    label = f"trajectory {trajectory.name!r}"
    shape = (len(times), trajectory.coordinates)
    motion = trajectory(times)
    if not isinstance(motion, Reference):
        raise ValueError(f"{label} must return a Reference, not {type(motion).__name__}")
    samples = [np.asarray(getattr(motion, name)) for name in orders]
    for name, values in zip(orders, samples, strict=True):
        if values.shape != shape:
            raise ValueError(
                f"{label} must return a {name} of shape {shape} for {shape[0]} times, not {values.shape}"
            )
        if values.dtype.kind not in "iuf":
            raise ValueError(f"{label} must return a {name} of numbers, not of {values.dtype}")
        if not np.all(np.isfinite(values)):
            time = times[np.flatnonzero(~np.all(np.isfinite(values), axis=1))[0]]
            raise ValueError(
                f"{label} must return finite numbers: its {name} at {time:g} s is not finite"
            )
    return samples
