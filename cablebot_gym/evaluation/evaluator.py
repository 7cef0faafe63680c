"""Search for the largest payload that a policy carries: a scan, then refinements below the first failure."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cablebot_gym.evaluation.batch import Batch, Progress, StepCount, Trial, uncertainty_name, versions
from cablebot_gym.evaluation.result import DLCCResult
from cablebot_gym.evaluation.rollout import Recorder, Rollout
from cablebot_gym.evaluation.statistics import RequiredDraws
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import PolicyError
from cablebot_gym.task import ErrorBounds, find_error_bounds
from cablebot_gym.utils.checks import number

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
    number("probability", probability, above=0, below=1)
    number("confidence", confidence, above=0.5, below=1)
    if resolution is not None:
        number("resolution", resolution, above=0, unit="kg")
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
    robot = batch.task.robot
    top = PAYLOAD_MAX["planar" if robot.planar else "spatial"] if payload_max is None else payload_max
    top = number("payload_max", top, above=0, unit="kg")
    if resolution is None:
        resolution = DEFAULT_RESOLUTION if batch.draws == 1 else DRAWN_RESOLUTION
    required = RequiredDraws.of(batch.draws, probability, confidence)
    search = _Search(batch, top, resolution, required, progress)
    search.run()
    below, above = search.gap(required.fraction)
    feasible = search.feasible()
    if below is not None:
        feasible[0] = (0.0, below.payload)
    assured = None if required.assured is None else search.gap(required.assured)[0]
    rollout = search.record(below)
    several = batch.draws > 1
    has_rotation = batch.criterion == "task" and not robot.planar
    bounds = {"position": error_bounds.position, "rotation": error_bounds.rotation if has_rotation else None}
    draw = None if above is None else above.violation_draw
    return DLCCResult(
        env_id=env_id,
        policy=batch.name,
        criterion=batch.criterion,
        payload=None if below is None else below.payload,
        total_mass=None if below is None else below.payload + robot.mass,
        resolution=0.0 if below is None or above is None else above.payload - below.payload,
        violation=None if above is None else above.violation,
        scan_ended=above is None,
        margins=_margins(below, bounds) if below else {},
        feasible=tuple(feasible),
        payload_max=top,
        error_bounds=bounds,
        payload_known=bool(batch.task.payload_known),
        model_payload_factor=float(batch.keywords.get("model_payload_factor", 1.0)),
        uncertainty=uncertainty_name(uncertainty),
        draws=batch.draws,
        probability=probability if several else None,
        confidence=confidence if several else None,
        assured_payload=None if assured is None else assured.payload,
        failures=above.failures if several and above else {},
        draw_seeds=tuple(batch.seeds),
        violation_seed=None if draw is None else batch.seeds[draw],
        success=search.success() if several else (),
        seed=int(seed),
        environment=batch.description(),
        versions=versions(),
        task=batch.task,
        rollout=rollout,
        fallbacks=batch.fallbacks,
    )


class _Search:
    """Search for the largest carried payload and for the assured payload."""

    def __init__(
        self, batch: Batch, top: float, resolution: float, required: RequiredDraws, progress: Progress | None
    ) -> None:
        self._batch, self._resolution, self._required = batch, resolution, required
        self._grid = np.linspace(0.0, top, SCAN_POINTS)
        refinements = math.ceil(
            math.log(max(1.0, top / (SCAN_POINTS - 1) / resolution)) / math.log(SCAN_POINTS + 1) - 1e-9
        )
        self._count = StepCount(progress, (1 + refinements) * batch.steps(SCAN_POINTS) + batch.steps(1))
        self._trials: dict[float, Trial] = {}

    def run(self) -> None:
        """Scans, then subdivides the gaps above the payload and above the assured payload down to the resolution."""
        self._try(self._grid)
        required = {count for count in (self._required.fraction, self._required.assured) if count is not None}
        while True:
            gaps = {(below.payload, above.payload) for below, above in map(self.gap, required) if below and above}
            wide = [gap for gap in sorted(gaps) if gap[1] - gap[0] > self._resolution]
            inner = [np.linspace(*gap, SCAN_POINTS // len(wide) + 2)[1:-1] for gap in wide]
            fresh = [payload for payload in np.concatenate([[], *inner]).tolist() if payload not in self._trials]
            if not fresh:
                return
            self._try(np.array(fresh))

    def gap(self, required: int) -> tuple[Trial | None, Trial | None]:
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

    def feasible(self) -> list[tuple[float, float]]:
        """Intervals of carried payloads on the grid of the scan [kg]."""
        carried = [self._trials[payload].carried >= self._required.fraction for payload in self._grid]
        edges = np.flatnonzero(np.diff(np.concatenate([[False], carried, [False]]).astype(int)))
        return [(float(self._grid[low]), float(self._grid[high - 1])) for low, high in edges.reshape(-1, 2)]

    def success(self) -> tuple[tuple[float, float], ...]:
        """Pairs of payload [kg] and fraction of the draws that carry it."""
        return tuple((payload, self._trials[payload].carried / self._batch.draws) for payload in sorted(self._trials))

    def record(self, carried: Trial | None) -> Rollout:
        """Repeats an episode at the carried payload, or the unloaded one that fails, and records it.

        Raises:
            PolicyError: if the repeated episodes have another outcome.
        """
        batch, trial = self._batch, carried or self._trials[0.0]
        draw = trial.violation_draw or 0
        if carried is not None:
            draw = [verdict.carried for verdict in carried.verdicts].index(True)
        self._count.expected = min(self._count.expected, self._count.done + batch.steps(1))
        recorder = Recorder(batch.env, [draw])
        repeated = batch.run([trial.payload], observer=recorder, count=self._count)[0]
        if repeated.carried != trial.carried:
            raise PolicyError(
                f"policy {batch.name!r} is not reproducible: it carried {trial.payload:g} kg in {trial.carried} of "
                f"{batch.draws} episodes, and in {repeated.carried} of the same episodes when they were repeated"
            )
        return recorder.rollouts(repeated.verdicts)[0]

    def _try(self, payloads: Array) -> None:
        self._trials |= {trial.payload: trial for trial in self._batch.run(payloads, count=self._count)}


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
