"""A control law that acts for the robot that it meets, with an observer's estimates of mass, motors and
delay."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_baselines.episodes import first_steps
from cablebot_baselines.laws.allocation import allocate
from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_baselines.observer.expectation import Expectation, possible_payload
from cablebot_baselines.observer.observer import RobotObserver
from cablebot_baselines.observer.observer_state import ObserverState, RobotEstimate
from cablebot_gym.motions import Pieces, sampled
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.task import Task

UNCERTAINTY = "hardware"
"""Uncertainty that the laws expect."""

SAMPLES = 4
"""Samples of a reference in a control period. Between them it is linear: with a jerk of 1000 m/s³, the
error of the velocity is below 0.1 mm/s."""

REFERENCE = (
    "reference_pose",
    "reference_velocity",
    "reference_acceleration",
    "reference_jerk",
    "reference_snap",
)
"""Blocks of the reference that an observation may have, in the order of the derivatives."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Instant:
    """What is known in a control step of N episodes."""

    blocks: dict[str, Array]
    """Blocks of the observation, each (N, size)."""
    estimate: RobotEstimate
    """Estimates of the observer."""
    ahead: dict[str, Array]
    """State at the instant at which the action takes effect, see
    :meth:`~cablebot_baselines.observer.observer.RobotObserver.at_effect`."""
    time_to_go: Array
    """Rest of the motion at that instant, (N,) [s]."""
    starts: NDArray[np.bool_]
    """Whether an episode starts, (N,)."""

    def time(self, task: Task, rows: Any) -> Array:
        """Time of a task's motion at that instant in some episodes [s]."""
        time: Array = task.trajectory.duration - self.time_to_go[rows]
        return time


@dataclass(frozen=True, kw_only=True, eq=False)
class ObservingState:
    """State of an observing law between two control steps."""

    observer: ObserverState
    """State of the observer."""
    requested: Array
    """Actions before saturation, (N, m)."""
    memory: Any = None
    """Memory of the reference, see :meth:`ObserverLaw.reference`."""


