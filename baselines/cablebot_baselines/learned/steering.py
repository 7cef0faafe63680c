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
        fractions = np.asarray(times)[..., None, None, None] / self._action_period
        powers = fractions ** np.arange(self._series.shape[1])
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
        self._bounds = FRACTION * error_bounds.of_coordinates(self.robot)
        first = [task.trajectory(0.0).position for task, _ in self._motions]
        self._seen = _padded([self._inputs_of(task) for task, _ in self._motions])
        self._motion = np.zeros(len(tasks), np.int64)
        start = np.empty((len(tasks), self.robot.coordinates))
        for index, (task, rows) in enumerate(self._motions):
            self._motion[rows] = index
            start[rows] = task.start_pose - first[index]
        self._start = start / self._bounds
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
        layout = observation_layout(self.robot)
        count = math.ceil(motion.duration / self._action_period)
        instants = np.arange(count + 1)
        to_go = motion.duration / self._action_period - instants
        edges = [np.exp(-span[:, None] / TIME_CONSTANTS) for span in (instants, to_go)]
        scale = {name: layout.per_scale[part] for name, part in layout.slices().items()}
        now = motion(instants * self._action_period)
        values = [
            *edges,
            (now.position - self.robot.home) * scale["reference_pose"],
            now.velocity * scale["reference_velocity"],
        ]
        for ahead in (0, *PREVIEWS):
            later = motion((instants + ahead) * self._action_period)
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
        actions = np.repeat(start[..., None, :], self._degree + 1, axis=-2)
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
        shape = memory.step.shape
        instant = np.minimum(memory.step // self.periods, self._seen.shape[1] - 1)
        weights = self._spline.weights(np.array(self._action_period))[0]
        shift = self._bounds * (weights @ memory.actions)
        error = (blocks["reference_pose"] + shift - blocks["pose"]) / self._bounds
        known = np.zeros((*shape, 1 + self.robot.cables))
        if memory.law is not None:
            estimate = self.observer.estimate(memory.law.observer)
            payload = (estimate.mass - self.robot.mass) / self.exact_payloads
            known = np.column_stack([payload / PAYLOAD_PRIOR, 5 * (estimate.strength - 1)])
            known = np.where(memory.step[..., None] > 0, known.reshape(*shape, -1), 0.0)
        past = memory.actions[..., 1:, :].reshape(*shape, -1)
        values = [self._seen[self._motion, instant], past, error, known]
        return np.clip(np.concatenate(values, axis=-1), -5.0, 5.0)

    def steer(
        self, blocks: Blocks, action: Array, memory: Memory, episode_start: Any = None
    ) -> tuple[Array, Memory]:
        """Returns actions (..., m) and the next memory; ``action`` (..., n) is used where one is
        :meth:`due`. It is clipped to ±1, and its position to the unit ball."""
        due = self.due(memory)
        if np.any(due):
            clipped = np.clip(np.asarray(action, float), -1.0, 1.0)
            position = clipped[..., : self.robot.dimensions]
            position /= np.maximum(np.linalg.norm(position, axis=-1, keepdims=True), 1.0)
            moved = np.concatenate([memory.actions[..., 1:, :], clipped[..., None, :]], axis=-2)
            memory = replace(memory, actions=np.where(due[..., None, None], moved, memory.actions))
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
        shift = self._spline.weights(times) @ (instant.blocks["shift_points"] * self._bounds)
        for order, name in enumerate(REFERENCE):
            if name in blocks:
                blocks[name] = blocks[name] + shift[:, order]
        return blocks, None


def _padded(tables: Sequence[Array]) -> Array:
    """Tables of different lengths as one array; their last rows are repeated."""
    length = max(map(len, tables))
    return np.stack(
        [np.pad(table, ((0, length - len(table)), (0, 0)), mode="edge") for table in tables]
    )
