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

from cablebot_gym.envs import check_spec
from cablebot_gym.envs.outcome import TERMINATION_REASONS, info_dict
from cablebot_gym.envs.pictures import RATE, Pictures, check_render_mode
from cablebot_gym.envs.settings import check_keywords, make_settings
from cablebot_gym.envs.simulation import Simulation
from cablebot_gym.envs.single import SEED_MESSAGE, check_action
from cablebot_gym.kinematics import Array
from cablebot_gym.task import Task

_REASONS = np.array(TERMINATION_REASONS)

VectorStep = tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]


class CableBotVectorEnv(VectorEnv[Array, Array, Array]):
    """N environments :class:`~cablebot_gym.envs.single.CableBotEnv` in one batch.

    Make it with ``gym.make_vec(id, num_envs=N)``. Each environment returns the same numbers as the single environment,
    bit for bit. The keywords and options are those of the single environment. ``payload``, ``payload_known``,
    ``model_payload_factor``, ``initial_error`` and ``uncertainty`` are given once for all environments, or once per
    environment with a leading axis N.

    Args:
        robot: as for the single environment.
        num_envs: number of environments, N.
        max_episode_steps: number of control steps until truncation; None for no limit.
        autoreset_mode: an :class:`AutoresetMode` or its value. An autoreset uses the constructor keywords: reset
            options apply to one episode only.
        render_mode: None or ``rgb_array``.
        keywords: further keywords of the single environment.

    ``info`` contains arrays with a leading axis N, valid for every environment. With same-step autoreset, ``final_obs``
    and ``final_info`` contain the last observation and info of the environments that are marked in ``_final_obs``. The
    reset option ``reset_mask`` (N booleans) restarts the marked environments and leaves the others unchanged.
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
        self.render_mode = check_render_mode(render_mode, self.metadata["render_modes"])
        if not isinstance(num_envs, (int, np.integer)) or num_envs < 1:
            raise ValueError(f"num_envs must be a whole number of at least 1, not {num_envs!r}")
        if max_episode_steps is not None and max_episode_steps < 1:
            raise ValueError(f"max_episode_steps must be at least 1 or None, not {max_episode_steps!r}")
        try:
            self._autoreset = AutoresetMode(autoreset_mode)
        except ValueError:
            modes = ", ".join(mode.value for mode in AutoresetMode)
            raise ValueError(f"unknown autoreset_mode {autoreset_mode!r}; choose one of {modes}") from None
        self.num_envs = int(num_envs)
        self.metadata = {**self.metadata, "autoreset_mode": self._autoreset}
        check_keywords(keywords)
        self.settings = make_settings(robot=robot, count=self.num_envs, **keywords)
        """Checked constructor keywords."""
        self._simulation = Simulation(self.settings, self.num_envs)
        self.layout = self._simulation.layout
        """Layout of the observation: names, slices, units and bounds of its blocks."""
        self._cables = self.settings.robot.cables
        self.single_action_space = Box(-1.0, 1.0, (self._cables,), dtype=np.float32)
        self.single_observation_space = self.layout.space()
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._max_steps = max_episode_steps
        self._steps = np.zeros(self.num_envs, np.int64)
        self._done = np.zeros(self.num_envs, np.bool_)
        self._all_indices = np.arange(self.num_envs)
        self._started = False
        title = self.settings.robot.name
        self._pictures = None if render_mode is None else Pictures(self._simulation, title)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """Tasks of the present episodes: the public knowledge of a policy."""
        return self._simulation.tasks

    @property
    def truth(self) -> dict[str, Array]:
        """True parameters of the present episodes, keys of :data:`cablebot_gym.uncertainty.PARAMETERS`, each (N, …)."""
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
            seed: an integer, which seeds environment i with ``seed + i``, or a sequence of N seeds, or None.
            options: as for the single environment, and ``reset_mask``, N booleans. They apply to the episodes that
                start now.

        Raises:
            ValueError: if an option or a seed is invalid; the environments are unchanged then. At the first reset, also
                if the robot is not of the kind of the id.
            ResetNeeded: if ``reset_mask`` is given at the first reset.
        """
        if not self._started:
            check_spec(self.spec, self.settings.robot)
        env_indices = self._reset_indices(options)
        seeds = self._seeds(seed)
        if not self._started:
            missing = [env_index for env_index, item in enumerate(seeds) if item is None]
            entropy = np.random.SeedSequence().generate_state(len(missing), np.uint64)
            for env_index, item in zip(missing, entropy, strict=True):
                seeds[env_index] = int(item)
        # Seed first, because this reset draws from the streams. An invalid option restores the old seeds.
        before = self._simulation.streams.state()
        seeded = [env_index for env_index in env_indices.tolist() if seeds[env_index] is not None]
        self._simulation.streams.seed(seeded, [seeds[env_index] for env_index in seeded])
        try:
            self._simulation.reset(env_indices, options)
        except Exception:
            self._simulation.streams.restore(before)
            raise
        self._started = True
        self._on_reset(env_indices)
        self._done[env_indices] = False
        return self._simulation.observation.copy(), self._info(self._simulation.info.copy())

    def _reset_indices(self, options: dict[str, Any] | None) -> NDArray[np.int64]:
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return self._all_indices
        mask = np.asarray(mask)
        if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(
                f"reset_mask must be {self.num_envs} booleans with at least one True, not {mask.tolist()!r}"
            )
        if not self._started:
            raise ResetNeeded("the first reset has to start all environments: omit reset_mask")
        return np.flatnonzero(mask)

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        integer = (int, np.integer)
        seeds: list[int | None]
        if isinstance(seed, integer):
            seeds = [int(seed) + env_index for env_index in range(self.num_envs)]
        else:
            seeds = list(seed) if isinstance(seed, (Sequence, np.ndarray)) else [-1]
        if any(item is not None and (not isinstance(item, integer) or item < 0) for item in seeds):
            raise ValueError(SEED_MESSAGE.format(seed))
        if len(seeds) != self.num_envs:
            raise ValueError(
                f"seed must be one number or {self.num_envs} numbers, one for each environment, not {len(seeds)}"
            )
        return [None if item is None else int(item) for item in seeds]

    def step(self, actions: ArrayLike, *, past_end: bool = False) -> VectorStep:
        """Advances every environment by one control period.

        Args:
            actions: actions (N, m).
            past_end: with autoreset disabled, whether a step is allowed while the episodes of some environments have
                ended. A wrapper that resets them later needs this. Their results are meaningless.

        Raises:
            ResetNeeded: before the first reset. With autoreset disabled, also if an episode has ended and ``past_end``
                is False.
            ValueError: if the actions are not (N, m) finite numbers.
        """
        if not self._started:
            raise ResetNeeded("call reset() before step()")
        actions = check_action(actions, (self.num_envs, self._cables))
        if self._autoreset is AutoresetMode.DISABLED and self._done.any() and not past_end:
            raise ResetNeeded("the episode of an environment has ended: call reset(options={'reset_mask': …})")
        simulation, ended = self._simulation, self._done
        simulation.step(actions)
        self._steps += 1
        if self._pictures is not None:
            self._pictures.on_step()
        restarted = ended if self._autoreset is AutoresetMode.NEXT_STEP else np.zeros_like(ended)
        if restarted.any():
            self._restart(restarted)
        reward, terminated = simulation.reward.copy(), simulation.reason > 0
        truncated = self._steps >= self._max_steps if self._max_steps is not None else np.zeros_like(ended)
        self._done = terminated | truncated
        if self._autoreset is AutoresetMode.DISABLED:
            self._done |= ended
        final = {}
        if self._autoreset is AutoresetMode.SAME_STEP and self._done.any():
            final = self._final(self._done)
            self._restart(self._done)
            self._done = np.zeros_like(ended)
        info = self._info(simulation.info.copy()) | final
        return simulation.observation.copy(), reward, terminated, truncated, info

    def _restart(self, mask: NDArray[np.bool_]) -> None:
        env_indices = np.flatnonzero(mask)
        self._simulation.reset(env_indices)
        self._on_reset(env_indices)

    def _on_reset(self, env_indices: NDArray[np.int64]) -> None:
        self._steps[env_indices] = 0
        if self._pictures is not None:
            self._pictures.on_reset(env_indices.tolist())

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture of each environment, as in the single environment, if the render mode is ``rgb_array``; else None.

        Raises:
            ResetNeeded: before the first reset.
        """
        if self._pictures is None:
            return None
        if not self._started:
            raise ResetNeeded("call reset() before render()")
        return tuple(self._pictures.array(env_index) for env_index in range(self.num_envs))

    def _final(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        """Last observation and info of the episodes that have ended, in the form of Gymnasium's vector environments."""
        observations = np.full(self.num_envs, None, dtype=object)
        for env_index in np.flatnonzero(mask):
            observations[env_index] = self._simulation.observation[env_index].copy()
        info = self._info(self._simulation.info.copy())
        info |= {f"_{name}": mask.copy() for name in info}
        return {"final_obs": observations, "_final_obs": mask.copy(), "final_info": info, "_final_info": mask.copy()}

    def _info(self, rows: Array) -> dict[str, Any]:
        return info_dict(rows, self._cables) | {"termination_reason": _REASONS[self._simulation.reason]}
