"""Survey: the payloads that a policy carries on many motions, on robots that are not exactly known.

Each motion meets its own random robots, and its payload is the largest one that all of them carry.
A further random robot is the weakest of all with a probability of 1 / (robots + 1), so it carries
this payload with a probability of at least ``robots / (robots + 1)``: 95 % with :data:`ROBOTS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.evaluation.batch import (
    DEPENDENT,
    STOCHASTIC_ALONE,
    Batch,
    Progress,
    Row,
    StepCount,
    Trial,
    derived_seeds,
    draw_seeds,
    secret_order,
)
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.constraints import Verdict, Violation
from cablebot_gym.evaluation.evaluator import default_payload_max
from cablebot_gym.evaluation.repetition import closest_to, first_difference
from cablebot_gym.evaluation.search import SCAN_POINTS, scan_grid
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import PolicyError, Wrapper
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.checks import number, whole
from cablebot_gym.utils.console import chosen_progress

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


@dataclass(frozen=True, kw_only=True, eq=False)
class SurveyResult:
    """The payloads of a policy over several motions."""

    policy: str
    """Name of the policy."""
    conditions: Conditions
    """Conditions of all episodes, without the motion."""
    robots: int
    """Number of random robots of each motion."""
    resolutions: tuple[float, ...]
    """Largest accepted gap to the least failed payload of each motion [kg]."""
    motions: tuple[MotionPayload, ...]
    """Payloads in the order of the motions."""
    stochastic: bool
    """Whether the policy declares random actions."""
    isolated: bool
    """Whether the policy ran in a process of its own."""

    @property
    def payloads(self) -> Array:
        """Payloads of the motions [kg], (motions,); 0 where a robot fails unloaded."""
        return np.array([motion.payload or 0.0 for motion in self.motions])


def survey(
    policy: Any,
    env_id: str,
    motions: Sequence[Trajectory],
    *,
    robots: int | None = None,
    resolution: float | None = None,
    name: str | None = None,
    wrappers: Sequence[Wrapper] = (),
    progress: Progress | bool | None = None,
    **conditions: Any,
) -> SurveyResult:
    """Finds the payload of every motion. All motions share their batches.

    A scan with few robots finds where each motion fails first. The gap below is halved with all
    robots until it is narrow enough. Each robot then tries one random payload below the result.

    Args:
        policy: as for :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc`.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        motions: reference motions.
        robots: number of random robots of each motion; None for :data:`ROBOTS` under a random
            uncertainty, and 1 otherwise.
        resolution: gap to the least failed payload as a fraction of the end of the scan; None for
            :data:`RESOLUTION` with several robots, else :data:`NOMINAL_RESOLUTION`.
        name: name of the policy in the result; None for its own name.
        wrappers: wrappers of the training of the policy.
        progress: callback after every control step; True shows a bar on standard error.
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
    checked = Conditions.of(env_id, **conditions)
    batch = Batch(policy, checked, name=name, wrappers=wrappers, motions=motions)
    if robots is None:
        robots = ROBOTS if checked.uncertainty.random else 1
    robots = whole("robots", robots, least=1)
    if robots > 1 and not batch.random:
        raise ValueError(
            f"all {robots} robots would be equal: choose a random uncertainty or robots=1"
        )
    if resolution is None:
        resolution = NOMINAL_RESOLUTION if robots == 1 else RESOLUTION
    resolution = number("resolution", resolution, above=0, below=1)
    with chosen_progress(progress, f"{batch.policy.name} on {env_id}, motions") as on_step:
        search = _Search(batch, robots, resolution, on_step)
        payloads = search.run()
    return SurveyResult(
        policy=batch.policy.name,
        conditions=checked,
        robots=robots,
        resolutions=search.resolutions,
        motions=payloads,
        stochastic=batch.policy.declarations.stochastic,
        isolated=batch.policy.isolated,
    )


def motion_seeds(seed: int, count: int) -> list[int]:
    """Evaluation seed of each motion. :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc` with
    this seed, and with as many draws as there are robots, meets the same robots.

    Args:
        seed: evaluation seed of the survey.
        count: number of motions. The seeds of the first motions do not depend on it.
    """
    return derived_seeds(np.random.SeedSequence(seed, spawn_key=(3,)), count)


class _Search:
    """Search for the payloads of all motions of a batch."""

    def __init__(
        self, batch: Batch, robots: int, resolution: float, progress: Progress | None
    ) -> None:
        self._batch = batch
        self._robots = robots
        self._resolution = resolution
        conditions = batch.conditions
        self._ends = np.array(
            [
                default_payload_max(conditions.robot, task.trajectory, conditions.error_bounds)
                for task in batch.tasks
            ]
        )
        self._seeds = [
            draw_seeds(seed, robots) for seed in motion_seeds(conditions.seed, len(self._ends))
        ]
        self._rng = np.random.default_rng(np.random.SeedSequence(conditions.seed, spawn_key=(4,)))
        points = SCAN_POINTS if robots == 1 else SCAN_POINTS_OF_ROBOTS
        self._grid = np.array([scan_grid(self._rng, end, points) for end in self._ends.tolist()])
        halvings = np.ceil(np.log2(1 / (points * resolution)))
        batches = 6 + int(halvings) + points * min(robots, SCAN_ROBOTS) / robots
        self._count = StepCount(progress, int(batches) * max(task.steps for task in batch.tasks))
        self._below: list[Trial | None] = [None] * len(self._ends)
        self._above: list[Trial | None] = [None] * len(self._ends)
        # Robots that have failed. The others are met at the first payload and at the last one only.
        self._weak: list[list[int]] = [[] for _ in self._ends]
        self._has_met_all = np.zeros(len(self._ends), np.bool_)

    @property
    def resolutions(self) -> tuple[float, ...]:
        """Largest accepted gap to the least failed payload of each motion [kg]."""
        return tuple((self._resolution * self._ends).tolist())

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
            MotionPayload(below=below, above=above)
            for below, above in zip(self._below, self._above, strict=True)
        )

    def _scan(self) -> None:
        """Finds the first failure of a few robots of each motion."""
        scan_robots = range(min(self._robots, SCAN_ROBOTS))
        rows = []
        for motion, grid in enumerate(self._grid):
            rows += self._rows(motion, grid.tolist(), scan_robots)
        verdicts = iter(self._batch.run(rows, count=self._count))
        for motion, grid in enumerate(self._grid):
            for payload in grid.tolist():
                trial = self._trial(motion, payload, scan_robots, verdicts)
                if self._above[motion] is None and trial.carried < len(scan_robots):
                    self._fail(motion, trial, scan_robots)

    def _narrow(self) -> None:
        """Halves the gaps until they are narrow enough.

        Each motion meets all of its robots first, then only those that have failed, and at the end
        all again.
        """
        drops = np.zeros(len(self._ends), np.int64)
        while True:
            candidates = {}
            for motion in range(len(self._ends)):
                payload = self._candidate(motion, int(drops[motion]))
                if payload is not None:
                    candidates[motion] = payload
            if not candidates:
                return
            for motion, trial in self._trials(candidates).items():
                if trial.carried == len(trial.verdicts):
                    self._below[motion] = trial
                elif self._below[motion] is None:
                    drops[motion] = 2 * drops[motion] + 1

    def _candidate(self, motion: int, drop: int) -> float | None:
        """Next payload of a motion; None if its gap is narrow enough and all robots carry its
        payload.

        Without a carried payload, it is one of the scan: the largest one below the least failed
        one, or one that is ``drop`` places lower.
        """
        below, above = self._below[motion], self._above[motion]
        grid = self._grid[motion]
        if below is None:
            if above is None:
                return float(grid[-1])
            if above.payload == 0:
                return None
            lower = np.flatnonzero(grid < above.payload)
            return float(grid[max(0, lower[-1] - drop)])
        gap = 0.0
        if above is not None:
            gap = above.payload - below.payload
        if gap > self._resolution * self._ends[motion]:
            return below.payload + gap / 2
        if len(below.verdicts) < self._robots:
            return below.payload
        return None

    def _trials(self, payloads: dict[int, float]) -> dict[int, Trial]:
        """Tries a payload of each motion: with all robots if it has not met them yet, or if those
        that have failed before carry it already; else with those."""
        robots: dict[int, Sequence[int]] = {}
        rows = []
        for motion, payload in payloads.items():
            below = self._below[motion]
            is_last = below is not None and below.payload == payload
            robots[motion] = self._weak[motion]
            if is_last or not self._has_met_all[motion]:
                robots[motion] = range(self._robots)
                self._has_met_all[motion] = True
            rows += self._rows(motion, [payload], robots[motion])
        verdicts = iter(self._batch.run(rows, count=self._count))
        trials = {}
        for motion, payload in payloads.items():
            trial = self._trial(motion, payload, robots[motion], verdicts)
            trials[motion] = trial
            if trial.carried < len(trial.verdicts):
                self._fail(motion, trial, robots[motion])
        return trials

    def _fail(self, motion: int, trial: Trial, robots: Sequence[int]) -> None:
        """Stores a failed trial and the robots that failed."""
        self._above[motion] = trial
        below = self._below[motion]
        if below is not None and below.payload >= trial.payload:
            self._below[motion] = None
        for robot, verdict in zip(robots, trial.verdicts, strict=True):
            if not verdict.carried and robot not in self._weak[motion]:
                self._weak[motion].append(robot)

    def _rows(self, motion: int, payloads: Sequence[float], robots: Sequence[int]) -> list[Row]:
        """An episode of each payload with each robot."""
        seeds = self._seeds[motion]
        return [Row(payload, seeds[robot], motion) for payload in payloads for robot in robots]

    def _trial(
        self, motion: int, payload: float, robots: Sequence[int], verdicts: Iterator[Verdict]
    ) -> Trial:
        """The trial of robots with their next verdicts."""
        return Trial(
            payload=payload,
            verdicts=tuple(islice(verdicts, len(robots))),
            seeds=tuple(self._seeds[motion][robot] for robot in robots),
        )

    def _try_below(self) -> None:
        """Every robot tries one random payload below the payload of its motion. The least failed
        one bounds the motion's payload from above."""
        rows = []
        for motion, below in enumerate(self._below):
            if below is not None and below.payload > 0:
                payloads = self._rng.uniform(0.0, below.payload, self._robots).tolist()
                for robot, payload in enumerate(payloads):
                    rows += self._rows(motion, [payload], [robot])
        if not rows:
            return
        verdicts = self._batch.run(rows, count=self._count)
        robots = {seed: robot for seeds in self._seeds for robot, seed in enumerate(seeds)}
        failed = [
            (row, verdict)
            for row, verdict in zip(rows, verdicts, strict=True)
            if not verdict.carried
        ]
        failed.sort(key=lambda failure: -failure[0].payload)  # the least one comes last
        for row, verdict in failed:
            failing = [robots[row.seed]]
            trial = self._trial(row.motion, row.payload, failing, iter([verdict]))
            self._fail(row.motion, trial, failing)

    def _carried_episodes(self) -> tuple[list[Row], list[Verdict]]:
        """All episodes of the robots with the payloads of their motions."""
        rows: list[Row] = []
        verdicts: list[Verdict] = []
        for motion, below in enumerate(self._below):
            if below is not None:
                rows += [Row(below.payload, seed, motion) for seed in below.seeds]
                verdicts += below.verdicts
        return rows, verdicts

    def _repeated_episodes(self) -> list[int]:
        """Indices of the carried episodes that are repeated: at most one half are the robots that
        came closest to the next violation of their motion, the others are random.

        These robots bound the payloads. A policy that helped them only, by what it sees of other
        robots, would gain the most with the fewest episodes that differ.
        """
        closest = []
        count = 0
        for below, above in zip(self._below, self._above, strict=True):
            if below is None:
                continue
            kind = "position"
            if above is not None and above.violation is not None:
                kind = above.violation.kind
            closest.append(count + closest_to(kind, below.verdicts))
            count += len(below.verdicts)
        order = [closest[index] for index in secret_order(len(closest))[: REPEATED // 2]]
        order += secret_order(count).tolist()
        return list(dict.fromkeys(order))[:REPEATED]

    def _repeat(self) -> None:
        """Repeats carried episodes: in a batch of their own for a policy of this project, else each
        alone.

        Raises:
            PolicyError: if they differ.
        """
        rows, verdicts = self._carried_episodes()
        if not rows:
            return
        chosen = self._repeated_episodes()
        repeated = [rows[index] for index in chosen]
        if self._batch.policy.shipped:
            repetitions = self._batch.run(repeated, count=self._count)
        else:
            repetitions = [self._batch.run([row], count=self._count)[0] for row in repeated]
        bounds = self._batch.conditions.error_bounds
        difference = first_difference([verdicts[index] for index in chosen], repetitions, bounds)
        if difference is not None:
            raise PolicyError(f"policy {self._batch.policy.name!r} {DEPENDENT.format(difference)}")

    def _confirm_alone(self) -> None:
        """Tries fresh robots with the payloads of random motions, each alone. They all have to
        carry them; otherwise all payloads are reduced.

        Raises:
            PolicyError: if unloaded robots fail.
        """
        rng = np.random.default_rng()
        while True:
            carrying = [motion for motion, below in enumerate(self._below) if below is not None]
            if not carrying or self._are_carried_alone(rng.choice(carrying, STOCHASTIC_ALONE)):
                return
            self._reduce(carrying)

    def _reduce(self, motions: Sequence[int]) -> None:
        """Reduces the payloads of motions until all robots carry them again."""
        reduced = {motion: self._reduced(motion) for motion in motions}
        while reduced:
            failed = {}
            self._has_met_all[list(reduced)] = False
            for motion, trial in self._trials(reduced).items():
                if trial.carried < self._robots and trial.payload > 0:
                    self._below[motion] = trial
                    failed[motion] = self._reduced(motion)
                elif trial.carried == self._robots:
                    self._above[motion] = self._below[motion]
                    self._below[motion] = trial
            reduced = failed

    def _reduced(self, motion: int) -> float:
        """Next lower payload of a motion: lower by a factor, or zero if it is small."""
        below = self._below[motion]
        assert below is not None
        payload = RETREAT * below.payload
        if payload < self._resolution * self._ends[motion]:
            return 0.0
        return payload

    def _are_carried_alone(self, motions: NDArray[np.int64]) -> bool:
        """Whether fresh robots carry the payloads of motions, each alone in its batch."""
        seeds = derived_seeds(np.random.SeedSequence(), len(motions))
        for motion, seed in zip(motions.tolist(), seeds, strict=True):
            below = self._below[motion]
            assert below is not None
            (verdict,) = self._batch.run([Row(below.payload, seed, motion)], count=self._count)
            if not verdict.carried:
                if below.payload == 0:
                    raise PolicyError(
                        f"policy {self._batch.policy.name!r} "
                        + DEPENDENT.format("unloaded robots fail alone and not together")
                    )
                return False
        return True
