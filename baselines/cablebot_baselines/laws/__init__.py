"""The paper's control laws, and variants that also work where the paper's laws fail."""

from cablebot_baselines.laws.feedback_linearization import FL, FeedbackLinearization
from cablebot_baselines.laws.flex_eq22 import FLEX_EQ22, PaperFlexible
from cablebot_baselines.laws.flexible import COMPOSITE, MOTOR_PD, Composite, MotorPD
from cablebot_baselines.laws.observer_law import ObserverLaw
from cablebot_baselines.laws.observing import OBSERVING, Observing
from cablebot_baselines.laws.outer_loop import PD, BoundedRobustPD, RobustPD
from cablebot_baselines.laws.robust import ROBUST, make_robust

__all__ = [
    "COMPOSITE",
    "FL",
    "FLEX_EQ22",
    "MOTOR_PD",
    "OBSERVING",
    "PD",
    "ROBUST",
    "BoundedRobustPD",
    "Composite",
    "FeedbackLinearization",
    "MotorPD",
    "ObserverLaw",
    "Observing",
    "PaperFlexible",
    "RobustPD",
    "make_robust",
]
