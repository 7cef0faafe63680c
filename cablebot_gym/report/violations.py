"""When along the motion limits broke: the figures of the report page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from statistics import median
from typing import Any

import numpy as np

from cablebot_gym.evaluation.judge import KINDS, LIMIT_NAMES

BINS = 20
"""Number of equal parts of the motion."""


def violation_strips(violations: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """JSON-able histograms of violations over the motion: one for each kind that occurs.

    Args:
        violations: ``kind`` and ``fraction`` of the motion at which the limit broke, and ``lead``
            [s] or None, see :class:`~cablebot_gym.evaluation.judge.Violation`.

    Returns:
        ``limit``, its name; ``counts`` of :data:`BINS` parts; their sum ``count``; medians ``fraction`` and
        ``lead`` [s], which is None if no violation has one.
    """
    groups: dict[str, list[Mapping[str, Any]]] = {kind: [] for kind in KINDS}
    for violation in violations:
        groups[violation["kind"]].append(violation)
    strips = []
    for kind, group in groups.items():
        if not group:
            continue
        fractions = [violation["fraction"] for violation in group]
        leads = [violation["lead"] for violation in group if violation.get("lead") is not None]
        strips.append(
            {
                "limit": LIMIT_NAMES[kind],
                "counts": np.histogram(fractions, BINS, (0, 1))[0].tolist(),
                "count": len(group),
                "fraction": median(fractions),
                "lead": median(leads) if leads else None,
            }
        )
    return strips
