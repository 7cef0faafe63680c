"""The paper's control laws, and variants that also work where the paper's laws fail."""

from cablebot_baselines.classical.adaptive import ADAPTIVE, Adaptive
from cablebot_baselines.classical.feedback_linearization import FL, FeedbackLinearization
from cablebot_baselines.classical.flex_eq22 import FLEX_EQ22, PaperFlexible
from cablebot_baselines.classical.flexible import COMPOSITE, MOTOR_PD, Composite, MotorPD
from cablebot_baselines.classical.observer_law import ObserverLaw
from cablebot_baselines.classical.observing import OBSERVING, Observing
from cablebot_baselines.classical.outer_loop import PD, BoundedRobustPD, RobustPD
from cablebot_baselines.classical.robust import ROBUST, make_robust

__all__ = [
    "ADAPTIVE",
    "COMPOSITE",
    "FL",
    "FLEX_EQ22",
    "MOTOR_PD",
    "OBSERVING",
    "PD",
    "ROBUST",
    "Adaptive",
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
