"""Estimators: pose and velocity from the sensors of winches and platform, so that any policy runs
with them."""

from cablebot_baselines.estimation.ekf import ExtendedKalmanFilter
from cablebot_baselines.estimation.errors import FilterErrors
from cablebot_baselines.estimation.estimated import (
    Estimated,
    KinematicEstimator,
    ekf,
    ekf_homed,
    fk,
)

__all__ = [
    "Estimated",
    "ExtendedKalmanFilter",
    "FilterErrors",
    "KinematicEstimator",
    "ekf",
    "ekf_homed",
    "fk",
]
