"""Search for the largest payload that a policy carries, in four steps: scan, refine, audit,
confirm.

An episode is carried (:class:`~cablebot_gym.evaluation.constraints.Verdict`), a payload is carried
if enough of its draws are (``Search._bracket``). What is random follows from the seed of the
conditions, which an isolated policy does not know: grid and refined payloads, payloads of the dense
check, repeated episodes and those beside them, and the seeds of all draws.
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
    STOCHASTIC_ALONE,
    Batch,
    EpisodeSpec,
    Progress,
    StepCount,
    Trial,
    derived_seeds,
    fresh_sequence,
)
from cablebot_gym.evaluation.constraints import Verdict
from cablebot_gym.evaluation.repetition import first_difference
from cablebot_gym.evaluation.rollout import Recorder, Rollout
from cablebot_gym.evaluation.statistics import fewest_draws, plausible_successes, required_successes
from cablebot_gym.policies import PolicyError

SCAN_POINTS = 64
"""Number of payloads in the scan, including both ends."""

SCAN_JITTER = 0.25
"""Largest random shift of a payload of the scan, as a fraction of the distance between payloads."""

DENSE_POINTS = SCAN_POINTS
"""Number of random payloads in the dense check with one draw. With several draws, each draw tries
one."""

REPEATED_EPISODES = SCAN_POINTS
"""Largest number of episodes of the scan that are repeated."""

REFINED_POINTS = 32
"""Largest number of payloads in a refinement."""

REFINED_JITTER = 0.1
"""Largest random shift of a payload of a refinement, as a fraction of the distance between them."""

BISECTION_POINTS = 5
"""Number of payloads that a bisection tries first, including both ends."""

SEARCH_DRAWS = 16
"""Number of draws of each payload of a scan under uncertainty. The payload is confirmed with other
draws. A bisection has the draws of the confirmation only."""

REPEATED_DRAWS = STOCHASTIC_ALONE
"""Largest number of draws of the payload that are repeated among other payloads and draws."""

DIAGNOSES = 3
"""Largest number of further runs of the scan that look for randomness after a repeated episode
differs."""

FINER = 10
"""Factor of the number of physics steps in the episodes that measure the discretisation error."""

_NOT_REPRODUCIBLE = (
    "is not reproducible: {}. If its actions are random, declare stochastic = True; otherwise reset() must restore "
    "everything that it remembers"
)

_Verdicts = Sequence[Verdict]
_Pairs = tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchOutcome:
    """Outcome of a search. ``feasible``, ``success`` and ``discretisation`` are fields of
    :class:`~cablebot_gym.evaluation.result.Details`, ``assured`` and ``rollout`` of
    :class:`~cablebot_gym.evaluation.result.DLCCResult`."""

    below: Trial | None
    """Trial of the payload; None if the policy fails unloaded."""
    above: Trial | None
    """Trial of the least failed payload above; None if there is none."""
    feasible: _Pairs
    """Intervals of carried payloads on the grid of the scan [kg]."""
    success: _Pairs
    """Payload [kg] and fraction of the draws that carry it, for each payload of the scan; empty for
    one draw."""
    discretisation: float | None
    assured: bool
    rollout: Rollout


def scan_grid(rng: np.random.Generator, end: float, points: int) -> list[float]:
    """Payloads of a scan from zero to its end [kg]; those in between are moved at random."""
    return [0.0, *_between(rng, 0.0, end, points - 2, SCAN_JITTER), end]


def _between(
    rng: np.random.Generator, low: float, high: float, count: int, jitter: float
) -> list[float]:
    """Equidistant payloads between two others, each moved by up to the fraction ``jitter`` of the
    distance."""
    fractions = (1 + np.arange(count) + rng.uniform(-jitter, jitter, count)) / (count + 1)
    payloads: list[float] = (low + (high - low) * fractions).tolist()
    return payloads


class Search:
    """Search for the largest carried payload.

    Args:
        batch: runs the episodes.
        payload_max: end of the scan [kg].
        resolution: largest gap to the least failed payload [kg].
        probability: required success probability.
        confidence: confidence of the payload.
        progress: callback after every control step.
        is_scan: whether to scan; a bisection otherwise, which has no dense check, no repetitions of
            the scan and no discretisation check.
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
        is_scan: bool,
    ) -> None:
        self._batch = batch
        self._resolution = resolution
        self._probability = probability
        self._confidence = confidence
        self._is_scan = is_scan
        self._is_drawn = batch.draws > 1
        self._required, self._assured = required_successes(batch.draws, probability, confidence)
        seed = batch.conditions.seed
        payload_sequence = np.random.SeedSequence(seed, spawn_key=(1,))
        self._rng = np.random.default_rng(payload_sequence)
        scan_sequence = np.random.SeedSequence(seed, spawn_key=(2,))
        self._scan_seeds = batch.seeds
        if is_scan:
            scan_points = SCAN_POINTS
            self._refined_points = max(2, min(REFINED_POINTS, BATCH // batch.draws))
            if self._is_drawn:
                self._scan_seeds = derived_seeds(scan_sequence, SEARCH_DRAWS)
        else:
            scan_points = BISECTION_POINTS
            self._refined_points = 1
        self._grid = scan_grid(self._rng, payload_max, scan_points)
        # Estimated number of batches, for the progress only. Shifted payloads are at most
        # 1 + 2 · jitter distances apart.
        scan_gap = (1 + 2 * SCAN_JITTER) * payload_max / scan_points
        narrowing = (self._refined_points + 1) / (1 + 2 * REFINED_JITTER)
        refinements = math.log(max(1.0, scan_gap / resolution)) / math.log(narrowing)
        batches = 3 + max(1, math.ceil(refinements))
        if is_scan:
            batches += 1
        if self._is_drawn and batch.policy.declarations.stochastic:
            batches += 1 + STOCHASTIC_ALONE
        elif self._is_drawn:
            batches += 2 + plausible_successes(self._required, batch.draws, ALONE, RISK)
        self._count = StepCount(progress, batches * batch.task.steps)
        self._trials: dict[float, Trial] = {}

    def run(self) -> SearchOutcome:
        """Scans, refines, audits and confirms. A refinement and an audit share a batch.

        Raises:
            PolicyError: if a repeated episode differs, or if too few fresh draws carry the payload.
        """
        self._scan()
        while True:
            payloads = self._next_payloads()
            dense_rows, repeated = self._due_checks()
            refined_rows = _rows(payloads, self._batch.seeds)
            repeated_rows = [self._scan_rows[index] for index in repeated]
            rows = refined_rows + dense_rows + repeated_rows
            if not rows:
                return self._confirm()
            verdicts = self._batch.run(rows, count=self._count)
            dense_start = len(refined_rows)
            repeated_start = dense_start + len(dense_rows)
            refined = _trials(payloads, self._batch.seeds, verdicts[:dense_start])
            self._store(refined)
            self._add_dense(dense_rows, verdicts[dense_start:repeated_start])
            scan_verdicts = [self._scan_verdicts[index] for index in repeated]
            self._check_repetition(scan_verdicts, verdicts[repeated_start:])

    def _scan(self) -> None:
        """Tries the payloads of the grid, and chooses the episodes to repeat."""
        self._scan_rows = _rows(self._grid, self._scan_seeds)
        self._scan_verdicts = self._batch.run(self._scan_rows, count=self._count)
        self._scan_trials = _trials(self._grid, self._scan_seeds, self._scan_verdicts)
        has_other_draws = self._is_scan and self._is_drawn
        if not has_other_draws:  # the scan has the draws of the confirmation
            self._store(self._scan_trials)
        self._dense_due = self._is_scan
        # Drawn in every case: the next payloads depend on the state of the generator.
        shuffled = self._rng.permutation(len(self._scan_rows))
        self._repeated: list[int] = []
        if self._is_scan and not self._batch.policy.declarations.stochastic:
            self._repeated = shuffled[:REPEATED_EPISODES].tolist()

    def _next_payloads(self) -> list[float]:
        """Payloads to try next; none when the gap is narrow enough."""
        below, above = self._bracket()
        if below is not None and above is not None:
            payloads = self._inside(below, above)
        elif above is not None:  # no carried payload yet: try zero and the nearest payload below
            lower = [payload for payload in self._grid if payload < above.payload]
            payloads = sorted({*lower[:1], *lower[-1:]})
        elif below is not None:  # no failed payload yet
            higher = [payload for payload in self._grid if payload > below.payload]
            payloads = higher[: self._refined_points]
        else:
            # No payload has been tried in the draws of the confirmation. It starts on both sides of
            # the first failure in the scan, or at the end of the scan.
            carried = self._scan_carried()
            carried[-1] = False
            upper = max(1, carried.index(False))
            payloads = [self._grid[upper - 1], self._grid[upper]]
        return [payload for payload in payloads if payload not in self._trials]

    def _due_checks(self) -> tuple[list[EpisodeSpec], list[int]]:
        """Checks to run with the next refinement, each once: episodes of the dense check, as soon as
        a payload is carried, and indices of the episodes of the scan to repeat."""
        repeated = self._repeated
        self._repeated = []
        below, _ = self._bracket()
        if not self._dense_due or below is None or below.payload == 0:
            return [], repeated
        self._dense_due = False
        seeds = self._batch.seeds
        if not self._is_drawn:
            seeds = seeds * DENSE_POINTS
        payloads = self._rng.uniform(0.0, below.payload, len(seeds)).tolist()
        return list(map(EpisodeSpec, payloads, seeds)), repeated

    def _confirm(self) -> SearchOutcome:
        """Checks the discretisation, or tries fresh draws, and records the episode at the
        payload."""
        below, above = self._bracket()
        discretisation = None
        if self._is_scan and not self._is_drawn:
            discretisation = self._discretisation(below, above)
        if below is not None and self._is_drawn:
            if self._batch.policy.declarations.stochastic:
                below, above = self._confirm_alone()
            else:
                self._batch.check_alone(below.payload, self._required, self._count)
                self._repeat_draws(below)
        rollout, below, above = self._record(below, above)
        success = []
        if self._is_drawn:
            for trial in self._scan_trials:
                success.append((trial.payload, trial.carried / len(trial.verdicts)))
        return SearchOutcome(
            below=below,
            above=above,
            feasible=self._feasible(below),
            success=tuple(success),
            discretisation=discretisation,
            assured=self._assured,
            rollout=rollout,
        )

    def _confirm_alone(self) -> tuple[Trial | None, Trial | None]:
        """Tries the payload of a stochastic policy in draws alone, which have to assure it without
        the draws that it has carried together.

        A payload that they do not assure counts as failed. The next lower one that has been tried
        follows, or, if there is none, the next lower one of the scan.

        Returns:
            The trials of the payload and of the least failed one above.

        Raises:
            PolicyError: if the draws do not even assure zero payload.
        """
        draws = max(STOCHASTIC_ALONE, fewest_draws(self._probability, self._confidence))
        required, _ = required_successes(draws, self._probability, self._confidence)
        while True:
            below, above = self._bracket()
            if below is None and (above is None or above.payload == 0):
                return below, above
            if below is None:
                assert above is not None
                lower = [max(payload for payload in self._grid if payload < above.payload)]
                verdicts = self._batch.run(_rows(lower, self._batch.seeds), count=self._count)
                self._store(_trials(lower, self._batch.seeds, verdicts))
                continue
            alone = self._batch.try_alone(below.payload, draws, required, self._count)
            if alone.carried >= required:
                return below, above
            if below.payload == 0:
                raise self._batch.dependent(alone, below.carried)
            failed = [verdict.carried for verdict in alone.verdicts].index(False)
            verdict = alone.verdicts[failed]
            seed = alone.seeds[failed]
            self._store([replace(alone, verdicts=(verdict,), seeds=(seed,))])

    def _store(self, trials: Sequence[Trial]) -> None:
        for trial in trials:
            self._trials[trial.payload] = trial

    def _repeat_draws(self, trial: Trial) -> None:
        """Repeats draws of a payload among other payloads and draws, in another order.

        Raises:
            PolicyError: if they differ.
        """
        draws = self._rng.permutation(self._batch.draws)[:REPEATED_DRAWS].tolist()
        repeated = [EpisodeSpec(trial.payload, trial.seeds[draw]) for draw in draws]
        payloads = self._rng.uniform(0.0, self._grid[-1], len(draws)).tolist()
        seeds = derived_seeds(fresh_sequence(self._batch.conditions.seed), len(draws))
        others = list(map(EpisodeSpec, payloads, seeds))
        verdicts = self._batch.run(repeated + others, count=self._count)
        before = [trial.verdicts[draw] for draw in draws]
        self._check_repetition(before, verdicts[: len(repeated)])

    def _bracket(self) -> tuple[Trial | None, Trial | None]:
        """The trials on both sides of the first failure: the largest carried payload below it and
        the least failed one; None for a side without a trial."""
        below = None
        for payload in sorted(self._trials):
            trial = self._trials[payload]
            if trial.carried < self._required:
                return below, trial
            below = trial
        return below, None

    def _inside(self, below: Trial, above: Trial) -> list[float]:
        """Payloads that subdivide a gap; none if it is narrow enough."""
        low = below.payload
        high = above.payload
        gap = high - low
        if gap <= self._resolution:
            return []
        points = min(self._refined_points, (1 + 2 * REFINED_JITTER) * gap / self._resolution)
        payloads = _between(self._rng, low, high, math.ceil(points), REFINED_JITTER)
        lost_draws = below.carried - above.carried
        if self._is_drawn and 0 < lost_draws < self._batch.draws / 8:
            # The number of carried draws is nearly linear in such a gap: try both sides of the
            # interpolated payload.
            half_width = max(0.4 * self._resolution, 0.1 * gap)
            margin = 1.5 * half_width
            center = low + gap * (below.carried - self._required + 0.5) / lost_draws
            center = min(max(center, low + margin), high - margin)
            payloads = [center - half_width, center + half_width]
        # In a gap near the resolution, a payload can fall on an end.
        return [payload for payload in payloads if low < payload < high]

    def _scan_carried(self) -> list[bool]:
        """Whether enough draws of the scan carry each payload."""
        # the product may be rounded up
        required = max(1, math.ceil(len(self._scan_seeds) * self._probability - 1e-9))
        return [trial.carried >= required for trial in self._scan_trials]

    def _feasible(self, below: Trial | None) -> _Pairs:
        """Intervals of carried payloads on the grid of the scan [kg]. The one that contains zero ends
        at the payload; without a payload it is left out."""
        padded = np.concatenate([[False], self._scan_carried(), [False]])
        edges = np.flatnonzero(np.diff(padded.astype(int)))
        intervals = []
        if below is not None:
            intervals.append((0.0, below.payload))
        for start, end in edges.reshape(-1, 2):
            if start > 0:  # the interval that contains zero is the refined one above
                intervals.append((self._grid[start], self._grid[end - 1]))
        return tuple(intervals)

    def _add_dense(self, rows: list[EpisodeSpec], verdicts: _Verdicts) -> None:
        """Adds a failed trial if too many episodes of the dense check fail.

        Too many are more than the required number of draws allows plus three standard deviations,
        because noise differs between payloads. The trial has the payload at which the number of
        failures, counted from zero, exceeds this.
        """
        failed = []
        for row, verdict in zip(rows, verdicts, strict=True):
            if not verdict.carried:
                failed.append((row, verdict))
        failed.sort(key=lambda failure: failure[0])
        allowed = self._batch.draws - self._required
        allowed += int(3 * math.sqrt(allowed))
        if len(failed) > allowed:
            row, verdict = failed[allowed]
            self._store([Trial(payload=row.payload, verdicts=(verdict,), seeds=(row.seed,))])

    def _discretisation(self, below: Trial | None, above: Trial | None) -> float:
        """Upper bound of the change of the payload under finer physics steps [kg]."""
        if below is None:
            return 0.0
        payload = below.payload
        spacing = self._resolution
        if above is not None:
            spacing = above.payload - payload
        # Growing distances: small changes are resolved, large ones are still found.
        offsets = spacing * 4.0 ** np.arange(7)
        candidates = np.concatenate([[payload], payload - offsets, payload + offsets])
        is_within = (candidates >= 0) & (candidates <= self._grid[-1])
        payloads = np.unique(candidates[is_within]).tolist()
        rows = _rows(payloads, self._batch.seeds)
        verdicts = self._batch.run(rows, count=self._count, refinement=FINER)
        carried = [verdict.carried for verdict in verdicts]
        largest_carried = least_failed = payloads[-1]
        if not all(carried):
            index = carried.index(False)
            least_failed = payloads[index]
            largest_carried = 0.0
            if index > 0:
                largest_carried = payloads[index - 1]
        if largest_carried > payload:
            return least_failed - payload
        return payload - largest_carried

    def _record(
        self, below: Trial | None, above: Trial | None
    ) -> tuple[Rollout, Trial | None, Trial | None]:
        """Repeats an episode of each trial, alone, and records the one at the payload, or the
        unloaded one that fails.

        With several draws, only one episode is repeated.

        Returns:
            The recorded episode and the trials. With one draw, they have the verdicts of the
            repeated episodes, which do not depend on the order of the batches.
        """
        batch = self._batch
        if below is not None and self._is_drawn:
            first_carried = [verdict.carried for verdict in below.verdicts].index(True)
            repeats = [(below, first_carried)]
        else:
            # A trial of one draw that is carried has no violation.
            repeats = []
            for trial in (below, above):
                if trial is not None:
                    repeats.append((trial, trial.violation_draw or 0))
        # The rest of the work is known now: the progress ends at 100 %.
        remaining = len(repeats) * batch.task.steps
        self._count.expected = min(self._count.expected, self._count.done + remaining)
        rows = []
        before = []
        for trial, draw in repeats:
            rows.append(EpisodeSpec(trial.payload, trial.seeds[draw]))
            before.append(trial.verdicts[draw])
        recorder = Recorder([0])
        # The recorded episode runs last: Batch.fallbacks counts those of the last batch.
        unrecorded = []
        for row in rows[1:]:
            unrecorded += batch.run([row], count=self._count)
        verdicts = batch.run(rows[:1], observer=recorder, count=self._count) + unrecorded
        rollout = recorder.rollouts(verdicts)[0]
        if batch.policy.declarations.stochastic:
            return rollout, below, above
        self._check_repetition(before, verdicts)
        if not self._is_drawn:
            if below is not None:
                below = replace(below, verdicts=(verdicts[0],))
            if above is not None:
                above = replace(above, verdicts=(verdicts[-1],))
        return rollout, below, above

    def _check_repetition(self, first: _Verdicts, repeated: _Verdicts) -> None:
        """Compares episodes with their repetitions.

        Raises:
            PolicyError: if they differ. Further runs of the scan tell the reason.
        """
        bounds = self._batch.conditions.bounds
        difference = first_difference(first, repeated, bounds)
        if difference is None:
            return
        reason = DEPENDENT
        for _ in range(DIAGNOSES):
            verdicts = self._batch.run(self._scan_rows, count=self._count)
            if first_difference(self._scan_verdicts, verdicts, bounds) is not None:
                reason = _NOT_REPRODUCIBLE
                break
        raise PolicyError(f"policy {self._batch.policy.name!r} {reason.format(difference)}")


def _rows(payloads: Sequence[float], seeds: Sequence[int]) -> list[EpisodeSpec]:
    return [EpisodeSpec(payload, seed) for payload in payloads for seed in seeds]


def _trials(payloads: Sequence[float], seeds: Sequence[int], verdicts: _Verdicts) -> list[Trial]:
    draws = len(seeds)
    trials = []
    for index, payload in enumerate(payloads):
        start = index * draws
        drawn = tuple(verdicts[start : start + draws])
        trials.append(Trial(payload=payload, verdicts=drawn, seeds=tuple(seeds)))
    return trials
