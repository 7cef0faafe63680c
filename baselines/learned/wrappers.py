"""Gymnasium wrappers that a learner trains through: the task's limits, heavier payloads step by step, a steered law.

Each stands around a single environment of this package, and has a twin for N at once, :class:`CableBotVectorEnv` made
with autoreset disabled; a lane of the twin is the single environment bit for bit. Arguments are plain JSON-able data.
The order from the inside out: :class:`WithinLimits`, :class:`PayloadCurriculum`, :class:`Steered`.
"""

from __future__ import annotations

import inspect
import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from numbers import Real
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

import cablebot_gym  # noqa: F401 - registers the ids
from baselines.classical.law import Array
from baselines.learned.base import Base, find_base
from baselines.learned.steering import Memory, Residual, Shift, Steering, find_way
from cablebot_gym.envs.settings import Settings
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.envs.streams import Purpose, Streams
from cablebot_gym.envs.vector import CableBotVectorEnv, VectorStep

SATURATED = 0.97
"""Drive command beyond which a motor counts as saturated, a little before it is."""

HEAVY = 2 / 3
"""Share of the ceiling from which a payload counts for raising it."""

SingleStep = tuple[Array, float, bool, bool, dict[str, Any]]


class _Single(gym.Wrapper[Array, ArrayLike, Array, ArrayLike], RecordConstructorArgs):
    """Around a single environment of this package.

    Raises:
        TypeError: if the environment is none.
        ValueError: if the wrappers beneath are in the wrong order.
    """

    env: gym.Env[Array, ArrayLike]

    def __init__(self, env: gym.Env[Array, ArrayLike], **arguments: Any) -> None:
        RecordConstructorArgs.__init__(self, **arguments)
        if not isinstance(env, gym.Env) or not isinstance(env.unwrapped, CableBotEnv):
            raise TypeError(f"{type(self).__name__} needs an environment of this package, from gym.make, not {env!r}")
        gym.Wrapper.__init__(self, env)
        _check_order(self)
        self._plant: CableBotEnv = env.unwrapped


class _Many(VectorWrapper[Array, ArrayLike, Array, ArrayLike, Array]):
    """Around N environments of this package, which do not restart on their own.

    Raises:
        TypeError: if the environment is no :class:`CableBotVectorEnv`.
        ValueError: if it has another autoreset mode, or the wrappers beneath are in the wrong order.
    """

    env: Any

    def __init__(self, env: VectorEnv[Array, ArrayLike, Array]) -> None:
        name = type(self).__name__
        if not isinstance(env, VectorEnv) or not isinstance(env.unwrapped, CableBotVectorEnv):
            raise TypeError(f"{name} needs N environments of this package as one batch, from gym.make_vec, not {env!r}")
        super().__init__(env)
        _check_order(self)
        mode = env.metadata.get("autoreset_mode")
        if mode is not AutoresetMode.DISABLED:
            raise ValueError(
                f"{name} needs environments that do not restart on their own, not {getattr(mode, 'name', mode)}: "
                "make them by gym.make_vec(…, autoreset_mode=AutoresetMode.DISABLED), or all by make_steered_vec"
            )
        self._plant: CableBotVectorEnv = env.unwrapped


def _layers(env: Any) -> Iterator[Any]:
    """An environment's wrappers, from the outside in."""
    while isinstance(env, (gym.Wrapper, VectorWrapper)):
        yield env
        env = env.env


def _check_order(env: Any) -> None:
    """Refuses what a wrapper cannot stand around.

    Raises:
        ValueError: naming the right order.
    """
    beneath = list(_layers(env))[1:]
    if any(isinstance(layer, (Steered, SteeredVector)) for layer in beneath):
        why = "has to see every control period"
    elif isinstance(env, (WithinLimits, WithinLimitsVector)) and any(
        isinstance(layer, (PayloadCurriculum, PayloadCurriculumVector)) for layer in beneath
    ):
        why = "ends episodes of which PayloadCurriculum has to hear"
    else:
        return
    raise ValueError(
        f"{type(env).__name__} {why}: the order is WithinLimits, PayloadCurriculum, Steered, the first one innermost"
    )


