"""How a learner's actions steer: they shift the reference of a classical law, or add to its drive commands.

Here is what one control period does with an observation and an action, for one episode or a batch. Wrappers train
through it and policies run through it, so that a bundle does in an evaluation what it did in training.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cablebot_baselines.classical.law import Array, first_steps
from cablebot_baselines.learned.base import Base, is_number
from cablebot_baselines.learned.features import OF_SHIFTS, check_features, feature_values
from cablebot_gym.envs.observation import PREVIEWS, observation_layout, preview_name
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits, Task

DERIVATIVES = ("pose", "velocity", "acceleration", "jerk", "snap")
"""Of the reference, in an observation's blocks ``reference_…``; rigid robots have the first three."""

DEFAULT_PERIOD = 1 / 500
"""Control period until :meth:`Steering.begin` has told it [s]."""

LONGEST_HOLD = 10.0
"""Largest time between two actions [s]."""


@dataclass(frozen=True, kw_only=True)
class Shift:
    """Actions in [−1, 1]ⁿ shift the reference inside the tube, along a spline that a law can track.

    Action k, taken at k · ``hold``, is the k-th control point of a uniform B-spline, the position part cut to the unit
    ball and scaled by the position bound, the rotation part by the rotation bound, both times ``share``. A control
    point has no weight yet when it is taken, and most of it ``(degree + 1)/2 · hold`` later. Before an episode all are
    0. A spline stays in the convex hull of its control points: the shift never leaves the tube.

    With a ``lead`` the spline does not shift the reference but takes its place: each control point is the reference so
    far ahead, plus the action. Where the reference's acceleration jumps, the motion's then does not; but the spline
    cuts corners, and that can leave the tube.

    Raises:
        ValueError: if a number is out of its range.
    """

    hold: float = 0.04
    """Time between two actions [s]; > 0. Rounded to whole control periods."""
    share: float = 0.95
    """Of the bounds of position and rotation, what a shift may use; in (0, 1]."""
    degree: int = 3
    """Of the spline, 2 to 5. Rigid torques follow the second derivative, those of joint springs the fourth."""
    lead: float = 0.0
    """0, or how far ahead the reference is read [s]: one of the observation's previews."""

    def __post_init__(self) -> None:
        _check_hold_and_share(self)
        if not isinstance(self.degree, Integral) or self.degree not in (2, 3, 4, 5):
            raise ValueError(f"degree must be 2, 3, 4 or 5, not {self.degree!r}")
        if not is_number(self.lead) or self.lead not in (0.0, *PREVIEWS):
            raise ValueError(f"lead must be 0 or a preview, {', '.join(map(str, PREVIEWS))} s, not {self.lead!r}")
        object.__setattr__(self, "degree", int(self.degree))
        object.__setattr__(self, "lead", float(self.lead))

    def actions(self, robot: Robot) -> int:
        """Size of an action."""
        return robot.coordinates

    @property
    def remembered(self) -> int:
        """How many of the last actions count."""
        return self.degree + 1

    def bounds(self, limits: Limits, coordinates: int) -> Array:
        """Largest shift of each coordinate, (n,) [m, rad]."""
        return self.share * np.array([limits.position] * min(coordinates, 3) + [limits.rotation] * 3)[:coordinates]

    def weights(self, times: Array, hold: float) -> Array:
        """Of the last control points in the spline and its derivatives to snap, (..., 5, degree + 1), oldest first.

        Args:
            times: since the last action, (...) [s]; from 0 to ``hold``.
            hold: as whole control periods give it [s].
        """
        basis = BSpline.basis_element(np.arange(self.degree + 2.0), extrapolate=False)
        age = np.arange(self.degree, -1.0, -1.0)
        places = np.asarray(times)[..., None] / hold + age
        # A knot belongs to the piece before it as well: the last one to the last piece, beyond which nothing is left.
        places = np.minimum(places, np.nextafter(age + 1, 0))
        orders = [
            np.nan_to_num(basis.derivative(order)(places) if order <= self.degree else 0 * places) / hold**order
            for order in range(5)
        ]
        return np.stack(orders, axis=-2)


@dataclass(frozen=True, kw_only=True)
class Residual:
    """Actions in [−1, 1]ᵐ are added to the drive commands of a law.

    Raises:
        ValueError: if a number is out of its range.
    """

    hold: float = 0.02
    """Time between two actions [s]; > 0. Rounded to whole control periods."""
    share: float = 0.3
    """Largest addition to a drive command; in (0, 1]."""

    def __post_init__(self) -> None:
        _check_hold_and_share(self)

    def actions(self, robot: Robot) -> int:
        """Size of an action."""
        return robot.cables

    @property
    def remembered(self) -> int:
        """How many of the last actions count."""
        return 1


