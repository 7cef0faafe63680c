"""Trajectory optimisation: motions within the error bounds for the heaviest payload (extra
``optimal``).

* ``stage_functions``: the constraints at one instant.
* ``program``: the nonlinear program.
* ``motion``: the planned motion, which is the result of the program.
* ``following``: the torques that follow a planned motion.
* ``library``: a cache of plans on disk.
* ``signals``: Ctrl-C while the solver runs.
"""

from cablebot_gym.planning.blocks import clamped_knots, greville
from cablebot_gym.planning.following import Follower, State
from cablebot_gym.planning.motion import MarginProfile, Margins, PlannedMotion, PlannedMotions
from cablebot_gym.planning.program import Infeasible, MotionProgram

__all__ = [
    "Follower",
    "Infeasible",
    "MarginProfile",
    "Margins",
    "MotionProgram",
    "PlannedMotion",
    "PlannedMotions",
    "State",
    "clamped_knots",
    "greville",
]
