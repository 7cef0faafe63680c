"""Survey: the payloads that a policy carries on many motions, on robots that are not exactly known.

Each motion meets its own random robots, and its payload is the largest one that all of them carry.
A further random robot is the weakest of all with a probability of 1 / (robots + 1), so it carries
this payload with a probability of at least ``robots / (robots + 1)``: 95 % with :data:`ROBOTS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from cablebot_gym.evaluation.batch import (
    DEPENDENT,
    STOCHASTIC_ALONE,
    Batch,
    EpisodeSpec,
    Trial,
    derived_seeds,
    draw_seeds,
    fresh_sequence,
)
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.constraints import Verdict, Violation
from cablebot_gym.evaluation.evaluator import default_payload_max
from cablebot_gym.evaluation.repetition import first_difference
from cablebot_gym.evaluation.search import SCAN_POINTS, scan_grid
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import PolicyError
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.checks import number, whole
from cablebot_gym.utils.results import Printed

ROBOTS = 19
"""Default number of random robots of each motion."""

SCAN_POINTS_OF_ROBOTS = 16
"""Number of payloads of the scan of each motion with several robots, including both ends. With one
robot it is :data:`~cablebot_gym.evaluation.search.SCAN_POINTS`."""

SCAN_ROBOTS = 3
"""Largest number of robots of each motion in the scan."""

RESOLUTION = 0.002
"""Default gap to the least failed payload under uncertainty, as a fraction of the end of the scan."""

NOMINAL_RESOLUTION = 0.0002
"""Default gap without uncertainty, as a fraction of the end of the scan."""

REPEATED = STOCHASTIC_ALONE
"""Number of carried episodes that are repeated in other company; alone, in a process of its own, for a
policy that is not shipped."""

RETREAT = 0.98
"""Factor of the payloads of a stochastic policy that it does not carry alone."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionPayload:
    """The payload of one motion."""

    below: Trial | None
    """The robots with the largest payload that they all carry; None if one of them fails
    unloaded."""
    above: Trial | None
    """The robots with the least failed payload; None if the scan ended without a failure."""
    seeds: tuple[int, ...]
    """Seed of each robot."""

    @property
    def payload(self) -> float | None:
        """Largest payload that all robots carry [kg]; None if one of them fails unloaded."""
        return None if self.below is None else self.below.payload

    @property
    def failed_payload(self) -> float | None:
        """Least failed payload above [kg]; None if the scan ended without a failure."""
        return None if self.above is None else self.above.payload

    @property
    def violation(self) -> Violation | None:
        """The earliest violation of the most frequent kind at the least failed payload."""
        return None if self.above is None else self.above.violation


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SurveyResult(Printed):
    """The payloads of a policy over several motions."""

    resolutions: tuple[float, ...]
    """Largest accepted gap to the least failed payload of each motion [kg]."""
    motions: tuple[MotionPayload, ...]
    """Payloads in the order of the motions."""
    stochastic: bool
    """Whether the policy declares random actions."""

    @property
    def payloads(self) -> Array:
        """Payloads of the motions [kg], (motions,); 0 where a robot fails unloaded."""
        return np.array([motion.payload or 0.0 for motion in self.motions])

    def __str__(self) -> str:
        return f"{len(self.motions)} motions, {np.mean(self.payloads):.3f} kg on average"


