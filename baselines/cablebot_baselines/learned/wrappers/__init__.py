"""Gymnasium wrappers for training: a payload curriculum, and a steered base law.

They wrap N environments of this package as one batch, from ``gym.make_vec(id, num_envs=N,
autoreset_mode=AutoresetMode.DISABLED, terminate_on_violation=True)``: a step after a violation
teaches nothing. Arguments are JSON-able data. :class:`Steered` is the outermost one.
"""

from __future__ import annotations

from cablebot_baselines.learned.wrappers.curriculum import PayloadCurriculum
from cablebot_baselines.learned.wrappers.steered import Steered

__all__ = ["PayloadCurriculum", "Steered"]
