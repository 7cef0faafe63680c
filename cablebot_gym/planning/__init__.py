"""Motions inside the tube around a reference, planned for a heavy payload (extra ``optimal``).

``instants`` holds what has to be true at one instant, ``program`` the nonlinear program, ``motion`` its result,
``following`` the torques that follow it, and ``library`` keeps plans on disk.
"""

from cablebot_gym.planning.following import Follower, State
from cablebot_gym.planning.library import planned
from cablebot_gym.planning.motion import Margins, PlannedMotion
from cablebot_gym.planning.program import Infeasible, MotionProgram

__all__ = ["Follower", "Infeasible", "Margins", "MotionProgram", "PlannedMotion", "State", "planned"]