def _check_hold_and_share(way: Shift | Residual) -> None:
    if not is_number(way.hold) or not 0 < way.hold <= LONGEST_HOLD:
        raise ValueError(f"hold must be a time above 0 s and at most {LONGEST_HOLD:g} s, not {way.hold!r}")
    if not is_number(way.share) or not 0 < way.share <= 1:
        raise ValueError(f"share must be above 0 and at most 1, not {way.share!r}")
    for name in ("hold", "share"):
        object.__setattr__(way, name, float(getattr(way, name)))  # of numpy's numbers too, JSON knows only these


_KINDS: dict[str, type[Shift] | type[Residual]] = {"shift": Shift, "residual": Residual}


def way_to_plain(way: Shift | Residual) -> dict[str, Any]:
    """A way to steer as JSON-able data; :func:`find_way` reads it."""
    return {"kind": next(kind for kind, made in _KINDS.items() if isinstance(way, made)), **asdict(way)}


def find_way(way: Shift | Residual | str | Mapping[str, Any]) -> Shift | Residual:
    """A way to steer from itself, from ``"shift"`` or ``"residual"``, or from ``{"kind": …, "hold": …}``.

    Raises:
        ValueError: if the kind or a key is unknown, or a value is not valid.
    """
    if isinstance(way, (Shift, Residual)):
        return way
    if not isinstance(way, (str, Mapping)):
        raise ValueError(f"steering must be {' or '.join(_KINDS)}, or a dict with one as its kind, not {way!r}")
    data = {"kind": way} if isinstance(way, str) else dict(way)
    kind = data.pop("kind", None)
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ValueError(f"steering: unknown kind {kind!r}; choose one of {', '.join(_KINDS)}")
    known = list(_KINDS[kind].__dataclass_fields__)
    if unknown := [name for name in data if name not in known]:
        raise ValueError(f"steering: unknown key {unknown[0]!r}; {kind} takes {', '.join(known)}")
    return _KINDS[kind](**data)


@dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """What one control instant leaves for the next, of one episode or of a batch."""

    actions: Array
    """The last ones that count, oldest first, (..., remembered, size); 0 before the first."""
    anchors: Array
    """What the control points of a shift with a lead are counted from, (..., remembered, n); otherwise empty."""
    step: NDArray[np.int64]
    """Control instants since the episode's start, (...)."""
    law: Any
    """The base law's own; None before the first instant."""


