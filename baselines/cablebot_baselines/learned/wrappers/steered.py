"""A classical law that a learner's actions steer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.base import Base, find_base
from cablebot_baselines.learned.steering import Memory, Residual, Shift, Steering, find_way
from cablebot_baselines.learned.wrappers.layers import STEERED, Many, Single, SingleStep, check_number, restarted
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.envs.vector import CableBotVectorEnv, VectorStep


def _steering(
    plant: CableBotEnv | CableBotVectorEnv,
    base: Base | str | Mapping[str, Any],
    steering: Shift | Residual | str | Mapping[str, Any],
    features: Sequence[str],
) -> tuple[Steering, Box, Box]:
    """The law at work, and the spaces of a learner's observations and actions."""
    made = Steering(plant.settings.robot, base=find_base(base), way=find_way(steering), features=features)
    return made, Box(-np.inf, np.inf, (made.inputs,), np.float32), Box(-1.0, 1.0, (made.actions,), np.float32)


def _checked(action: ArrayLike, shape: tuple[int, ...]) -> Array:
    """The action as finite floats of the right shape.

    Raises:
        ValueError: if it is anything else.
    """
    try:
        checked = np.asarray(action, np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"an action must be {shape[-1]} numbers for each environment, not {action!r}") from error
    if checked.shape != shape:
        raise ValueError(f"an action of this steered law has shape {shape}, numbers in [−1, 1], not {checked.shape}")
    if not np.all(np.isfinite(checked)):
        raise ValueError("an action must be finite: no NaN, no infinity")
    return checked


def _mean_square(actions: Array) -> Array:
    """Of what counts of each action, (...)."""
    square: Array = np.mean(np.clip(actions, -1.0, 1.0) ** 2, axis=-1)
    return square


