"""Dynamic load carrying capacity: the largest payload that a policy carries within the limits."""

from cablebot_gym.dlcc.comparison import Comparison, compare_policies
from cablebot_gym.dlcc.evaluator import evaluate_dlcc
from cablebot_gym.dlcc.exact import ExactPayload, exact_payload
from cablebot_gym.dlcc.monitor import CRITERIA, DLCCMonitor, Limit, Verdict
from cablebot_gym.dlcc.result import DLCCResult
from cablebot_gym.policies import PolicyError
from cablebot_gym.task import Limits, Task

__all__ = [
    "CRITERIA",
    "Comparison",
    "DLCCMonitor",
    "DLCCResult",
    "ExactPayload",
    "Limit",
    "Limits",
    "PolicyError",
    "Task",
    "Verdict",
    "compare_policies",
    "evaluate_dlcc",
    "exact_payload",
]
