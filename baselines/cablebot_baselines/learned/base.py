"""Base laws: the classical laws that learned policies steer, with explicit gains."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from cablebot_baselines.laws.feedback_linearization import FeedbackLinearization
from cablebot_baselines.laws.flexible import Composite, MotorPD
from cablebot_baselines.laws.law import ClassicalLaw
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import choice, numbers, record


@dataclass(frozen=True, kw_only=True)
class Base:
    """A classical law with its parameters.

    Raises:
        ValueError: if the law is unknown, does not have a given parameter, or its gains are invalid.
    """

    law: str = "fl"
    """Name of the law: ``fl``, ``composite`` or ``motor-pd``."""
    gains: tuple[float, float] | None = None
    """Gains (K_P, K_D) of ``fl`` and ``composite`` [1/s², 1/s]; None for the paper's gains."""
    minimum_tension: float | None = None
    """Least tension that the law allocates with more cables than coordinates [N]; None for the
    law's default."""

    def __post_init__(self) -> None:
        choice("base law", self.law, _LAWS)
        if self.gains is None:
            return
        if self.law == "motor-pd":
            raise ValueError(
                "base law 'motor-pd' has no gains: leave it out, or choose fl or composite"
            )
        gains = numbers("gains", self.gains, shapes=[(2,)], above=0.0)
        object.__setattr__(self, "gains", tuple(gains.tolist()))

    def make(self, robot: Robot) -> ClassicalLaw:
        """Creates the law for a nominal robot.

        Raises:
            ValueError: if the law does not support the robot, or rejects a parameter.
        """
        return _LAWS[self.law](robot, self)


def default_base(robot: Robot) -> Base:
    """The base law of a robot without a choice: ``motor-pd`` if it is flexible, else ``fl`` with
    stiff gains."""
    return Base(law="motor-pd") if robot.flexible else Base(gains=(2500.0, 100.0))


def find_base(base: Base | str | Mapping[str, Any]) -> Base:
    """Returns a base law from a :class:`Base`, a law's name, or a dict ``{"law": …, "gains": …}``.

    Raises:
        ValueError: if the law or a key is unknown, or a value is invalid.
    """
    return record("base", Base, {"law": base} if isinstance(base, str) else base)


_LAWS: dict[str, Callable[[Robot, Base], ClassicalLaw]] = {
    "fl": lambda robot, base: FeedbackLinearization(
        robot, gains=base.gains or "paper", minimum_tension=base.minimum_tension
    ),
    "composite": lambda robot, base: Composite(
        robot, gains=base.gains or "paper", minimum_tension=base.minimum_tension
    ),
    "motor-pd": lambda robot, base: MotorPD(robot, minimum_tension=base.minimum_tension),
}
