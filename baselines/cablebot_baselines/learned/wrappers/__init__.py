"""Gymnasium wrappers for training: a payload curriculum, and a steered base law.

Each wrapper is written for N environments, :class:`CableBotVectorEnv` with autoreset disabled. Its
single-environment form runs the vector form on one row, so that both return the same numbers bit by
bit. Arguments are JSON-able data. :class:`Steered` is the outermost one. Make the environments with
``terminate_on_violation=True``: a step after a violation teaches nothing.
"""

from __future__ import annotations

from cablebot_baselines.learned.wrappers.curriculum import (
    PayloadCurriculum,
    PayloadCurriculumVector,
)
from cablebot_baselines.learned.wrappers.steered import Steered, SteeredVector, make_steered_vec

__all__ = [
    "PayloadCurriculum",
    "PayloadCurriculumVector",
    "Steered",
    "SteeredVector",
    "make_steered_vec",
]
