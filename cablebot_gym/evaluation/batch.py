"""Batched episodes of one policy. All evaluations, comparisons and recordings run this loop."""

from __future__ import annotations

import hashlib
import platform
from collections import Counter
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, NamedTuple, Protocol

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from cablebot_gym.envs.vector import CableBotVectorEnv
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.judge import Judge, Verdict, Violation
from cablebot_gym.evaluation.statistics import fewest_draws, plausible_successes
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory
from cablebot_gym.policies import LoadedPolicy, PolicyError, Wrapper, load
from cablebot_gym.policies.spec import check_measurement
from cablebot_gym.policies.wrappers import PolicyEnv, run_policy
from cablebot_gym.task import Task, to_jsonable
from cablebot_gym.utils.console import Progress

BATCH = 1024
"""Number of episodes that one batch should have: this many fit into the caches of a core. A batch
of heavy payloads ends as soon as all of them have failed. Threads that share a step pay with larger
batches only."""

DEFAULT_DRAWS = 512
"""Default number of draws at each payload under a random uncertainty, and of repeats of a
stochastic policy."""

ALONE = 12
"""Largest number of fresh draws that try a payload of a reproducible policy alone in their batch.
Each costs the start of an isolated policy."""

STOCHASTIC_ALONE = fewest_draws(0.95, 0.95)
"""Largest number of them for a stochastic policy, whose episodes cannot be compared with
repetitions."""

RISK = 1e-4
"""Risk of :func:`~cablebot_gym.evaluation.statistics.plausible_successes` of these draws."""

DEPENDENT = (
    "depends on the other episodes of its batch, so its rows share a state (pass PolicyFactory(make_policy), which has "
    "one policy for each row): {}"
)
"""End of an error about a policy. Gets the difference that shows it."""


class EpisodeSpec(NamedTuple):
    """One episode."""

    payload: float
    """Nominal payload [kg]."""
    seed: int
    """Seed of the episode."""
    motion: int = 0
    """Index of its motion among those of the batch."""
    noise_seed: int | None = None
    """Seed of its sensor noise and wrench; None for :func:`noise_seed` of seed and payload."""


class Observer(Protocol):
    """Receives the control steps of a batch."""

    def start(self, env: CableBotVectorEnv, observation: Array, info: dict[str, Any]) -> None:
        """Called after the reset, with arrays (N, …)."""

    def step(
        self, observation: Array, reward: Array, info: dict[str, Any], running: NDArray[np.bool_]
    ) -> None:
        """Called after every control step, with arrays (N, …).

        ``running`` marks the episodes that this step belongs to: an episode ends when the
        environment terminates it and, unless the full motion is run, at its first violation.
        """


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Outcome of one payload in all draws."""

    payload: float
    """Nominal payload [kg]."""
    verdicts: tuple[Verdict, ...]
    """One verdict for each draw."""
    seeds: tuple[int, ...]
    """Seed of each draw."""

    @property
    def carried(self) -> int:
        """Number of draws in which the payload was carried."""
        return sum(verdict.carried for verdict in self.verdicts)

    @property
    def failures(self) -> dict[str, int]:
        """Number of failed draws by kind of violation, the most frequent kind first."""
        kinds = Counter(
            verdict.violation.kind for verdict in self.verdicts if verdict.violation is not None
        )
        return {str(kind): count for kind, count in kinds.most_common()}

    @property
    def violation(self) -> Violation | None:
        """The earliest violation of the most frequent kind; None if the payload was carried in
        every draw."""
        draw = self.violation_draw
        return None if draw is None else self.verdicts[draw].violation

    @property
    def violation_draw(self) -> int | None:
        """Index of the draw in which :attr:`violation` occurred, from 0; None without a
        violation."""
        kind = next(iter(self.failures), None)
        times = []
        for draw, verdict in enumerate(self.verdicts):
            violation = verdict.violation
            if violation is not None and violation.kind == kind:
                times.append((violation.time, draw))
        return min(times)[1] if times else None


class StepCount:
    """Counts finished control steps for a progress callback.

    Args:
        progress: the callback; None for none.
        expected: expected number of control steps.
    """

    def __init__(self, progress: Progress | None, expected: int) -> None:
        self._progress = progress
        self.done = 0
        self.expected = expected

    def add(self, steps: int) -> None:
        """Counts further steps and calls the callback."""
        self.done += steps
        if self._progress is not None:
            self._progress(self.done, max(self.expected, self.done))


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that determine the results, for result files."""
    packages = ("cablebot-gym", "gymnasium", "numpy", "numba")
    return {
        "python": platform.python_version(),
        **{package: version(package) for package in packages},
    }


