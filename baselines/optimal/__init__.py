"""Policies that plan with the plant's equations (extra ``optimal``)."""

from baselines.optimal.tube import TUBE, TUBE_SAFE, Tube

__all__ = ["TUBE", "TUBE_SAFE", "Tube"]
