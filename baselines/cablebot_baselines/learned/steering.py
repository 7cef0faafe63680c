"""Action mappings: a learner's actions shift the reference of a classical law, or add to the law's
actions.

This module computes one control period from an observation and an action, for one episode or a
batch. The wrappers for training and the policies for evaluation both use it, so that a policy
behaves the same in both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cablebot_baselines.classical.law import Array
from cablebot_baselines.episodes import first_steps
from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.features import SHIFT_FEATURES, check_features, feature_values
from cablebot_gym.envs.observation import PREVIEWS, observation_layout, preview_name
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds, Task
from cablebot_gym.utils.checks import choice, mapping, number, record, whole

DERIVATIVES = ("pose", "velocity", "acceleration", "jerk", "snap")
"""Suffixes of the observation's blocks ``reference_…``; rigid robots have the first three."""

DEFAULT_PERIOD = 1 / 500
"""Control period before :meth:`Steering.reset` sets it [s]."""

LONGEST_ACTION_PERIOD = 10.0
"""Largest time between two actions [s]."""


@dataclass(frozen=True, kw_only=True)
class Shift:
    """Actions in [−1, 1]ⁿ shift the reference within the error bounds, along a smooth spline that a
    law can track.

    Action k, taken at k · ``action_period``, is the k-th control point of a uniform B-spline. Its
    position is clipped to the unit ball and scaled by the position bound; its rotation is scaled by
    the rotation bound; both are multiplied by ``fraction``. The weight of a control point is zero
    when the action is taken, and largest ``(degree + 1)/2 · action_period`` later. Before an
    episode all control points are the start pose of the task minus the reference, so that the
    shifted motion starts at rest where the robot is. A spline stays in the convex hull of its
    control points, so that the shift never exceeds the error bounds.

    With a ``preview``, the spline replaces the reference: each control point is the reference at
    this time ahead, plus the action. The motion's acceleration is then continuous where the
    reference's acceleration jumps. However, the spline cuts corners, which can exceed the error
    bounds.

    Raises:
        ValueError: if a number is out of its range.
    """

    kind: ClassVar[str] = "shift"

    action_period: float = 0.04
    """Time between two actions [s]; > 0. It is rounded to whole control periods."""
    fraction: float = 0.95
    """Largest shift as a fraction of the bounds of position and rotation; in (0, 1]."""
    degree: int = 3
    """Degree of the spline, 2 to 5. Torques depend on its second derivative, with joint springs on
    its fourth."""
    preview: float = 0.0
    """Preview time of the reference [s]: 0, or one of the observation's previews."""

    def __post_init__(self) -> None:
        _check_period_and_fraction(self)
        object.__setattr__(self, "degree", whole("degree", self.degree, least=2, most=5))
        object.__setattr__(self, "preview", number("preview", self.preview, unit="s"))
        if self.preview not in (0.0, *PREVIEWS):
            raise ValueError(
                f"preview must be one of 0, {', '.join(map(str, PREVIEWS))} s, not {self.preview!r}"
            )

    def actions(self, robot: Robot) -> int:
        """Size of an action."""
        return robot.coordinates

    @property
    def memory_length(self) -> int:
        """Number of past actions that affect the spline."""
        return self.degree + 1

    def bounds(self, error_bounds: ErrorBounds, robot: Robot) -> Array:
        """Largest shift of each coordinate, (n,) [m, rad]."""
        turning = np.arange(robot.coordinates) >= robot.dimensions
        return self.fraction * np.where(turning, error_bounds.rotation, error_bounds.position)

    def weights(self, times: Array, action_period: float) -> Array:
        """Weights of the last control points in the spline and its derivatives up to snap.

        Args:
            times: time since the last action, (...) [s]; from 0 to ``action_period``.
            action_period: action period in whole control periods [s].

        Returns:
            (..., 5, degree + 1), oldest control point first.
        """
        basis = BSpline.basis_element(np.arange(self.degree + 2.0), extrapolate=False)
        age = np.arange(self.degree, -1.0, -1.0)
        parameters = np.asarray(times)[..., None] / action_period + age
        # A knot is evaluated on the piece before it, because the basis function ends at its last
        # knot.
        parameters = np.minimum(parameters, np.nextafter(age + 1, 0))
        weights = np.zeros((*parameters.shape[:-1], 5, self.degree + 1))
        for order in range(min(4, self.degree) + 1):
            derivative = basis.derivative(order)(parameters)
            weights[..., order, :] = np.nan_to_num(derivative) / action_period**order
        return weights