def _marked(options: Mapping[str, Any] | None, count: int) -> NDArray[np.bool_]:
    """The environments that a reset has restarted."""
    mask = (options or {}).get("reset_mask")
    return np.ones(count, np.bool_) if mask is None else np.array(mask, np.bool_)


# ------------------------------------------------------------------------------------------------- the task's limits


class _Rule:
    """Reward and end of an episode within limits, of N at once."""

    def __init__(self, alive: float, failure: float, saturation: float) -> None:
        for name, value in (("alive", alive), ("failure", failure), ("saturation", saturation)):
            _check_number(name, value, 0.0)
        self._alive, self._failure, self._saturation = float(alive), float(failure), float(saturation)

    def reason(self, info: Mapping[str, Any], bounds: Array, judged: NDArray[np.bool_]) -> NDArray[np.str_]:
        """Why each episode ends by failing, (N,); empty where it goes on. What the environment itself says comes first.

        Args:
            info: the environment's, arrays (N, …).
            bounds: of position and rotation, (N, 2) [m, rad].
            judged: whether the motion still lasts, (N,).
        """
        found = np.select(
            [
                judged & info["slack"].any(axis=-1),
                judged & (info["tracking_error_peak"] > bounds[:, 0]),
                judged & (info["rotation_error_peak"] > bounds[:, 1]),
            ],
            ["slack", "tracking_error", "rotation_error"],
            "",
        )
        own = info["termination_reason"]
        return np.where(own != "", own, found)

    def reward(self, info: Mapping[str, Any], terminated: NDArray[np.bool_]) -> Array:
        """Of one control period, (N,)."""
        beyond = np.maximum(np.abs(info["drive_demand"]) - SATURATED, 0.0).mean(axis=-1)
        return self._alive - self._failure * terminated - self._saturation * beyond


def _motion_steps(settings: Settings) -> int:
    """Control steps of the default motion, as :attr:`cablebot_gym.task.Task.steps`."""
    return round(settings.trajectory.duration * settings.control_frequency)


