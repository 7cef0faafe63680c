"""Batched rollouts of one policy: payloads × draws. The payload search and the comparison share this module."""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs import check_robot, env_robot
from cablebot_gym.envs.single import SEED_MESSAGE
from cablebot_gym.evaluation.constraints import Judge, Verdict, Violation, find_criterion
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import as_policy, load_policy, name_of
from cablebot_gym.policies.protocol import checked_actions, reset_policy
from cablebot_gym.robots import find_robot
from cablebot_gym.task import ErrorBounds, Task, to_jsonable
from cablebot_gym.uncertainty import Uncertainty, find_uncertainty

BATCH = 1024
"""Number of episodes in one batch; at least the draws of one payload. This many episodes fit into the caches of a core.
A batch of heavy payloads ends as soon as all of them have failed."""

DEFAULT_DRAWS = 256
"""Default number of draws at each payload under a random uncertainty."""

Progress = Callable[[int, int], None]
"""Callback after every control step: number of finished steps, expected number of steps."""

Observer = Callable[[dict[str, Any], Array, NDArray[np.bool_]], None]
"""Callback after every control step of the first batch: info, poses (N, n), and a mask of the running episodes (N,).
An episode is running until the environment ends it. Unless the full motion is run, a violation ends it as well."""


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
        return None if self.violation_draw is None else self.verdicts[self.violation_draw].violation

    @property
    def violation_draw(self) -> int | None:
        """Index of the draw in which :attr:`violation` occurred, from 0; None without a violation."""
        if not self.failures:
            return None
        most_frequent = next(iter(self.failures))
        violations = [(draw, verdict.violation) for draw, verdict in enumerate(self.verdicts)]
        times = [
            (violation.time or 0.0, draw)
            for draw, violation in violations
            if violation is not None and violation.kind == most_frequent
        ]
        return min(times)[1]


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that determine the results, for result files."""
    packages = ("cablebot-gym", "gymnasium", "numpy", "numba")
    return {"python": platform.python_version(), **{package: version(package) for package in packages}}


def uncertainty_name(uncertainty: Any) -> str | None:
    """Name of an uncertainty in results: its own name, ``custom`` for data, or None without uncertainty."""
    return uncertainty if isinstance(uncertainty, str | None) else "custom"


def resolve_draws(draws: int | None, uncertainty: Uncertainty, *, random: bool) -> int:
    """Checks the requested number of draws. None gives :data:`DEFAULT_DRAWS` under a random uncertainty, else 1.

    Raises:
        ValueError: if the number is not an integer of at least 1, or if it exceeds 1 although nothing is random.
    """
    if draws is None:
        return DEFAULT_DRAWS if uncertainty.random else 1
    if not isinstance(draws, (int, np.integer)) or isinstance(draws, bool) or draws < 1:
        raise ValueError(f"draws must be an integer of at least 1, not {draws!r}")
    if draws > 1 and not random:
        raise ValueError(f"all {draws} draws would be equal: choose a random uncertainty, such as table6, or draws=1")
    return int(draws)


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

    Use it as a context manager, which closes the environment.

    Args:
        policy: an object with ``predict``, a callable ``observation -> action``, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        name: name of the policy; None for its own name.
        criterion: ``task`` or ``paper``.
        error_bounds: bounds of the tracking errors.
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
        name: str | None,
        criterion: str,
        error_bounds: ErrorBounds,
        uncertainty: Any,
        draws: int | None,
        seed: int,
        max_payloads: int,
        keywords: dict[str, Any],
    ) -> None:
        self.criterion, self.error_bounds = find_criterion(criterion), error_bounds
        check_robot(env_id, keywords.get("robot"))
        _check_keywords(keywords | {"uncertainty": uncertainty})
        robot = find_robot(keywords.get("robot") or env_robot(env_id))
        resolved = find_uncertainty(uncertainty, robot)
        random = resolved.random or keywords.get("initial_error_range") is not None
        self.draws = resolve_draws(draws, resolved, random=random)
        if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or seed < 0:
            raise ValueError(SEED_MESSAGE.format(seed))
        self.seeds = draw_seeds(int(seed), self.draws)
        """Seed of each draw. An environment that is reset with this seed repeats the draw."""
        self._batch_payloads = min(max_payloads, max(1, BATCH // self.draws))
        # With wide error bounds the environment must not terminate an episode before a violation.
        self.keywords = {"termination_radius": error_bounds.termination_radius} | keywords
        """Keywords of the environment."""
        self.env = gym.make_vec(
            env_id,
            num_envs=self._batch_payloads * self.draws,
            error_bounds=error_bounds,
            max_episode_steps=None,
            uncertainty=resolved,
            **self.keywords,
        )
        try:
            self.env.reset(seed=self._episode_seeds)
            self.task: Task = self._unwrapped.tasks[0]
            self.task.check_motion()
            self.policy = load_policy(policy, self.task.robot) if isinstance(policy, str) else as_policy(policy)
            self.name = name or name_of(policy)
            if self.criterion == "paper" and not getattr(self.policy, "unsaturated_actions", False):
                raise ValueError(
                    f"the paper criterion does not apply to policy {self.name!r}, because it does not declare "
                    "unsaturated_actions = True; use criterion='task'"
                )
        except BaseException:
            self.env.close()
            raise

    def __enter__(self) -> Batch:
        return self

    def __exit__(self, *exception: object) -> None:
        self.env.close()

    @property
    def _episode_seeds(self) -> Any:  # the signature of Gymnasium excludes a sequence of seeds
        return self.seeds * self._batch_payloads

    @property
    def _unwrapped(self) -> Any:
        """The unwrapped environment, which has tasks, pose, settings and true parameters."""
        return self.env.unwrapped

    def description(self) -> dict[str, Any]:
        """Settings of the episodes without the seeds, as JSON-able data."""
        separate = ("robot", "trajectory", "payload_known", "model_payload_factor")
        settings = self._unwrapped.settings
        return {
            "robot": self.task.robot.to_dict(),
            "trajectory": to_jsonable(self.task.trajectory),
            "control_frequency": self.task.control_frequency,
            "substeps": settings.substeps,
            "cable": self.task.cable,
            **{name: to_jsonable(value) for name, value in self.keywords.items() if name not in separate},
            "uncertainty": to_jsonable(settings.uncertainty[0]),
        }

    @property
    def truth(self) -> dict[str, Array]:
        """True parameters of the current episodes by name, each (N, …)."""
        truth: dict[str, Array] = self._unwrapped.truth
        return truth

    def steps(self, payloads: int) -> int:
        """Number of control steps of :meth:`run` for a number of payloads, for a progress bar."""
        return -(-payloads // self._batch_payloads) * self.task.steps

    def run(
        self,
        payloads: Sequence[float] | Array,
        *,
        observe: Observer | None = None,
        progress: Callable[[int], None] | None = None,
        full_motion: bool = False,
    ) -> list[Trial]:
        """Rolls out payloads in all draws.

        Args:
            payloads: nominal payloads [kg].
            observe: callback for the steps of the first batch.
            progress: callback with the number of control steps just finished or skipped.
            full_motion: whether to simulate an episode to the end of the motion after a violation.

        Returns:
            One trial for each payload.
        """
        trials: list[Trial] = []
        for first in range(0, len(payloads), self._batch_payloads):
            chunk = np.asarray(payloads[first : first + self._batch_payloads], float)
            judge = self._roll_out(chunk, observe if first == 0 else None, progress, full_motion)
            for index, payload in enumerate(chunk):
                env_indices = range(index * self.draws, (index + 1) * self.draws)
                verdicts = tuple(
                    judge.verdict(env_index, complete=not judge.failed[env_index]) for env_index in env_indices
                )
                trials.append(Trial(payload=float(payload), verdicts=verdicts))
        return trials

    def _roll_out(
        self, payloads: Array, observe: Observer | None, progress: Callable[[int], None] | None, full_motion: bool
    ) -> Judge:
        fill = np.full(self._batch_payloads - len(payloads), payloads[-1])
        batch = np.repeat(np.append(payloads, fill), self.draws)
        task = self.task
        observation, info = self.env.reset(seed=self._episode_seeds, options={"payload": batch})
        judge = Judge(self.criterion, self.error_bounds, task.robot.cables, len(batch))
        judge.reset(info)
        reset_policy(self.policy, self.name, lambda: self._unwrapped.tasks)
        state, start = None, np.ones(len(batch), np.bool_)
        ended = np.zeros(len(batch), np.bool_)
        for step in range(task.steps):
            over = (ended if full_motion else judge.failed).copy()
            action, state = checked_actions(
                self.policy,
                self.name,
                observation,
                state,
                start,
                cables=task.robot.cables,
                payloads=batch,
                time=step / task.control_frequency,
                ignored=over,
            )
            observation, _, terminated, _, info = self.env.step(action)
            judge.observe(info, terminated)
            if observe is not None:
                observe(info, self._unwrapped.pose, ~over)
            ended |= terminated
            start = terminated  # the environment restarts these episodes; the judge ignores them
            if progress is not None:
                progress(1)
            if (ended if full_motion else judge.failed).all():
                if progress is not None:
                    progress(task.steps - step - 1)
                break
        return judge


def _check_keywords(keywords: dict[str, Any]) -> None:
    if taken := {"payload", "payload_range", "num_envs", "max_episode_steps", "autoreset_mode"} & set(keywords):
        raise ValueError(f"{sorted(taken)[0]} is set by the evaluation: remove it from the keywords")
    for key, most in (("payload_known", 0), ("model_payload_factor", 0), ("initial_error", 1)):
        if np.ndim(keywords.get(key, 0)) > most:
            raise ValueError(f"{key} must be one value for all episodes, not one for each environment")
    if isinstance(keywords["uncertainty"], (list, tuple)):
        raise ValueError("uncertainty must be one value for all episodes, not one for each environment")
