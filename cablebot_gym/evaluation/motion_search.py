"""Search for the largest payload that a policy carries along a motion: scan, refine, and check random
payloads below.

A :class:`MotionSearch` asks for episodes and is told their outcomes, so that the searches of many
motions share their batches (:func:`find_brackets`). An episode is carried
(:class:`~cablebot_gym.evaluation.judge.Verdict`), a payload is carried if enough of its draws
are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from cablebot_gym.evaluation.batch import Batch, EpisodeSpec, StepCount, Trial
from cablebot_gym.evaluation.judge import Verdict

SCAN_POINTS = 64
"""Number of payloads in the scan, including both ends."""

SCAN_JITTER = 0.25
"""Largest random shift of a payload of the scan, as a fraction of the distance between payloads."""

REFINED_POINTS = 32
"""Largest number of payloads in a refinement."""

REFINED_JITTER = 0.1
"""Largest random shift of a payload of a refinement, as a fraction of the distance between them."""

_Verdicts = Sequence[Verdict]


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


@dataclass(frozen=True, kw_only=True)
class SearchPlan:
    """How the payload of a motion is searched."""

    points: int
    """Number of payloads in the scan."""
    scan_seeds: tuple[int, ...]
    """Seeds of the draws of the scan."""
    seeds: tuple[int, ...]
    """Seeds of the draws that confirm a payload."""
    required: int
    """Number of these draws that have to carry it."""
    scan_required: int
    """Number of draws of the scan that have to carry a payload."""
    resolution: float
    """Largest gap to the least failed payload [kg]."""
    refined_points: int
    """Largest number of payloads in a refinement."""
    dense_points: int
    """Number of random payloads below the result that one draw tries; several draws try one each. None
    are tried if it is zero."""
    repeated: int = 0
    """Largest number of episodes of the scan that are repeated."""
    weak_first: bool = False
    """Whether draws that have failed are tried before the others. All draws have to carry a payload
    then."""


class MotionSearch:
    """Search for the largest carried payload of one motion: it asks for episodes (:meth:`ask`) and is
    told their outcomes (:meth:`tell`), until it asks for none.

    Args:
        plan: how it is searched.
        payload_max: end of the scan [kg].
        rng: draws payloads and repeated episodes.
        motion: index of the motion among those of the batch.
    """

    def __init__(
        self, plan: SearchPlan, payload_max: float, rng: np.random.Generator, *, motion: int = 0
    ) -> None:
        self.plan = plan
        """How it is searched."""
        self.motion = motion
        """Index of the motion among those of the batch."""
        self.grid = scan_grid(rng, payload_max, plan.points)
        """Payloads of the scan [kg]."""
        self.scan_trials: list[Trial] = []
        """Trials of the scan."""
        self._rng = rng
        self._trials: dict[float, Trial] = {}
        self._weak: dict[int, None] = {}
        self._dense_due = plan.dense_points > 0
        self._repeated: list[int] = []
        # what the last question asked for
        self._payloads = self.grid
        self._seeds = plan.scan_seeds
        self._dense: list[EpisodeSpec] = []
        self._asked_again: list[int] = []

    def ask(self) -> list[EpisodeSpec]:
        """Episodes of the scan, then those of the next refinement and of due checks; none at the
        end."""
        if self.scan_trials:
            self._payloads, self._seeds = self._next_payloads()
            self._dense = self._next_dense()
            self._asked_again = self._repeated
            self._repeated = []
        scanned = self.scan_rows()
        repeated = [scanned[index] for index in self._asked_again]
        return self._rows(self._payloads, self._seeds) + self._dense + repeated

    def tell(self, verdicts: _Verdicts) -> tuple[_Verdicts, _Verdicts]:
        """Takes the outcomes of the episodes that were asked for.

        Returns:
            Outcomes of the episodes of the scan that are repeated: before, and now.
        """
        outcomes = iter(verdicts)
        trials = []
        for payload in self._payloads:
            drawn = tuple(islice(outcomes, len(self._seeds)))
            trials.append(Trial(payload=payload, verdicts=drawn, seeds=self._seeds))
        if not self.scan_trials:
            self._end_scan(trials)
            return [], []
        self.store(trials)
        self._add_dense(list(islice(outcomes, len(self._dense))))
        scanned = self.scan_verdicts
        return [scanned[index] for index in self._asked_again], list(outcomes)

    @property
    def scan_verdicts(self) -> list[Verdict]:
        """Outcomes of the episodes of the scan."""
        return [verdict for trial in self.scan_trials for verdict in trial.verdicts]

    def scan_rows(self) -> list[EpisodeSpec]:
        """Episodes of the scan."""
        return self._rows(self.grid, self.plan.scan_seeds)

    def store(self, trials: Sequence[Trial]) -> None:
        """Stores trials, by their payloads."""
        for trial in trials:
            self._trials[trial.payload] = trial
            for seed, verdict in zip(trial.seeds, trial.verdicts, strict=True):
                if not verdict.carried:
                    self._weak[seed] = None

    def bracket(self) -> tuple[Trial | None, Trial | None]:
        """The trials on both sides of the first failure: the largest carried payload below it and
        the least failed one; None for a side without a trial."""
        below = None
        for payload in sorted(self._trials):
            trial = self._trials[payload]
            required = self.plan.required
            if self.plan.weak_first:  # a trial of some draws is carried by all of them
                required = len(trial.verdicts)
            if trial.carried < required:
                return below, trial
            below = trial
        return below, None

    def scan_carried(self) -> list[bool]:
        """Whether enough draws of the scan carry each payload."""
        return [trial.carried >= self.plan.scan_required for trial in self.scan_trials]

    def _rows(self, payloads: Sequence[float], seeds: Sequence[int]) -> list[EpisodeSpec]:
        return [EpisodeSpec(payload, seed, self.motion) for payload in payloads for seed in seeds]

    def _end_scan(self, trials: list[Trial]) -> None:
        """Keeps the trials of the scan, and chooses the episodes to repeat."""
        self.scan_trials = trials
        if self.plan.scan_seeds == self.plan.seeds:
            self.store(trials)
        # Drawn in every case: the next payloads depend on the state of the generator.
        shuffled = self._rng.permutation(len(self.scan_verdicts))
        self._repeated = shuffled[: self.plan.repeated].tolist()

    def _next_payloads(self) -> tuple[list[float], tuple[int, ...]]:
        """Payloads to try next, and the draws that try them; no payloads when the gap is narrow
        enough."""
        seeds = self.plan.seeds
        below, above = self.bracket()
        payloads: list[float] = []
        if below is not None and above is not None:
            payloads = self._inside(below, above)
            if self.plan.weak_first and self._weak:
                if payloads:
                    seeds = tuple(self._weak)
                elif len(below.verdicts) < len(seeds):  # all draws have to carry the result
                    return [below.payload], seeds
        elif above is not None:  # no carried payload yet: try zero and the nearest payload below
            lower = [payload for payload in self.grid if payload < above.payload]
            payloads = sorted({*lower[:1], *lower[-1:]})
        elif below is not None:  # no failed payload yet
            higher = [payload for payload in self.grid if payload > below.payload]
            payloads = higher[: self.plan.refined_points]
        else:
            # No payload has been tried in the draws of the confirmation. It starts on both sides of
            # the first failure in the scan, or at the end of the scan.
            carried = self.scan_carried()
            carried[-1] = False
            upper = max(1, carried.index(False))
            payloads = [self.grid[upper - 1], self.grid[upper]]
        return [payload for payload in payloads if payload not in self._trials], seeds

    def _inside(self, below: Trial, above: Trial) -> list[float]:
        """Payloads that subdivide a gap; none if it is narrow enough."""
        low = below.payload
        high = above.payload
        gap = high - low
        if gap <= self.plan.resolution:
            return []
        points = min(
            self.plan.refined_points, (1 + 2 * REFINED_JITTER) * gap / self.plan.resolution
        )
        payloads = _between(self._rng, low, high, math.ceil(points), REFINED_JITTER)
        draws = len(self.plan.seeds)
        lost_draws = below.carried - above.carried
        if draws > 1 and not self.plan.weak_first and 0 < lost_draws < draws / 8:
            # The number of carried draws is nearly linear in such a gap: try both sides of the
            # interpolated payload.
            half_width = max(0.4 * self.plan.resolution, 0.1 * gap)
            margin = 1.5 * half_width
            center = low + gap * (below.carried - self.plan.required + 0.5) / lost_draws
            center = min(max(center, low + margin), high - margin)
            payloads = [center - half_width, center + half_width]
        # In a gap near the resolution, a payload can fall on an end.
        return [payload for payload in payloads if low < payload < high]

    def _next_dense(self) -> list[EpisodeSpec]:
        """Episodes of the dense check, once, as soon as a payload is carried."""
        below, _ = self.bracket()
        if not self._dense_due or below is None or below.payload == 0:
            return []
        self._dense_due = False
        seeds = self.plan.seeds
        if len(seeds) > 1:
            fractions = self._rng.uniform(size=len(seeds))
        else:  # one in each of equal parts leaves no wide gap
            count = self.plan.dense_points
            seeds = seeds * count
            fractions = (np.arange(count) + self._rng.uniform(size=count)) / count
        payloads = (fractions * below.payload).tolist()
        return [
            EpisodeSpec(payload, seed, self.motion)
            for payload, seed in zip(payloads, seeds, strict=True)
        ]

    def _add_dense(self, verdicts: _Verdicts) -> None:
        """Adds a failed trial if too many episodes of the dense check fail.

        Too many are more than the required number of draws allows plus three standard deviations,
        because noise differs between payloads. The trial has the payload at which the number of
        failures, counted from zero, exceeds this.
        """
        failed = []
        for row, verdict in zip(self._dense, verdicts, strict=True):
            if not verdict.carried:
                failed.append((row, verdict))
        failed.sort(key=lambda failure: failure[0])
        allowed = len(self.plan.seeds) - self.plan.required
        allowed += int(3 * math.sqrt(allowed))
        if len(failed) > allowed:
            row, verdict = failed[allowed]
            self.store([Trial(payload=row.payload, verdicts=(verdict,), seeds=(row.seed,))])


RepetitionCheck = Callable[[_Verdicts, _Verdicts], None]
"""Compares outcomes of episodes with those of their repetitions. It raises an error if they differ."""


def find_brackets(
    batch: Batch,
    searches: Sequence[MotionSearch],
    *,
    count: StepCount | None = None,
    check: RepetitionCheck | None = None,
) -> None:
    """Runs the searches of motions to their ends. They share their batches.

    Args:
        batch: runs the episodes.
        searches: the searches.
        count: counts the control steps.
        check: compares repeated episodes.
    """
    while True:
        questions = [search.ask() for search in searches]
        rows = [row for question in questions for row in question]
        if not rows:
            return
        verdicts = batch.run(rows, count=count)
        start = 0
        for search, question in zip(searches, questions, strict=True):
            if question:
                end = start + len(question)
                before, now = search.tell(verdicts[start:end])
                start = end
                if check is not None:
                    check(before, now)
