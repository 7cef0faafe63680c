"""Batched episodes of one policy: payloads × draws. All evaluations, comparisons and recordings run this loop."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs import check_robot, env_robot
from cablebot_gym.envs.vector import CableBotVectorEnv
from cablebot_gym.evaluation.constraints import Judge, Verdict, Violation, find_criterion
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import Policy, as_policy, load_policy, name_of
from cablebot_gym.policies.protocol import checked_actions, reset_policy
from cablebot_gym.robots import find_robot
from cablebot_gym.task import ErrorBounds, Task, find_error_bounds, to_jsonable
from cablebot_gym.uncertainty import find_uncertainty
from cablebot_gym.utils.checks import whole

BATCH = 1024
"""Number of episodes in one batch; at least the draws of one payload. This many episodes fit into the caches of a core.
A batch of heavy payloads ends as soon as all of them have failed."""

DEFAULT_DRAWS = 256
"""Default number of draws at each payload under a random uncertainty."""

Progress = Callable[[int, int], None]
"""Callback after every control step: number of finished steps, expected number of steps."""


class Observer(Protocol):
    """Receives the control steps of the episodes of one payload."""

    def start(self, observation: Array, info: dict[str, Any]) -> None:
        """Called after the reset, with arrays (N, …)."""

    def step(self, observation: Array, reward: Array, info: dict[str, Any], running: NDArray[np.bool_]) -> None:
        """Called after every control step, with arrays (N, …).

        ``running`` marks the episodes that this step belongs to: an episode ends when the environment terminates it
        and, unless the full motion is run, at its first violation.
        """


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """Outcome of one payload in all draws."""

    payload: float
    """Nominal payload [kg]."""
    verdicts: tuple[Verdict, ...]
    """One verdict for each draw."""

    @property
    def carried(self) -> int:
        """Number of draws in which the payload was carried."""
        return sum(verdict.carried for verdict in self.verdicts)

    @property
    def failures(self) -> dict[str, int]:
        """Number of failed draws by kind of violation, the most frequent kind first."""
        kinds = Counter(verdict.violation.kind for verdict in self.verdicts if verdict.violation is not None)
        return {str(kind): count for kind, count in kinds.most_common()}

    @property
    def violation(self) -> Violation | None:
        """The earliest violation of the most frequent kind; None if the payload was carried in every draw."""
        draw = self.violation_draw
        return None if draw is None else self.verdicts[draw].violation

    @property
    def violation_draw(self) -> int | None:
        """Index of the draw in which :attr:`violation` occurred, from 0; None without a violation."""
        kind, violations = next(iter(self.failures), None), [verdict.violation for verdict in self.verdicts]
        times = [(one.time, draw) for draw, one in enumerate(violations) if one is not None and one.kind == kind]
        return min(times)[1] if times else None


class StepCount:
    """Counts finished control steps for a progress callback.

    Args:
        progress: the callback; None for none.
        expected: expected number of control steps.
    """

    def __init__(self, progress: Progress | None, expected: int) -> None:
        self._progress = progress
        self.done, self.expected = 0, expected

    def add(self, steps: int) -> None:
        """Counts further steps and calls the callback."""
        self.done += steps
        if self._progress is not None:
            self._progress(self.done, max(self.expected, self.done))


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that determine the results, for result files."""
    packages = ("cablebot-gym", "gymnasium", "numpy", "numba")
    return {"python": platform.python_version(), **{package: version(package) for package in packages}}


def uncertainty_name(uncertainty: Any) -> str | None:
    """Name of an uncertainty in results: its own name, ``custom`` for data, or None without uncertainty."""
    return uncertainty if isinstance(uncertainty, str | None) else "custom"


def draw_seeds(seed: int, draws: int) -> list[int]:
    """Seeds that reset the environment for each draw. A single draw uses ``seed`` itself.

    The seeds have 53 bits, so that every JSON parser reads them exactly.
    """
    if draws == 1:
        return [seed]
    words = np.random.SeedSequence(seed).generate_state(draws, np.uint64)
    return [int(word) >> 11 for word in words]


