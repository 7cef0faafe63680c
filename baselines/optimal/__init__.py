"""Policies that plan with the plant's equations (extra ``optimal``)."""

from baselines.optimal.nmpc import NMPC, NonlinearMPC
from baselines.optimal.tube import TUBE, TUBE_SAFE, Tube

__all__ = ["NMPC", "TUBE", "TUBE_SAFE", "NonlinearMPC", "Tube"]
