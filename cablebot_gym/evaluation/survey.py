"""Survey: the payloads that a policy carries on many motions, on robots that are not exactly known.

Each motion meets its own random robots, and its payload is the largest one that all of them carry.
A further random robot is the weakest of all with a probability of 1 / (robots + 1), so it carries
this payload with a probability of at least ``robots / (robots + 1)``: 95 % with :data:`ROBOTS`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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
from cablebot_gym.evaluation.evaluator import default_payload_max
from cablebot_gym.evaluation.judge import Verdict, Violation
from cablebot_gym.evaluation.motion_search import (
    MotionSearch,
    SearchPlan,
    find_brackets,
)
from cablebot_gym.evaluation.repetition import first_difference
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory
from cablebot_gym.policies import PolicyError
from cablebot_gym.utils.checks import number, whole

ROBOTS = 19
"""Default number of random robots of each motion."""

SURVEY_POINTS = 16
"""Number of payloads of the scan of each motion, including both ends."""

SCAN_ROBOTS = 3
"""Largest number of robots of each motion in the scan."""

RESOLUTION = 0.002
"""Default gap to the least failed payload under uncertainty, as a fraction of the end of the scan."""

NOMINAL_RESOLUTION = 0.0002
"""Default gap without uncertainty, as a fraction of the end of the scan."""

NOMINAL_POINTS = 4
"""Number of payloads in a refinement without uncertainty. Few episodes and several rounds suit policies
whose actions take long to compute."""

REPEATED = STOCHASTIC_ALONE
"""Number of carried episodes that are repeated in other company; alone, in a process of its own, for a
policy that is not shipped."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionPayload:
    """The payload of one motion."""

    below: Trial | None
    """The robots with the largest payload that they all carry; None if one of them fails
    unloaded."""
    above: Trial | None
    """The robots with the least failed payload; None if the scan ended without a failure."""
    resolution: float
    """Largest accepted gap between both [kg]."""
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


@dataclass(frozen=True, kw_only=True, eq=False)
class SurveyResult:
    """The payloads of a policy over several motions."""

    motions: tuple[MotionPayload, ...]
    """Payloads in the order of the motions."""
    stochastic: bool
    """Whether the policy declares random actions."""

    @property
    def payloads(self) -> Array:
        """Payloads of the motions [kg], (motions,); 0 where a robot fails unloaded."""
        return np.array([motion.payload or 0.0 for motion in self.motions])


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

    A scan with few robots finds where each motion fails first. The gap below is narrowed with the
    robots that have failed, and in the end all robots carry the result. Each robot also tries one
    random payload below.

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
    searches = _searches(batch, seeds, robots, resolution)
    find_brackets(batch, searches)
    rng = np.random.default_rng(np.random.SeedSequence(seeds, spawn_key=(4,)))
    if batch.policy.declarations.stochastic:
        _check_alone(batch, searches, seeds, rng)
    else:
        _check_repetition(batch, searches, rng)
    payloads = []
    for search in searches:
        below, above = search.bracket()
        plan = search.plan
        payloads.append(
            MotionPayload(below=below, above=above, resolution=plan.resolution, seeds=plan.seeds)
        )
    return SurveyResult(motions=tuple(payloads), stochastic=batch.policy.declarations.stochastic)


def motion_seeds(seed: int, count: int) -> list[int]:
    """Evaluation seed of each motion. :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc` with
    this seed, and with as many draws as there are robots, meets the same robots.

    Args:
        seed: evaluation seed of the survey.
        count: number of motions. The seeds of the first motions do not depend on it.
    """
    return derived_seeds(np.random.SeedSequence(seed, spawn_key=(3,)), count)


def _searches(
    batch: Batch, seeds: Sequence[int], robots: int, resolution: float
) -> list[MotionSearch]:
    """The search of each motion. It does not depend on the other motions."""
    conditions = batch.conditions
    searches = []
    for index, (task, seed) in enumerate(zip(batch.tasks, seeds, strict=True)):
        end = default_payload_max(conditions.nominal_robot, task.trajectory, conditions.bounds)
        robot_seeds = tuple(draw_seeds(seed, robots))
        plan = SearchPlan(
            points=SURVEY_POINTS,
            scan_seeds=robot_seeds[:SCAN_ROBOTS],
            seeds=robot_seeds,
            required=robots,
            scan_required=min(robots, SCAN_ROBOTS),
            resolution=resolution * end,
            refined_points=1 if robots > 1 else NOMINAL_POINTS,
            dense_points=2 * SURVEY_POINTS,
            weak_first=True,
        )
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(4,)))
        searches.append(MotionSearch(plan, end, rng, motion=index))
    return searches


def _carried(searches: Sequence[MotionSearch]) -> list[tuple[MotionSearch, Trial]]:
    """The searches with a carried payload, and its trial."""
    carried = []
    for search in searches:
        below, _ = search.bracket()
        if below is not None:
            carried.append((search, below))
    return carried


def _check_repetition(
    batch: Batch, searches: Sequence[MotionSearch], rng: np.random.Generator
) -> None:
    """Repeats carried episodes, chosen at random: in a batch of their own for a policy of this
    project, else each alone.

    Raises:
        PolicyError: if they differ.
    """
    rows: list[EpisodeSpec] = []
    verdicts: list[Verdict] = []
    for search, trial in _carried(searches):
        for seed in trial.seeds:
            rows.append(EpisodeSpec(trial.payload, seed, search.motion))
        verdicts += trial.verdicts
    chosen = rng.permutation(len(rows))[:REPEATED].tolist()
    rows = [rows[index] for index in chosen]
    verdicts = [verdicts[index] for index in chosen]
    if not rows:
        return
    if batch.policy.shipped:
        repetitions = batch.run(rows)
    else:
        repetitions = [batch.run([row])[0] for row in rows]
    difference = first_difference(verdicts, repetitions, batch.conditions.bounds)
    if difference is not None:
        raise PolicyError(f"policy {batch.policy.name!r} {DEPENDENT.format(difference)}")


def _check_alone(
    batch: Batch,
    searches: Sequence[MotionSearch],
    seeds: Sequence[int],
    rng: np.random.Generator,
) -> None:
    """Tries fresh robots with the payloads, each alone, on all motions in turn and in random order.

    Raises:
        PolicyError: if implausibly few of them carry the payloads.
    """
    carried = _carried(searches)
    if not carried:
        return
    chosen = rng.permutation(np.resize(np.arange(len(carried)), batch.alone))
    rows = []
    for index, seed in zip(chosen, derived_seeds(fresh_sequence(seeds), batch.alone), strict=True):
        search, trial = carried[index]
        rows.append(EpisodeSpec(trial.payload, seed, search.motion))
    robots = sum(len(trial.verdicts) for _, trial in carried)
    # one more robot on each motion may fail
    batch.check_alone(rows, robots, robots + len(carried))
