"""The largest payload that a policy carries: all payloads as one batch, then ever finer around the first failure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.evaluation.batch import Batch, Progress, Trial, uncertainty_name, versions
from cablebot_gym.evaluation.constraints import Limit
from cablebot_gym.evaluation.result import DLCCResult, History
from cablebot_gym.evaluation.statistics import Needed
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import PolicyError
from cablebot_gym.task import Limits, find_limits

SCAN_POINTS = 64
"""Payloads of the first scan, both ends included, and of every refinement."""

PAYLOAD_MAX = {"planar": 10.0, "spatial": 20.0}
"""Default end of the scan [kg]."""

DEFAULT_RESOLUTION = 1e-3
"""Default width of the gap between carried and not carried [kg]."""

DRAWN_RESOLUTION = 1e-2
"""The same over draws, whose number limits what can be known [kg]."""


def evaluate_dlcc(
    policy: Any,
    env_id: str,
    *,
    criterion: str = "task",
    limits: Limits | dict[str, float] | None = None,
    payload_max: float | None = None,
    resolution: float | None = None,
    uncertainty: Any = None,
    draws: int | None = None,
    probability: float = 0.95,
    confidence: float = 0.95,
    seed: int = 0,
    name: str | None = None,
    progress: Progress | None = None,
    **keywords: Any,
) -> DLCCResult:
    """The largest payload in the feasible interval that contains zero.

    Payloads are tried on :data:`SCAN_POINTS` points of [0, payload_max] at once; then the gap below the first failure
    is divided again and again until it is no wider than ``resolution``. Under a random ``uncertainty`` each payload is
    tried in the same ``draws``, and is carried if at least the share ``probability`` of them is.

    Args:
        policy: an object with ``predict``, a callable ``observation -> action``, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        criterion: ``task`` (motors clip; position, rotation, slack) or ``paper`` (|a| ≤ 1, position, slack).
        limits: bounds of the errors; None for 10 mm and 10 mrad.
        payload_max: end of the scan [kg]; None for 20 spatial, 10 planar.
        resolution: [kg]; None for :data:`DEFAULT_RESOLUTION`, or :data:`DRAWN_RESOLUTION` over draws.
        uncertainty: what the policy does not know, see :func:`cablebot_gym.uncertainty.find_uncertainty`.
        draws: episodes at each payload; None for :data:`~cablebot_gym.evaluation.batch.DEFAULT_DRAWS` if the uncertainty is
            random, else 1. They follow from ``seed`` alone: every policy and every payload meets the same ones.
        probability: p, the share of the draws in which a payload has to be carried; no effect on one draw.
        confidence: of the one-sided lower bound, ``result.assured_payload``.
        seed: of the environments.
        name: of the policy, in the result; None for its own.
        progress: called after every control step.
        keywords: for the environment: ``trajectory``, ``payload_known``, ``control_frequency``, ``robot``, …

    Raises:
        ValueError: if an argument is not valid, or ``paper`` is asked of a policy that does not declare ``unclipped``.
        cablebot_gym.policies.PolicyError: if the policy raises or returns anything but finite drive commands.
    """
    for name_, share, least in (("probability", probability, 0.0), ("confidence", confidence, 0.5)):
        if not least < share < 1:
            raise ValueError(f"{name_} must lie between {least:g} and 1, not {share}")
    if resolution is not None and not 0 < resolution < math.inf:
        raise ValueError(f"resolution must be greater than 0 kg, not {resolution}")
    limits = find_limits(limits)
    batch = Batch(
        policy,
        env_id,
        name=name,
        criterion=criterion,
        limits=limits,
        uncertainty=uncertainty,
        draws=draws,
        seed=seed,
        together=SCAN_POINTS,
        keywords=keywords,
    )
    with batch:
        robot = batch.task.robot
        top = float(PAYLOAD_MAX["planar" if robot.planar else "spatial"] if payload_max is None else payload_max)
        if not 0 < top < math.inf:
            raise ValueError(f"payload_max must be greater than 0 kg, not {top}")
        if resolution is None:
            resolution = DEFAULT_RESOLUTION if batch.draws == 1 else DRAWN_RESOLUTION
        needed = Needed.of(batch.draws, probability, confidence)
        found = _Search(batch, top, resolution, needed, progress).result()
        drawn = batch.draws > 1
        rotates = batch.criterion == "task" and not robot.planar
        bounds = {"position": limits.position, "rotation": limits.rotation if rotates else None}
        best = found.best
        return DLCCResult(
            env_id=env_id,
            policy=batch.name,
            criterion=batch.criterion,
            payload=None if best is None else best.payload,
            total_mass=None if best is None else best.payload + robot.mass,
            resolution=found.gap,
            limit=found.limit,
            margins=_margins(best, bounds) if best else {},
            feasible=found.feasible,
            payload_max=top,
            limits=bounds,
            payload_known=bool(batch.task.payload_known),
            uncertainty=uncertainty_name(uncertainty),
            draws=batch.draws,
            probability=probability if drawn else None,
            confidence=confidence if drawn else None,
            assured_payload=found.assured.payload if drawn and found.assured else None,
            failures=found.failures if drawn else {},
            draw_seeds=tuple(batch.seeds),
            limit_seed=None if found.limit_draw is None else batch.seeds[found.limit_draw],
            success=found.success if drawn else (),
            seed=int(seed),
            environment=batch.description(),
            versions=versions(),
            task=batch.task,
            history=found.history,
        )


@dataclass(frozen=True, kw_only=True)
class _Found:
    best: Trial | None
    assured: Trial | None
    limit: Limit
    limit_draw: int | None
    failures: dict[str, int]
    gap: float
    feasible: tuple[tuple[float, float], ...]
    success: tuple[tuple[float, float], ...]
    history: dict[str, Array]


class _Search:
    """Finds where a payload ceases to be carried."""

    def __init__(self, batch: Batch, top: float, resolution: float, needed: Needed, progress: Progress | None) -> None:
        self._batch, self._top, self._resolution, self._needed = batch, top, resolution, needed
        finer = math.ceil(math.log(max(1.0, top / (SCAN_POINTS - 1) / resolution)) / math.log(SCAN_POINTS + 1) - 1e-9)
        self._expected = (1 + finer) * batch.steps(SCAN_POINTS) + batch.steps(1)
        self._done, self._progress = 0, progress
        self._tried: dict[float, Trial] = {}

    def result(self) -> _Found:
        """Scan, refinement, and the payload once more for its history."""
        grid = np.linspace(0.0, self._top, SCAN_POINTS)
        self._try(grid)
        self._refine()
        needed, (below, above) = self._needed, self._gap(self._needed.share)
        assured = None if needed.assured is None else self._gap(needed.assured)[0]
        feasible = _intervals(grid, np.array([self._tried[payload].carried >= needed.share for payload in grid]))
        if below is not None:
            feasible[0] = (0.0, below.payload)
        first = self._tried[0.0] if below is None else below
        history, shown = History(), (first.limit_draw or 0) if below is None else _first_carried(first)

        def watch(info: dict[str, Any], pose: Array, lasting: NDArray[np.bool_]) -> None:
            if history.stall_torque is None:
                history.stall_torque = self._batch.truth["motor_strength"][shown]
            if lasting[shown]:
                history.append(info, pose, shown)

        self._expected = min(self._expected, self._done + self._batch.steps(1))
        again = self._run([first.payload], watch)[0]
        if again.carried != first.carried:
            raise PolicyError(
                f"policy {self._batch.name!r} is not reproducible: {again.payload:g} kg was carried in "
                f"{first.carried} of {self._batch.draws} episodes at first, and in {again.carried} when tried again"
            )
        limit = Limit(kind="scan_end", index=None, time=None, excess=None) if above is None else above.limit
        assert limit is not None
        return _Found(
            best=below,
            assured=assured,
            limit=limit,
            limit_draw=None if above is None else above.limit_draw,
            failures={} if above is None else above.failures,
            gap=0.0 if below is None or above is None else above.payload - below.payload,
            feasible=tuple(feasible),
            success=tuple(
                (payload, self._tried[payload].carried / self._batch.draws) for payload in sorted(self._tried)
            ),
            history=history.closed(),
        )

    def _refine(self) -> None:
        """Divides the gaps of the payload and of its lower bound until they are narrow."""
        needed = {number for number in (self._needed.share, self._needed.assured) if number is not None}
        while True:
            gaps = {(below.payload, above.payload) for below, above in map(self._gap, needed) if below and above}
            wide = [gap for gap in sorted(gaps) if gap[1] - gap[0] > self._resolution]
            inner = [np.linspace(*gap, SCAN_POINTS // len(wide) + 2)[1:-1] for gap in wide]
            fresh = [payload for payload in np.concatenate([[], *inner]).tolist() if payload not in self._tried]
            if not fresh:
                return
            self._try(np.array(fresh))

    def _gap(self, needed: int) -> tuple[Trial | None, Trial | None]:
        """The last payload before, and the first one that fewer than ``needed`` draws carry; None if there is none."""
        below = None
        for payload in sorted(self._tried):
            if self._tried[payload].carried < needed:
                return below, self._tried[payload]
            below = self._tried[payload]
        return below, None

    def _try(self, payloads: Array) -> None:
        self._tried |= {trial.payload: trial for trial in self._run(payloads, None)}

    def _run(self, payloads: Any, observe: Any) -> list[Trial]:
        return self._batch.run(payloads, observe=observe, progress=self._advance)

    def _advance(self, steps: int) -> None:
        self._done += steps
        if self._progress is not None:
            self._progress(self._done, max(self._expected, self._done))


def _first_carried(trial: Trial) -> int:
    return next(place for place, verdict in enumerate(trial.verdicts) if verdict.carried)


def _intervals(payloads: Array, carried: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Runs of carried payloads on the scan's points."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], carried.astype(int), [0]])))
    return [(float(payloads[low]), float(payloads[high - 1])) for low, high in edges.reshape(-1, 2)]


def _margins(trial: Trial, bounds: dict[str, float | None]) -> dict[str, float]:
    """What was left of each limit at the payload found in the tightest draw that carried, as a share; tension in N."""
    carried = [verdict for verdict in trial.verdicts if verdict.carried]
    margins = {
        "torque": 1 - max(max(verdict.peak_demand) for verdict in carried),
        "tension": min(verdict.least_tension for verdict in carried),
    }
    for name in ("position", "rotation"):
        bound = bounds[name]
        if bound is not None:
            margins[name] = 1 - max(getattr(verdict, f"{name}_peak") for verdict in carried) / bound
    return margins