class SteeredVector(Many):
    """N :class:`Steered` with same-step autoreset; arguments as there.

    An environment that ends within an action stands still for its rest as far as anybody can see, and is then
    restarted: ``final_obs`` and ``final_info`` hold its last observation and info as they were when it ended, in the
    form of :class:`CableBotVectorEnv`.

    Raises:
        TypeError: if the environment is no :class:`CableBotVectorEnv`.
        ValueError: as :class:`Steered`, or if its autoreset is not disabled.
    """

    level: ClassVar[int] = STEERED

    def __init__(
        self,
        env: VectorEnv[Array, ArrayLike, Array],
        *,
        base: Base | str | Mapping[str, Any],
        steering: Shift | Residual | str | Mapping[str, Any],
        features: Sequence[str],
        effort: float = 0.0,
    ) -> None:
        super().__init__(env)
        check_number("effort", effort, 0.0)
        self._effort = float(effort)
        self.steering, seen, action = _steering(self._plant, base, steering, features)
        """What the actions steer."""
        self.metadata = {**env.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        self.single_observation_space, self.single_action_space = seen, action
        self.observation_space = batch_space(seen, self.num_envs)
        self.action_space = batch_space(action, self.num_envs)
        self._memory: Memory | None = None
        self._part: dict[str, Array] = {}
        self._start: NDArray[np.bool_] = np.zeros(self.num_envs, np.bool_)
        self._first = np.zeros((self.num_envs, self._plant.layout.size))

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts episodes; seeds and options as for :class:`CableBotVectorEnv`, but without ``limits``.

        Raises:
            ValueError: if a seed or an option is not valid.
        """
        if "limits" in (options or {}):
            raise ValueError(
                "limits as an option would hold for the first episodes alone, and the steered law has the same ones in "
                "all environments: give limits where the environments are made"
            )
        observation, info = self.env.reset(seed=seed, options=options)
        marked = restarted(options, self.num_envs)
        if self._memory is None or marked.all():
            self.steering.begin(self._plant.tasks)
        return self._begun(observation, marked), info

    def _begun(self, observation: Array, marked: NDArray[np.bool_]) -> Array:
        """What a learner sees (N, features), once the marked environments have restarted."""
        self._first[marked] = observation[marked]
        self._part = self.steering.split(observation)
        self._memory = self.steering.remembered(self._part, self._memory, marked)
        self._start = self._start | marked
        return self._seen(self._part, self._memory)

    def _seen(self, part: dict[str, Array], memory: Memory) -> Array:
        return self.steering.seen(part, memory).astype(np.float32)

    def step(self, actions: ArrayLike) -> VectorStep:
        """One action: ``Steering.periods`` control periods, and what comes of them.

        Raises:
            ResetNeeded: before the first reset.
            ValueError: if the actions are not (N, size) finite numbers.
        """
        if self._memory is None:
            raise ResetNeeded("call reset() before step()")
        actions = _checked(actions, (self.num_envs, self.steering.actions))
        steering, memory, part, start = self.steering, self._memory, self._part, self._start
        total = -self._effort * _mean_square(actions)
        terminated, truncated, ended = (np.zeros(self.num_envs, np.bool_) for _ in range(3))
        last = _Last()
        for _ in range(steering.periods):
            command, memory = steering.respond(part, actions, memory, start)
            start = np.zeros_like(start)
            observation, reward, failed, over, info = self.env.step(command, past_end=True)
            total += np.where(ended, 0.0, reward)
            fresh = (failed | over) & ~ended
            if fresh.any():
                terminated |= fresh & failed
                truncated |= fresh & over
                ended |= fresh
                last.keep(fresh, observation, memory.step, info)
                if ended.all():
                    break
            # Wherever an ended plant may be by now, the law must not be asked about it.
            observation[ended] = self._first[ended]
            part = steering.split(observation)
        self._memory, self._part, self._start = memory, part, start
        if not ended.any():
            return self._seen(part, memory), total, terminated, truncated, info
        final = self._final(ended, last, memory)
        observation, info = self.env.reset(options={"reset_mask": ended.copy()})
        return self._begun(observation, ended), total, terminated, truncated, info | final

    def _final(self, ended: NDArray[np.bool_], last: _Last, memory: Memory) -> dict[str, Any]:
        """The last observation and info of ended environments, in the form of :class:`CableBotVectorEnv`."""
        lanes = np.flatnonzero(ended)
        then = replace(memory, actions=memory.actions[lanes], anchors=memory.anchors[lanes], step=last.steps[lanes])
        observations = np.full(self.num_envs, None, dtype=object)
        for lane, seen in zip(lanes, self._seen(self.steering.split(last.observation[lanes]), then), strict=True):
            observations[lane] = seen.copy()
        info = last.info | {f"_{name}": ended.copy() for name in last.info}
        return {"final_obs": observations, "_final_obs": ended.copy(), "final_info": info, "_final_info": ended.copy()}


class _Last:
    """Last observations, control instants and infos of environments that end within one action."""

    observation: Array
    steps: NDArray[np.int64]
    info: dict[str, Array]

    def __init__(self) -> None:
        self._empty = True

    def keep(
        self, ended: NDArray[np.bool_], observation: Array, steps: NDArray[np.int64], info: dict[str, Any]
    ) -> None:
        """Keeps those of the environments that have just ended."""
        if self._empty:
            self.observation, self.steps = observation.copy(), steps.copy()
            self.info = {name: np.array(value) for name, value in info.items()}
            self._empty = False
            return
        lanes = np.flatnonzero(ended)
        self.observation[lanes], self.steps[lanes] = observation[lanes], steps[lanes]
        for name, kept in self.info.items():
            kept[lanes] = info[name][lanes]


class Steered(Single):
    """A learner's action steers a classical law for some control periods: it shifts its reference or adds to its drive.

    A step is one action, held for ``Steering.periods`` control periods; their rewards are summed, and an episode
    that ends within them ends there. ``info`` is that of the last control period, so wrappers that watch it go within.
    Actions are numbers in [−1, 1], cut to that; the observation, float32, is made of ``features``, see
    :mod:`cablebot_baselines.learned.features`. What such a learner has learnt is kept in a
    :class:`cablebot_baselines.learned.bundle.Bundle` of the same three arguments.

    Args:
        env: a single environment of this package, other wrappers within.
        base: the law, as its name, ``{"law": …, "gains": …}`` or a :class:`Base`.
        steering: ``"shift"``, ``"residual"``, ``{"kind": "shift", "hold": 0.04, …}``, or what these make.
        features: names, in the order of the observation.
        effort: penalty on the mean square of each action; ≥ 0. Where an action has no consequence, at the end of an
            episode, nothing else keeps it from the edge of its range, where a learner that is cut off there sees no
            slope and does not come back.

    Raises:
        TypeError: if the environment is none of this package's.
        ValueError: if an argument is not valid, the law is not made for the robot, or the environment is already
            steered.
    """

    level: ClassVar[int] = STEERED
    vector: ClassVar[type[SteeredVector]] = SteeredVector

    def __init__(
        self,
        env: gym.Env[Array, ArrayLike],
        *,
        base: Base | str | Mapping[str, Any],
        steering: Shift | Residual | str | Mapping[str, Any],
        features: Sequence[str],
        effort: float = 0.0,
    ) -> None:
        super().__init__(env, base=base, steering=steering, features=features, effort=effort)
        check_number("effort", effort, 0.0)
        self._effort = float(effort)
        self.steering, self.observation_space, self.action_space = _steering(self._plant, base, steering, features)
        """What the actions steer."""
        self._memory: Memory | None = None
        self._part: dict[str, Array] = {}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode; seed and options as for the environment.

        Raises:
            ValueError: if the seed or an option is not valid.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        self.steering.begin([self._plant.task])
        self._part = self.steering.split(observation)
        self._memory = self.steering.remembered(self._part, None, None)
        return self._seen(self._part, self._memory), info

    def _seen(self, part: dict[str, Array], memory: Memory) -> Array:
        return self.steering.seen(part, memory).astype(np.float32)

    def step(self, action: ArrayLike) -> SingleStep:
        """One action: ``Steering.periods`` control periods, or as many as the episode lasts.

        Raises:
            ResetNeeded: before the first reset, and after the end of an episode.
            ValueError: if the action is not a vector of finite numbers of the right size.
        """
        if self._memory is None:
            raise ResetNeeded("call reset() before step(): no episode runs")
        action = _checked(action, (self.steering.actions,))
        steering, memory, part = self.steering, self._memory, self._part
        total = -self._effort * float(_mean_square(action))
        for _ in range(steering.periods):
            command, memory = steering.respond(part, action, memory)
            observation, reward, terminated, truncated, info = self.env.step(command)
            total += float(reward)
            part = steering.split(observation)
            if terminated or truncated:
                break
        self._part, self._memory = part, None if terminated or truncated else memory
        return self._seen(part, memory), total, terminated, truncated, info
