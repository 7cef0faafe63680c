"""Estimators: pose and velocity from the sensors of winches and platform, so that any policy runs with them."""

from cablebot_baselines.estimation.calibration import Calibration, calibrate, home_offset
from cablebot_baselines.estimation.ekf import ExtendedKalmanFilter
from cablebot_baselines.estimation.estimated import Estimated, KinematicEstimator, ekf, ekf_homed, fk
from cablebot_baselines.estimation.forward_kinematics import ForwardKinematics, forward_kinematics

__all__ = [
    "Calibration",
    "Estimated",
    "ExtendedKalmanFilter",
    "ForwardKinematics",
    "KinematicEstimator",
    "calibrate",
    "ekf",
    "ekf_homed",
    "fk",
    "forward_kinematics",
    "home_offset",
]
