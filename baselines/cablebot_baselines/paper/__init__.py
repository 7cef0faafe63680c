"""Reproduction of the tables, figures and claims of the paper under a chosen interpretation:
``cablebot reproduce``."""

from cablebot_baselines.paper.interpretation import Interpretation

__all__ = ["Interpretation"]
