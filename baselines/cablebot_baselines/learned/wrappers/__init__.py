"""Gymnasium wrappers for training: the task's error bounds, a payload curriculum, and a steered base law.

Each wraps a single environment of this package. Each has a vector form for N environments, which wraps a
:class:`CableBotVectorEnv` with autoreset disabled; its environment i equals the single environment bit by bit.
Arguments are JSON-able data. The order is :class:`WithinLimits` (innermost), :class:`PayloadCurriculum`,
:class:`Steered`.
"""

from __future__ import annotations

from cablebot_baselines.learned.wrappers.batch import make_steered_vec
from cablebot_baselines.learned.wrappers.curriculum import PayloadCurriculum, PayloadCurriculumVector
from cablebot_baselines.learned.wrappers.limits import WithinLimits, WithinLimitsVector
from cablebot_baselines.learned.wrappers.steered import Steered, SteeredVector

__all__ = [
    "PayloadCurriculum",
    "PayloadCurriculumVector",
    "Steered",
    "SteeredVector",
    "WithinLimits",
    "WithinLimitsVector",
    "make_steered_vec",
]