@dataclass(frozen=True, kw_only=True)
class Residual:
    """Actions in [−1, 1]ᵐ, scaled by ``fraction``, are added to the actions of a law.

    Raises:
        ValueError: if a number is out of its range.
    """

    kind: ClassVar[str] = "residual"
    preview: ClassVar[float] = 0.0

    action_period: float = 0.02
    """Time between two actions [s]; > 0. It is rounded to whole control periods."""
    fraction: float = 0.3
    """Largest addition to an action; in (0, 1]."""

    def __post_init__(self) -> None:
        _check_period_and_fraction(self)

    def actions(self, robot: Robot) -> int:
        """Size of an action."""
        return robot.cables

    @property
    def memory_length(self) -> int:
        """Number of past actions in the memory."""
        return 1


def _check_period_and_fraction(action_mapping: Shift | Residual) -> None:
    period = number(
        "action_period",
        action_mapping.action_period,
        above=0.0,
        most=LONGEST_ACTION_PERIOD,
        unit="s",
    )
    object.__setattr__(action_mapping, "action_period", period)
    object.__setattr__(
        action_mapping, "fraction", number("fraction", action_mapping.fraction, above=0.0, most=1.0)
    )


_KINDS: dict[str, type[Shift] | type[Residual]] = {Shift.kind: Shift, Residual.kind: Residual}


def action_mapping_to_jsonable(action_mapping: Any) -> dict[str, Any]:
    """An action mapping as JSON-able data, for :func:`find_action_mapping`."""
    return {"kind": action_mapping.kind, **asdict(action_mapping)}


def find_action_mapping(
    action_mapping: Shift | Residual | str | Mapping[str, Any],
) -> Shift | Residual:
    """Returns an action mapping from an object, a kind, or a dict ``{"kind": …, "action_period":
    …}``.

    The kinds are ``"shift"`` and ``"residual"``.

    Raises:
        ValueError: if the kind or a key is unknown, or a value is invalid.
    """
    if isinstance(action_mapping, (Shift, Residual)):
        return action_mapping
    data = {"kind": action_mapping} if isinstance(action_mapping, str) else action_mapping
    known = {"kind", *Shift.__dataclass_fields__, *Residual.__dataclass_fields__}
    data = mapping("steering", data, sorted(known))
    kind = choice("kind of steering", data.pop("kind", None), _KINDS)
    return record("steering", _KINDS[kind], data)


@dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """State between two control instants, of one episode or of a batch."""

    actions: Array
    """Last actions, oldest first, (..., memory_length, size). Before the first action, those of a
    shift to the start pose; 0 for a residual."""
    anchors: Array
    """Origins of the control points of a shift with a preview, (..., memory_length, n); otherwise
    empty."""
    step: NDArray[np.int64]
    """Number of control instants since the episode's start, (...)."""
    law: Any
    """State of the base law; None before the first instant."""