class ObserverLaw(ClassicalLaw):
    """A control law behind a :class:`~cablebot_baselines.observer.observer.RobotObserver`.

    The law computes torques for the expected robot with the estimated mass, from the state and the
    reference at the instant at which its action will take effect. The requested acceleration cancels
    that of the estimated wrench. The action divides the torques by the estimated strengths of the
    motors. With as many cables as coordinates, saturated actions are
    replaced by those within ±1 that come closest to the requested acceleration.

    Args:
        law: control law without memory for the expected robot.
        expectation: what is expected of the robot.
        largest_payload: largest payload that is considered possible if the payload is unknown, one
            number or (N,) [kg]; None for ``payload_prior`` times that with which the motors can track
            the reference of the task exactly.
        payload_prior: a multiple, as above.
    """

    unsaturated_actions = False
    observer: RobotObserver
    """Observer of the robots of the tasks; :meth:`reset` makes it."""

    def __init__(
        self,
        law: ClassicalLaw,
        expectation: Expectation,
        *,
        largest_payload: float | Array | None = None,
        payload_prior: float = 1.0,
    ) -> None:
        super().__init__(law.robot, minimum_tension=law.minimum_tension)
        self.law = law
        self.expectation = expectation
        self.largest_payload = largest_payload
        self._payload_prior = payload_prior
        self._tasks: tuple[Task, ...] = ()
        # Each motion's first task and its rows.
        self._motions: list[tuple[Task, Any]] = []
        self._allocates = law.robot.cables == law.robot.coordinates

    def reset(self, tasks: Sequence[Task]) -> None:
        """Passes the tasks to the law, and makes the observer for their control period.

        Raises:
            ValueError: if a task's robot differs from the law's robot in kind or anchors.
        """
        self.law.reset(tasks)
        self._tasks = tuple(tasks)
        groups: dict[int, list[int]] = {}
        for row, task in enumerate(tasks):
            groups.setdefault(id(task.trajectory), []).append(row)
        self._motions = [(tasks[rows[0]], np.array(rows)) for rows in groups.values()]
        if len(groups) == 1:
            self._motions = [(tasks[0], slice(None))]  # serves any number of episodes
        self._curve: int | NDArray[np.int64] = 0
        if len(groups) > 1:
            self._curve = np.empty(len(tasks), np.int64)
            for index, (_, rows) in enumerate(self._motions):
                self._curve[rows] = index
        self._references = Pieces.joined([_reference_of(task) for task, _ in self._motions])
        payloads = np.zeros(len(tasks))
        if self.largest_payload is not None:
            payloads += self.largest_payload
        else:
            for task, rows in self._motions:
                payloads[rows] = self._payload_prior * possible_payload(self.robot, task)
        self._prepare(payloads)
        period = 1 / tasks[0].control_frequency
        self.observer = RobotObserver(self.expectation, period, largest_payload=payloads)
        self._load_compiled_code(tasks)

    def _load_compiled_code(self, tasks: Sequence[Task]) -> None:
        """Runs the observer for two steps: in a control step the loading of its compiled code would
        take longer than the control period."""
        blocks = self.split(np.zeros((len(tasks), self._layout.size)))
        blocks["pose"] = np.array([task.start_pose for task in tasks])
        starts = np.zeros(len(tasks), np.bool_)
        observer = self.observer
        state = observer.update(blocks, None, starts)
        state = observer.update(blocks, state, starts)
        observer.at_effect(blocks, state)

    def _prepare(self, payloads: Array) -> None:
        """Adapts the law to the motions and the largest possible payloads, (N,) [kg]."""

    def respond(
        self, blocks: dict[str, Array], state: Any = None, episode_start: Any = None
    ) -> tuple[Array, Any]:
        """Actions within ±1 from the blocks of an observation, and the next state.

        Raises:
            RuntimeError: before the first :meth:`reset`.
        """
        self._check_reset()
        shape = blocks["pose"].shape[:-1]
        rows = blocks
        if not shape:
            rows = {name: values[None] for name, values in blocks.items()}
        starts = first_steps(state, episode_start, shape).reshape(-1)
        observed = None
        memory = None
        if state is not None:
            observed = state.observer
            memory = state.memory
        observed = self.observer.update(rows, observed, starts)
        estimate = self.observer.estimate(observed)
        ahead = self.observer.at_effect(rows, observed)
        time_to_go = np.maximum(rows["time_to_go"][:, 0] - estimate.delay, 0.0)
        instant = Instant(
            blocks=rows, estimate=estimate, ahead=ahead, time_to_go=time_to_go, starts=starts
        )
        reference, memory = self.reference(instant, memory)
        later = ahead | {"time_to_go": time_to_go[:, None]} | reference
        at_effect = rows | later
        requested, action = self._act(at_effect, estimate)
        after = ObservingState(observer=observed, requested=requested, memory=memory)
        return action.reshape(*shape, self.robot.cables), after

    def _check_reset(self) -> None:
        if not self._tasks:
            raise RuntimeError("call reset(tasks) before predict(): the tasks have the motions")

    def reference(self, instant: Instant, memory: Any) -> tuple[dict[str, Array], Any]:
        """Blocks of the reference at the instant at which the action takes effect, and the memory
        for the next step; ``memory`` is that of the last step, None before the first.

        They are those of the task's motion: a Taylor series from the observed reference does not
        know where its acceleration jumps, and a light platform then loses the tension of a cable.
        """
        times = self._references.durations[self._curve] - instant.time_to_go
        (samples,) = self._references(self._curve, times, 1)
        parts = np.split(samples, len(REFERENCE), axis=-1)
        reference = {}
        for name, values in zip(REFERENCE, parts, strict=True):
            if name in instant.blocks:
                reference[name] = values
        return reference, None

    def _act(self, blocks: dict[str, Array], estimate: RobotEstimate) -> tuple[Array, Array]:
        """Requested and saturated actions of the law, each (N, m), for blocks at the instant at which
        they take effect."""
        acceleration = blocks["reference_acceleration"] - blocks["disturbance"]
        blocks = blocks | {"reference_acceleration": acceleration}
        torques, speeds = self.law.torques(blocks, estimate.mass)
        requested = normalised_action(self.robot, torques / estimate.strength, speeds)
        action = requested.copy()
        is_saturated = np.any(np.abs(requested) > 1, axis=-1)
        if np.any(is_saturated):
            action[is_saturated] = self._reduced(requested, blocks, estimate, is_saturated)
        return requested, np.clip(action, -1.0, 1.0)

    def _reduced(
        self,
        requested: Array,
        blocks: dict[str, Array],
        estimate: RobotEstimate,
        rows: NDArray[np.bool_],
    ) -> Array:
        """Actions in place of the requested ones of some rows, which are beyond ±1, (rows, m)."""
        if not self._allocates:
            return requested[rows]
        of_rows = estimate.of(rows)
        slope = self.law.torque_slope(of_rows.mass, blocks["pose"][rows])
        stall = self.robot.stall_torque * of_rows.strength
        return allocate(requested[rows], slope / stall[..., None])


def _reference_of(task: Task) -> Pieces:
    """A motion and its derivatives, those of one sample after the other."""
    motion = task.trajectory
    count = math.ceil(SAMPLES * motion.duration * task.control_frequency)
    samples = sampled(motion, np.linspace(0.0, motion.duration, count + 1))
    return Pieces.of_samples(np.concatenate(samples, axis=1), motion.duration)