class Steering:
    """A base law and a way to steer it, at work.

    Args:
        robot: nominal.
        base: the law.
        way: how actions steer it.
        features: what a learner sees, see :mod:`cablebot_baselines.learned.features`.

    Raises:
        ValueError: if the law is not made for such robots, a feature is unknown, or a residual does not fit
            its features or the law.
    """

    def __init__(self, robot: Robot, *, base: Base, way: Shift | Residual, features: Sequence[str]) -> None:
        self.robot, self.base, self.way = robot, base, way
        self.features = check_features(features, robot)
        if isinstance(way, Residual) and (odd := [name for name in self.features if name in OF_SHIFTS]):
            raise ValueError(f"feature {odd[0]!r} is of a shifted reference, and a residual shifts none: leave it out")
        if isinstance(way, Residual) and base.weighs and not robot.flexible:
            raise ValueError(
                "a law that weighs its payload by its own torques takes a residual for mass: leave weighs out of the "
                "base, or steer by shift"
            )
        self.law = base.made(robot)
        self.actions = way.actions(robot)
        """Size of an action."""
        self._prepare(Limits(), DEFAULT_PERIOD)
        part = self.split(np.zeros(observation_layout(robot).size))
        self.inputs = self.seen(part, self.remembered(part, None, None)).size
        """How many numbers a learner sees."""

    def _prepare(self, limits: Limits, period: float) -> None:
        self._period = period
        self.periods = max(1, round(self.way.hold / period))
        """Control periods from one action to the next."""
        if isinstance(self.way, Shift):
            self._bounds = self.way.bounds(limits, self.robot.coordinates)
            hold, phases = self.periods * period, np.arange(self.periods) * period
            now, after = self.way.weights(phases, hold), self.way.weights(phases + period, hold)
            # Torques are held for a period: what they are for is the period's mean acceleration.
            self._motion, self._mean = now, (after[:, 1] - now[:, 1]) / period
            # Where an action is due, the oldest control point is about to go and the newest has no weight yet.
            self._present = now[:, :2].copy()
            self._present[0] = np.roll(now[0, :2], 1, axis=-1)

    def begin(self, tasks: Sequence[Task]) -> None:
        """Reads limits and control frequency.

        Raises:
            ValueError: if the tasks differ in these, or a task's robot does not fit.
        """
        self.law.begin(tasks)
        conditions = {(task.limits, task.control_frequency) for task in tasks}
        if len(conditions) != 1:
            raise ValueError("a learned policy runs episodes with the same limits and control frequency at once")
        ((limits, frequency),) = conditions
        self._prepare(limits, 1 / frequency)

    def split(self, observation: Any) -> dict[str, Array]:
        """The blocks of an observation by name, each (..., size).

        Raises:
            ValueError: if the observation is not of this robot's layout.
        """
        return self.law.split(observation)

    def remembered(self, part: dict[str, Array], memory: Memory | None, episode_start: Any) -> Memory:
        """The memory, where episodes that have no past begin one."""
        batch, way = part["pose"].shape[:-1], self.way
        first = first_steps(memory, episode_start, batch)
        if memory is not None and not np.any(first):
            return memory
        anchors = np.zeros((*batch, 0, self.robot.coordinates))
        if isinstance(way, Shift) and way.lead:
            anchors = np.repeat(part["reference_pose"][..., None, :], way.remembered, axis=-2)
        fresh = Memory(
            actions=np.zeros((*batch, way.remembered, self.actions)),
            anchors=anchors,
            step=np.zeros(batch, np.int64),
            law=None,
        )
        if memory is None:
            return fresh
        begun = first[..., None, None]
        return Memory(
            actions=np.where(begun, fresh.actions, memory.actions),
            anchors=np.where(begun, fresh.anchors, memory.anchors),
            step=np.where(first, 0, memory.step),
            law=memory.law,
        )

    def due(self, memory: Memory) -> NDArray[np.bool_]:
        """Which episodes take an action now, (...)."""
        return memory.step % self.periods == 0

    def seen(self, part: dict[str, Array], memory: Memory) -> Array:
        """What a learner sees before it acts, (..., features)."""
        made = {
            "elapsed": (memory.step * self._period)[..., None],
            "actions": memory.actions[..., 1:, :].reshape(*memory.step.shape, -1)
            if isinstance(self.way, Shift)
            else memory.actions[..., 0, :],
        }
        shift = np.zeros_like(part["pose"])
        if isinstance(self.way, Shift):
            position, velocity = np.moveaxis(self._spline(self._present[memory.step % self.periods], memory), -2, 0)
            anchored = bool(self.way.lead)
            shift = position - anchored * part["reference_pose"]
            made["shift"] = shift / self._bounds
            rate = velocity - anchored * part["reference_velocity"]
            made["shift_velocity"] = rate * self.periods * self._period / self._bounds
        made["error"] = part["reference_pose"] + shift - part["pose"]
        return feature_values(self.features, part, made)

    def respond(
        self, part: dict[str, Array], action: Array, memory: Memory, episode_start: Any = None
    ) -> tuple[Array, Memory]:
        """Drive commands (..., m) and the next memory; ``action`` (..., size) counts where one is :meth:`due`."""
        due = self.due(memory)
        actions, anchors = memory.actions, memory.anchors
        if np.any(due):
            taken = np.concatenate([actions[..., 1:, :], self._allowed(action)[..., None, :]], axis=-2)
            actions = np.where(due[..., None, None], taken, actions)
            if anchors.shape[-2]:
                assert isinstance(self.way, Shift)
                ahead = part["reference_pose"] + part[preview_name(self.way.lead)]
                moved = np.concatenate([anchors[..., 1:, :], ahead[..., None, :]], axis=-2)
                anchors = np.where(due[..., None, None], moved, anchors)
        now = Memory(actions=actions, anchors=anchors, step=memory.step, law=memory.law)
        start = episode_start if memory.law is not None else None
        command, law = self.law.respond(self._shifted(part, now), memory.law, start)
        if isinstance(self.way, Residual):
            command = command + self.way.share * actions[..., 0, :]
        return command, Memory(actions=actions, anchors=anchors, step=memory.step + 1, law=law)

    def _allowed(self, action: Array) -> Array:
        """An action within ±1; of a shift, its position part within the unit ball."""
        action = np.clip(np.asarray(action, float), -1.0, 1.0)
        if isinstance(self.way, Shift):
            lines = min(self.actions, 3)
            action[..., :lines] /= np.maximum(np.linalg.norm(action[..., :lines], axis=-1, keepdims=True), 1.0)
        return action

    def _spline(self, weights: Array, memory: Memory) -> Array:
        """What the weights (..., orders, remembered) make of the control points, (..., orders, n)."""
        points = memory.actions * self._bounds
        if memory.anchors.shape[-2]:
            points = points + memory.anchors
        result: Array = weights @ points
        return result

    def _shifted(self, part: dict[str, Array], memory: Memory) -> dict[str, Array]:
        """The blocks, with the shifted reference in place of the reference."""
        if not isinstance(self.way, Shift):
            return part
        phase = memory.step % self.periods
        weights = self._motion[phase]
        if not self.robot.flexible:
            weights = weights.copy()
            weights[..., 2, :] = self._mean[phase]
        motion = self._spline(weights, memory)
        moved = {}
        for order, name in enumerate(DERIVATIVES):
            block = f"reference_{name}"
            if block in part:
                moved[block] = motion[..., order, :] + (0.0 if self.way.lead else part[block])
        return part | moved
