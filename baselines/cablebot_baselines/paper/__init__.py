"""The paper's tables, figures and claims, made again under any reading of it: ``cablebot reproduce``."""

from cablebot_baselines.paper.readings import Readings

__all__ = ["Readings"]