class WithinLimitsVector(_Many):
    """N :class:`WithinLimits`; arguments and errors as there."""

    def __init__(
        self,
        env: VectorEnv[Array, ArrayLike, Array],
        *,
        alive: float = 0.02,
        failure: float = 1.0,
        saturation: float = 0.02,
    ) -> None:
        super().__init__(env)
        self._rule = _Rule(alive, failure, saturation)
        self._bounds, self._needed = np.zeros((self.num_envs, 2)), np.zeros(self.num_envs, np.int64)
        self._steps = np.zeros(self.num_envs, np.int64)
        self._ended, self._succeeded = (np.zeros(self.num_envs, np.bool_) for _ in range(2))
        self._reason = np.full(self.num_envs, "", "<U14")

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts episodes, which are not judged yet; ``info`` has ``is_success``."""
        observation, info = self.env.reset(seed=seed, options=options)
        marked = _marked(options, self.num_envs)
        settings = self._plant.settings
        limits, steps = settings.limits, _motion_steps(settings)
        if options and ("limits" in options or "trajectory" in options):  # so many tasks take their time to make
            task = self._plant.tasks[int(np.argmax(marked))]
            limits, steps = task.limits, task.steps
        self._bounds[marked], self._needed[marked] = (limits.position, limits.rotation), steps
        self._steps[marked], self._reason[marked] = 0, ""
        self._ended[marked] = self._succeeded[marked] = False
        return observation, info | self._told()

    def _told(self) -> dict[str, Any]:
        return {"termination_reason": self._reason.copy(), "is_success": self._succeeded.copy()}

    def step(self, actions: ArrayLike, *, past_end: bool = False) -> VectorStep:
        """One control period.

        Raises:
            ResetNeeded: for an environment that has ended, unless ``past_end``.
            ValueError: if the actions are not (N, m) finite numbers.
        """
        if self._ended.any() and not past_end:
            raise ResetNeeded("an environment has ended: restart it by reset(options={'reset_mask': …})")
        observation, _, _, truncated, info = self.env.step(actions, past_end=past_end)
        self._reason = self._rule.reason(info, self._bounds, self._steps < self._needed)
        self._steps += 1
        terminated = self._reason != ""
        self._succeeded = truncated & ~terminated
        self._ended |= truncated | terminated
        reward = self._rule.reward(info, terminated)
        return observation, reward, terminated, truncated, info | self._told()


class WithinLimits(_Single):
    """Ends an episode where the task criterion would fail, and rewards lasting until the end.

    An episode terminates where the position or rotation error exceeds its bound at any physics step, or a cable is
    slack, while the motion lasts, as :class:`cablebot_gym.dlcc.DLCCMonitor` judges it; the start itself is not
    judged. It also terminates where the environment itself ends it. ``info["termination_reason"]`` is ``slack``,
    ``tracking_error``, ``rotation_error``, or the environment's own. ``info["is_success"]`` is true where an episode
    ends without terminating, and false before.

    The bounds are those of the episode, ``env.unwrapped.task.limits``. The reward takes the place of the
    environment's: ``alive − failure · terminated − saturation · mean(max(0, |a| − 0.97))``, the mean over the cables.

    Args:
        env: a single environment of this package.
        alive: per control period.
        failure: what terminating costs.
        saturation: what a drive command beyond ±0.97 costs.

    Raises:
        TypeError: if the environment is none of this package's.
        ValueError: if an argument is negative or no finite number, or the environment is already steered.
    """

    vector: ClassVar[type[WithinLimitsVector]] = WithinLimitsVector

    def __init__(
        self,
        env: gym.Env[Array, ArrayLike],
        *,
        alive: float = 0.02,
        failure: float = 1.0,
        saturation: float = 0.02,
    ) -> None:
        super().__init__(env, alive=alive, failure=failure, saturation=saturation)
        self._rule = _Rule(alive, failure, saturation)
        self._bounds = np.zeros((1, 2))
        self._steps = self._needed = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode, which is not judged yet; ``info`` has ``is_success``."""
        observation, info = self.env.reset(seed=seed, options=options)
        task = self._plant.task
        self._bounds[0] = task.limits.position, task.limits.rotation
        self._steps, self._needed = 0, task.steps
        return observation, info | {"is_success": False}

    def step(self, action: ArrayLike) -> SingleStep:
        """One control period.

        Raises:
            ValueError: if the action is not m finite numbers.
        """
        observation, _, _, truncated, info = self.env.step(action)
        read = ("slack", "tracking_error_peak", "rotation_error_peak", "termination_reason", "drive_demand")
        batch = {name: np.asarray(info[name])[None] for name in read}
        reason = self._rule.reason(batch, self._bounds, np.array([self._steps < self._needed]))
        self._steps += 1
        reward, terminated = float(self._rule.reward(batch, reason != "")[0]), bool(reason[0] != "")
        ended = {"termination_reason": str(reason[0]), "is_success": truncated and not terminated}
        return observation, reward, terminated, truncated, info | ended


# --------------------------------------------------------------------------------------- heavier payloads step by step


