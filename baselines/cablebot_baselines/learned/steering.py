"""Steered control: a learner's actions shift the reference of ``observing`` within the error bounds.

The environment for training and the policy for evaluation both use :class:`Steering`, so that a
learner acts the same in both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from cablebot_baselines.episodes import first_steps
from cablebot_baselines.laws.law import Array
from cablebot_baselines.laws.observer_law import REFERENCE, Instant
from cablebot_baselines.laws.observing import Observing
from cablebot_gym.envs.observation import Blocks, observation_layout
from cablebot_gym.motions import random_loop
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task

ACTIONS = 40
"""Number of actions in a random loop."""

FRACTION = 0.8
"""Largest shift as a fraction of the error bounds."""

DEGREE = {"rigid": 3, "flexible": 5}
"""Degree of the spline: torques depend on its second derivative, with joint springs on its fourth."""

PAYLOAD_PRIOR = 3.0
"""Largest payload that the observer considers possible, in payloads of exact tracking."""

PREVIEWS = (1, 2, 3, 4, 6, 8)
"""Accelerations of the reference that a learner sees, in actions ahead."""

TIME_CONSTANTS = (0.5, 1.5, 4.0, 10.0, 25.0)
"""Time constants τ of the inputs exp(−t/τ) that mark the start and the end of a motion, in actions."""


STRENGTH_SCALE = 5.0
"""Factor of the estimated deviations of the motors' strengths."""

LARGEST_INPUT = 5.0
"""Largest input of a learner."""


class ShiftSpline:
    """Uniform B-spline whose control points are the last actions.

    A control point has the weight zero when its action is taken. The spline stays within the convex
    hull of its control points, so that the shift never exceeds their bounds.

    Args:
        degree: degree of the spline.
        action_period: time between two actions [s].
    """

    def __init__(self, degree: int, action_period: float) -> None:
        self._action_period = action_period
        basis = BSpline.basis_element(np.arange(degree + 2.0))
        ages = np.arange(degree, -1.0, -1.0)
        slopes = np.array([basis(ages, order) for order in range(degree + 1)])
        self._series = np.zeros((5, degree + 1, degree + 1))
        """Taylor series of the weights at an action, by derivative, power and control point."""
        for order in range(min(4, degree) + 1):
            for power in range(degree + 1 - order):
                factor = math.factorial(power) * action_period**order
                self._series[order, power] = slopes[order + power] / factor

    def weights(self, times: Array) -> Array:
        """Weights of the control points in the spline and its derivatives up to snap, (..., 5, degree
        + 1), the oldest control point first.

        Args:
            times: times since the last action [s], (...).
        """
        fractions = np.asarray(times) / self._action_period
        exponents = np.arange(self._series.shape[1])
        powers = fractions[..., None, None, None] ** exponents
        weights: Array = (powers @ self._series)[..., 0, :]
        return weights


@dataclass(frozen=True, kw_only=True, eq=False)
class Memory:
    """State between two control instants, of one episode or of a batch."""

    actions: Array
    """Last actions, the oldest first, (..., degree + 1, n). Before the first action, those of a shift
    to the start pose."""
    step: NDArray[np.int64]
    """Number of control instants since the start of the episode, (...)."""
    law: Any
    """State of the steered law; None before the first instant."""


