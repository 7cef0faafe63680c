"""Gymnasium environments and a payload benchmark for cable-suspended robots.

Importing registers the ids in :data:`ENV_IDS`; everything heavy is loaded when it is used.
"""

from cablebot_gym.envs import ENV_IDS, register_envs

__version__ = "0.1.0"
__all__ = ["ENV_IDS", "__version__"]

register_envs()