def survey(
    policy: Any,
    env_id: str,
    motions: Sequence[Trajectory],
    *,
    seeds: Sequence[int] | None = None,
    robots: int | None = None,
    resolution: float | None = None,
    name: str | None = None,
    **conditions: Any,
) -> SurveyResult:
    """Finds the payload of every motion. All motions share their batches.

    A scan with few robots finds where each motion fails first. The gap below is halved with all
    robots until it is narrow enough. Each robot then tries one random payload below the result.

    Args:
        policy: as for :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc`.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        motions: reference motions.
        seeds: evaluation seed of each motion; None for :func:`motion_seeds` of ``seed``.
        robots: number of random robots of each motion; None for :data:`ROBOTS` under a random
            uncertainty, and 1 otherwise.
        resolution: gap to the least failed payload as a fraction of the end of the scan; None for
            :data:`RESOLUTION` with several robots, else :data:`NOMINAL_RESOLUTION`.
        name: name of the policy in the result; None for its own name.
        conditions: keywords of :class:`~cablebot_gym.evaluation.conditions.Conditions` but
            ``trajectory`` and ``draws``.

    Raises:
        ValueError: if an argument is invalid.
        cablebot_gym.policies.protocol.PolicyError: if the policy raises, returns anything but
            finite actions, or does not act the same when its episodes are repeated.
    """
    for keyword in ("trajectory", "draws"):
        if keyword in conditions:
            raise ValueError(f"a survey has its own {keyword}: remove it from the keywords")
    if not motions:
        raise ValueError("a survey needs motions: pass at least one")
    checked = Conditions.of(env_id, survey, **conditions)
    batch = Batch(policy, checked, name=name, motions=motions)
    if robots is None:
        robots = ROBOTS if checked.model_error.random else 1
    robots = whole("robots", robots, least=1)
    if seeds is None:
        seeds = motion_seeds(checked.seed, len(motions))
    if robots > 1 and not batch.random:
        raise ValueError(
            f"all {robots} robots would be equal: choose a random uncertainty or robots=1"
        )
    if resolution is None:
        resolution = NOMINAL_RESOLUTION if robots == 1 else RESOLUTION
    resolution = number("resolution", resolution, above=0, below=1)
    search = _Search(batch, list(seeds), robots, resolution)
    payloads = search.run()
    return SurveyResult(
        resolutions=search.resolutions,
        motions=payloads,
        stochastic=batch.policy.declarations.stochastic,
    )


def motion_seeds(seed: int, count: int) -> list[int]:
    """Evaluation seed of each motion. :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc` with
    this seed, and with as many draws as there are robots, meets the same robots.

    Args:
        seed: evaluation seed of the survey.
        count: number of motions. The seeds of the first motions do not depend on it.
    """
    return derived_seeds(np.random.SeedSequence(seed, spawn_key=(3,)), count)


@dataclass(kw_only=True, eq=False)
class _Motion:
    """State of the search for the payload of one motion."""

    index: int
    """Index among the motions of the batch."""
    end: float
    """End of the scan [kg]."""
    seeds: list[int]
    """Seeds of its robots."""
    grid: list[float]
    """Payloads of the scan [kg]."""
    rng: np.random.Generator
    """Draws the payloads below the result. It is the motion's own: the payloads of the other motions
    and their number do not change them."""
    below: Trial | None = None
    """Largest carried payload; None if there is none yet."""
    above: Trial | None = None
    """Least failed payload; None if there is none yet."""
    weak: list[int] = field(default_factory=list)
    """Robots that have failed. The others are met at the first payload and at the last one only."""
    has_met_all: bool = False

    def rows(self, payloads: Sequence[float], robots: Sequence[int]) -> list[EpisodeSpec]:
        """An episode of each payload with each robot."""
        return [
            EpisodeSpec(payload, self.seeds[robot], self.index)
            for payload in payloads
            for robot in robots
        ]

    def trial(self, payload: float, robots: Sequence[int], verdicts: Iterator[Verdict]) -> Trial:
        """The trial of robots with their next verdicts."""
        return Trial(
            payload=payload,
            verdicts=tuple(islice(verdicts, len(robots))),
            seeds=tuple(self.seeds[robot] for robot in robots),
        )

    def fail(self, trial: Trial, robots: Sequence[int]) -> None:
        """Stores a failed trial and the robots that failed."""
        self.above = trial
        if self.below is not None and self.below.payload >= trial.payload:
            self.below = None
        for robot, verdict in zip(robots, trial.verdicts, strict=True):
            if not verdict.carried and robot not in self.weak:
                self.weak.append(robot)

    def candidate(self, resolution: float, drop: int) -> float | None:
        """Next payload; None if the gap is at most ``resolution`` [kg] and all robots carry the
        payload.

        Without a carried payload, it is one of the scan: the largest one below the least failed
        one, or one that is ``drop`` places lower.
        """
        below = self.below
        above = self.above
        if below is None:
            if above is None:
                return self.grid[-1]
            lower = [payload for payload in self.grid if payload < above.payload]
            return lower[max(0, len(lower) - 1 - drop)] if lower else None
        if above is not None and above.payload - below.payload > resolution:
            return below.payload + (above.payload - below.payload) / 2
        if len(below.verdicts) < len(self.seeds):
            return below.payload
        return None


