"""Search for the largest payload that a policy carries: scan, refinement, repetition, dense check, discretisation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cablebot_gym.evaluation.batch import (
    ALONE,
    BATCH,
    DEPENDENT,
    RISK,
    Batch,
    Progress,
    Row,
    StepCount,
    Trial,
    derived_seeds,
    secret_order,
)
from cablebot_gym.evaluation.constraints import Verdict
from cablebot_gym.evaluation.result import DLCCResult
from cablebot_gym.evaluation.rollout import Recorder, Rollout
from cablebot_gym.evaluation.statistics import plausible_successes, required_successes
from cablebot_gym.physics.statics import payload_ceiling
from cablebot_gym.policies import PolicyError, Wrapper
from cablebot_gym.robots import PAPER_PAYLOAD_MAX, Robot, has_paper_capacity
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.checks import choice, number
from cablebot_gym.utils.console import chosen_progress

SCAN_POINTS = 64
"""Number of payloads in the scan, including both ends, and in the dense check below the payload."""

REFINED_POINTS = 32
"""Largest number of payloads in a refinement."""

SEARCHES = ("scan", "bisection")
"""Kinds of search. Only a scan gives a ranked result."""

BISECTION_POINTS = 5
"""Number of payloads that a bisection tries first, including both ends."""

SEARCH_DRAWS = 16
"""Number of draws of each payload of the scan, if there are several. The confirmation has other draws."""

SCAN_MARGIN = 1.25
"""End of the scan of a robot without a payload range, over the payload that no controller can be expected to carry."""

DEFAULT_RESOLUTION = 1e-3
"""Default resolution for one draw: gap between the DLCC and the least failed payload [kg]."""

DRAWN_RESOLUTION = 1e-2
"""Default resolution for several draws, whose number limits the accuracy [kg]."""

REPEAT_TOLERANCE = 1e-6
"""Largest difference of the peaks of an episode and of its repetition, as a fraction of the bound. Products of matrices
round differently in batches of another order."""

DIAGNOSES = 3
"""Largest number of further runs of the scan that look for randomness after a repeated episode differs."""

FINER = 10
"""Factor of the number of physics steps in the episodes that measure the discretisation error."""


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
    search: str = "scan",
    name: str | None = None,
    wrappers: Sequence[Wrapper] = (),
    progress: Progress | bool | None = None,
    **keywords: Any,
) -> DLCCResult:
    """Evaluates the DLCC of a policy: the largest payload in the feasible interval that contains zero.

    The scan tries :data:`SCAN_POINTS` payloads from 0 to ``payload_max`` in one batch. The gap below the first failed
    payload is then subdivided until it is at most ``resolution`` wide. The episodes of the scan are repeated in another
    order, random payloads below the result are tried, and payloads around the result are tried with finer physics
    steps. Under a random ``uncertainty`` the scan has :data:`SEARCH_DRAWS` draws; the payload is then confirmed with
    ``draws`` other ones, which all payloads share.

    ``search="bisection"`` is for policies that take seconds for an episode. It tries :data:`BISECTION_POINTS` payloads
    and bisects the lowest gap below a failed one, without further checks except the repetition of the last two
    episodes. It can miss a failure between two payloads, so its result is marked as unranked.

    Args:
        policy: a loaded policy, an object with ``predict``, a callable ``observation -> action``, a class that makes
            one of them, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        criterion: ``task`` (saturated motors; position, rotation, tension) or ``paper`` (|a| ≤ 1, position, slack).
        error_bounds: bounds of the tracking errors; None for those of the robot.
        payload_max: end of the scan [kg]; None for that of :func:`default_payload_max`.
        resolution: largest gap to the least failed payload [kg]; None for :data:`DEFAULT_RESOLUTION`, or
            :data:`DRAWN_RESOLUTION` with several draws.
        uncertainty: model errors and disturbances that the policy does not know, see
            :func:`cablebot_gym.uncertainty.find_uncertainty`.
        draws: number of draws that confirm the payload; None for
            :data:`~cablebot_gym.evaluation.batch.DEFAULT_DRAWS` under a random uncertainty or with a policy that
            declares ``stochastic = True``, else 1.
        probability: required success probability; no effect with one draw.
        confidence: confidence of the payload as a one-sided lower tolerance bound; no effect with one draw.
        seed: seed that determines payloads and draws, so all policies share them.
        name: name of the policy in the result; None for its own name.
        wrappers: wrappers of the training of the policy, the innermost first: classes or functions, their names, or the
            file of a ``VecNormalize``. They wrap a stand-in of the environment, see
            :data:`cablebot_gym.policies.wrappers.Wrapper`.
        search: ``scan``, or ``bisection`` for slow policies.
        progress: callback after every control step; True shows it on standard error.
        keywords: keywords of the environment: ``trajectory``, ``payload_known``, ``control_frequency``, ``robot``, …

    Returns:
        The result. With several draws and the default ``probability`` and ``confidence``, the payload is a 95/95 lower
        tolerance bound: with 95 % confidence, at least 95 % of all draws carry it.

    Raises:
        ValueError: if an argument is invalid, or if the ``paper`` criterion is used for a policy that does not declare
            ``unsaturated_actions``.
        cablebot_gym.policies.protocol.PolicyError: if the policy raises, returns anything but finite actions, or does
            not act the same when its episodes are repeated.
    """
    choice("search", search, SEARCHES)
    number("probability", probability, above=0, below=1)
    number("confidence", confidence, above=0.5, below=1)
    batch = Batch(
        policy,
        env_id,
        name=name,
        wrappers=wrappers,
        criterion=criterion,
        error_bounds=error_bounds,
        uncertainty=uncertainty,
        draws=draws,
        seed=seed,
        keywords=keywords,
    )
    robot = batch.task.robot
    if payload_max is None:
        payload_max = default_payload_max(robot, batch.task.trajectory, batch.error_bounds)
    top = number("payload_max", payload_max, above=0, unit="kg")
    several = batch.draws > 1
    ranked = search == SEARCHES[0]
    default = DEFAULT_RESOLUTION if ranked and not several else DRAWN_RESOLUTION
    resolution = number("resolution", default if resolution is None else resolution, above=0, unit="kg")
    with chosen_progress(progress, f"{batch.policy.name}, {batch.criterion} criterion") as step:
        finder = _Search(batch, top, resolution, probability, confidence, step, thorough=ranked)
        finder.run()
        below, above = finder.gap()
        discretisation = finder.discretisation(below, above)
        rollout, below, above = finder.record(below, above)
    has_rotation = batch.criterion == "task" and not robot.point_mass
    position, rotation = batch.error_bounds.position, batch.error_bounds.rotation if has_rotation else None
    bounds = {"position": position, "rotation": rotation}
    return DLCCResult(
        policy=batch.policy.name,
        criterion=batch.criterion,
        payload=None if below is None else below.payload,
        total_mass=None if below is None else below.payload + robot.mass,
        resolution=max(above.payload - below.payload if below and above else 0.0, discretisation or 0.0),
        discretisation=discretisation,
        failed_payload=None if above is None else above.payload,
        violation=None if above is None else above.violation,
        scan_ended=above is None,
        ranked=ranked,
        margins=_margins(below, bounds) if below else {},
        feasible=finder.feasible(below),
        payload_max=top,
        error_bounds=bounds,
        stochastic=batch.policy.declarations.stochastic,
        declared=batch.criterion == "paper" and not batch.policy.held,
        assured=finder.assured if batch.random else None,
        probability=probability if several else None,
        confidence=confidence if several else None,
        failures=above.failures if above and len(above.verdicts) > 1 else {},
        violation_seed=None if above is None else above.seeds[above.violation_draw or 0],
        success=finder.success(),
        rollout=rollout,
        fallbacks=batch.fallbacks,
        wrappers=batch.policy.wrappers,
        **batch.description(),
    )


def default_payload_max(robot: Robot, trajectory: Trajectory, error_bounds: ErrorBounds) -> float:
    """Default end of the scan of a robot [kg]: the end of its payload range, or slightly more than its motors hold.

    For the paper's robots it is :data:`~cablebot_gym.robots.PAPER_PAYLOAD_MAX`.
    """
    if robot.defaults.payload_range is not None:
        return robot.defaults.payload_range[1]
    if has_paper_capacity(robot):
        return PAPER_PAYLOAD_MAX[robot.kind]
    ceiling = payload_ceiling(robot, trajectory, error_bounds)
    if ceiling <= 0:  # the motors do not even hold the platform
        ceiling = robot.mass
    return float(f"{SCAN_MARGIN * ceiling:.2g}")


_Verdicts = Sequence[Verdict]


class _Search:
    """Search for the largest carried payload.

    Attributes:
        assured: whether the required number of successes gives the lower tolerance bound.
    """

    def __init__(
        self,
        batch: Batch,
        top: float,
        resolution: float,
        probability: float,
        confidence: float,
        progress: Progress | None,
        *,
        thorough: bool,
    ) -> None:
        self._batch, self._resolution, self._probability = batch, resolution, probability
        self._required, self.assured = required_successes(batch.draws, probability, confidence)
        jitter, draws = (np.random.SeedSequence(batch.seed, spawn_key=(key,)) for key in (1, 2))
        self._random = np.random.default_rng(jitter)
        several, self._thorough = batch.draws > 1, thorough
        self._scan_seeds = derived_seeds(draws, SEARCH_DRAWS) if several and thorough else batch.seeds
        self._points = max(2, min(REFINED_POINTS, BATCH // batch.draws)) if thorough else 1
        points = SCAN_POINTS if thorough else BISECTION_POINTS
        self._grid = [0.0, *self._between(0.0, top, points - 2, 0.25), top]
        narrowing = math.log(max(1.0, 1.5 * top / points / resolution)) / math.log((self._points + 1) / 1.2)
        self._alone = plausible_successes(self._required, batch.draws, ALONE, RISK)
        batches = (4 if thorough else 3) + several + self._alone + max(1, math.ceil(narrowing))
        self._count = StepCount(progress, batches * batch.task.steps)
        self._scan: list[Trial] = []
        self._trials: dict[float, Trial] = {}

    def run(self) -> None:
        """Scans, and subdivides the gap above the payload down to the resolution, with all checks on the way."""
        batch = self._batch
        rows = [(payload, seed) for payload in self._grid for seed in self._scan_seeds]
        order = secret_order(len(rows))
        verdicts = batch.run(rows, count=self._count, order=order)
        self._scanned = rows, verdicts, order
        self._scan = self._trials_of(self._grid, self._scan_seeds, verdicts)
        if batch.draws == 1 or not self._thorough:
            self._trials = {trial.payload: trial for trial in self._scan}
        again_count = SCAN_POINTS if self._thorough and not batch.policy.declarations.stochastic else 0
        chosen = self._random.permutation(len(rows))[:again_count].tolist()
        dense_rows: list[Row] = []
        while True:
            payloads = [payload for payload in self._next() if payload not in self._trials]
            below, _ = self.gap()
            check = self._thorough and not dense_rows and below is not None and below.payload > 0
            if check and below is not None:
                seeds = batch.seeds if batch.draws > 1 else batch.seeds * SCAN_POINTS
                drawn = self._random.uniform(0.0, below.payload, len(seeds)).tolist()
                dense_rows = list(zip(drawn, seeds, strict=True))
            groups = [
                [(payload, seed) for payload in payloads for seed in batch.seeds],
                dense_rows if check else [],
                [rows[index] for index in chosen],
            ]
            if not any(groups):
                return
            found = iter(batch.run([row for group in groups for row in group], count=self._count))
            tried, dense, again = ([next(found) for _ in group] for group in groups)
            self._trials |= {trial.payload: trial for trial in self._trials_of(payloads, batch.seeds, tried)}
            self._add_dense(groups[1], dense)
            self._check_repetition([verdicts[index] for index in chosen], again)
            chosen = []

    def gap(self) -> tuple[Trial | None, Trial | None]:
        """The trial of the first payload that too few draws carry, and the trial below it.

        Returns:
            (below, above); None where there is none.
        """
        below = None
        for payload in sorted(self._trials):
            if self._trials[payload].carried < self._required:
                return below, self._trials[payload]
            below = self._trials[payload]
        return below, None

    def feasible(self, below: Trial | None) -> tuple[tuple[float, float], ...]:
        """Intervals of carried payloads on the grid of the scan [kg]. The first one ends at the payload."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self._scan_carried(), [False]]).astype(int)))
        found = [(self._grid[low], self._grid[high - 1]) for low, high in edges.reshape(-1, 2)]
        return (*([] if below is None else [(0.0, below.payload)]), *(pair for pair in found if pair[0] > 0))

    def success(self) -> tuple[tuple[float, float], ...]:
        """Pairs of payload [kg] and fraction of the draws of the scan that carry it; empty with one draw."""
        several = self._batch.draws > 1
        return tuple((one.payload, one.carried / len(one.verdicts)) for one in self._scan) if several else ()

    def discretisation(self, below: Trial | None, above: Trial | None) -> float | None:
        """Largest deviation of the payload with finer physics steps from the payload [kg]; None if it is not checked:
        with several draws, and by bisection."""
        if self._batch.draws > 1 or not self._thorough:
            return None
        if below is None:
            return 0.0
        payload, top = below.payload, self._grid[-1]
        step = above.payload - payload if above else self._resolution
        offsets = (step * 4.0 ** np.arange(7)).tolist()
        around = {payload, *(payload - offset for offset in offsets), *(payload + offset for offset in offsets)}
        tried = sorted(one for one in around if 0 <= one <= top)
        rows = [(one, self._batch.seeds[0]) for one in tried]
        carried = [verdict.carried for verdict in self._batch.run(rows, count=self._count, refinement=FINER)]
        failed = carried.index(False) if False in carried else len(carried)
        low, high = tried[failed - 1] if failed else 0.0, tried[failed] if failed < len(tried) else tried[-1]
        return max(0.0, high - payload if low > payload else payload - low)

    def record(self, below: Trial | None, above: Trial | None) -> tuple[Rollout, Trial | None, Trial | None]:
        """Repeats an episode of each trial, alone, and records the one at the payload, or the unloaded one that fails.

        With several draws, fresh ones have to carry the payload first, and only one episode is repeated.

        Returns:
            The recorded episode and the trials. With one draw, they have the verdicts of the repeated episodes, which
            do not depend on the order of the batches.

        Raises:
            PolicyError: if a repeated episode differs, or if too few fresh draws carry the payload.
        """
        batch, trials = self._batch, [trial for trial in (below, above) if trial is not None]
        draws = [(trial, trial.violation_draw or 0) for trial in trials]
        if below is not None and batch.draws > 1:
            draws = [(below, [verdict.carried for verdict in below.verdicts].index(True))]
            batch.check_alone(below.payload, self._required, self._count)
        self._count.expected = min(self._count.expected, self._count.done + len(draws) * batch.task.steps)
        recorder = Recorder([0])
        rows = [(trial.payload, trial.seeds[draw]) for trial, draw in draws]
        others = [batch.run([row], count=self._count)[0] for row in rows[1:]]
        verdicts = batch.run(rows[:1], observer=recorder, count=self._count) + others
        rollout = recorder.rollouts(verdicts)[0]
        if batch.policy.declarations.stochastic:
            return rollout, below, above
        self._check_repetition([trial.verdicts[draw] for trial, draw in draws], verdicts)
        if batch.draws == 1:
            again = [replace(trial, verdicts=(verdict,)) for trial, verdict in zip(trials, verdicts, strict=True)]
            below, above = (None, *again) if below is None else (*again, None)[:2]
        return rollout, below, above

    def _next(self) -> list[float]:
        """Payloads to try next; none when the gap is narrow enough."""
        below, above = self.gap()
        if below is not None and above is not None:
            low, high = below.payload, above.payload
            if high - low <= self._resolution:
                return []
            inner = self._between(low, high, math.ceil(min(self._points, 1.2 * (high - low) / self._resolution)), 0.1)
            fewer = below.carried - above.carried
            if self._batch.draws > 1 and 0 < fewer < self._batch.draws / 8:  # nearly linear: around the interpolation
                half = max(0.4 * self._resolution, 0.1 * (high - low))
                place = low + (high - low) * (below.carried - self._required + 0.5) / fewer
                place = min(max(place, low + 1.5 * half), high - 1.5 * half)
                inner = [place - half, place + half]
            return [payload for payload in inner if low < payload < high]
        if above is not None:  # no carried payload yet
            lower = [payload for payload in self._grid if payload < above.payload]
            return list(dict.fromkeys([*lower[:1], *lower[-1:]]))
        if below is not None:  # no failed payload yet
            return [payload for payload in self._grid if payload > below.payload][: self._points]
        # Several draws: the confirmation starts where the payloads of the scan begin to fail.
        failed = next((index for index, carried in enumerate(self._scan_carried()) if not carried), len(self._grid) - 1)
        return [self._grid[max(0, failed - 1)], self._grid[max(1, failed)]]

    def _scan_carried(self) -> list[bool]:
        needed = max(1, math.ceil(len(self._scan_seeds) * self._probability - 1e-9))
        return [trial.carried >= needed for trial in self._scan]

    def _between(self, low: float, high: float, count: int, jitter: float) -> list[float]:
        """Equidistant payloads between two others, each moved by up to the fraction ``jitter`` of the distance."""
        places = (1 + np.arange(count) + self._random.uniform(-jitter, jitter, count)) / (count + 1)
        return [float(payload) for payload in low + (high - low) * places]

    def _trials_of(self, payloads: Sequence[float], seeds: Sequence[int], verdicts: _Verdicts) -> list[Trial]:
        draws = len(seeds)
        return [
            Trial(payload=payload, verdicts=tuple(verdicts[i * draws : (i + 1) * draws]), seeds=tuple(seeds))
            for i, payload in enumerate(payloads)
        ]

    def _add_dense(self, rows: Sequence[Row], verdicts: _Verdicts) -> None:
        """Adds the first payload of the dense check up to which too many episodes fail.

        These are more than the required number of draws allows, plus three standard deviations: noise differs between
        payloads.
        """
        failed = sorted((row, index) for index, row in enumerate(rows) if not verdicts[index].carried)
        allowed = self._batch.draws - self._required
        allowed += int(3 * math.sqrt(allowed))
        if len(failed) > allowed:
            (payload, seed), index = failed[allowed]
            self._trials[payload] = Trial(payload=payload, verdicts=(verdicts[index],), seeds=(seed,))

    def _check_repetition(self, first: _Verdicts, again: _Verdicts) -> None:
        """Compares episodes with their repetitions.

        Raises:
            PolicyError: if they differ. Further runs of the scan in its order tell the reason.
        """
        if text := self._difference(first, again):
            rows, scan, order = self._scanned
            further = (self._batch.run(rows, count=self._count, order=order) for _ in range(DIAGNOSES))
            reason = _RANDOM if any(self._difference(scan, one) for one in further) else DEPENDENT
            raise PolicyError(f"policy {self._batch.policy.name!r} {reason.format(text)}")

    def _difference(self, first: _Verdicts, again: _Verdicts) -> str | None:
        """The first difference between episodes and their repetitions as text; None if there is none."""
        scale = 1 / np.array([self._batch.error_bounds.position, self._batch.error_bounds.rotation])
        for pair in zip(first, again, strict=True):
            ends = [verdict.violation and (verdict.violation.kind, verdict.violation.time) for verdict in pair]
            peaks = [np.array([*(scale * [v.position_peak, v.rotation_peak]), *v.peak_action]) for v in pair]
            apart = np.abs(peaks[1] - peaks[0]) > REPEAT_TOLERANCE * np.maximum(1.0, np.abs(peaks[0]))
            if ends[0] != ends[1] or apart.any():
                index = int(apart.argmax())
                name = f"|a| of motor {index - 1}" if index > 1 else f"{('position', 'rotation')[index]} error / bound"
                values = " and then ".join(f"{peak[index]:.6g}" for peak in peaks)
                outcome = " and then ".join(dict.fromkeys(str(verdict.violation or "carried") for verdict in pair))
                return f"at {pair[0].payload:.3f} kg: {outcome}, with a largest {name} of {values}"
        return None


_RANDOM = (
    "is not reproducible: {}. If its actions are random, declare stochastic = True; otherwise reset() must restore "
    "everything that it remembers"
)


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
