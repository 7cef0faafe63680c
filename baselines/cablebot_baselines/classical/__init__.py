"""The paper's control laws, and variants that also work where the paper's laws fail."""

from cablebot_baselines.classical.adaptive import ADAPTIVE, ADAPTIVE_COMPOSITE, Adaptive
from cablebot_baselines.classical.feedback_linearization import FL, FL_TUNED, FeedbackLinearization
from cablebot_baselines.classical.flex_eq22 import FLEX_EQ22, PaperFlexible
from cablebot_baselines.classical.flexible import (
    COMPOSITE,
    COMPOSITE_TUNED,
    FL4,
    MOTOR_PD,
    Composite,
    FourthOrder,
    MotorPD,
)
from cablebot_baselines.classical.observer_law import OBSERVING, ObserverLaw
from cablebot_baselines.classical.observing import ROBUST_OBSERVING, Observing
from cablebot_baselines.classical.outer_loop import PD, BoundedRobustPD, RobustPD
from cablebot_baselines.classical.robust import (
    ROBUST,
    ROBUST_COMPOSITE,
    Robust,
    RobustComposite,
)

__all__ = [
    "ADAPTIVE",
    "ADAPTIVE_COMPOSITE",
    "COMPOSITE",
    "COMPOSITE_TUNED",
    "FL",
    "FL4",
    "FLEX_EQ22",
    "FL_TUNED",
    "MOTOR_PD",
    "OBSERVING",
    "PD",
    "ROBUST",
    "ROBUST_COMPOSITE",
    "ROBUST_OBSERVING",
    "Adaptive",
    "BoundedRobustPD",
    "Composite",
    "FeedbackLinearization",
    "FourthOrder",
    "MotorPD",
    "ObserverLaw",
    "Observing",
    "PaperFlexible",
    "Robust",
    "RobustComposite",
    "RobustPD",
]
