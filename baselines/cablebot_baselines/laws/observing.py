"""Robust control behind an observer: the paper's robust law (Eqs. 26–36) in a form that holds on
robots that are not exactly known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cablebot_baselines.entries import entry
from cablebot_baselines.laws.feedback_linearization import FeedbackLinearization
from cablebot_baselines.laws.flexible import Composite
from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_baselines.laws.observer_law import PERIOD, UNCERTAINTY, ObserverLaw
from cablebot_baselines.laws.robust_design import Peaks, RobustDesign
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.observer.observer_state import RobotEstimate
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.robots import Robot
from cablebot_gym.task import Task
from cablebot_gym.uncertainty import find_uncertainty

_HALVINGS = 7
"""Number of halvings that find the largest acceleration within the limits of the motors."""

_Law = FeedbackLinearization | Composite


class Observing(ObserverLaw):
    """The law of :class:`~cablebot_baselines.laws.observer_law.ObserverLaw` with the gains, bounds
    and tensions of a :class:`~cablebot_baselines.laws.robust_design.RobustDesign` for each
    motion that it meets.

    Args:
        expectation: what is expected of the robot.
        largest_payload: as in :class:`~cablebot_baselines.laws.observer_law.ObserverLaw`.
    """

    law: _Law

    def __init__(self, expectation: Expectation, *, largest_payload: float | None = None) -> None:
        kind = Composite if expectation.robot.flexible else FeedbackLinearization
        super().__init__(kind(expectation.robot), expectation, largest_payload=largest_payload)
        self._unknown = self._designed(PERIOD, self._possible(None), Peaks())
        self._of_motions: dict[int, _Law] = {}

    def _prepare(self, tasks: Sequence[Task], payloads: Array) -> None:
        self._of_motions = {}
        for task, payload in zip(tasks, payloads.tolist(), strict=True):
            motion = id(task.trajectory)
            if motion not in self._of_motions:
                peaks = Peaks.of(self.robot, task, float(self.robot.mass) + payload / 2)
                law = self._designed(1 / task.control_frequency, payload, peaks)
                law.reset([task])
                self._of_motions[motion] = law

    def _designed(self, period: float, largest_payload: float, peaks: Peaks) -> _Law:
        """The law for a motion."""
        design = RobustDesign(
            expectation=self.expectation,
            period=period,
            largest_payload=largest_payload,
            peaks=peaks,
        )
        law: _Law
        minimum = design.minimum_tension
        if self.robot.flexible:
            law = Composite(
                self.robot,
                spring_damping=design.spring_damping,
                leads_springs=not self.robot.elastic,
                minimum_tension=minimum,
            )
        else:
            law = FeedbackLinearization(self.robot, minimum_tension=minimum)
        law.outer = design.outer
        return law

    def _act(self, blocks: dict[str, Array], estimate: RobotEstimate) -> tuple[Array, Array]:
        count = len(estimate.mass)
        requested = np.empty((count, self.robot.cables))
        action = np.empty_like(requested)
        laws = [(self._unknown, np.arange(count))]
        if self._tasks:
            laws = [
                (self._of_motions[id(task.trajectory)], rows)
                for task, rows in self._rows_by_motion(count)
            ]
        for law, rows in laws:
            of_motion = {name: values[rows] for name, values in blocks.items()}
            requested[rows], action[rows] = self._of_law(law, of_motion, estimate.of(rows))
        return requested, action

    def _reduced(
        self,
        law: ClassicalLaw,
        requested: Array,
        blocks: dict[str, Array],
        mass: Array,
        strength: Array,
    ) -> Array:
        """With more cables than coordinates the acceleration is reduced in its direction, so that
        all cables keep the allocated tension."""
        if self._allocates:
            return super()._reduced(law, requested, blocks, mass, strength)
        assert isinstance(law, _Law)
        acceleration = law.outer(blocks)
        on_reference = blocks | {
            "reference_pose": blocks["pose"],
            "reference_velocity": blocks["velocity"],
        }
        factor = np.zeros(len(mass))
        action = np.clip(requested, -1.0, 1.0)
        for step in 0.5 ** np.arange(1, _HALVINGS + 1):
            larger = factor + step
            on_reference["reference_acceleration"] = larger[:, None] * acceleration
            torques, speeds = law.torques(on_reference, mass)
            candidate = normalised_action(self.robot, torques / strength, speeds)
            is_possible = np.all(np.abs(candidate) <= 1, axis=-1)
            factor[is_possible] = larger[is_possible]
            action[is_possible] = candidate[is_possible]
        return action


def make_observing(robot: Robot, *, largest_payload: float | None = None) -> Observing:
    """The law for a robot that may be any of ``hardware``; the arguments are those of
    :class:`Observing`."""
    expectation = Expectation.of(robot, find_uncertainty(UNCERTAINTY, robot))
    return Observing(expectation, largest_payload=largest_payload)


OBSERVING = entry("observing", make_observing)
