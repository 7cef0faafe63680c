"""Environment of a training: learners steer ``observing`` on random motions, with heavier payloads as
they succeed."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.laws.law import Array
from cablebot_baselines.laws.observer_law import UNCERTAINTY
from cablebot_baselines.learned.steering import LARGEST_INPUT, Memory, Steering
from cablebot_gym.envs.vector import CableBotVectorEnv, VectorStep
from cablebot_gym.motions import Trajectory, random_loop
from cablebot_gym.motions.loops import TRAINING_SEEDS
from cablebot_gym.utils.checks import numbers, whole

MOTIONS = 8
"""Number of random motions at a time."""

SEASON = 160
"""Actions after which all episodes are cut off, and other motions are drawn."""

EFFORT = 2.5
"""Penalty of the mean square of each action. At the end of an episode actions have no consequence;
without this penalty they drift to the edge of their range, where the gradient vanishes."""

POWER = 0.6
"""Exponent of the uniform draws of payloads; below 1, heavy ones are more frequent."""

HEAVY = 2 / 3
"""Fraction of the ceiling from which on a payload counts."""

if TYPE_CHECKING:
    _Wrapper = VectorWrapper[Array, ArrayLike, Array, ArrayLike, Array]
else:  # Gymnasium's class is generic from 1.4 on
    _Wrapper = VectorWrapper


class PayloadCurriculum:
    """Ceiling of the payloads, in payloads of exact tracking, which follows the success with heavy
    ones.

    Of the last heavy episodes, a fraction of at least ``success`` raises it by ``step``, and one below
    ``setback`` lowers it. After each of these decisions a new window begins.

    Args:
        window: number of last heavy episodes that decide.
    """

    start, step = 0.5, 0.05
    success, setback = 0.7, 0.5

    def __init__(self, window: int = 100) -> None:
        self.ceiling = self.start
        """Present ceiling."""
        self._window = window
        self._successes = deque[bool](maxlen=window)

    def count(self, payload: float, succeeded: bool) -> None:
        """Counts an episode with a payload, if it is heavy."""
        if payload < HEAVY * self.ceiling:
            return
        self._successes.append(succeeded)
        if len(self._successes) < self._window:
            return
        fraction = sum(self._successes) / self._window
        if fraction >= self.success:
            self.ceiling += self.step
        elif fraction < self.setback:
            self.ceiling = max(self.ceiling - self.step, self.start)
        else:
            return
        self._successes.clear()


class Steered(_Wrapper):
    """N robots of an environment whose reference a learner shifts, see
    :class:`~cablebot_baselines.learned.steering.Steering`.

    A step is one action of each robot, which lasts ``steering.periods`` control periods; their
    rewards are summed. An episode ends at its first violation of a limit; its ``info`` is that of
    its last control period. The robots are drawn from ``hardware``, and payloads are unknown.
    A reset of all robots draws random motions, robot i gets number i modulo :data:`MOTIONS`; all
    episodes are truncated after each :data:`SEASON` actions. Reset ended environments with the
    option ``reset_mask`` before the next step.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        n_envs: number of robots N.
    """

    env: Any

    def __init__(self, env_id: str, n_envs: int) -> None:
        env: Any = gym.make_vec(
            env_id,
            num_envs=n_envs,
            autoreset_mode=AutoresetMode.DISABLED,
            terminate_on_violation=True,
            uncertainty=UNCERTAINTY,
            payload_known=False,
        )
        super().__init__(env)
        self._base_env: CableBotVectorEnv = env.unwrapped
        robot = self._base_env.settings.robot
        self.steering = Steering(robot)
        """The steered law."""
        self.curriculum = PayloadCurriculum()
        """Ceiling of the payloads."""
        self.single_observation_space = Box(
            -LARGEST_INPUT, LARGEST_INPUT, (self.steering.inputs,), np.float32
        )
        self.single_action_space = Box(-1.0, 1.0, (robot.coordinates,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, n_envs)
        self.action_space = batch_space(self.single_action_space, n_envs)
        self._action_shape = (n_envs, robot.coordinates)
        self._motions: list[Trajectory] = []
        self._motion = np.arange(n_envs) % MOTIONS
        self._age = 0
        self._random = np.random.default_rng()
        self._memory: Memory | None = None
        self._blocks: dict[str, Array] = {}
        self._start = np.zeros(n_envs, np.bool_)
        self._ended = np.zeros(n_envs, np.bool_)
        self._start_observation = np.zeros((n_envs, self._base_env.layout.size))
        # Payloads of the present episodes in those of exact tracking, (N,).
        self._payload = np.zeros(n_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Starts episodes with drawn payloads: all, on new motions, or those of the option
        ``reset_mask``.

        Raises:
            ValueError: if the seed is neither None nor an integer ≥ 0.
        """
        if seed is not None:
            self._random = np.random.default_rng(whole("seed", seed))
            self._base_env.reset(seed=seed)
        starts = np.ones(self.num_envs, np.bool_)
        if options:
            starts = np.asarray(options["reset_mask"], np.bool_)
        if starts.all():
            self._draw_motions()
        uniform = self._random.uniform(size=self.num_envs)
        drawn = self.curriculum.ceiling * uniform**POWER
        self._payload[starts] = drawn[starts]
        observation, info = self._restart(starts, self._payload * self.steering.exact_payloads)
        self._start_observation[starts] = observation[starts]
        self._blocks = self.steering.split(observation)
        self._memory = self.steering.started(self._memory, starts, (self.num_envs,))
        self._start = self._start | starts
        self._ended &= ~starts
        return self._observe(self._blocks, self._memory), info

    def _draw_motions(self) -> None:
        kind = self._base_env.settings.robot.kind
        seeds = self._random.choice(len(TRAINING_SEEDS), min(MOTIONS, self.num_envs), replace=False)
        self._motions = [random_loop(kind, int(seed)) for seed in seeds]
        everyone = np.ones(self.num_envs, np.bool_)
        self._restart(everyone, np.zeros(self.num_envs))
        self.steering.reset(self._base_env.tasks)
        self._memory = None

    def _restart(self, starts: NDArray[np.bool_], payload: Array) -> tuple[Array, dict[str, Any]]:
        """Starts some episodes, those of each motion together."""
        for index in np.unique(self._motion[starts]):
            options = {
                "reset_mask": starts & (self._motion == index),
                "trajectory": self._motions[index],
                "payload": payload,
            }
            observation, info = self._base_env.reset(options=options)
        return observation, info

    def _observe(self, blocks: dict[str, Array], memory: Memory) -> Array:
        return self.steering.observe(blocks, memory).astype(np.float32)

    def step(self, actions: ArrayLike) -> VectorStep:
        """One action, which lasts until the next one is due or the episode ends.

        Raises:
            ResetNeeded: before the first reset, and if an episode has ended.
            ValueError: if the actions are not (N, n) finite numbers.
        """
        if self._memory is None or self._ended.any():
            raise ResetNeeded(
                "an episode has ended or was never started: call reset(), with reset_mask for some"
            )
        steering, memory, blocks = self.steering, self._memory, self._blocks
        actions = numbers("action", actions, shapes=[self._action_shape])
        total = -EFFORT * np.mean(np.clip(actions, -1.0, 1.0) ** 2, axis=-1)
        terminated, truncated, ended = np.zeros((3, self.num_envs), np.bool_)
        ends = []
        for _ in range(steering.periods):
            applied, memory = steering.steer(blocks, actions, memory, self._start)
            self._start = np.zeros_like(self._start)
            observation, reward, failed, over, info = self.env.step(applied)
            total += np.where(ended, 0.0, reward)
            last = {"observation": observation, "step": memory.step, "info": info}
            fresh = (failed | over) & ~ended
            if fresh.any():
                terminated |= fresh & failed
                truncated |= fresh & over
                ended |= fresh
                ends.append((np.flatnonzero(fresh), last))
                if ended.all():
                    break
            # The law must not be evaluated at the state of an ended plant, which may be anywhere.
            blocks = steering.split(np.where(ended[:, None], self._start_observation, observation))
        self._memory, self._blocks = memory, blocks
        for rows, at_end in ends:
            last = _with_rows(last, at_end, rows)
        success = truncated & ~terminated & ~last["info"]["violated"]
        for row in np.flatnonzero(ended):
            self.curriculum.count(self._payload[row], bool(success[row]))
        self._age += 1
        if self._age % SEASON == 0:
            truncated = ~terminated
        self._ended = terminated | truncated
        memory = replace(memory, step=last["step"])
        observed = self._observe(steering.split(last["observation"]), memory)
        info = last["info"] | {"is_success": success}
        return observed, total, terminated, truncated, info


def _with_rows(values: Any, replacement: Any, rows: Array) -> Any:
    """A copy of an array, or of a dict of arrays, with some rows of another."""
    if isinstance(values, dict):
        return {name: _with_rows(value, replacement[name], rows) for name, value in values.items()}
    merged = values.copy()
    merged[rows] = replacement[rows]
    return merged
