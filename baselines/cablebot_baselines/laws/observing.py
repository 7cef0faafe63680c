"""Robust control behind an observer: the paper's robust law (Eqs. 26–36) in a form that holds on
robots that are not exactly known."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cablebot_baselines.entries import entry
from cablebot_baselines.laws.feedback_linearization import FeedbackLinearization
from cablebot_baselines.laws.flexible import Composite, MotorPD
from cablebot_baselines.laws.law import Array
from cablebot_baselines.laws.observer_law import UNCERTAINTY, ObserverLaw
from cablebot_baselines.laws.outer_loop import BoundedRobustPD
from cablebot_baselines.laws.robust_design import RobustDesign
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.observer.observer_state import RobotEstimate
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.robots import Robot
from cablebot_gym.uncertainty import find_uncertainty

_HALVINGS = 7
"""Number of halvings that find the largest acceleration within the limits of the motors."""

_Law = FeedbackLinearization | Composite
"""Laws with an outer loop."""


class Observing(ObserverLaw):
    """The law of :class:`~cablebot_baselines.laws.observer_law.ObserverLaw` with the gains of a
    :class:`~cablebot_baselines.laws.robust_design.RobustDesign`, and the bounds and tensions of one
    for each motion that it meets.

    A platform on springs that is lighter than the rotors is moved by
    :class:`~cablebot_baselines.laws.flexible.MotorPD`: an outer loop would have to be slower than its
    swing.

    Args:
        robot: nominal robot; the law expects any of ``hardware``.
        payload_prior: as for :class:`~cablebot_baselines.laws.observer_law.ObserverLaw`.
    """

    def __init__(self, robot: Robot, *, payload_prior: float = 1.0) -> None:
        expectation = Expectation.of(robot, find_uncertainty(UNCERTAINTY, robot))
        kind: type[_Law | MotorPD] = FeedbackLinearization
        if robot.flexible:
            kind = MotorPD if expectation.light_on_springs else Composite
        super().__init__(kind(expectation.robot), expectation, payload_prior=payload_prior)

    def _prepare(self, payloads: Array) -> None:
        if isinstance(self.law, MotorPD):
            return
        designs = []
        for task, rows in self._motions:
            largest = float(payloads[rows][0])
            designs.append(
                RobustDesign(expectation=self.expectation, task=task, largest_payload=largest)
            )
        design = RobustDesign.usual(self.expectation, self._tasks[0])
        law: _Law = FeedbackLinearization(self.robot)
        if self.robot.flexible:
            law = Composite(
                self.robot,
                spring_damping=design.spring_damping,
                leads_springs=not self.robot.elastic,
            )
        if not self._allocates:
            law.minimum_tension = self._by_row([each.minimum_tension for each in designs])
        zeta = self._by_row([each.zeta for each in designs])
        position_phi = self._by_row([each.phi[0] for each in designs])
        rotation_phi = self._by_row([each.phi[1] for each in designs])
        phi = position_phi[..., None], rotation_phi[..., None]
        law.outer = replace(design.outer, zeta=zeta[..., None], phi=phi)
        law.reset(self._tasks)
        self.law = law

    def _by_row(self, values: Sequence[float]) -> Array:
        """Values of the motions for each row, (N,); one number, (), of a single motion."""
        if len(values) == 1:
            return np.array(values[0])
        of_rows = np.empty(len(self._tasks))
        for (_, rows), value in zip(self._motions, values, strict=True):
            of_rows[rows] = value
        return of_rows

    def _reduced(
        self,
        requested: Array,
        blocks: dict[str, Array],
        estimate: RobotEstimate,
        rows: NDArray[np.bool_],
    ) -> Array:
        """With more cables than coordinates the acceleration is reduced in its direction, so that
        all cables keep the allocated tension."""
        if self._allocates or isinstance(self.law, MotorPD):
            return super()._reduced(requested, blocks, estimate, rows)
        estimate = estimate.of(rows)
        blocks = {name: values[rows] for name, values in blocks.items()}
        law = copy(self.law)
        assert isinstance(law, _Law)
        if isinstance(law.outer, BoundedRobustPD) and law.minimum_tension.ndim:
            law.minimum_tension = law.minimum_tension[rows]
            law.outer = law.outer.of(rows)
        acceleration = law.outer(blocks)
        on_reference = blocks | {
            "reference_pose": blocks["pose"],
            "reference_velocity": blocks["velocity"],
        }
        action = np.clip(requested[rows], -1.0, 1.0)
        factor = np.zeros(len(action))
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