class _Ceiling:
    """How heavy payloads may be by now."""

    def __init__(
        self, *, heaviest: float, power: float, start: float | None, step: float, success: float, window: int
    ) -> None:
        _check_number("heaviest", heaviest, 0.0, above=True)
        _check_number("power", power, 0.0, above=True)
        _check_number("start", heaviest if start is None else start, 0.0, heaviest)
        _check_number("step", step, 0.0, 1.0, above=True)
        _check_number("success", success, 0.0, 1.0)
        if not isinstance(window, (int, np.integer)) or isinstance(window, bool) or window < 1:
            raise ValueError(f"window must be a whole number of episodes of at least 1, not {window!r}")
        self._heaviest, self._power, self._step = float(heaviest), float(power), float(step)
        self._success, self._lately = float(success), deque[bool](maxlen=int(window))
        self.value = self._heaviest if start is None else float(start)

    def drawn(self, uniform: Array) -> Array:
        """Payloads [kg] for numbers in [0, 1)."""
        payload: Array = self.value * uniform**self._power
        return payload

    def count(self, payload: float, carried: bool) -> None:
        """Raises the ceiling if enough of the last heavy payloads were carried."""
        lately = self._lately
        if self.value >= self._heaviest or not payload >= HEAVY * self.value:  # NaN is not
            return
        lately.append(carried)
        if len(lately) == lately.maxlen and sum(lately) >= self._success * len(lately):
            self.value = min(self.value + self._step * self._heaviest, self._heaviest)
            lately.clear()


class _Payloads:
    """Payloads of N lanes: seeded, drawn at each reset, counted once at each end."""

    def __init__(self, count: int, ceiling: _Ceiling) -> None:
        self.ceiling = ceiling
        self._streams = Streams(count)
        self._payload = np.full(count, np.nan)
        self._running = np.zeros(count, np.bool_)
        self._everyone = np.arange(count)
        self._begun = False

    def drawn(self, seeds: Sequence[Any], lanes: NDArray[np.int64]) -> Array:
        """Moves ``lanes`` on to their next episodes and draws for them, (N,) [kg]; 0 for the others.

        Seeds that no environment takes are left for it to refuse; afterwards :meth:`restore` takes all back.
        """
        streams, whole = self._streams, (int, np.integer)
        if not self._begun:
            entropy = np.random.SeedSequence().generate_state(len(self._everyone), np.uint64)
            streams.seed(self._everyone.tolist(), entropy.tolist())
        sane = {lane: int(seeds[lane]) for lane in lanes[lanes < len(seeds)].tolist() if isinstance(seeds[lane], whole)}
        sane = {lane: seed for lane, seed in sane.items() if seed >= 0}
        streams.seed(list(sane), list(sane.values()))
        streams.begin(lanes)
        payload = np.zeros(len(self._everyone))
        payload[lanes] = self.ceiling.drawn(streams.uniform(lanes, Purpose.PAYLOAD, 1)[:, 0])
        return payload

    def standing(self) -> Any:
        """Where the streams stand, for :meth:`restore`."""
        return self._streams.standing()

    def restore(self, standing: Any) -> None:
        """Puts the streams back to where they stood."""
        self._streams.restore(standing)

    def begin(self, lanes: NDArray[np.int64], payload: Array | None) -> None:
        """The episodes of ``lanes`` have begun; of payloads that were not drawn, None, nothing is learnt."""
        self._payload[lanes] = np.nan if payload is None else payload[lanes]
        self._running[lanes] = self._begun = True

    def count(self, terminated: NDArray[np.bool_], ended: NDArray[np.bool_]) -> None:
        """Counts the episodes that have just ended."""
        ended = ended & self._running
        if ended.any():
            self._running &= ~ended
            for lane in np.flatnonzero(ended).tolist():
                self.ceiling.count(float(self._payload[lane]), not terminated[lane])


