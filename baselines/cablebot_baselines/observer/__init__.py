"""Estimators: pose and velocity from the sensors of winches and platform, so that any policy runs
with them."""

from cablebot_baselines.observer.estimated import (
    Estimated,
    KinematicEstimator,
    WinchEstimator,
    ekf,
    ekf_homed,
    fk,
    usual_expectation,
)
from cablebot_baselines.observer.expectation import Expectation

__all__ = [
    "Estimated",
    "Expectation",
    "KinematicEstimator",
    "WinchEstimator",
    "ekf",
    "ekf_homed",
    "fk",
    "usual_expectation",
]
