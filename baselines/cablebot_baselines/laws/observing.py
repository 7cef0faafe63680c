"""Robust control behind an observer: the paper's robust law (Eqs. 26–36) in a form that holds on
robots that are not exactly known."""

from __future__ import annotations

import numpy as np

from cablebot_baselines.entries import entry
from cablebot_baselines.laws.feedback_linearization import FeedbackLinearization
from cablebot_baselines.laws.flexible import Composite
from cablebot_baselines.laws.law import Array, ClassicalLaw
from cablebot_baselines.laws.observer_law import UNCERTAINTY, ObserverLaw
from cablebot_baselines.laws.robust_design import RobustDesign
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.observer.observer_state import RobotEstimate
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import find_uncertainty

_HALVINGS = 7
"""Number of halvings that find the largest acceleration within the limits of the motors."""

_Law = FeedbackLinearization | Composite


class Observing(ObserverLaw):
    """The law of :class:`~cablebot_baselines.laws.observer_law.ObserverLaw` with the gains, bounds
    and tensions of a :class:`~cablebot_baselines.laws.robust_design.RobustDesign` for each
    motion that it meets.

    Args:
        robot: nominal robot; the law expects any of ``hardware``.
        payload_prior: as for :class:`~cablebot_baselines.laws.observer_law.ObserverLaw`.
    """

    def __init__(self, robot: Robot, *, payload_prior: float = 1.0) -> None:
        expectation = Expectation.of(robot, find_uncertainty(UNCERTAINTY, robot))
        kind = Composite if robot.flexible else FeedbackLinearization
        super().__init__(kind(expectation.robot), expectation, payload_prior=payload_prior)

    def _prepare(self, payloads: Array) -> None:
        self._laws = []
        for task, rows in self._motions:
            design = RobustDesign(
                expectation=self.expectation,
                task=task,
                largest_payload=float(payloads[rows][0]),
            )
            law = self._designed(design)
            law.reset([task])
            self._laws.append((law, rows))

    def _designed(self, design: RobustDesign) -> _Law:
        """The law for a motion."""
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

    def _reduced(
        self,
        law: ClassicalLaw,
        requested: Array,
        blocks: dict[str, Array],
        estimate: RobotEstimate,
    ) -> Array:
        """With more cables than coordinates the acceleration is reduced in its direction, so that
        all cables keep the allocated tension."""
        if self._allocates:
            return super()._reduced(law, requested, blocks, estimate)
        assert isinstance(law, _Law)
        acceleration = law.outer(blocks)
        on_reference = blocks | {
            "reference_pose": blocks["pose"],
            "reference_velocity": blocks["velocity"],
        }
        factor = np.zeros(len(requested))
        action = np.clip(requested, -1.0, 1.0)
        for step in 0.5 ** np.arange(1, _HALVINGS + 1):
            larger = factor + step
            on_reference["reference_acceleration"] = larger[:, None] * acceleration
            torques, speeds = law.torques(on_reference, estimate.mass)
            candidate = normalised_action(self.robot, torques / estimate.strength, speeds)
            is_possible = np.all(np.abs(candidate) <= 1, axis=-1)
            factor[is_possible] = larger[is_possible]
            action[is_possible] = candidate[is_possible]
        return action


OBSERVING = entry("observing", Observing)