class PayloadCurriculumVector(_Many):
    """N :class:`PayloadCurriculum` under one ceiling; arguments and errors as there. Lane i is seeded ``seed + i``."""

    def __init__(
        self,
        env: VectorEnv[Array, ArrayLike, Array],
        *,
        heaviest: float,
        power: float = 0.6,
        start: float | None = None,
        step: float = 0.05,
        success: float = 0.8,
        window: int = 64,
    ) -> None:
        super().__init__(env)
        ceiling = _Ceiling(heaviest=heaviest, power=power, start=start, step=step, success=success, window=window)
        self._payloads = _Payloads(self.num_envs, ceiling)

    @property
    def ceiling(self) -> float:
        """The heaviest payload by now [kg]."""
        return self._payloads.ceiling.value

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts episodes with payloads drawn, unless ``options`` have one; what it refuses changes nothing.

        Raises:
            ValueError: if a seed or an option is not valid.
        """
        one, several = isinstance(seed, (int, np.integer)), isinstance(seed, (Sequence, np.ndarray))
        seeds = [seed + lane for lane in range(self.num_envs)] if one else list(seed) if several else []
        marked = _marked(options, self.num_envs)
        lanes = np.flatnonzero(marked) if marked.shape == (self.num_envs,) else np.arange(0)  # the other is refused
        before = self._payloads.standing()
        payload = self._payloads.drawn(seeds, lanes)
        given = "payload" in (options or {})
        try:
            result = self.env.reset(seed=seed, options=options if given else {**(options or {}), "payload": payload})
        except Exception:
            self._payloads.restore(before)
            raise
        self._payloads.begin(lanes, None if given else payload)
        return result

    def step(self, actions: ArrayLike, *, past_end: bool = False) -> VectorStep:
        """One control period; an episode counts when it first ends."""
        result: VectorStep = self.env.step(actions, past_end=past_end)
        self._payloads.count(result[2], result[2] | result[3])
        return result


class PayloadCurriculum(_Single):
    """Draws the payload of each episode, and heavier ones as the heavy ones are carried.

    Each reset draws ``ceiling · U^power`` [kg], U uniform in [0, 1) from a stream of its own that ``reset(seed=…)``
    seeds, and passes it on as the option ``payload``; one that the caller gives counts instead, and for that episode
    only. The ceiling rises by ``step · heaviest`` when at least the share ``success`` of the last ``window`` episodes
    with payloads in the ceiling's upper third ended without terminating; each rise takes a window of its own.

    Args:
        env: a single environment of this package; within :class:`WithinLimits`, if that is used.
        heaviest: the last ceiling [kg]; > 0.
        power: below 1, heavy payloads are commoner; > 0.
        start: the first ceiling [kg]; None for ``heaviest``, a distribution that never changes.
        step: of the ceiling, as a share of ``heaviest``; in (0, 1].
        success: share that has to be carried, in [0, 1].
        window: number of episodes; ≥ 1.

    Raises:
        TypeError: if the environment is none of this package's.
        ValueError: if an argument is out of its range, or the environment is already steered.
    """

    vector: ClassVar[type[PayloadCurriculumVector]] = PayloadCurriculumVector

    def __init__(
        self,
        env: gym.Env[Array, ArrayLike],
        *,
        heaviest: float,
        power: float = 0.6,
        start: float | None = None,
        step: float = 0.05,
        success: float = 0.8,
        window: int = 64,
    ) -> None:
        rule: dict[str, Any] = {"heaviest": heaviest, "power": power, "start": start, "step": step}
        rule |= {"success": success, "window": window}
        super().__init__(env, **rule)
        self._payloads = _Payloads(1, _Ceiling(**rule))
        self._lane = np.zeros(1, np.int64)

    @property
    def ceiling(self) -> float:
        """The heaviest payload by now [kg]."""
        return self._payloads.ceiling.value

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Starts an episode with a payload drawn, unless ``options`` have one; what it refuses changes nothing.

        Raises:
            ValueError: if the seed or an option is not valid.
        """
        before = self._payloads.standing()
        payload = self._payloads.drawn([seed], self._lane)
        given = "payload" in (options or {})
        asked = options if given else {**(options or {}), "payload": float(payload[0])}
        try:
            result = self.env.reset(seed=seed, options=asked)
        except Exception:
            self._payloads.restore(before)
            raise
        self._payloads.begin(self._lane, None if given else payload)
        return result

    def step(self, action: ArrayLike) -> SingleStep:
        """One control period; an episode counts when it first ends."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._payloads.count(np.array([terminated]), np.array([terminated or truncated]))
        return observation, float(reward), terminated, truncated, info


# ------------------------------------------------------------------------------------------------------- a steered law


def _steering(
    plant: CableBotEnv | CableBotVectorEnv,
    base: Base | str | Mapping[str, Any],
    steering: Shift | Residual | str | Mapping[str, Any],
    features: Sequence[str],
) -> tuple[Steering, Box, Box]:
    """The law at work, and the spaces of a learner's observations and actions."""
    made = Steering(plant.settings.robot, base=find_base(base), way=find_way(steering), features=features)
    part = made.split(np.zeros(plant.layout.size))
    seen = made.seen(part, made.remembered(part, None, None))
    return made, Box(-np.inf, np.inf, seen.shape, np.float32), Box(-1.0, 1.0, (made.actions,), np.float32)


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


