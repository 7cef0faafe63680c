"""Action mapping: a learner's actions shift the reference of a classical law.

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

from cablebot_baselines.episodes import first_steps
from cablebot_baselines.laws.law import Array
from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.features import check_features, decays
from cablebot_gym.envs.observation import Blocks, observation_layout
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

    def __post_init__(self) -> None:
        period = number(
            "action_period", self.action_period, above=0.0, most=LONGEST_ACTION_PERIOD, unit="s"
        )
        fraction = number("fraction", self.fraction, above=0.0, most=1.0)
        degree = whole("degree", self.degree, least=2, most=5)
        object.__setattr__(self, "action_period", period)
        object.__setattr__(self, "fraction", fraction)
        object.__setattr__(self, "degree", degree)

    def actions(self, robot: Robot) -> int:
        """Size of an action."""
        return robot.coordinates

    @property
    def memory_length(self) -> int:
        """Number of past actions that affect the spline."""
        return self.degree + 1

    def bounds(self, error_bounds: ErrorBounds, robot: Robot) -> Array:
        """Largest shift of each coordinate, (n,) [m, rad]."""
        is_rotation = np.arange(robot.coordinates) >= robot.dimensions
        bounds = np.where(is_rotation, error_bounds.rotation, error_bounds.position)
        return self.fraction * bounds

    def weights(self, times: Array, action_period: float) -> Array:
        """Weights of the last control points in the spline and its derivatives up to snap.

        Args:
            times: time since the last action, (...) [s]; from 0 to ``action_period``.
            action_period: action period in whole control periods [s].

        Returns:
            (..., 5, degree + 1), oldest control point first.
        """
        knots = np.arange(self.degree + 2.0)
        basis = BSpline.basis_element(knots, extrapolate=False)
        ages = np.arange(self.degree, -1.0, -1.0)
        times = np.asarray(times)[..., None]
        phases = times / action_period
        # A knot is evaluated on the piece before it, because the basis function ends at its last
        # knot.
        before_knot = np.nextafter(ages + 1, 0)
        parameters = np.minimum(phases + ages, before_knot)
        shape = (*phases.shape[:-1], 5, self.memory_length)
        weights = np.zeros(shape)
        largest_order = min(4, self.degree)
        for order in range(largest_order + 1):
            derivative = basis.derivative(order)
            values = derivative(parameters)
            values = np.nan_to_num(values)
            weights[..., order, :] = values / action_period**order
        return weights


def action_mapping_to_jsonable(action_mapping: Any) -> dict[str, Any]:
    """An action mapping as JSON-able data, for :func:`find_action_mapping`."""
    return {"kind": action_mapping.kind, **asdict(action_mapping)}


def find_action_mapping(action_mapping: Shift | str | Mapping[str, Any]) -> Shift:
    """Returns an action mapping from an object, the kind ``"shift"``, or a dict ``{"kind":
    "shift", "action_period": …}``.

    Raises:
        ValueError: if the kind or a key is unknown, or a value is invalid.
    """
    if isinstance(action_mapping, Shift):
        return action_mapping
    if isinstance(action_mapping, str):
        action_mapping = {"kind": action_mapping}
    keys = {"kind", *Shift.__dataclass_fields__}
    data = mapping("steering", action_mapping, sorted(keys))
    choice("kind of steering", data.pop("kind", None), [Shift.kind])
    return record("steering", Shift, data)


@dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """State between two control instants, of one episode or of a batch."""

    actions: Array
    """Last actions, oldest first, (..., memory_length, size). Before the first action, those of a
    shift to the start pose."""
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
        ValueError: if the law does not support the robot, or a feature is unknown.
    """

    def __init__(
        self, robot: Robot, *, base: Base, action_mapping: Shift, features: Sequence[str]
    ) -> None:
        self.robot = robot
        self.base = base
        self.action_mapping = action_mapping
        self.features = check_features(features, robot)
        self.law = base.make(robot)
        self.actions = action_mapping.actions(robot)
        """Size of an action."""
        self._start = np.zeros(robot.coordinates)
        self._prepare(ErrorBounds(), DEFAULT_PERIOD)
        layout = observation_layout(robot)
        blocks = self.split(np.zeros(layout.size))
        memory = self.reset_memory(blocks, None, None)
        self.inputs = self.observe(blocks, memory).size
        """Size of a learner's observation."""

    def _prepare(self, error_bounds: ErrorBounds, period: float) -> None:
        self._period = period
        periods = round(self.action_mapping.action_period / period)
        self.periods = max(1, periods)
        """Number of control periods per action."""
        shift = self.action_mapping
        self._bounds = shift.bounds(error_bounds, self.robot)
        action_period = self.periods * period
        # Weights of the control points at each phase of an action period.
        phases = np.arange(self.periods) * period
        now = shift.weights(phases, action_period)
        after = shift.weights(phases + period, action_period)
        self._motion = now
        # Torques are constant over a period, so that the law needs the period's mean
        # acceleration.
        speed_change = after[:, 1] - now[:, 1]
        self._mean = speed_change / period
        # When an action is due, the oldest control point is about to be dropped, and the newest
        # has zero weight.
        self._present = now.copy()
        self._present[0] = np.roll(now[0], 1, axis=-1)

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
                "a learned policy requires the same error bounds and control frequency in all "
                "episodes"
            )
        error_bounds, frequency = conditions.pop()
        self._prepare(error_bounds, 1 / frequency)
        shift_by_motion: dict[int, Array] = {}  # few motions, many tasks
        shifts = []
        for task in tasks:
            motion = task.trajectory
            if id(motion) not in shift_by_motion:
                reference = motion(0.0)
                shift_by_motion[id(motion)] = task.start_pose - reference.position
            shifts.append(shift_by_motion[id(motion)])
        self._start = np.array(shifts)
        ranges = np.ptp(self._start, axis=0)
        if not ranges.any():
            self._start = self._start[0]

    def split(self, observation: Any) -> Blocks:
        """The blocks of an observation by name, each (..., size).

        Raises:
            ValueError: if the observation does not have this robot's layout.
        """
        return self.law.split(observation)

    def reset_memory(self, blocks: Blocks, memory: Memory | None, episode_start: Any) -> Memory:
        """Resets the memory of the episodes that start."""
        batch = blocks["pose"].shape[:-1]
        starts = first_steps(memory, episode_start, batch)
        if memory is not None and not np.any(starts):
            return memory
        actions = np.zeros((*batch, self.action_mapping.memory_length, self.actions))
        start_action = self._start / self._bounds
        actions += np.expand_dims(start_action, -2)
        if memory is None:
            return Memory(actions=actions, step=np.zeros(batch, np.int64), law=None)
        rows = starts[..., None, None]
        return Memory(
            actions=np.where(rows, actions, memory.actions),
            step=np.where(starts, 0, memory.step),
            law=memory.law,
        )

    def due(self, memory: Memory) -> NDArray[np.bool_]:
        """Mask of the episodes that take an action at this instant, (...)."""
        return memory.step % self.periods == 0

    def observe(self, blocks: Blocks, memory: Memory) -> Array:
        """The observation of a learner before its action, (..., features)."""
        time = memory.step * self._period
        # The oldest action no longer affects the spline.
        actions = memory.actions[..., 1:, :]
        phase = memory.step % self.periods
        shift = self._spline(self._present[phase], memory)[..., 0, :]
        values = {
            **blocks,
            "time_since_start": decays(time[..., None]),
            "time_to_go_decays": decays(blocks["time_to_go"]),
            "actions": actions.reshape(*memory.step.shape, -1),
            "error": blocks["reference_pose"] + shift - blocks["pose"],
        }
        return np.concatenate([values[name] for name in self.features], axis=-1)

    def respond(
        self, blocks: Blocks, action: Array, memory: Memory, episode_start: Any = None
    ) -> tuple[Array, Memory]:
        """Returns actions (..., m) and the next memory; ``action`` (..., size) is used where one is
        :meth:`due`."""
        due = self.due(memory)
        if np.any(due):
            # to ±1, and the position to the unit ball
            clipped = np.clip(np.asarray(action, float), -1.0, 1.0)
            position = clipped[..., :3]
            length = np.linalg.norm(position, axis=-1, keepdims=True)
            position /= np.maximum(length, 1.0)
            later = memory.actions[..., 1:, :]  # without the oldest action
            moved = np.concatenate([later, clipped[..., None, :]], axis=-2)
            actions = np.where(due[..., None, None], moved, memory.actions)
            memory = replace(memory, actions=actions)
        if memory.law is None:
            episode_start = None
        shifted = self._shifted_reference(blocks, memory)
        applied, law = self.law.respond(shifted, memory.law, episode_start)
        memory = replace(memory, step=memory.step + 1, law=law)
        return applied, memory

    def _spline(self, weights: Array, memory: Memory) -> Array:
        """Spline (..., orders, n) from weights (..., orders, memory_length) and the control
        points."""
        points = memory.actions * self._bounds
        result: Array = weights @ points
        return result

    def _shifted_reference(self, blocks: Blocks, memory: Memory) -> Blocks:
        """The blocks with the shifted reference instead of the reference."""
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
                shifted[block] = motion[..., order, :] + blocks[block]
        return shifted
