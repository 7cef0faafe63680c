"""Payloads × draws, rolled out together with one policy: what the payload search and the comparison have in common."""

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
from cablebot_gym.evaluation.constraints import Judge, Limit, Verdict, find_criterion
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import as_policy, load_policy, name_of
from cablebot_gym.policies.protocol import begin, commands
from cablebot_gym.robots import find_robot
from cablebot_gym.task import Limits, Task, as_plain
from cablebot_gym.uncertainty import Uncertainty, find_uncertainty

BATCH = 1024
"""Episodes that are rolled out together, or the draws of one payload if these are more. So many stay within a core's
caches, and a batch of heavy payloads ends as soon as all of them have failed."""

DEFAULT_DRAWS = 256
"""Episodes at each payload, where the uncertainty is random."""

Progress = Callable[[int, int], None]
"""Called after every control step with the steps done and the steps expected."""

Observer = Callable[[dict[str, Any], Array, NDArray[np.bool_]], None]
"""Called after every control step of the first batch with info, poses (N, n), and which episodes the step was still of
(N,): not those that had ended before, nor, unless it is run whole, those that had broken a limit before."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One payload in all draws."""

    payload: float
    """Nominal [kg]."""
    verdicts: tuple[Verdict, ...]
    """One for each draw."""

    @property
    def carried(self) -> int:
        """Draws in which the payload was carried."""
        return sum(verdict.carried for verdict in self.verdicts)

    @property
    def failures(self) -> dict[str, int]:
        """How many draws failed by each kind of limit, the commonest first."""
        kinds = Counter(verdict.limit.kind for verdict in self.verdicts if verdict.limit is not None)
        return {str(kind): number for kind, number in kinds.most_common()}

    @property
    def limit(self) -> Limit | None:
        """The earliest failure of the commonest kind; None if every draw carried."""
        return None if self.limit_draw is None else self.verdicts[self.limit_draw].limit

    @property
    def limit_draw(self) -> int | None:
        """The draw, from 0, to which :attr:`limit` happened."""
        if not self.failures:
            return None
        commonest = next(iter(self.failures))
        limits = [(draw, verdict.limit) for draw, verdict in enumerate(self.verdicts) if verdict.limit is not None]
        return min((limit.time or 0.0, draw) for draw, limit in limits if limit.kind == commonest)[1]


def versions() -> dict[str, str]:
    """Of Python and of the packages that make the numbers, for result files."""
    packages = ("cablebot-gym", "gymnasium", "numpy", "numba")
    return {"python": platform.python_version(), **{package: version(package) for package in packages}}


def uncertainty_name(uncertainty: Any) -> str | None:
    """What to call an uncertainty in a title: its name, ``custom``, or None for none."""
    return uncertainty if isinstance(uncertainty, str | None) else "custom"


def resolve_draws(draws: int | None, uncertainty: Uncertainty, *, random: bool) -> int:
    """The number of draws asked for, or :data:`DEFAULT_DRAWS` for a random uncertainty and 1 for none.

    Raises:
        ValueError: if it is not a whole number of at least 1, or more than 1 where nothing is random.
    """
    if draws is None:
        return DEFAULT_DRAWS if uncertainty.random else 1
    if not isinstance(draws, (int, np.integer)) or isinstance(draws, bool) or draws < 1:
        raise ValueError(f"draws must be a whole number of at least 1, not {draws!r}")
    if draws > 1 and not random:
        raise ValueError(f"{draws} draws would all be the same: give an uncertainty that is random, such as table6")
    return int(draws)


def draw_seeds(seed: int, draws: int) -> list[int]:
    """Seeds of the draws, which reset an environment. One draw is the environment's own episode of the seed.

    They have 53 bits, so that every reader of JSON gets them whole.
    """
    if draws == 1:
        return [seed]
    words = np.random.SeedSequence(seed).generate_state(draws, np.uint64)
    return [int(word) >> 11 for word in words]


