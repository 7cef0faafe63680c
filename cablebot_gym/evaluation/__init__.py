"""Dynamic load carrying capacity: the largest payload that a policy carries within the limits."""

from cablebot_gym.evaluation.comparison import Comparison, compare_policies
from cablebot_gym.evaluation.constraints import CRITERIA, DLCCMonitor, Limit, Verdict
from cablebot_gym.evaluation.evaluator import evaluate_dlcc
from cablebot_gym.evaluation.result import DLCCResult
from cablebot_gym.policies import PolicyError
from cablebot_gym.task import Limits, Task

__all__ = [
    "CRITERIA",
    "Comparison",
    "DLCCMonitor",
    "DLCCResult",
    "Limit",
    "Limits",
    "PolicyError",
    "Task",
    "Verdict",
    "compare_policies",
    "evaluate_dlcc",
]
