"""Search for the largest payload that a policy carries: a scan, then refinements below the first failure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.evaluation.batch import Batch, Progress, Trial, uncertainty_name, versions
from cablebot_gym.evaluation.constraints import Violation
from cablebot_gym.evaluation.result import DLCCResult, History
from cablebot_gym.evaluation.statistics import RequiredDraws
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import PolicyError
from cablebot_gym.task import ErrorBounds, find_error_bounds

SCAN_POINTS = 64
"""Number of payloads in the first scan, including both ends, and in every refinement."""

PAYLOAD_MAX = {"planar": 10.0, "spatial": 20.0}
"""Default end of the scan [kg]."""

DEFAULT_RESOLUTION = 1e-3
"""Default resolution for one draw: gap between the DLCC and the least failed payload [kg]."""

DRAWN_RESOLUTION = 1e-2
"""Default resolution for several draws, whose number limits the accuracy [kg]."""


def evaluate_dlcc(
    policy: Any,
    env_id: str,
    *,
    criterion: str = "task",
    error_bounds: ErrorBounds | dict[str, float] | None = None,
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
    """Evaluates the DLCC of a policy: the largest payload in the feasible interval that contains zero.

    The scan tries :data:`SCAN_POINTS` payloads from 0 to ``payload_max`` in one batch. The gap below the first failed
    payload is then subdivided until it is at most ``resolution`` wide. Under a random ``uncertainty`` every payload is
    tried in the same ``draws``. A payload is carried if at least the fraction ``probability`` of the draws carries it.

    Args:
        policy: an object with ``predict``, a callable ``observation -> action``, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        criterion: ``task`` (saturated motors; position, rotation, slack) or ``paper`` (|a| ≤ 1, position, slack).
        error_bounds: bounds of the tracking errors; None for 10 mm and 10 mrad.
        payload_max: end of the scan [kg]; None for 20 kg (spatial) or 10 kg (planar).
        resolution: largest gap to the least failed payload [kg]; None for :data:`DEFAULT_RESOLUTION`, or
            :data:`DRAWN_RESOLUTION` with several draws.
        uncertainty: model errors and disturbances that the policy does not know, see
            :func:`cablebot_gym.uncertainty.find_uncertainty`.
        draws: number of episodes at each payload; None for :data:`~cablebot_gym.evaluation.batch.DEFAULT_DRAWS` under
            a random uncertainty, else 1. ``seed`` alone determines the draws, so all policies and payloads share them.
        probability: required fraction of the draws that carry a payload; no effect with one draw.
        confidence: confidence of ``result.assured_payload``, a one-sided lower tolerance bound.
        seed: seed of the environments.
        name: name of the policy in the result; None for its own name.
        progress: callback after every control step.
        keywords: keywords of the environment: ``trajectory``, ``payload_known``, ``control_frequency``, ``robot``, …

    Returns:
        The result. With the default ``probability`` and ``confidence``, ``assured_payload`` is a 95/95 lower tolerance
        bound: with 95 % confidence, at least 95 % of all draws carry it.

    Raises:
        ValueError: if an argument is invalid, or if the ``paper`` criterion is used for a policy that does not declare
            ``unsaturated_actions``.
        cablebot_gym.policies.protocol.PolicyError: if the policy raises or returns anything but finite actions.
    """
    for label, fraction, least in (("probability", probability, 0.0), ("confidence", confidence, 0.5)):
        if not least < fraction < 1:
            raise ValueError(f"{label} must lie between {least:g} and 1, not {fraction}")
    if resolution is not None and not 0 < resolution < math.inf:
        raise ValueError(f"resolution must be greater than 0 kg, not {resolution}")
    error_bounds = find_error_bounds(error_bounds)
    batch = Batch(
        policy,
        env_id,
        name=name,
        criterion=criterion,
        error_bounds=error_bounds,
        uncertainty=uncertainty,
        draws=draws,
        seed=seed,
        max_payloads=SCAN_POINTS,
        keywords=keywords,
    )
    with batch:
        robot = batch.task.robot
        top = float(PAYLOAD_MAX["planar" if robot.planar else "spatial"] if payload_max is None else payload_max)
        if not 0 < top < math.inf:
            raise ValueError(f"payload_max must be greater than 0 kg, not {top}")
        if resolution is None:
            resolution = DEFAULT_RESOLUTION if batch.draws == 1 else DRAWN_RESOLUTION
        required = RequiredDraws.of(batch.draws, probability, confidence)
        search = _Search(batch, top, resolution, required, progress).run()
        several = batch.draws > 1
        has_rotation = batch.criterion == "task" and not robot.planar
        bounds = {"position": error_bounds.position, "rotation": error_bounds.rotation if has_rotation else None}
        carried = search.carried
        return DLCCResult(
            env_id=env_id,
            policy=batch.name,
            criterion=batch.criterion,
            payload=None if carried is None else carried.payload,
            total_mass=None if carried is None else carried.payload + robot.mass,
            resolution=search.gap,
            violation=search.violation,
            scan_ended=search.violation is None,
            margins=_margins(carried, bounds) if carried else {},
            feasible=search.feasible,
            payload_max=top,
            error_bounds=bounds,
            payload_known=bool(batch.task.payload_known),
            model_payload_factor=float(batch.keywords.get("model_payload_factor", 1.0)),
            uncertainty=uncertainty_name(uncertainty),
            draws=batch.draws,
            probability=probability if several else None,
            confidence=confidence if several else None,
            assured_payload=search.assured.payload if several and search.assured else None,
            failures=search.failures if several else {},
            draw_seeds=tuple(batch.seeds),
            violation_seed=None if search.violation_draw is None else batch.seeds[search.violation_draw],
            success=search.success if several else (),
            seed=int(seed),
            environment=batch.description(),
            versions=versions(),
            task=batch.task,
            history=search.history,
        )


@dataclass(frozen=True, kw_only=True)
class _SearchResult:
    """Result of a payload search; attributes as in :class:`~cablebot_gym.evaluation.result.DLCCResult`."""

    carried: Trial | None
    """Trial at the largest carried payload; None if the policy fails unloaded."""
    assured: Trial | None
    """Trial at the assured payload; None if there is none."""
    violation: Violation | None
    violation_draw: int | None
    failures: dict[str, int]
    gap: float
    feasible: tuple[tuple[float, float], ...]
    success: tuple[tuple[float, float], ...]
    history: dict[str, Array]


class _Search:
    """Search for the largest carried payload and for the assured payload."""

    def __init__(
        self, batch: Batch, top: float, resolution: float, required: RequiredDraws, progress: Progress | None
    ) -> None:
        self._batch, self._top, self._resolution, self._required = batch, top, resolution, required
        refinements = math.ceil(
            math.log(max(1.0, top / (SCAN_POINTS - 1) / resolution)) / math.log(SCAN_POINTS + 1) - 1e-9
        )
        self._expected = (1 + refinements) * batch.steps(SCAN_POINTS) + batch.steps(1)
        self._done, self._progress = 0, progress
        self._trials: dict[float, Trial] = {}

    def run(self) -> _SearchResult:
        """Scans, refines, and repeats the episode at the payload to record its history."""
        grid = np.linspace(0.0, self._top, SCAN_POINTS)
        self._try(grid)
        self._refine()
        required, (below, above) = self._required, self._gap(self._required.fraction)
        assured = None if required.assured is None else self._gap(required.assured)[0]
        feasible = _intervals(grid, np.array([self._trials[payload].carried >= required.fraction for payload in grid]))
        if below is not None:
            feasible[0] = (0.0, below.payload)
        trial = self._trials[0.0] if below is None else below
        history, draw = History(), (trial.violation_draw or 0) if below is None else _first_carried(trial)

        def record(info: dict[str, Any], pose: Array, running: NDArray[np.bool_]) -> None:
            if history.stall_torque is None:
                history.stall_torque = self._batch.truth["motor_strength"][draw]
            if running[draw]:
                history.append(info, pose, draw)

        self._expected = min(self._expected, self._done + self._batch.steps(1))
        repeated = self._run([trial.payload], record)[0]
        if repeated.carried != trial.carried:
            raise PolicyError(
                f"policy {self._batch.name!r} is not reproducible: it carried {repeated.payload:g} kg in "
                f"{trial.carried} of {self._batch.draws} episodes, and in {repeated.carried} of the same episodes when "
                "they were repeated"
            )
        return _SearchResult(
            carried=below,
            assured=assured,
            violation=None if above is None else above.violation,
            violation_draw=None if above is None else above.violation_draw,
            failures={} if above is None else above.failures,
            gap=0.0 if below is None or above is None else above.payload - below.payload,
            feasible=tuple(feasible),
            success=tuple(
                (payload, self._trials[payload].carried / self._batch.draws) for payload in sorted(self._trials)
            ),
            history=history.closed(),
        )

    def _refine(self) -> None:
        """Subdivides the gaps above the payload and above the assured payload down to the resolution."""
        required = {count for count in (self._required.fraction, self._required.assured) if count is not None}
        while True:
            gaps = {(below.payload, above.payload) for below, above in map(self._gap, required) if below and above}
            wide = [gap for gap in sorted(gaps) if gap[1] - gap[0] > self._resolution]
            inner = [np.linspace(*gap, SCAN_POINTS // len(wide) + 2)[1:-1] for gap in wide]
            fresh = [payload for payload in np.concatenate([[], *inner]).tolist() if payload not in self._trials]
            if not fresh:
                return
            self._try(np.array(fresh))

    def _gap(self, required: int) -> tuple[Trial | None, Trial | None]:
        """The trial of the first payload that fewer than ``required`` draws carry, and the trial below it.

        Returns:
            (below, above); None where there is none.
        """
        below = None
        for payload in sorted(self._trials):
            if self._trials[payload].carried < required:
                return below, self._trials[payload]
            below = self._trials[payload]
        return below, None

    def _try(self, payloads: Array) -> None:
        self._trials |= {trial.payload: trial for trial in self._run(payloads, None)}

    def _run(self, payloads: Any, observe: Any) -> list[Trial]:
        return self._batch.run(payloads, observe=observe, progress=self._advance)

    def _advance(self, steps: int) -> None:
        self._done += steps
        if self._progress is not None:
            self._progress(self._done, max(self._expected, self._done))


def _first_carried(trial: Trial) -> int:
    return next(draw for draw, verdict in enumerate(trial.verdicts) if verdict.carried)


def _intervals(payloads: Array, carried: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Intervals of carried payloads on the grid of the scan."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], carried.astype(int), [0]])))
    return [(float(payloads[low]), float(payloads[high - 1])) for low, high in edges.reshape(-1, 2)]


def _margins(trial: Trial, bounds: dict[str, float | None]) -> dict[str, float]:
    """Least margins over the draws that carry the payload, as fractions of the limits; tension in N."""
    carried = [verdict for verdict in trial.verdicts if verdict.carried]
    margins = {
        "torque": 1 - max(max(verdict.peak_action) for verdict in carried),
        "tension": min(verdict.least_tension for verdict in carried),
    }
    for name in ("position", "rotation"):
        bound = bounds[name]
        if bound is not None:
            margins[name] = 1 - max(getattr(verdict, f"{name}_peak") for verdict in carried) / bound
    return margins