class Steering:
    """A base law with an action mapping: computes the learner's observation and the applied
    actions.

    Args:
        robot: nominal robot.
        base: base law.
        action_mapping: mapping from a learner's actions to the base law.
        features: observation of a learner, see :mod:`cablebot_baselines.learned.features`.

    Raises:
        ValueError: if the law does not support the robot, a feature is unknown, or a residual is
            combined with features of a shift or with a law that estimates the payload of a rigid
            robot.
    """

    def __init__(
        self, robot: Robot, *, base: Base, action_mapping: Shift | Residual, features: Sequence[str]
    ) -> None:
        self.robot = robot
        self.base = base
        self.action_mapping = action_mapping
        self.features = check_features(features, robot)
        if isinstance(action_mapping, Residual):
            for name in self.features:
                if name in SHIFT_FEATURES:
                    raise ValueError(
                        f"feature {name!r} requires steering of kind shift: remove it, or use shift"
                    )
            if base.estimates_payload and not robot.flexible:
                raise ValueError(
                    "a residual would bias the payload estimate of the base law: set estimates_payload to False, or "
                    "use steering of kind shift"
                )
        self.law = base.make(robot)
        self.actions = action_mapping.actions(robot)
        """Size of an action."""
        self._start = np.zeros(robot.coordinates)
        self._prepare(ErrorBounds(), DEFAULT_PERIOD)
        blocks = self.split(np.zeros(observation_layout(robot).size))
        self.inputs = self.observe(blocks, self.reset_memory(blocks, None, None)).size
        """Size of a learner's observation."""

    def _prepare(self, error_bounds: ErrorBounds, period: float) -> None:
        self._period = period
        self.periods = max(1, round(self.action_mapping.action_period / period))
        """Number of control periods per action."""
        if isinstance(self.action_mapping, Shift):
            self._bounds = self.action_mapping.bounds(error_bounds, self.robot)
            action_period = self.periods * period
            phases = np.arange(self.periods) * period
            now = self.action_mapping.weights(phases, action_period)
            after = self.action_mapping.weights(phases + period, action_period)
            # Torques are constant over a period, so that the law needs the period's mean
            # acceleration.
            self._motion = now
            self._mean = (after[:, 1] - now[:, 1]) / period
            # When an action is due, the oldest control point is about to be dropped, and the newest
            # has zero weight.
            self._present = now[:, :2].copy()
            self._present[0] = np.roll(now[0, :2], 1, axis=-1)

    def reset(self, tasks: Sequence[Task]) -> None:
        """Reads the error bounds, the control frequency and the start poses of the tasks.

        Raises:
            ValueError: if the tasks differ in bounds or frequency, or a task's robot is not
                supported.
        """
        self.law.reset(tasks)
        conditions = {(task.error_bounds, task.control_frequency) for task in tasks}
        if len(conditions) != 1:
            raise ValueError(
                "a learned policy requires the same error bounds and control frequency in all episodes"
            )
        ((error_bounds, frequency),) = conditions
        self._prepare(error_bounds, 1 / frequency)
        shifts: dict[int, Array] = {}  # few motions, many tasks
        for task in tasks:
            if id(task.trajectory) not in shifts:
                start_shift = task.start_pose - task.trajectory(0.0).position
                shifts[id(task.trajectory)] = start_shift
        self._start = np.array([shifts[id(task.trajectory)] for task in tasks])
        if not np.ptp(self._start, axis=0).any():
            self._start = self._start[0]

    def split(self, observation: Any) -> dict[str, Array]:
        """The blocks of an observation by name, each (..., size).

        Raises:
            ValueError: if the observation does not have this robot's layout.
        """
        return self.law.split(observation)

    def reset_memory(
        self, blocks: dict[str, Array], memory: Memory | None, episode_start: Any
    ) -> Memory:
        """Resets the memory of the episodes that start."""
        batch = blocks["pose"].shape[:-1]
        action_mapping = self.action_mapping
        starts = first_steps(memory, episode_start, batch)
        if memory is not None and not np.any(starts):
            return memory
        length = action_mapping.memory_length
        actions = np.zeros((*batch, length, self.actions))
        anchors = np.zeros((*batch, 0, self.robot.coordinates))
        if isinstance(action_mapping, Shift):
            actions += np.expand_dims(self._start / self._bounds, -2)
        if action_mapping.preview:
            anchors = np.repeat(blocks["reference_pose"][..., None, :], length, axis=-2)
        if memory is None:
            step = np.zeros(batch, np.int64)
            return Memory(actions=actions, anchors=anchors, step=step, law=None)
        rows = starts[..., None, None]
        return Memory(
            actions=np.where(rows, actions, memory.actions),
            anchors=np.where(rows, anchors, memory.anchors),
            step=np.where(starts, 0, memory.step),
            law=memory.law,
        )

    def due(self, memory: Memory) -> NDArray[np.bool_]:
        """Mask of the episodes that take an action at this instant, (...)."""
        return memory.step % self.periods == 0

    def observe(self, blocks: dict[str, Array], memory: Memory) -> Array:
        """The observation of a learner before its action, (..., features)."""
        # The oldest action of a shift no longer affects the spline.
        actions = memory.actions[..., 0, :]
        shift = np.zeros_like(blocks["pose"])
        derived = {"time_since_start": (memory.step * self._period)[..., None]}
        if isinstance(self.action_mapping, Shift):
            actions = memory.actions[..., 1:, :].reshape(*memory.step.shape, -1)
            spline = self._spline(self._present[memory.step % self.periods], memory)
            anchored = bool(self.action_mapping.preview)
            shift = spline[..., 0, :] - anchored * blocks["reference_pose"]
            rate = spline[..., 1, :] - anchored * blocks["reference_velocity"]
            derived["shift"] = shift / self._bounds
            derived["shift_velocity"] = rate * self.periods * self._period / self._bounds
        derived["actions"] = actions
        derived["error"] = blocks["reference_pose"] + shift - blocks["pose"]
        return feature_values(self.features, blocks, derived)

    def respond(
        self, blocks: dict[str, Array], action: Array, memory: Memory, episode_start: Any = None
    ) -> tuple[Array, Memory]:
        """Returns actions (..., m) and the next memory; ``action`` (..., size) is used where one is
        :meth:`due`."""
        due = self.due(memory)
        if np.any(due):
            memory = self._with_action(blocks, action, memory, due[..., None, None])
        if memory.law is None:
            episode_start = None
        applied, law = self.law.respond(
            self._shifted_reference(blocks, memory), memory.law, episode_start
        )
        if isinstance(self.action_mapping, Residual):
            applied = applied + self.action_mapping.fraction * memory.actions[..., 0, :]
        return applied, replace(memory, step=memory.step + 1, law=law)

    def _with_action(
        self, blocks: dict[str, Array], action: Array, memory: Memory, due: NDArray[np.bool_]
    ) -> Memory:
        """The memory with another action, and its anchor, in the episodes that are due."""
        actions = _appended(memory.actions, self._clipped(action), due)
        anchors = memory.anchors
        if self.action_mapping.preview:
            ahead = blocks["reference_pose"] + blocks[preview_name(self.action_mapping.preview)]
            anchors = _appended(anchors, ahead, due)
        return replace(memory, actions=actions, anchors=anchors)

    def _clipped(self, action: Array) -> Array:
        """Clips an action to ±1, and the position of a shift to the unit ball."""
        action = np.clip(np.asarray(action, float), -1.0, 1.0)
        if isinstance(self.action_mapping, Shift):
            position = action[..., :3]
            position /= np.maximum(np.linalg.norm(position, axis=-1, keepdims=True), 1.0)
        return action

    def _spline(self, weights: Array, memory: Memory) -> Array:
        """Spline (..., orders, n) from weights (..., orders, memory_length) and the control
        points."""
        points = memory.actions * self._bounds
        if self.action_mapping.preview:
            points = points + memory.anchors
        result: Array = weights @ points
        return result

    def _shifted_reference(self, blocks: dict[str, Array], memory: Memory) -> dict[str, Array]:
        """The blocks with the shifted reference instead of the reference."""
        if not isinstance(self.action_mapping, Shift):
            return blocks
        phase = memory.step % self.periods
        weights = self._motion[phase]
        if not self.robot.flexible:
            weights = weights.copy()
            weights[..., 2, :] = self._mean[phase]
        motion = self._spline(weights, memory)
        shifted = dict(blocks)
        for order, name in enumerate(DERIVATIVES):
            block = f"reference_{name}"
            if block in blocks:
                origin: Array | float = 0.0
                if not self.action_mapping.preview:
                    origin = blocks[block]
                shifted[block] = motion[..., order, :] + origin
        return shifted


def _appended(values: Array, newest: Array, rows: NDArray[np.bool_]) -> Array:
    """Values (..., length, size) without the oldest and with the newest, in the marked rows."""
    moved = np.concatenate([values[..., 1:, :], newest[..., None, :]], axis=-2)
    return np.where(rows, moved, values)
