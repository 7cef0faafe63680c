"""The paper's control laws, and laws that work where they do not."""

from baselines.classical.feedback_linearization import FL, FeedbackLinearization
from baselines.classical.flexible import COMPOSITE, FL4, MOTOR_PD, Composite, FourthOrder, MotorPD

__all__ = [
    "COMPOSITE",
    "FL",
    "FL4",
    "MOTOR_PD",
    "Composite",
    "FeedbackLinearization",
    "FourthOrder",
    "MotorPD",
]
