"""Policies that plan motions with the equations of the plant. They need the extra ``optimal``."""

from cablebot_baselines.planners.nmpc import NMPC, NonlinearMPC
from cablebot_baselines.planners.trajopt import TRAJOPT, TrajOpt

__all__ = ["NMPC", "TRAJOPT", "NonlinearMPC", "TrajOpt"]