class SteeredVector(_Many):
    """N :class:`Steered` with same-step autoreset; arguments as there.

    An environment that ends within an action stands still for its rest as far as anybody can see, and is then
    restarted: ``final_obs`` and ``final_info`` hold its last observation and info as they were when it ended, in the
    form of :class:`CableBotVectorEnv`.

    Raises:
        TypeError: if the environment is no :class:`CableBotVectorEnv`.
        ValueError: as :class:`Steered`, or if its autoreset is not disabled.
    """

    def __init__(
        self,
        env: VectorEnv[Array, ArrayLike, Array],
        *,
        base: Base | str | Mapping[str, Any],
        steering: Shift | Residual | str | Mapping[str, Any],
        features: Sequence[str],
    ) -> None:
        super().__init__(env)
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
        marked = _marked(options, self.num_envs)
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
        """One action: :attr:`Steering.periods` control periods, and what comes of them.

        Raises:
            ResetNeeded: before the first reset.
            ValueError: if the actions are not (N, size) finite numbers.
        """
        if self._memory is None:
            raise ResetNeeded("call reset() before step()")
        actions = _checked(actions, (self.num_envs, self.steering.actions))
        steering, memory, part, start = self.steering, self._memory, self._part, self._start
        total = np.zeros(self.num_envs)
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


class Steered(_Single):
    """A learner's action steers a classical law for some control periods: it shifts its reference or adds to its drive.

    A step is one action, held for :attr:`Steering.periods` control periods; their rewards are summed, and an episode
    that ends within them ends there. ``info`` is that of the last control period, so wrappers that watch it go within.
    Actions are numbers in [−1, 1], cut to that; the observation, float32, is made of ``features``, see
    :mod:`baselines.learned.features`. What such a learner has learnt is kept in a
    :class:`baselines.learned.bundle.Bundle` of the same three arguments.

    Args:
        env: a single environment of this package, other wrappers within.
        base: the law, as its name, ``{"law": …, "gains": …}`` or a :class:`Base`.
        steering: ``"shift"``, ``"residual"``, ``{"kind": "shift", "hold": 0.04, …}``, or what these make.
        features: names, in the order of the observation.

    Raises:
        TypeError: if the environment is none of this package's.
        ValueError: if an argument is not valid, the law is not made for the robot, or the environment is already
            steered.
    """

    vector: ClassVar[type[SteeredVector]] = SteeredVector

    def __init__(
        self,
        env: gym.Env[Array, ArrayLike],
        *,
        base: Base | str | Mapping[str, Any],
        steering: Shift | Residual | str | Mapping[str, Any],
        features: Sequence[str],
    ) -> None:
        super().__init__(env, base=base, steering=steering, features=features)
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
        """One action: :attr:`Steering.periods` control periods, or as many as the episode lasts.

        Raises:
            ResetNeeded: before the first reset, and after the end of an episode.
            ValueError: if the action is not a vector of finite numbers of the right size.
        """
        if self._memory is None:
            raise ResetNeeded("call reset() before step(): no episode runs")
        action = _checked(action, (self.steering.actions,))
        steering, memory, part, total = self.steering, self._memory, self._part, 0.0
        for _ in range(steering.periods):
            command, memory = steering.respond(part, action, memory)
            observation, reward, terminated, truncated, info = self.env.step(command)
            total += float(reward)
            part = steering.split(observation)
            if terminated or truncated:
                break
        self._part, self._memory = part, None if terminated or truncated else memory
        return self._seen(part, memory), total, terminated, truncated, info


