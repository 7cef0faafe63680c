"""Gymnasium environments and a payload benchmark for cable-suspended robots.

Importing the package registers the ids in :data:`ENV_IDS`. The names for policies and evaluations
can be imported from here; their modules are loaded on first use.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from cablebot_gym.envs import ENV_IDS, register_envs
from cablebot_gym.utils.results import Printed

if TYPE_CHECKING:
    from cablebot_gym.envs.observation import observation_layout
    from cablebot_gym.evaluation.comparison import compare_policies
    from cablebot_gym.evaluation.evaluator import evaluate_dlcc
    from cablebot_gym.evaluation.judge import DLCCMonitor
    from cablebot_gym.evaluation.rollout import record_rollout
    from cablebot_gym.motions import find_trajectory
    from cablebot_gym.physics.textbook import inverse_dynamics, linearise, normalised_action
    from cablebot_gym.policies.adapters import PolicyFactory
    from cablebot_gym.policies.protocol import Policy
    from cablebot_gym.policies.spec import load_policy
    from cablebot_gym.robots import Robot, find_robot
    from cablebot_gym.task import ErrorBounds
    from cablebot_gym.uncertainty import Uncertainty

__version__ = "0.1.0"
__all__ = [
    "ENV_IDS",
    "DLCCMonitor",
    "ErrorBounds",
    "Policy",
    "PolicyFactory",
    "Robot",
    "Uncertainty",
    "__version__",
    "compare_policies",
    "evaluate_dlcc",
    "find_robot",
    "find_trajectory",
    "inverse_dynamics",
    "linearise",
    "load_policy",
    "normalised_action",
    "observation_layout",
    "record_rollout",
]

_HOMES = {
    "DLCCMonitor": "cablebot_gym.evaluation.judge",
    "ErrorBounds": "cablebot_gym.task",
    "Policy": "cablebot_gym.policies.protocol",
    "PolicyFactory": "cablebot_gym.policies.adapters",
    "Robot": "cablebot_gym.robots",
    "Uncertainty": "cablebot_gym.uncertainty",
    "compare_policies": "cablebot_gym.evaluation.comparison",
    "evaluate_dlcc": "cablebot_gym.evaluation.evaluator",
    "find_robot": "cablebot_gym.robots",
    "find_trajectory": "cablebot_gym.motions",
    "inverse_dynamics": "cablebot_gym.physics.textbook",
    "linearise": "cablebot_gym.physics.textbook",
    "load_policy": "cablebot_gym.policies.spec",
    "normalised_action": "cablebot_gym.physics.textbook",
    "observation_layout": "cablebot_gym.envs.observation",
    "record_rollout": "cablebot_gym.evaluation.rollout",
}
"""Module of each name that is loaded on first use: an evaluation needs SciPy, an environment does
not."""


def _figure_png(result: Any) -> bytes | None:
    """Figure of a result for notebooks; None without matplotlib, or if it has no figure."""
    from cablebot_gym.plotting import figure_png

    return figure_png(result)


Printed._repr_png_ = _figure_png


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)


register_envs()
