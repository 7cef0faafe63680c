"""Evaluation of policies: dynamic load carrying capacity (DLCC), comparison, recorded episodes.

The DLCC is the largest payload that a policy carries within the limits.
"""

from cablebot_gym.evaluation.comparison import (
    Comparison,
    PayloadComparison,
    compare_over_payloads,
    compare_policies,
)
from cablebot_gym.evaluation.evaluator import evaluate_dlcc
from cablebot_gym.evaluation.judge import DLCCMonitor, Verdict, Violation
from cablebot_gym.evaluation.result import DLCCResult
from cablebot_gym.evaluation.timing import ActionTimes, time_actions
from cablebot_gym.policies import PolicyError
from cablebot_gym.task import ErrorBounds

__all__ = [
    "ActionTimes",
    "Comparison",
    "DLCCMonitor",
    "DLCCResult",
    "ErrorBounds",
    "PayloadComparison",
    "PolicyError",
    "Verdict",
    "Violation",
    "compare_over_payloads",
    "compare_policies",
    "evaluate_dlcc",
    "time_actions",
]
