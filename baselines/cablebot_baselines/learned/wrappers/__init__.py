"""Gymnasium wrappers that a learner trains through: the task's limits, heavier payloads step by step, a steered law.

Each stands around a single environment of this package, and has a twin for N at once, :class:`CableBotVectorEnv` made
with autoreset disabled; a lane of the twin is the single environment bit for bit. Arguments are plain JSON-able data.
The order from the inside out: :class:`WithinLimits`, :class:`PayloadCurriculum`, :class:`Steered`.
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
