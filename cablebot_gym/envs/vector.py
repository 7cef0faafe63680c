"""The vector environment: N episodes in one compiled batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.envs import SpecChecked
from cablebot_gym.envs.outcome import info_dict
from cablebot_gym.envs.pictures import RATE, Pictures, check_render_mode
from cablebot_gym.envs.settings import KEYWORDS
from cablebot_gym.envs.simulation import Simulation
from cablebot_gym.kinematics import Array
from cablebot_gym.task import Task
from cablebot_gym.utils.checks import check_keywords, choice, whole

VectorStep = tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]


class CableBotVectorEnv(SpecChecked, VectorEnv[Array, Array, Array]):
    """N environments :class:`~cablebot_gym.envs.single.CableBotEnv` in one batch.

    Make it with ``gym.make_vec(id, num_envs=N)``. Each environment returns the same numbers as the
    single environment, bit for bit. The keywords and options are those of the single environment.
    ``payload``, ``payload_known``, ``model_payload_factor``, ``initial_error`` and ``uncertainty``
    are given once for all environments, or once per environment with a leading axis N.

    Args:
        robot: as for the single environment.
        num_envs: number of environments, N.
        max_episode_steps: number of control steps after which an episode is truncated, if its
            motion is longer; None for the whole motion.
        autoreset_mode: an :class:`AutoresetMode` or its value. An autoreset uses the constructor
            keywords: reset options apply to one episode only.
        render_mode: None or ``rgb_array``.
        keywords: further keywords of the single environment.

    An environment is truncated by the step that completes its motion. With autoreset disabled it
    may be stepped on without effect on the others: its reference stays at the final pose, and it is
    truncated at every further step.

    ``info`` contains arrays with a leading axis N, valid for every environment. With same-step
    autoreset, ``final_obs`` and ``final_info`` contain the last observation and info of the
    environments that are marked in ``_final_obs``. The reset option ``reset_mask`` (N booleans)
    restarts the marked environments and leaves the others unchanged.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "render_fps": RATE,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        *,
        robot: Any,
        num_envs: int = 1,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **keywords: Any,
    ) -> None:
        check_keywords(keywords, KEYWORDS, type(self))
        self.render_mode = check_render_mode(render_mode, self.metadata["render_modes"])
        self.num_envs = whole("num_envs", num_envs, least=1)
        if max_episode_steps is not None:
            max_episode_steps = whole("max_episode_steps", max_episode_steps, least=1)
        if not isinstance(autoreset_mode, AutoresetMode):
            autoreset_mode = AutoresetMode(
                choice("autoreset_mode", autoreset_mode, [m.value for m in AutoresetMode])
            )
        self.metadata = {**self.metadata, "autoreset_mode": autoreset_mode}
        self.autoreset_mode = autoreset_mode
        """Autoreset mode, an attribute of Gymnasium's own vector environments too."""
        self._simulation = Simulation(robot, (self.num_envs,), keywords)
        self.settings = self._simulation.settings
        """Checked constructor keywords."""
        self.layout = self._simulation.layout
        """Layout of the observation: names, slices, units and bounds of its blocks."""
        self.single_action_space = Box(-1.0, 1.0, (self.settings.robot.cables,), dtype=np.float32)
        self.single_observation_space = self.settings.observation_space()
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._max_steps = max_episode_steps or np.inf
        self._done = np.zeros(self.num_envs, np.bool_)
        self._started = False
        self._pictures: Pictures | None = None
        if render_mode is not None:
            self._pictures = Pictures(self._simulation, self.settings.robot.name)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Tasks of the present episodes: the public knowledge of a policy."""
        return self._simulation.tasks

    @property
    def truth(self) -> dict[str, Array]:
        """True parameters of the present episodes, keys of
        :data:`cablebot_gym.uncertainty.PARAMETERS`, each (N, …)."""
        return {name: values.copy() for name, values in self._simulation.truth.items()}

    @property
    def pose(self) -> Array:
        """True poses X, shape (N, n)."""
        return self._simulation.pose

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of each environment, in the form of Gymnasium's own vector environments."""
        return tuple(self._simulation.streams.seeds.tolist())

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Array, dict[str, Any]]:
        """Starts episodes in all environments, or in those of ``options["reset_mask"]``.

        Args:
            seed: an integer, which seeds environment i with ``seed + i``, or a sequence of N seeds,
                or None.
            options: as for the single environment, and ``reset_mask``, N booleans. They apply to
                the episodes that start now.

        Raises:
            ValueError: if an option or a seed is invalid; the environments are unchanged then.
            ResetNeeded: if ``reset_mask`` is given at the first reset.
        """
        env_indices = self._reset_indices(options)
        seeds = self._seeds(seed)
        if not self._started:
            random_seeds = np.random.SeedSequence().generate_state(self.num_envs, np.uint64)
            for env_index, random_seed in enumerate(random_seeds.tolist()):
                if seeds[env_index] is None:
                    seeds[env_index] = random_seed
        self._reset(env_indices, options, [seeds[env_index] for env_index in env_indices.tolist()])
        self._started = True
        self._done[env_indices] = False
        return self._observation(), self._info()

    def _reset(
        self,
        env_indices: NDArray[np.int64],
        options: dict[str, Any] | None = None,
        seeds: Sequence[int | None] | None = None,
    ) -> None:
        self._simulation.reset(env_indices, options, seeds)
        if self._pictures is not None:
            self._pictures.on_reset(env_indices.tolist())

    def _reset_indices(self, options: dict[str, Any] | None) -> NDArray[np.int64]:
        if not isinstance(options, dict) or options.get("reset_mask") is None:
            return np.arange(self.num_envs)
        mask = np.asarray(options["reset_mask"])
        if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"reset_mask must be {self.num_envs} booleans with at least one True, not {mask!r}"
            )
        if not self._started:
            raise ResetNeeded("the first reset has to start all environments: omit reset_mask")
        return np.flatnonzero(mask)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if not isinstance(seed, (Sequence, np.ndarray)):
            first_seed = whole("seed", seed)
            return list(range(first_seed, first_seed + self.num_envs))
        if len(seed) != self.num_envs:
            raise ValueError(
                f"seed must be an integer or {self.num_envs} integers, one per environment, not {len(seed)}"
            )
        seeds: list[int | None] = []
        for item in seed:
            if item is not None:
                item = whole("seed", item)
            seeds.append(item)
        return seeds

    def step(self, actions: ArrayLike) -> VectorStep:
        """Advances every environment by one control period.

        Args:
            actions: actions (N, m).

        Raises:
            ResetNeeded: before the first reset.
            ValueError: if the actions are not (N, m) finite numbers.
        """
        if not self._started:
            raise ResetNeeded("call reset() before step()")
        simulation = self._simulation
        ended = self._done
        autoreset = self.autoreset_mode
        simulation.step(actions)
        if self._pictures is not None:
            self._pictures.on_step()
        if autoreset is AutoresetMode.NEXT_STEP and ended.any():
            self._reset(np.flatnonzero(ended))
        reward = simulation.reward.copy()
        terminated = simulation.reason > 0
        truncated = simulation.complete | (simulation.steps >= self._max_steps)
        self._done = terminated | truncated
        final = {}
        if autoreset is AutoresetMode.SAME_STEP and self._done.any():
            final = self._final(self._done)
            self._reset(np.flatnonzero(self._done))
        return self._observation(), reward, terminated, truncated, self._info() | final

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture of each environment, as in the single environment, if the render mode is
        ``rgb_array``; else None.

        Raises:
            ResetNeeded: before the first reset.
        """
        if self._pictures is None:
            return None
        if not self._started:
            raise ResetNeeded("call reset() before render()")
        return tuple(map(self._pictures.array, range(self.num_envs)))

    def _final(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Last observation and info of the episodes that have ended, in the form of Gymnasium's
        vector environments."""
        observations = np.full(self.num_envs, None, dtype=object)
        last = self._observation()
        for env_index in np.flatnonzero(mask):
            observations[env_index] = last[env_index]
        info = self._info()
        info |= {f"_{name}": mask.copy() for name in info}
        return {
            "final_obs": observations,
            "_final_obs": mask.copy(),
            "final_info": info,
            "_final_info": mask.copy(),
        }

    def _observation(self) -> Array:
        return self._simulation.observation.astype(self.settings.observation_dtype)

    def _info(self) -> dict[str, Any]:
        info = info_dict(self._simulation.info, self._simulation.cables[:, : self.num_envs])
        return info | {"termination_reason": self._simulation.reason.copy()}