# -------------------------------------------------------------------------------------------------------------- making


def make_steered_vec(
    env_id: str,
    n_envs: int,
    *,
    wrappers: Sequence[tuple[type[Any], Mapping[str, Any]]],
    seed: int | None = None,
    **keywords: Any,
) -> SteeredVector:
    """N environments of one id as one compiled batch, within the twins of single wrappers.

    ``CableBotVecEnv(make_steered_vec(…))`` is what Stable-Baselines3 trains on.

    Args:
        env_id: out of :data:`cablebot_gym.ENV_IDS`.
        n_envs: N.
        wrappers: classes and their arguments, the first one innermost, the last one :class:`Steered`.
        seed: environment i is reset with ``seed + i``, and the action space is seeded; later resets go on from there.
        keywords: the environment's, see ``help(gym.make(env_id).unwrapped)``, and ``max_episode_steps``.

    Raises:
        gymnasium.error.Error: if the id is unknown.
        ValueError: if the last wrapper is not :class:`Steered`, their order is wrong, one of them has no twin, or an
            argument is unknown, missing or not valid.
    """
    for made, arguments in wrappers:
        _check_arguments(made, arguments)
    if not wrappers or wrappers[-1][0] is not Steered:
        names = ", ".join(made.__name__ for made, _ in wrappers) or "nothing"
        raise ValueError(f"the last of wrappers, the outermost, must be Steered: there is {names}")
    env: Any = gym.make_vec(env_id, num_envs=n_envs, autoreset_mode=AutoresetMode.DISABLED, **keywords)
    try:
        for made, arguments in wrappers:
            env = made.vector(env, **arguments)
        if seed is not None:
            env.reset(seed=seed)
            env.action_space.seed(seed)
    except BaseException:
        env.close()
        raise
    steered: SteeredVector = env
    return steered


def _check_arguments(made: type[Any], arguments: Mapping[str, Any]) -> None:
    """Refuses wrappers without a twin, and arguments that they do not have, or lack.

    Raises:
        ValueError: naming those there are.
    """
    name = getattr(made, "__name__", repr(made))
    if not hasattr(made, "vector"):
        raise ValueError(f"wrappers: {name} has no twin for batches, an attribute 'vector'; there are {_NAMES}")
    known = {key: value for key, value in inspect.signature(made).parameters.items() if key != "env"}
    if unknown := [key for key in arguments if key not in known]:
        raise ValueError(f"wrappers: {name} has no argument {unknown[0]!r}; it takes {', '.join(known)}")
    if missing := [key for key, value in known.items() if value.default is value.empty and key not in arguments]:
        raise ValueError(f"wrappers: {name} needs {', '.join(missing)} too")


_NAMES = ", ".join(made.__name__ for made in (WithinLimits, PayloadCurriculum, Steered))


def _check_number(name: str, value: Any, low: float, high: float = math.inf, *, above: bool = False) -> None:
    """Refuses what is no finite number within the bounds, or, ``above`` the lower one.

    Raises:
        ValueError: naming the bounds.
    """
    number = isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
    if not number or not low <= value <= high or (above and value == low):
        least = f"greater than {low:g}" if above else f"of at least {low:g}"
        most = f" and at most {high:g}" if high < math.inf else ""
        raise ValueError(f"{name} must be a number {least}{most}, not {value!r}")
