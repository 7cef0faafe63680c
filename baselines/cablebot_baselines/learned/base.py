"""Base laws: the classical laws that learned policies steer, with explicit gains."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

from cablebot_baselines.classical.adaptive import Adaptive
from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.classical.flexible import Composite, FourthOrder, MotorPD
from cablebot_baselines.classical.law import ClassicalLaw
from cablebot_gym.robots import Robot
from cablebot_gym.utils.checks import unknown_name_error


@dataclass(frozen=True, kw_only=True)
class Base:
    """A classical law with its parameters.

    Raises:
        ValueError: if the law is unknown, does not have a given parameter, or a value is invalid.
    """

    law: str = "fl"
    """Name of the law: ``fl``, ``composite``, ``motor-pd`` or ``fl4``."""
    gains: tuple[float, float] | None = None
    """Gains (K_P, K_D) of ``fl`` and ``composite`` [1/s², 1/s]; None for the paper's gains."""
    frequency: float | None = None
    """Natural frequency of the motor loop of ``motor-pd`` [rad/s]; None for its default."""
    minimum_tension: float = 5.0
    """Minimum tension T_min of a planar robot [N]."""
    estimates_payload: bool = False
    """Whether the law estimates the payload, see :class:`~cablebot_baselines.classical.adaptive.Adaptive`."""
    estimator_prior_weight: float = 0.01
    """Weight of the model's mass in the payload estimate [s]."""
    allocates: bool = False
    """Whether a law that estimates the payload also allocates the available motor torques, see ``Adaptive``."""

    def __post_init__(self) -> None:
        if not isinstance(self.law, str) or self.law not in _LAWS:
            raise unknown_name_error("base law", self.law, _LAWS)
        for name, laws in (("gains", ("fl", "composite")), ("frequency", ("motor-pd",))):
            if getattr(self, name) is not None and self.law not in laws:
                raise ValueError(f"base law {self.law!r} has no {name}: leave it out, or choose {' or '.join(laws)}")
        if self.gains is not None:
            gains = tuple(self.gains) if isinstance(self.gains, Sequence) else ()
            if len(gains) != 2 or not all(is_number(gain) and gain > 0 for gain in gains):
                raise ValueError(f"gains must be two positive numbers (K_P, K_D), not {self.gains!r}")
            object.__setattr__(self, "gains", (float(gains[0]), float(gains[1])))
        for name in ("estimates_payload", "allocates"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(f"{name} must be True or False, not {getattr(self, name)!r}")
        if self.allocates and not self.estimates_payload:
            raise ValueError("allocates requires estimates_payload: set estimates_payload to True too")
        if not is_number(self.minimum_tension) or self.minimum_tension < 0:
            raise ValueError(f"minimum_tension must be at least 0 N, not {self.minimum_tension!r}")
        for name, unit in (
            ("estimator_prior_weight", "s"),
            *([("frequency", "rad/s")] if self.frequency is not None else []),
        ):
            if not is_number(getattr(self, name)) or getattr(self, name) <= 0:
                raise ValueError(f"{name} must be greater than 0 {unit}, not {getattr(self, name)!r}")
        for name in ("minimum_tension", "estimator_prior_weight"):
            object.__setattr__(self, name, float(getattr(self, name)))

    def make(self, robot: Robot) -> ClassicalLaw:
        """Creates the law for a nominal robot.

        Raises:
            ValueError: if the law does not support the robot.
        """
        law = _LAWS[self.law](robot, self)
        return (
            Adaptive(law, estimator_prior_weight=self.estimator_prior_weight, allocation=self.allocates)
            if self.estimates_payload
            else law
        )


def find_base(base: Base | str | Mapping[str, Any]) -> Base:
    """Returns a base law from a :class:`Base`, a law's name, or a dict ``{"law": …, "gains": …}``.

    Raises:
        ValueError: if the law or a key is unknown, or a value is invalid.
    """
    if isinstance(base, Base):
        return base
    if not isinstance(base, (str, Mapping)):
        raise ValueError(f"base must be one of {', '.join(_LAWS)}, or a dict {{'law': NAME, …}}, not {base!r}")
    data = {"law": base} if isinstance(base, str) else dict(base)
    known = list(Base.__dataclass_fields__)
    if unknown := [name for name in data if name not in known]:
        raise ValueError(f"base: unknown key {unknown[0]!r}; it takes {', '.join(known)}")
    return Base(**data)


def is_number(value: Any) -> bool:
    """Whether a value is a finite real number and not a bool."""
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _motor_pd(robot: Robot, base: Base) -> MotorPD:
    frequency = {} if base.frequency is None else {"frequency": base.frequency}
    return MotorPD(robot, minimum_tension=base.minimum_tension, **frequency)


_LAWS: dict[str, Callable[[Robot, Base], ClassicalLaw]] = {
    "fl": lambda robot, base: FeedbackLinearization(robot, gains=base.gains, minimum_tension=base.minimum_tension),
    "composite": lambda robot, base: Composite(robot, gains=base.gains, minimum_tension=base.minimum_tension),
    "motor-pd": _motor_pd,
    "fl4": lambda robot, base: FourthOrder(robot),
}