class Batch:
    """Rolls out payloads × draws with one policy in one vector environment.

    Args:
        policy: an object with ``predict``, a callable ``observation -> action``, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        name: name of the policy; None for its own name.
        criterion: ``task`` or ``paper``.
        error_bounds: bounds of the tracking errors; None for the default.
        uncertainty: model errors and disturbances that the policy does not know.
        draws: number of episodes at each payload; None for the default.
        seed: seed that alone determines the draws.
        max_payloads: largest number of payloads in one batch.
        keywords: keywords of the environment.

    Raises:
        ValueError: if an argument is invalid, or if the ``paper`` criterion is used for a policy that does not declare
            ``unsaturated_actions``.
    """

    def __init__(
        self,
        policy: Any,
        env_id: str,
        *,
        name: str | None = None,
        criterion: str = "task",
        error_bounds: ErrorBounds | dict[str, float] | None = None,
        uncertainty: Any = None,
        draws: int | None = None,
        seed: int = 0,
        max_payloads: int = 1,
        keywords: dict[str, Any] | None = None,
    ) -> None:
        keywords = keywords or {}
        for key in {"payload", "payload_range", "num_envs", "max_episode_steps", "autoreset_mode"} & keywords.keys():
            raise ValueError(f"{key} is set by the evaluation: remove it from the keywords")
        self.criterion, self.error_bounds = find_criterion(criterion), find_error_bounds(error_bounds)
        check_robot(env_id, keywords.get("robot"))
        resolved = find_uncertainty(uncertainty, find_robot(keywords.get("robot") or env_robot(env_id)))
        default = DEFAULT_DRAWS if resolved.random else 1
        self.draws = default if draws is None else whole("draws", draws, least=1)
        if self.draws > 1 and not resolved.random and keywords.get("initial_error_range") is None:
            raise ValueError(f"all {draws} draws would be equal: choose a random uncertainty or draws=1")
        self.seeds = draw_seeds(whole("seed", seed), self.draws)
        """Seed of each draw. An environment that is reset with this seed repeats the draw."""
        self._batch_payloads = min(max_payloads, max(1, BATCH // self.draws))
        # With wide error bounds the environment must not terminate an episode before a violation.
        self.keywords = {"termination_radius": self.error_bounds.termination_radius} | keywords
        """Keywords of the environment."""
        env = gym.make_vec(
            env_id,
            num_envs=self._batch_payloads * self.draws,
            error_bounds=self.error_bounds,
            max_episode_steps=None,
            uncertainty=resolved,
            **self.keywords,
        ).unwrapped
        assert isinstance(env, CableBotVectorEnv)
        self.env: CableBotVectorEnv = env
        """The vector environment."""
        env.reset(seed=self.seeds * self._batch_payloads)
        self.task: Task = env.tasks[0]
        self.task.check_motion()
        self.policy = load_policy(policy, self.task.robot) if isinstance(policy, str) else as_policy(policy)
        self.name = name or name_of(policy)
        if self.criterion == "paper" and not getattr(self.policy, "unsaturated_actions", False):
            raise ValueError(
                f"the paper criterion does not apply to policy {self.name!r}, because it does not declare "
                "unsaturated_actions = True; use criterion='task'"
            )

    @property
    def fallbacks(self) -> float | None:
        """Mean number of the policy's fallbacks per episode of the last batch; None if it does not count them."""
        count = getattr(self.policy, "fallbacks", None)
        return None if count is None else float(count) / self.env.num_envs

    def description(self) -> dict[str, Any]:
        """Settings of the episodes without the seeds, as JSON-able data."""
        separate = ("robot", "trajectory", "payload_known", "model_payload_factor")
        settings = self.env.settings
        return {
            "robot": self.task.robot.to_dict(),
            "trajectory": to_jsonable(self.task.trajectory),
            "control_frequency": self.task.control_frequency,
            "substeps": settings.substeps,
            "cable": self.task.cable,
            **{name: to_jsonable(value) for name, value in self.keywords.items() if name not in separate},
            "uncertainty": to_jsonable(settings.uncertainty[0]),
        }

    def steps(self, payloads: int) -> int:
        """Number of control steps of :meth:`run` for a number of payloads, for a progress bar."""
        return -(-payloads // self._batch_payloads) * self.task.steps

    def run(
        self,
        payloads: Sequence[float] | Array,
        *,
        observer: Observer | None = None,
        count: StepCount | None = None,
        full_motion: bool = False,
    ) -> list[Trial]:
        """Rolls out payloads in all draws.

        Args:
            payloads: nominal payloads [kg]; exactly one with an observer.
            observer: receives the steps; the first ``draws`` environments are the draws.
            count: counts the finished or skipped control steps.
            full_motion: whether to simulate an episode to the end of the motion after a violation.

        Returns:
            One trial for each payload.
        """
        trials: list[Trial] = []
        for first in range(0, len(payloads), self._batch_payloads):
            chunk = np.asarray(payloads[first : first + self._batch_payloads], float)
            filled = np.append(chunk, np.full(self._batch_payloads - len(chunk), chunk[-1]))
            batch = np.repeat(filled, self.draws)
            observation, info = self.env.reset(seed=self.seeds * self._batch_payloads, options={"payload": batch})
            judge = Judge(self.criterion, self.task.robot.cables, len(batch))
            judge.reset(info, self.error_bounds, self.task.steps)
            if observer is not None:
                observer.start(observation, info)
            run_episodes(
                self.env,
                self.policy,
                self.name,
                observation,
                judge,
                payloads=batch,
                observer=observer,
                count=count,
                full_motion=full_motion,
            )
            for index, payload in enumerate(chunk):
                draws = range(index * self.draws, (index + 1) * self.draws)
                trials.append(Trial(payload=float(payload), verdicts=tuple(judge.verdict(draw) for draw in draws)))
        return trials


def run_episodes(
    env: CableBotVectorEnv,
    policy: Policy,
    name: str,
    observation: Array,
    judge: Judge,
    *,
    payloads: Array,
    observer: Observer | None = None,
    count: StepCount | None = None,
    full_motion: bool = False,
) -> None:
    """Runs the episodes of a vector environment that has been reset.

    Args:
        env: the environment.
        policy: the policy, which is reset first.
        name: name of the policy in messages.
        observation: observations of the reset, (N, size).
        judge: checks the steps; it has been reset and has the number of control steps of each motion.
        payloads: nominal payloads in messages, (N,) [kg].
        observer: receives the steps.
        count: counts the finished or skipped control steps.
        full_motion: whether to simulate an episode to the end of the motion after a violation.

    Raises:
        cablebot_gym.policies.protocol.PolicyError: if the policy raises or returns anything but finite actions.
    """
    reset_policy(policy, name, lambda: env.tasks)
    state, start = None, np.ones(env.num_envs, np.bool_)
    terminated = np.zeros(env.num_envs, np.bool_)
    count, longest = count or StepCount(None, 0), int(judge.steps.max())
    for step in range(longest):
        over = (terminated if full_motion else judge.failed) | judge.finished
        if over.all():
            count.add(longest - step)
            return
        action, state = checked_actions(
            policy,
            name,
            observation,
            state,
            start,
            cables=env.settings.robot.cables,
            payloads=payloads,
            time=step / env.settings.control_frequency,
            ignored=over,
        )
        observation, reward, start, _, info = env.step(action)  # the environment restarts terminated episodes
        judge.observe(info, start)
        if observer is not None:
            observer.step(observation, reward, info, ~over)
        terminated |= start
        count.add(1)