class Steering(Observing):
    """``observing`` with a reference that a learner shifts.

    Args:
        robot: nominal robot.
    """

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot, payload_prior=PAYLOAD_PRIOR)
        self._degree = DEGREE[robot.joints]
        self._wanted_period = random_loop(robot.kind, 0).duration / ACTIONS
        n = robot.coordinates
        edges = 2 * len(TIME_CONSTANTS)
        self.inputs = edges + n * (3 + len(PREVIEWS) + self._degree + 1) + 1 + robot.cables
        """Size of a learner's observation."""

    def reset(self, tasks: Sequence[Task]) -> None:
        """Passes the tasks to the law, and computes what a learner sees of their motions.

        Raises:
            ValueError: if the tasks differ in error bounds or control frequency, or in the robot from
                that of the law.
        """
        conditions = {(task.error_bounds, task.control_frequency) for task in tasks}
        if len(conditions) != 1:
            raise ValueError(
                "a steered law needs the same error bounds and control frequency in all episodes"
            )
        error_bounds, frequency = conditions.pop()
        super().reset(tasks)
        self._period = 1 / frequency
        self.periods = max(1, round(self._wanted_period * frequency))
        """Number of control periods per action."""
        self._action_period = self.periods * self._period
        self._spline = ShiftSpline(self._degree, self._action_period)
        before_action = np.array(self._action_period)
        self._present = self._spline.weights(before_action)[0]
        """Weights of the shift when an action is due."""
        self._bounds = FRACTION * error_bounds.of_coordinates(self.robot)
        self._motion = np.zeros(len(tasks), np.int64)
        """Number of the motion of each episode, (N,)."""
        self._start = np.empty((len(tasks), self.robot.coordinates))
        """Shift to the start pose, as an action, (N, n)."""
        tables = []
        for index, (task, rows) in enumerate(self._motions):
            tables.append(self._inputs_of(task))
            shift = task.start_pose - task.trajectory(0.0).position
            self._motion[rows] = index
            self._start[rows] = shift / self._bounds
        self._seen = _padded(tables)
        if len(self._motions) == 1:  # serves any number of episodes
            self._motion = self._motion[0]
            self._start = self._start[0]

    def _prepare(self, payloads: Array) -> None:
        super()._prepare(payloads)
        self.exact_payloads = payloads / PAYLOAD_PRIOR
        """Payload of exact tracking, at least the mass of the platform, of each episode, (N,) [kg]."""

    def _inputs_of(self, task: Task) -> Array:
        """What a learner sees of a motion at each action, (actions, size)."""
        motion = task.trajectory
        period = self._action_period
        layout = observation_layout(self.robot)
        scale = {name: layout.per_scale[part] for name, part in layout.slices().items()}
        actions = motion.duration / period
        instants = np.arange(math.ceil(actions) + 1)
        values = []
        for span in (instants, actions - instants):
            values.append(np.exp(-span[:, None] / TIME_CONSTANTS))
        now = motion(instants * period)
        values.append((now.position - self.robot.home) * scale["reference_pose"])
        values.append(now.velocity * scale["reference_velocity"])
        for ahead in (0, *PREVIEWS):
            later = motion((instants + ahead) * period)
            values.append(later.acceleration * scale["reference_acceleration"])
        return np.concatenate(values, axis=1)

    def started(self, memory: Memory | None, episode_start: Any, shape: tuple[int, ...]) -> Memory:
        """The memory, in which the episodes that start are new.

        Raises:
            RuntimeError: before the first :meth:`reset`.
        """
        self._check_reset()
        starts = first_steps(memory, episode_start, shape)
        start = np.broadcast_to(self._start, (*shape, self.robot.coordinates))
        start = start[..., None, :]
        actions = np.repeat(start, self._degree + 1, axis=-2)
        if memory is None:
            return Memory(actions=actions, step=np.zeros(shape, np.int64), law=None)
        return Memory(
            actions=np.where(starts[..., None, None], actions, memory.actions),
            step=np.where(starts, 0, memory.step),
            law=memory.law,
        )

    def due(self, memory: Memory) -> NDArray[np.bool_]:
        """Mask of the episodes that take an action at this instant, (...)."""
        return memory.step % self.periods == 0

    def observe(self, blocks: Blocks, memory: Memory) -> Array:
        """The observation of a learner when an action is due, (..., inputs)."""
        last = self._seen.shape[1] - 1
        instant = np.minimum(memory.step // self.periods, last)
        past = memory.actions[..., 1:, :]
        shift = self._bounds * (self._present @ memory.actions)
        error = blocks["reference_pose"] + shift - blocks["pose"]
        values = [
            self._seen[self._motion, instant],
            past.reshape(*memory.step.shape, -1),
            error / self._bounds,
            self._estimates(memory),
        ]
        return np.clip(np.concatenate(values, axis=-1), -LARGEST_INPUT, LARGEST_INPUT)

    def _estimates(self, memory: Memory) -> Array:
        """Payload and strengths of the motors, (..., 1 + m); zero at the start of an episode."""
        shape = (*memory.step.shape, 1 + self.robot.cables)
        if memory.law is None:
            return np.zeros(shape)
        estimate = self.observer.estimate(memory.law.observer)
        payload = (estimate.mass - self.robot.mass) / self.exact_payloads
        weakness = STRENGTH_SCALE * (estimate.strength - 1)
        known = np.column_stack([payload / PAYLOAD_PRIOR, weakness])
        return np.where(memory.step[..., None] > 0, known.reshape(shape), 0.0)

    def steer(
        self, blocks: Blocks, action: Array, memory: Memory, episode_start: Any = None
    ) -> tuple[Array, Memory]:
        """Returns actions (..., m) and the next memory; ``action`` (..., n) is used where one is
        :meth:`due`. It is clipped to ±1, and its position to the unit ball."""
        due = self.due(memory)
        if np.any(due):
            clipped = np.clip(np.asarray(action, float), -1.0, 1.0)
            position = clipped[..., : self.robot.dimensions]
            length = np.linalg.norm(position, axis=-1, keepdims=True)
            position /= np.maximum(length, 1.0)
            kept = memory.actions[..., 1:, :]
            moved = np.concatenate([kept, clipped[..., None, :]], axis=-2)
            actions = np.where(due[..., None, None], moved, memory.actions)
            memory = replace(memory, actions=actions)
        phase = memory.step % self.periods * self._period
        blocks = blocks | {"shift_points": memory.actions, "shift_phase": phase[..., None]}
        if memory.law is None:
            episode_start = None
        applied, law = super().respond(blocks, memory.law, episode_start)
        return applied, replace(memory, step=memory.step + 1, law=law)

    def reference(self, instant: Instant, memory: Any) -> tuple[dict[str, Array], Any]:
        """The shifted reference at the instant at which the action takes effect."""
        blocks, _ = super().reference(instant, None)
        times = instant.blocks["shift_phase"][:, 0] + instant.estimate.delay
        points = instant.blocks["shift_points"] * self._bounds
        shift = self._spline.weights(times) @ points
        for order, name in enumerate(REFERENCE):
            if name in blocks:
                blocks[name] = blocks[name] + shift[:, order]
        return blocks, None


def _padded(tables: Sequence[Array]) -> Array:
    """Tables of different lengths as one array; their last rows are repeated."""
    length = max(map(len, tables))
    rows = np.arange(length)
    return np.stack([table[np.minimum(rows, len(table) - 1)] for table in tables])
