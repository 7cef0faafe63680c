"""Search for the largest payload that a policy carries, in four steps: scan, refine, audit,
confirm.

An episode is carried (:class:`~cablebot_gym.evaluation.constraints.Verdict`), a payload is carried
if enough of its draws are (:meth:`Search._gap`). What is random follows from the seed of the
conditions: grid and refined payloads, payloads of the dense check, repeated episodes, seeds of the
draws. The order of a batch and the seeds of draws that are tried alone come from the operating
system: no policy can foresee them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

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
from cablebot_gym.evaluation.rollout import Recorder, Rollout
from cablebot_gym.evaluation.statistics import plausible_successes, required_successes
from cablebot_gym.policies import PolicyError

SCAN_POINTS = 64
"""Number of payloads in the scan, including both ends, and in the dense check below the payload."""

REFINED_POINTS = 32
"""Largest number of payloads in a refinement."""

BISECTION_POINTS = 5
"""Number of payloads that a bisection tries first, including both ends."""

SEARCH_DRAWS = 16
"""Number of draws of each payload of the scan, if there are several. The confirmation has other
draws."""

REPEAT_TOLERANCE = 1e-6
"""Largest difference of the peaks of an episode and of its repetition, as a fraction of the bound.
Products of matrices round differently in batches of another order."""

DIAGNOSES = 3
"""Largest number of further runs of the scan that look for randomness after a repeated episode
differs."""

FINER = 10
"""Factor of the number of physics steps in the episodes that measure the discretisation error."""

_RANDOM = (
    "is not reproducible: {}. If its actions are random, declare stochastic = True; otherwise reset() must restore "
    "everything that it remembers"
)

_Verdicts = Sequence[Verdict]
_Intervals = tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchOutcome:
    """What a search tells; see the fields of the same names of
    :class:`~cablebot_gym.evaluation.result.DLCCResult`."""

    below: Trial | None
    """Trial of the payload; None if the policy fails unloaded."""
    above: Trial | None
    """Trial of the least failed payload above; None if there is none."""
    feasible: _Intervals
    success: _Intervals
    discretisation: float | None
    assured: bool
    rollout: Rollout


class Search:
    """Search for the largest carried payload.

    Args:
        batch: runs the episodes.
        payload_max: end of the scan [kg].
        resolution: largest gap to the least failed payload [kg].
        probability: required success probability.
        confidence: confidence of the payload.
        progress: callback after every control step.
        thorough: whether to scan; otherwise a bisection, with few checks.
    """

    def __init__(
        self,
        batch: Batch,
        payload_max: float,
        resolution: float,
        probability: float,
        confidence: float,
        progress: Progress | None,
        *,
        thorough: bool,
    ) -> None:
        self._batch = batch
        self._resolution = resolution
        self._probability = probability
        self._thorough = thorough
        self._several = batch.draws > 1
        self._required, self._assured = required_successes(batch.draws, probability, confidence)
        jitter, draws = (
            np.random.SeedSequence(batch.conditions.seed, spawn_key=(key,)) for key in (1, 2)
        )
        self._random = np.random.default_rng(jitter)
        self._scan_seeds = batch.seeds
        if thorough:
            points = SCAN_POINTS
            self._points = max(2, min(REFINED_POINTS, BATCH // batch.draws))
            if self._several:
                self._scan_seeds = derived_seeds(draws, SEARCH_DRAWS)
        else:
            points = BISECTION_POINTS
            self._points = 1
        self._grid = [0.0, *self._between(0.0, payload_max, points - 2, 0.25), payload_max]
        narrowing = math.log(max(1.0, 1.5 * payload_max / points / resolution)) / math.log(
            (self._points + 1) / 1.2
        )
        alone = plausible_successes(self._required, batch.draws, ALONE, RISK)
        batches = 3 + thorough + self._several + alone + max(1, math.ceil(narrowing))
        self._count = StepCount(progress, batches * batch.task.steps)
        self._trials: dict[float, Trial] = {}

    def run(self) -> SearchOutcome:
        """Scans, refines, audits and confirms. A refinement and an audit share a batch.

        Raises:
            PolicyError: if a repeated episode differs, or if too few fresh draws carry the payload.
        """
        self._scan()
        while True:
            payloads = self._refine()
            dense_rows, repeated = self._audit()
            refined_rows = _rows(payloads, self._batch.seeds)
            rows = refined_rows + dense_rows + [self._scan_rows[index] for index in repeated]
            if not rows:
                return self._confirm()
            verdicts = self._batch.run(rows, count=self._count)
            dense_start = len(refined_rows)
            repeated_start = dense_start + len(dense_rows)
            refined = _trials(payloads, self._batch.seeds, verdicts[:dense_start])
            self._trials |= {trial.payload: trial for trial in refined}
            self._add_dense(dense_rows, verdicts[dense_start:repeated_start])
            self._check_repetition(
                [self._scan_verdicts[index] for index in repeated], verdicts[repeated_start:]
            )

    def _scan(self) -> None:
        """Tries the payloads of the grid, and chooses the episodes to repeat."""
        self._scan_rows = _rows(self._grid, self._scan_seeds)
        self._scan_order = secret_order(len(self._scan_rows))
        self._scan_verdicts = self._batch.run(
            self._scan_rows, count=self._count, order=self._scan_order
        )
        self._scan_trials = _trials(self._grid, self._scan_seeds, self._scan_verdicts)
        if not (self._thorough and self._several):  # the scan has the draws of the confirmation
            self._trials = {trial.payload: trial for trial in self._scan_trials}
        self._dense_due = self._thorough
        self._repeated: list[int] = self._random.permutation(len(self._scan_rows))[
            :SCAN_POINTS
        ].tolist()
        if not self._thorough or self._batch.policy.declarations.stochastic:
            self._repeated = []

    def _refine(self) -> list[float]:
        """Payloads to try next; none when the gap is narrow enough."""
        below, above = self._gap()
        if below is not None and above is not None:
            payloads = self._inside(below, above)
        elif above is not None:  # no carried payload yet
            lower = [payload for payload in self._grid if payload < above.payload]
            payloads = list(dict.fromkeys([*lower[:1], *lower[-1:]]))
        elif below is not None:  # no failed payload yet
            payloads = [payload for payload in self._grid if payload > below.payload][
                : self._points
            ]
        else:  # several draws: the confirmation starts where the payloads of the scan begin to fail
            failed = [*self._scan_carried()[:-1], False].index(False)
            payloads = [self._grid[max(0, failed - 1)], self._grid[max(1, failed)]]
        return [payload for payload in payloads if payload not in self._trials]

    def _audit(self) -> tuple[list[Row], list[int]]:
        """Episodes of the dense check, once a payload is carried, and indices of those of the scan
        that are repeated.

        Each of them is due once.
        """
        repeated, self._repeated = self._repeated, []
        below, _ = self._gap()
        if not self._dense_due or below is None or below.payload == 0:
            return [], repeated
        self._dense_due = False
        seeds = self._batch.seeds
        if not self._several:
            seeds = seeds * SCAN_POINTS
        payloads = self._random.uniform(0.0, below.payload, len(seeds)).tolist()
        return list(zip(payloads, seeds, strict=True)), repeated

    def _confirm(self) -> SearchOutcome:
        """Checks the discretisation, or tries fresh draws, and records the episode at the
        payload."""
        below, above = self._gap()
        discretisation = None
        if self._thorough and not self._several:
            discretisation = self._discretisation(below, above)
        rollout, below, above = self._record(below, above)
        success: _Intervals = ()
        if self._several:
            success = tuple(
                (trial.payload, trial.carried / len(trial.verdicts)) for trial in self._scan_trials
            )
        return SearchOutcome(
            below=below,
            above=above,
            feasible=self._feasible(below),
            success=success,
            discretisation=discretisation,
            assured=self._assured,
            rollout=rollout,
        )

    def _gap(self) -> tuple[Trial | None, Trial | None]:
        """The trials below and at the first payload that too few draws carry; None where there is
        none."""
        below = None
        for payload in sorted(self._trials):
            trial = self._trials[payload]
            if trial.carried < self._required:
                return below, trial
            below = trial
        return below, None

    def _inside(self, below: Trial, above: Trial) -> list[float]:
        """Payloads that subdivide a gap; none if it is narrow enough."""
        low, high = below.payload, above.payload
        gap = high - low
        if gap <= self._resolution:
            return []
        payloads = self._between(
            low, high, math.ceil(min(self._points, 1.2 * gap / self._resolution)), 0.1
        )
        fewer = below.carried - above.carried
        # nearly linear: around the interpolation
        if self._several and 0 < fewer < self._batch.draws / 8:
            half = max(0.4 * self._resolution, 0.1 * gap)
            place = low + gap * (below.carried - self._required + 0.5) / fewer
            place = min(max(place, low + 1.5 * half), high - 1.5 * half)
            payloads = [place - half, place + half]
        return [payload for payload in payloads if low < payload < high]

    def _between(self, low: float, high: float, count: int, jitter: float) -> list[float]:
        """Equidistant payloads between two others, each moved by up to the fraction ``jitter`` of
        the distance."""
        places = (1 + np.arange(count) + self._random.uniform(-jitter, jitter, count)) / (count + 1)
        return [float(payload) for payload in low + (high - low) * places]

    def _scan_carried(self) -> list[bool]:
        needed = max(1, math.ceil(len(self._scan_seeds) * self._probability - 1e-9))
        return [trial.carried >= needed for trial in self._scan_trials]

    def _feasible(self, below: Trial | None) -> _Intervals:
        """Intervals of carried payloads on the grid of the scan [kg]. The first one ends at the
        payload."""
        edges = np.flatnonzero(
            np.diff(np.concatenate([[False], self._scan_carried(), [False]]).astype(int))
        )
        intervals = [
            (self._grid[low], self._grid[high - 1]) for low, high in edges.reshape(-1, 2) if low > 0
        ]
        if below is not None:
            intervals.insert(0, (0.0, below.payload))
        return tuple(intervals)

    def _add_dense(self, rows: list[Row], verdicts: _Verdicts) -> None:
        """Adds the first payload of the dense check up to which too many episodes fail.

        These are more than the required number of draws allows, plus three standard deviations:
        noise differs between payloads.
        """
        failed = sorted(
            (row, index) for index, row in enumerate(rows) if not verdicts[index].carried
        )
        allowed = self._batch.draws - self._required
        allowed += int(3 * math.sqrt(allowed))
        if len(failed) > allowed:
            (payload, seed), index = failed[allowed]
            self._trials[payload] = Trial(
                payload=payload, verdicts=(verdicts[index],), seeds=(seed,)
            )

    def _discretisation(self, below: Trial | None, above: Trial | None) -> float:
        """Largest deviation of the payload with finer physics steps from the payload [kg]."""
        if below is None:
            return 0.0
        payload, step = below.payload, self._resolution
        if above is not None:
            step = above.payload - payload
        offsets = step * 4.0 ** np.arange(7)
        around = {payload, *(payload - offsets).tolist(), *(payload + offsets).tolist()}
        payloads = sorted(near for near in around if 0 <= near <= self._grid[-1])
        rows = _rows(payloads, self._batch.seeds)
        carried = [
            verdict.carried
            for verdict in self._batch.run(rows, count=self._count, refinement=FINER)
        ]
        failed = [*carried, False].index(False)
        low = [0.0, *payloads][failed]
        high = [*payloads, payloads[-1]][failed]
        if low > payload:
            return high - payload
        return max(0.0, payload - low)

    def _record(
        self, below: Trial | None, above: Trial | None
    ) -> tuple[Rollout, Trial | None, Trial | None]:
        """Repeats an episode of each trial, alone, and records the one at the payload, or the
        unloaded one that fails.

        With several draws, fresh ones have to carry the payload first, and only one episode is
        repeated.

        Returns:
            The recorded episode and the trials. With one draw, they have the verdicts of the
            repeated episodes, which do not depend on the order of the batches.
        """
        batch = self._batch
        draws = [
            (trial, trial.violation_draw or 0) for trial in (below, above) if trial is not None
        ]
        if below is not None and self._several:
            draws = [(below, [verdict.carried for verdict in below.verdicts].index(True))]
            batch.check_alone(below.payload, self._required, self._count)
        self._count.expected = min(
            self._count.expected, self._count.done + len(draws) * batch.task.steps
        )
        recorder = Recorder([0])
        rows = [(trial.payload, trial.seeds[draw]) for trial, draw in draws]
        unrecorded = [batch.run([row], count=self._count)[0] for row in rows[1:]]
        verdicts = batch.run(rows[:1], observer=recorder, count=self._count) + unrecorded
        rollout = recorder.rollouts(verdicts)[0]
        if batch.policy.declarations.stochastic:
            return rollout, below, above
        self._check_repetition([trial.verdicts[draw] for trial, draw in draws], verdicts)
        if not self._several:
            if below is not None:
                below = replace(below, verdicts=(verdicts[0],))
            if above is not None:
                above = replace(above, verdicts=(verdicts[-1],))
        return rollout, below, above

    def _check_repetition(self, first: _Verdicts, repeated: _Verdicts) -> None:
        """Compares episodes with their repetitions.

        Raises:
            PolicyError: if they differ. Further runs of the scan in its order tell the reason.
        """
        difference = self._difference(first, repeated)
        if difference is None:
            return
        reason = DEPENDENT
        for _ in range(DIAGNOSES):
            verdicts = self._batch.run(self._scan_rows, count=self._count, order=self._scan_order)
            if self._difference(self._scan_verdicts, verdicts) is not None:
                reason = _RANDOM
                break
        raise PolicyError(f"policy {self._batch.policy.name!r} {reason.format(difference)}")

    def _difference(self, first: _Verdicts, repeated: _Verdicts) -> str | None:
        """The first difference between episodes and their repetitions as text; None if there is
        none."""
        bounds = self._batch.conditions.error_bounds
        scale = 1 / np.array([bounds.position, bounds.rotation])
        for pair in zip(first, repeated, strict=True):
            ends = [
                verdict.violation and (verdict.violation.kind, verdict.violation.time)
                for verdict in pair
            ]
            peaks = [
                np.array([*(scale * [v.position_peak, v.rotation_peak]), *v.peak_action])
                for v in pair
            ]
            apart = np.abs(peaks[1] - peaks[0]) > REPEAT_TOLERANCE * np.maximum(
                1.0, np.abs(peaks[0])
            )
            if ends[0] != ends[1] or apart.any():
                index = int(apart.argmax())
                name = ("position error / bound", "rotation error / bound")[min(index, 1)]
                if index > 1:
                    name = f"|a| of motor {index - 1}"
                values = " and then ".join(f"{peak[index]:.6g}" for peak in peaks)
                outcome = " and then ".join(
                    dict.fromkeys(str(verdict.violation or "carried") for verdict in pair)
                )
                return f"at {pair[0].payload:.3f} kg: {outcome}, with a largest {name} of {values}"
        return None


def _rows(payloads: Sequence[float], seeds: Sequence[int]) -> list[Row]:
    return [(payload, seed) for payload in payloads for seed in seeds]


def _trials(payloads: Sequence[float], seeds: Sequence[int], verdicts: _Verdicts) -> list[Trial]:
    draws = len(seeds)
    trials = []
    for index, payload in enumerate(payloads):
        drawn = tuple(verdicts[index * draws : (index + 1) * draws])
        trials.append(Trial(payload=payload, verdicts=drawn, seeds=tuple(seeds)))
    return trials