def noise_seed(seed: int, payload: float) -> int:
    """Seed of the sensor noise and the wrench in an episode of an evaluation.

    Payloads share the parameters of a draw and have independent noise. The reset option
    ``noise_seed`` with this value, or ``cablebot rollout`` with the same seed and payload, repeats
    the episode.

    Args:
        seed: seed of the draw.
        payload: nominal payload [kg], which counts in whole milligrams.
    """
    digest = hashlib.blake2b(f"{seed} {payload:.6f}".encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") >> 11


def draw_seeds(seed: int, draws: int) -> list[int]:
    """Seeds that reset the environment for each draw. A single draw uses ``seed`` itself.

    The seeds have 53 bits, so that every JSON parser reads them exactly.
    """
    return [seed] if draws == 1 else derived_seeds(np.random.SeedSequence(seed), draws)


def fresh_sequence(seed: int | Sequence[int]) -> np.random.SeedSequence:
    """Seed sequence of the draws that confirm a payload and belong to no other part of a search."""
    return np.random.SeedSequence(seed, spawn_key=(5,))


def derived_seeds(sequence: np.random.SeedSequence, count: int) -> list[int]:
    """Seeds of 53 bits from a seed sequence."""
    return [int(word) >> 11 for word in sequence.generate_state(count, np.uint64)]


class Batch:
    """Rolls out payloads and draws with one policy in vector environments.

    The judge's task is read once, before the policy is loaded, and the policy receives copies of
    tasks and robot. That protects against mistakes: a policy in this process can change everything,
    one in an :class:`~cablebot_gym.isolation.isolated.IsolatedPolicy` nothing.

    Args:
        policy: a loaded policy, an object with ``predict``, a callable ``observation -> action``, a
            class that makes one of them, or a name as on the command line.
        conditions: conditions of all episodes.
        name: name of the policy; None for its own name.
        wrappers: wrappers of the training of the policy, the innermost first, see
            :data:`~cablebot_gym.policies.wrappers.Wrapper`.
        motions: reference motions of the rows; empty for that of the conditions.

    Raises:
        ValueError: if the policy does not fit the conditions.
    """

    def __init__(
        self,
        policy: Any,
        conditions: Conditions,
        *,
        name: str | None = None,
        wrappers: Sequence[Wrapper] = (),
        motions: Sequence[Trajectory] = (),
    ) -> None:
        self.conditions = conditions
        """Conditions of all episodes."""
        env = self._make(1)
        self.settings = env.settings
        """Settings of the environments."""
        self._motions = tuple(motions)
        self.tasks = tuple(_task(env, motion, conditions.seed) for motion in motions or (None,))
        """Task of each motion. The judge reads its bounds, length and robot."""
        self.task: Task = self.tasks[0]
        """Task of the first motion."""
        robot = deepcopy(conditions.nominal_robot)
        self.policy: LoadedPolicy = load(policy, robot, name=name, wrappers=wrappers)
        """The policy."""
        self._check_policy()
        random = conditions.model_error.random or self.policy.declarations.stochastic
        self.random = random or conditions.further.get("initial_error_range") is not None
        """Whether two episodes with the same payload can differ."""
        default_draws = DEFAULT_DRAWS if random else 1
        self.draws = default_draws if conditions.draws is None else conditions.draws
        """Number of episodes at each payload."""
        if self.draws > 1 and not self.random:
            raise ValueError(
                f"all {self.draws} draws would be equal: choose a random uncertainty or draws=1"
            )
        self.seeds = draw_seeds(conditions.seed, self.draws)
        """Seed of each draw. An environment that is reset with this seed has the parameters of the
        draw."""
        self._last_rows = 1

    def _check_policy(self) -> None:
        """Checks that the policy reads what is measured, and that the criterion applies to it."""
        declared = self.policy.declarations
        name = self.policy.name
        check_measurement(self.policy, self.settings.measurement)
        if self.conditions.criterion == "paper" and not declared.unsaturated_actions:
            raise ValueError(
                f"the paper criterion does not apply to policy {name!r}, because it does not "
                "declare unsaturated_actions = True; use criterion='task'"
            )

    def _make(self, rows: int, **changes: Any) -> CableBotVectorEnv:
        """A vector environment of ``rows`` episodes with changed keywords."""
        conditions = self.conditions
        env = gym.make_vec(
            conditions.env_id,
            num_envs=rows,
            max_episode_steps=None,
            autoreset_mode=AutoresetMode.DISABLED,
            **{**conditions.env_keywords(), **changes},
        ).unwrapped
        assert isinstance(env, CableBotVectorEnv)
        return env

    @property
    def fallbacks(self) -> float | None:
        """Mean number of the policy's fallbacks per episode of the last batch; None if it does not
        count them."""
        count = self.policy.fallbacks
        return None if count is None else count / self._last_rows

    def environment(self) -> dict[str, Any]:
        """Robot, trajectory, control frequency and further settings for results, as JSON-able
        data."""
        separate = ("robot", "trajectory", "payload_known", "model_payload_factor", "error_bounds")
        data: dict[str, Any] = {
            "robot": self.task.robot.to_dict(),
            "trajectory": to_jsonable(self.task.trajectory),
            "control_frequency": self.task.control_frequency,
            "substeps": self.settings.substeps,
            "cable": self.task.cable,
        }
        for name, value in self.conditions.env_keywords().items():
            if name not in separate:
                data[name] = to_jsonable(value)
        return data

    def run(
        self,
        rows: Sequence[EpisodeSpec],
        *,
        observer: Observer | None = None,
        count: StepCount | None = None,
        full_motion: bool = False,
        refinement: int = 1,
    ) -> list[Verdict]:
        """Rolls out episodes.

        Args:
            rows: payload and seed of each episode.
            observer: receives the steps of the rows in their order. A policy whose episodes run
                alone has a single row then.
            count: counts the finished or skipped control steps.
            full_motion: whether to simulate an episode to the end of the motion after a violation.
            refinement: factor of the number of physics steps in a control period.

        Returns:
            One verdict for each row.
        """
        groups = [np.arange(len(rows))]
        if self.policy.alone:
            groups = np.array_split(groups[0], len(rows))
        elif observer is None and len(rows) > 2 * BATCH:
            # a group ends with its longest motion
            steps = [self.tasks[row.motion].steps for row in rows]
            groups = np.array_split(np.argsort(steps, kind="stable"), -(-len(rows) // (2 * BATCH)))
        changes: dict[str, Any] = {}
        if refinement > 1:
            changes["substeps"] = refinement * self.settings.substeps
        verdicts: dict[int, Verdict] = {}
        for indices in groups:
            env = self._make(len(indices), **changes)
            self._last_rows = len(indices)
            judge = Judge(self.conditions.criterion, self.task.robot.cables, len(indices))
            group = [rows[index] for index in indices.tolist()]
            observation, info = self._start(env, judge, group)
            if observer is not None:
                observer.start(env, observation, info)
            run_episodes(
                env,
                self.policy,
                observation,
                judge,
                observer=observer,
                count=count,
                full_motion=full_motion,
            )
            for row, index in enumerate(indices.tolist()):
                verdicts[index] = judge.verdict(row)
        return [verdicts[index] for index in range(len(rows))]

    def _start(
        self, env: CableBotVectorEnv, judge: Judge, rows: Sequence[EpisodeSpec]
    ) -> tuple[Array, dict[str, Any]]:
        """Starts an episode for each row; the last observation and info of the reset."""
        seeds = [row.seed for row in rows]
        noise_seeds = []
        for row in rows:
            if row.noise_seed is None:
                noise_seeds.append(noise_seed(row.seed, row.payload))
            else:
                noise_seeds.append(row.noise_seed)
        options: dict[str, Any] = {
            "payload": np.array([row.payload for row in rows]),
            "noise_seed": noise_seeds,
        }
        if not self._motions:
            observation, info = env.reset(seed=seeds, options=options)
            judge.reset(info, self.task)
            return observation, info
        motion_of_row = np.array([row.motion for row in rows])
        for motion in np.unique(motion_of_row).tolist():
            task = self.tasks[motion]
            mask = motion_of_row == motion
            options["trajectory"] = task.trajectory
            observation, info = env.reset(seed=seeds, options=options)
            judge.reset(info, task, mask)
            # only the first reset starts all episodes
            options["reset_mask"] = motion_of_row > motion
        return observation, info

    @property
    def alone(self) -> int:
        """Largest number of fresh draws that try a payload alone."""
        return STOCHASTIC_ALONE if self.policy.declarations.stochastic else ALONE

    def check_alone(
        self,
        rows: Sequence[EpisodeSpec],
        carried: int,
        draws: int,
        count: StepCount | None = None,
    ) -> None:
        """Tries fresh draws, one batch each, until enough of them are carried. An isolated policy has
        a fresh process for each.

        A policy that averages noise over the rows of a batch carries more there than alone.

        Args:
            rows: the fresh draws, with payloads that were carried together with other episodes.
            carried: number of the other draws that were carried together.
            draws: number of these draws.
            count: counts the control steps.

        Raises:
            PolicyError: if fewer than the plausible number of rows are carried.
        """
        required = plausible_successes(carried, draws, len(rows), RISK)
        alone = 0
        for tried, row in enumerate(rows, 1):
            if alone == required:
                return
            alone += self.run([row], count=count)[0].carried
            if tried - alone > len(rows) - required:
                text = f"up to {max(rows).payload:.3f} kg is carried in {alone} of {tried} draws "
                text += f"alone, in {carried} of {draws} together"
                raise PolicyError(f"policy {self.policy.name!r} {DEPENDENT.format(text)}")


def _task(env: CableBotVectorEnv, motion: Trajectory | None, seed: int) -> Task:
    """A copy of the task of a motion; of that of the environment if it is None."""
    options = None if motion is None else {"trajectory": motion}
    env.reset(seed=seed, options=options)
    task = deepcopy(env.tasks[0])
    task.check_motion()
    return task


def run_episodes(
    env: CableBotVectorEnv,
    policy: LoadedPolicy,
    observation: Array,
    judge: Judge,
    *,
    observer: Observer | None = None,
    count: StepCount | None = None,
    full_motion: bool = False,
) -> None:
    """Runs the episodes of a vector environment that has been reset.

    Args:
        env: the environment.
        policy: the policy, which is reset first.
        observation: observations of the reset, (N, size).
        judge: checks the steps; it has been reset and has the number of control steps of each
            motion.
        observer: receives the steps.
        count: counts the finished or skipped control steps.
        full_motion: whether to simulate an episode to the end of the motion after a violation.

    Raises:
        PolicyError: if the policy raises or returns anything but finite actions.
    """

    def public_tasks() -> tuple[Task, ...]:
        return deepcopy(env.tasks)

    policy.reset(public_tasks)
    count = count or StepCount(None, 0)
    steps = _JudgedSteps(env, policy, observation, judge, observer, count, full_motion=full_motion)
    cables = env.settings.robot.cables
    inside = PolicyEnv(env.layout, cables, observation, steps.advance, public_tasks)
    steps.env_of_policy = inside
    inside.over = bool(steps.over().all())
    try:
        run_policy(policy.policy, inside)
    except PolicyError as error:
        time = steps.made / env.settings.control_frequency
        raise policy.failure(error, judge.payload, time) from error.__cause__
    count.add(max(0, int(judge.motion_steps.max()) - steps.made))


class _JudgedSteps:
    """Control steps of the true environment, each judged. Wrappers of a policy are outside."""

    env_of_policy: PolicyEnv

    def __init__(
        self,
        env: CableBotVectorEnv,
        policy: LoadedPolicy,
        observation: Array,
        judge: Judge,
        observer: Observer | None,
        count: StepCount,
        *,
        full_motion: bool,
    ) -> None:
        self.made = 0
        """Number of control steps that have been made."""
        self._env = env
        self._policy = policy
        self._observation = observation
        self._judge = judge
        self._observer = observer
        self._count = count
        self._full_motion = full_motion
        self._terminated = np.zeros(env.num_envs, np.bool_)

    def over(self) -> NDArray[np.bool_]:
        """Which episodes are over, (N,)."""
        ended = self._judge.failed
        if self._full_motion:
            ended = self._terminated
        return ended | self._judge.finished

    def advance(self, actions: Any) -> Array:
        """Makes a control step with the actions of the policy, and returns the next observations,
        (N, size).

        Raises:
            PolicyError: if the actions are invalid.
        """
        env = self._env
        over = self.over()
        action = self._policy.checked(actions, env.num_envs, env.settings.robot.cables, over)
        observation, reward, ended, _, info = env.step(action)
        self._judge.observe(info, ended)
        if self._observer is not None:
            self._observer.step(observation, reward, info, ~over)
        # a policy keeps the last sensible observation of a terminated episode
        observation[self._terminated] = self._observation[self._terminated]
        self._observation = observation
        self._terminated |= ended
        self.made += 1
        self._count.add(1)
        self.env_of_policy.over = bool(self.over().all())
        return observation
