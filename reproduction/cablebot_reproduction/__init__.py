"""Reproduction of the tables, figures and claims of the paper under a chosen interpretation:
``cablebot reproduce``."""

from cablebot_reproduction.interpretation import Interpretation

__all__ = ["Interpretation"]