class Batch:
    """Rolls out payloads × draws with one policy in one vector environment. Close it, or use it as a context.

    Args:
        policy: an object with ``predict``, a callable ``observation -> action``, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        name: of the policy; None for its own.
        criterion: ``task`` or ``paper``.
        limits: bounds of the errors.
        uncertainty: what the policy does not know.
        draws: episodes at each payload, None for the usual number.
        seed: from which the draws follow, and nothing else.
        together: how many payloads a call is likely to bring.
        keywords: for the environment.

    Raises:
        ValueError: if an argument is not valid, or ``paper`` is asked of a policy that does not declare ``unclipped``.
    """

    def __init__(
        self,
        policy: Any,
        env_id: str,
        *,
        name: str | None,
        criterion: str,
        limits: Limits,
        uncertainty: Any,
        draws: int | None,
        seed: int,
        together: int,
        keywords: dict[str, Any],
    ) -> None:
        self.criterion, self.limits = find_criterion(criterion), limits
        check_robot(env_id, keywords.get("robot"))
        _check_keywords(keywords | {"uncertainty": uncertainty})
        robot = find_robot(keywords.get("robot") or env_robot(env_id))
        unknown = find_uncertainty(uncertainty, robot)
        random = unknown.random or keywords.get("initial_error_range") is not None
        self.draws = resolve_draws(draws, unknown, random=random)
        if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or seed < 0:
            raise ValueError(SEED_MESSAGE.format(seed))
        self.seeds = draw_seeds(int(seed), self.draws)
        """Of the draws: an environment reset with one of them repeats the draw."""
        self._together = min(together, max(1, BATCH // self.draws))
        # A wide tube must not be cut short by the environment's own end of an episode.
        self.keywords = {"termination_radius": limits.termination_radius} | keywords
        """For the environment."""
        self.env = gym.make_vec(
            env_id,
            num_envs=self._together * self.draws,
            limits=limits,
            max_episode_steps=None,
            uncertainty=unknown,
            **self.keywords,
        )
        try:
            self.env.reset(seed=self._lane_seeds)
            self.task: Task = self._plain.tasks[0]
            self.task.check_motion()
            self.policy = load_policy(policy, self.task.robot) if isinstance(policy, str) else as_policy(policy)
            self.name = name or name_of(policy)
            if self.criterion == "paper" and not getattr(self.policy, "unclipped", False):
                raise ValueError(
                    f"the paper criterion says nothing of {self.name!r}, which does not declare unclipped = True: "
                    "a policy that clips its own commands would pass it for nothing; use criterion='task'"
                )
        except BaseException:
            self.env.close()
            raise

    def __enter__(self) -> Batch:
        return self

    def __exit__(self, *exception: object) -> None:
        self.env.close()

    @property
    def _lane_seeds(self) -> Any:  # Gymnasium's signature knows no sequence of seeds
        return self.seeds * self._together

    @property
    def _plain(self) -> Any:
        """The environment itself: tasks, pose, settings and truth are beyond Gymnasium's class."""
        return self.env.unwrapped

    def description(self) -> dict[str, Any]:
        """What the episodes were made with, as plain data; the draws' seed apart."""
        told_elsewhere = ("robot", "trajectory", "payload_known")
        settings = self._plain.settings
        return {
            "robot": self.task.robot.to_dict(),
            "trajectory": as_plain(self.task.trajectory),
            "control_frequency": self.task.control_frequency,
            "substeps": settings.substeps,
            "cable": self.task.cable,
            **{name: as_plain(value) for name, value in self.keywords.items() if name not in told_elsewhere},
            "uncertainty": as_plain(settings.uncertainty[0]),
        }

    @property
    def truth(self) -> dict[str, Array]:
        """True parameters of the present episodes by name, each (N, …)."""
        truth: dict[str, Array] = self._plain.truth
        return truth

    def steps(self, payloads: int) -> int:
        """Control steps of :meth:`run` for a number of payloads, for a progress bar."""
        return -(-payloads // self._together) * self.task.steps

    def run(
        self,
        payloads: Sequence[float] | Array,
        *,
        observe: Observer | None = None,
        progress: Callable[[int], None] | None = None,
        whole: bool = False,
    ) -> list[Trial]:
        """Tries payloads in all draws.

        Args:
            payloads: nominal ones [kg].
            observe: sees the steps of the first batch.
            progress: called with the number of control steps just done or become needless.
            whole: to the end of the motion, even after all have failed; and after an episode has broken a limit the
                policy still commands it.
        """
        trials: list[Trial] = []
        for first in range(0, len(payloads), self._together):
            some = np.asarray(payloads[first : first + self._together], float)
            judge = self._roll(some, observe if first == 0 else None, progress, whole)
            for place, payload in enumerate(some):
                lanes = range(place * self.draws, (place + 1) * self.draws)
                verdicts = tuple(judge.verdict(lane, complete=not judge.failed[lane]) for lane in lanes)
                trials.append(Trial(payload=float(payload), verdicts=verdicts))
        return trials

    def _roll(
        self, payloads: Array, observe: Observer | None, progress: Callable[[int], None] | None, whole: bool
    ) -> Judge:
        fill = np.full(self._together - len(payloads), payloads[-1])
        batch = np.repeat(np.append(payloads, fill), self.draws)
        task = self.task
        observation, info = self.env.reset(seed=self._lane_seeds, options={"payload": batch})
        judge = Judge(self.criterion, self.limits, task.robot.cables, len(batch))
        judge.begin(info)
        if hasattr(self.policy, "begin"):  # so many tasks take their time to make
            begin(self.policy, self.name, self._plain.tasks)
        state, start = None, np.ones(len(batch), np.bool_)
        ended = np.zeros(len(batch), np.bool_)
        for step in range(task.steps):
            over = (ended if whole else judge.failed).copy()
            action, state = commands(
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
                observe(info, self._plain.pose, ~over)
            ended |= terminated
            start = terminated  # the environment starts these anew, though nobody judges them any more
            if progress is not None:
                progress(1)
            if (ended if whole else judge.failed).all():
                if progress is not None:
                    progress(task.steps - step - 1)
                break
        return judge


def _check_keywords(keywords: dict[str, Any]) -> None:
    if taken := {"payload", "payload_range", "num_envs", "max_episode_steps", "autoreset_mode"} & set(keywords):
        raise ValueError(f"{sorted(taken)[0]} is set by the evaluation itself: leave it out")
    for key, most in (("payload_known", 0), ("initial_error", 1)):
        if np.ndim(keywords.get(key, 0)) > most:
            raise ValueError(f"{key} is one for all episodes here, not one for each environment")
    if isinstance(keywords["uncertainty"], (list, tuple)):
        raise ValueError("uncertainty is one for all episodes here, not one for each environment")