class _Search:
    """Search for the payloads of all motions of a batch."""

    def __init__(self, batch: Batch, seeds: list[int], robots: int, resolution: float) -> None:
        self._batch = batch
        self._robots = robots
        self._resolution = resolution
        conditions = batch.conditions
        self._seeds = seeds
        self._rng = np.random.default_rng(np.random.SeedSequence(seeds, spawn_key=(4,)))
        points = SCAN_POINTS
        if robots > 1:
            points = SCAN_POINTS_OF_ROBOTS
        self._motions: list[_Motion] = []
        for index, (task, seed) in enumerate(zip(batch.tasks, seeds, strict=True)):
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(4,)))
            end = default_payload_max(conditions.nominal_robot, task.trajectory, conditions.bounds)
            motion = _Motion(
                index=index,
                end=end,
                seeds=draw_seeds(seed, robots),
                grid=scan_grid(rng, end, points),
                rng=rng,
            )
            self._motions.append(motion)

    @property
    def resolutions(self) -> tuple[float, ...]:
        """Largest accepted gap to the least failed payload of each motion [kg]."""
        return tuple(self._resolution * motion.end for motion in self._motions)

    def run(self) -> tuple[MotionPayload, ...]:
        """Scans, narrows the gaps, tries random payloads below, and repeats episodes."""
        self._scan()
        self._narrow()
        self._try_below()
        self._narrow()
        if self._batch.policy.declarations.stochastic:
            self._confirm_alone()
        else:
            self._repeat()
        return tuple(
            MotionPayload(below=motion.below, above=motion.above, seeds=tuple(motion.seeds))
            for motion in self._motions
        )

    def _scan(self) -> None:
        """Finds the first failure of a few robots of each motion."""
        robots = range(min(self._robots, SCAN_ROBOTS))
        rows = []
        for motion in self._motions:
            rows += motion.rows(motion.grid, robots)
        verdicts = iter(self._batch.run(rows))
        for motion in self._motions:
            for payload in motion.grid:
                trial = motion.trial(payload, robots, verdicts)
                if motion.above is None and trial.carried < len(robots):
                    motion.fail(trial, robots)

    def _narrow(self) -> None:
        """Halves the gaps until they are narrow enough.

        Each motion meets all of its robots first, then only those that have failed, and at the end
        all again.
        """
        drops = dict.fromkeys(self._motions, 0)
        while True:
            candidates = {}
            for motion, drop in drops.items():
                payload = motion.candidate(self._resolution * motion.end, drop)
                if payload is not None:
                    candidates[motion] = payload
            if not candidates:
                return
            for motion, trial in self._trials(candidates).items():
                if trial.carried == len(trial.verdicts):
                    motion.below = trial
                elif motion.below is None:
                    drops[motion] = 2 * drops[motion] + 1

    def _trials(self, payloads: dict[_Motion, float]) -> dict[_Motion, Trial]:
        """Tries a payload of each motion: with all robots if it has not met them yet, or if those
        that have failed before carry it already; else with those."""
        robots: dict[_Motion, Sequence[int]] = {}
        rows = []
        for motion, payload in payloads.items():
            is_last = motion.below is not None and motion.below.payload == payload
            robots[motion] = motion.weak
            if is_last or not motion.has_met_all:
                robots[motion] = range(self._robots)
                motion.has_met_all = True
            rows += motion.rows([payload], robots[motion])
        verdicts = iter(self._batch.run(rows))
        trials = {}
        for motion, payload in payloads.items():
            trial = motion.trial(payload, robots[motion], verdicts)
            trials[motion] = trial
            if trial.carried < len(trial.verdicts):
                motion.fail(trial, robots[motion])
        return trials

    def _try_below(self) -> None:
        """Every robot tries one random payload below the payload of its motion. The least failed
        one bounds the motion's payload from above."""
        rows = []
        robots = []
        for motion in self._motions:
            if motion.below is not None and motion.below.payload > 0:
                payloads = motion.rng.uniform(0.0, motion.below.payload, self._robots).tolist()
                for robot, payload in enumerate(payloads):
                    rows += motion.rows([payload], [robot])
                    robots.append(robot)
        if not rows:
            return
        verdicts = self._batch.run(rows)
        failed = []
        for row, robot, verdict in zip(rows, robots, verdicts, strict=True):
            if not verdict.carried:
                failed.append((row, robot, verdict))
        failed.sort(key=lambda failure: -failure[0].payload)  # the least one comes last
        for row, robot, verdict in failed:
            motion = self._motions[row.motion]
            trial = motion.trial(row.payload, [robot], iter([verdict]))
            motion.fail(trial, [robot])

    def _repeat(self) -> None:
        """Repeats carried episodes, chosen at random: in a batch of their own for a policy of this project, else each
        alone.

        Raises:
            PolicyError: if they differ.
        """
        rows: list[EpisodeSpec] = []
        verdicts: list[Verdict] = []
        for motion in self._motions:
            if motion.below is not None:
                for seed in motion.below.seeds:
                    rows.append(EpisodeSpec(motion.below.payload, seed, motion.index))
                verdicts += motion.below.verdicts
        chosen = self._rng.permutation(len(rows))[:REPEATED].tolist()
        rows = [rows[index] for index in chosen]
        verdicts = [verdicts[index] for index in chosen]
        if not rows:
            return
        if self._batch.policy.shipped:
            repetitions = self._batch.run(rows)
        else:
            repetitions = [self._batch.run([row])[0] for row in rows]
        bounds = self._batch.conditions.bounds
        difference = first_difference(verdicts, repetitions, bounds)
        if difference is not None:
            raise PolicyError(f"policy {self._batch.policy.name!r} {DEPENDENT.format(difference)}")

    def _confirm_alone(self) -> None:
        """Tries fresh robots with the payloads of random motions, each alone. They all have to
        carry them; otherwise all payloads are reduced.

        Raises:
            PolicyError: if unloaded robots fail.
        """
        while True:
            carrying = [motion for motion in self._motions if motion.below is not None]
            if not carrying:
                return
            chosen = self._rng.integers(len(carrying), size=STOCHASTIC_ALONE)
            if self._are_carried_alone([carrying[index] for index in chosen]):
                return
            self._reduce(carrying)

    def _reduce(self, motions: Sequence[_Motion]) -> None:
        """Reduces the payloads of motions until all robots carry them again."""
        reduced = {motion: self._reduced(motion) for motion in motions}
        while reduced:
            failed = {}
            for motion in reduced:
                motion.has_met_all = False
            for motion, trial in self._trials(reduced).items():
                if trial.carried < self._robots and trial.payload > 0:
                    motion.below = trial
                    failed[motion] = self._reduced(motion)
                elif trial.carried == self._robots:
                    motion.above = motion.below
                    motion.below = trial
            reduced = failed

    def _reduced(self, motion: _Motion) -> float:
        """Next lower payload of a motion: lower by a factor, or zero if it is small."""
        assert motion.below is not None
        payload = RETREAT * motion.below.payload
        if payload < self._resolution * motion.end:
            return 0.0
        return payload

    def _are_carried_alone(self, motions: Sequence[_Motion]) -> bool:
        """Whether fresh robots carry the payloads of motions, each alone in its batch."""
        seeds = derived_seeds(fresh_sequence(self._seeds), len(motions))
        for motion, seed in zip(motions, seeds, strict=True):
            assert motion.below is not None
            row = EpisodeSpec(motion.below.payload, seed, motion.index)
            (verdict,) = self._batch.run([row])
            if verdict.carried:
                continue
            if motion.below.payload == 0:
                reason = DEPENDENT.format("unloaded robots fail alone and not together")
                raise PolicyError(f"policy {self._batch.policy.name!r} {reason}")
            return False
        return True
