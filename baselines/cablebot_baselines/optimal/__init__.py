"""Policies that plan with the plant's equations (extra ``optimal``)."""

from cablebot_baselines.optimal.nmpc import NMPC, NonlinearMPC
from cablebot_baselines.optimal.tube import TUBE, TUBE_SAFE, Tube

__all__ = ["NMPC", "TUBE", "TUBE_SAFE", "NonlinearMPC", "Tube"]
