"""Search for the DLCC, in four steps: scan, refine, audit, confirm.

What is random follows from the seed of the conditions, which an isolated policy does not know: grid
and refined payloads, payloads of the dense check, repeated episodes and those beside them, and the
seeds of all draws.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cablebot_gym.evaluation.batch import (
    BATCH,
    DEPENDENT,
    STOCHASTIC_ALONE,
    Batch,
    EpisodeSpec,
    StepCount,
    Trial,
    derived_seeds,
    fresh_sequence,
)
from cablebot_gym.evaluation.judge import Verdict
from cablebot_gym.evaluation.motion_search import (
    REFINED_POINTS,
    SCAN_POINTS,
    MotionSearch,
    SearchPlan,
    find_brackets,
)
from cablebot_gym.evaluation.repetition import first_difference
from cablebot_gym.evaluation.rollout import Recorder, Rollout
from cablebot_gym.evaluation.statistics import required_successes
from cablebot_gym.policies import PolicyError
from cablebot_gym.utils.console import Progress

REPEATED_EPISODES = SCAN_POINTS
"""Largest number of episodes of the scan that are repeated."""

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

BATCHES = 8
"""Usual number of batches, for the progress only."""

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
    """Outcome of a search. ``feasible`` and ``discretisation`` are fields of
    :class:`~cablebot_gym.evaluation.result.Details`, ``assured`` and ``rollout`` of
    :class:`~cablebot_gym.evaluation.result.DLCCResult`."""

    below: Trial | None
    """Trial of the payload; None if the policy fails unloaded."""
    above: Trial | None
    """Trial of the least failed payload above; None if there is none."""
    feasible: _Pairs
    """Intervals of carried payloads on the grid of the scan [kg]."""
    discretisation: float | None
    assured: bool
    rollout: Rollout


class Search:
    """Search for the DLCC: the payload of one motion, with audits that confirm it.

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
        self._is_scan = is_scan
        self._is_drawn = batch.draws > 1
        self._required, self._assured = required_successes(batch.draws, probability, confidence)
        seed = batch.conditions.seed
        self._rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,)))
        scan_seeds = batch.seeds
        points = BISECTION_POINTS
        refined_points = 1
        repeated = 0
        if is_scan:
            points = SCAN_POINTS
            refined_points = max(2, min(REFINED_POINTS, BATCH // batch.draws))
            if self._is_drawn:
                scan_sequence = np.random.SeedSequence(seed, spawn_key=(2,))
                scan_seeds = derived_seeds(scan_sequence, SEARCH_DRAWS)
            if not batch.policy.declarations.stochastic:
                repeated = REPEATED_EPISODES
        plan = SearchPlan(
            points=points,
            scan_seeds=tuple(scan_seeds),
            seeds=tuple(batch.seeds),
            required=self._required,
            # the product may be rounded up
            scan_required=max(1, math.ceil(len(scan_seeds) * probability - 1e-9)),
            resolution=resolution,
            refined_points=refined_points,
            dense_points=SCAN_POINTS if is_scan else 0,
            repeated=repeated,
        )
        self._motion = MotionSearch(plan, payload_max, self._rng)
        self._grid = self._motion.grid
        batches = BATCHES
        if self._is_drawn:
            batches += batch.alone
        self._count = StepCount(progress, batches * batch.task.steps)

    def run(self) -> SearchOutcome:
        """Scans, refines, audits and confirms. A refinement and an audit share a batch.

        Raises:
            PolicyError: if a repeated episode differs, or if too few fresh draws carry the payload.
        """
        find_brackets(self._batch, [self._motion], count=self._count, check=self._check_repetition)
        below, above = self._motion.bracket()
        discretisation = None
        if self._is_scan and not self._is_drawn:
            discretisation = self._discretisation(below, above)
        if below is not None and self._is_drawn:
            batch = self._batch
            seeds = derived_seeds(fresh_sequence(batch.conditions.seed), batch.alone)
            rows = _rows([below.payload], seeds)
            batch.check_alone(rows, self._required, batch.draws, self._count)
            if not batch.policy.declarations.stochastic:
                self._repeat_draws(below)
        rollout, below, above = self._record(below, above)
        return SearchOutcome(
            below=below,
            above=above,
            feasible=self._feasible(below),
            discretisation=discretisation,
            assured=self._assured,
            rollout=rollout,
        )

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

    def _feasible(self, below: Trial | None) -> _Pairs:
        """Intervals of carried payloads on the grid of the scan [kg]. The one that contains zero ends
        at the payload; without a payload it is left out."""
        padded = np.concatenate([[False], self._motion.scan_carried(), [False]])
        edges = np.flatnonzero(np.diff(padded.astype(int)))
        intervals = []
        if below is not None:
            intervals.append((0.0, below.payload))
        for start, end in edges.reshape(-1, 2):
            if start > 0:  # the interval that contains zero is the refined one above
                intervals.append((self._grid[start], self._grid[end - 1]))
        return tuple(intervals)

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
            verdicts = self._batch.run(self._motion.scan_rows(), count=self._count)
            if first_difference(self._motion.scan_verdicts, verdicts, bounds) is not None:
                reason = _NOT_REPRODUCIBLE
                break
        raise PolicyError(f"policy {self._batch.policy.name!r} {reason.format(difference)}")


def _rows(payloads: Sequence[float], seeds: Sequence[int]) -> list[EpisodeSpec]:
    return [EpisodeSpec(payload, seed) for payload in payloads for seed in seeds]
