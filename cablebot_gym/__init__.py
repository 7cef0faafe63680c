"""Gymnasium environments and a payload benchmark for cable-suspended robots.

Importing the package registers the ids in :data:`ENV_IDS`. Heavy modules are imported on first use.
"""

from cablebot_gym.envs import ENV_IDS, register_envs

__version__ = "0.1.0"
__all__ = ["ENV_IDS", "INTERNAL", "__version__"]

INTERNAL = (
    "cablebot_gym.benchmark.policy_source",
    "cablebot_gym.benchmark.tables",
    "cablebot_gym.cli",
    "cablebot_gym.envs.disturbances",
    "cablebot_gym.envs.outcome",
    "cablebot_gym.envs.pictures",
    "cablebot_gym.envs.references",
    "cablebot_gym.envs.sensors",
    "cablebot_gym.envs.simulation",
    "cablebot_gym.evaluation.search",
    "cablebot_gym.importers",
    "cablebot_gym.isolation.server",
    "cablebot_gym.physics.code_cache",
    "cablebot_gym.physics.compiling",
    "cablebot_gym.physics.inlining",
    "cablebot_gym.physics.kernel",
    "cablebot_gym.physics.nearest_point",
    "cablebot_gym.physics.tension_problems",
    "cablebot_gym.planning.signals",
    "cablebot_gym.policies.sb3",
    "cablebot_gym.report",
)
"""Internal modules and packages. The names without a leading underscore in all other modules form the public API."""

register_envs()
