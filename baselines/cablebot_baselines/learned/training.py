"""Training runs with PPO of Stable-Baselines3 (SB3).

A run's folder contains:

* ``policy.zip``, the policy: the actor's weights, arrays only.
* ``log``, SB3's log: ``progress.csv``, and events for TensorBoard. A run that was continued after N
  timesteps has the rest in ``log_N``.
* ``checkpoints``, the files of SB3's ``CheckpointCallback``. SB3 loads them with ``pickle``:
  continue only runs that you trust.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

try:
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import CheckpointCallback
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.vec_env import VecNormalize
except ImportError as error:
    raise ImportError(
        "training needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name
    ) from error

from cablebot_baselines.learned.recipe import (
    N_ENVS,
    TIMESTEPS,
    make_training_envs,
    ppo_settings,
)
from cablebot_baselines.learned.steered import Steered
from cablebot_baselines.learned.steered_policy import save_policy
from cablebot_gym.utils.checks import whole
from cablebot_gym.utils.console import Step
from cablebot_gym.utils.files import check_writable_dir

POLICY = "policy.zip"
CHECKPOINTS = "checkpoints"
"""Names of the file and the folder of a run."""

PARTS = 20
"""Checkpoints of a run."""


@contextmanager
def one_thread() -> Iterator[None]:
    """Limits torch to one thread: more do not speed up so small a network, and they are much slower
    if other processes use the cores."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@one_thread()
def train(
    env_id: str,
    *,
    out: str | Path,
    timesteps: int = TIMESTEPS,
    seed: int = 0,
    n_envs: int = N_ENVS,
    progress: Step | None = None,
) -> PPO:
    """Trains a policy with Stable-Baselines3, or continues the run in ``out`` from its last
    checkpoint.

    The same seed on the same machine gives the same weights, unless the run is continued: the
    episodes are new then, because checkpoints do not have the state of the environments.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        timesteps: number of actions over all robots, in whole rollouts.
        seed: seed of weights, exploration, robots and payloads.
        n_envs: number of robots that step together.
        progress: function called with the progress.

    Raises:
        ValueError: if an argument is invalid, or the checkpoint in ``out`` is that of another
            seed, does not fit the environment or is damaged. No file is changed.
    """
    whole("timesteps", timesteps, least=1)
    whole("seed", seed)
    out = Path(out)
    check_writable_dir(out)
    done = _last_checkpoint(out)
    if progress is not None:  # the robots are compiled first
        progress(done, timesteps)
    envs = make_training_envs(env_id, n_envs, seed=seed + done)
    with closing(envs):
        if done:
            model = _load(out, done, envs)
            if model.seed != seed:
                raise ValueError(
                    f"the run in {str(out)!r} is that of seed {model.seed}: choose another --out"
                )
            model.set_random_seed(seed + done)
        else:
            model = PPO("MlpPolicy", envs, seed=seed, **ppo_settings(n_envs))
        logger = configure(
            str(out / f"log_{done}" if done else out / "log"), ["csv", "tensorboard"]
        )
        model.set_logger(logger)
        try:
            callback = _Checkpoints(model, out, timesteps, progress)
            model.learn(max(0, timesteps - done), callback=callback, reset_num_timesteps=not done)
        finally:
            logger.close()
    return model


def _last_checkpoint(out: Path) -> int:
    """Timesteps of the last complete checkpoint in a folder; 0 without one."""
    files = out.glob(f"{CHECKPOINTS}/rl_model_vecnormalize_*_steps.pkl")  # SB3 writes them last
    return max((int(re.findall(r"\d+", file.name)[0]) for file in files), default=0)


def _load(out: Path, done: int, envs: VecNormalize) -> PPO:
    prefix = out / CHECKPOINTS / "rl_model"
    try:
        envs = VecNormalize.load(f"{prefix}_vecnormalize_{done}_steps.pkl", envs.venv)
        model = PPO.load(f"{prefix}_{done}_steps.zip", env=envs, device="cpu")
    # Damaged files raise errors of zipfile, pickle, json and torch.
    except Exception as error:
        raise ValueError(
            f"the checkpoint in {str(out)!r} cannot be continued ({error}): choose another --out"
        ) from error
    return model


class _Checkpoints(CheckpointCallback):
    """SB3's checkpoints, with the policy and the ceiling of the payloads.

    Args:
        model: the model, which keeps the ceiling as ``payload_ceiling``.
        out: folder of the run.
        timesteps: number of timesteps in all.
        progress: function called with the progress.
    """

    def __init__(self, model: Any, out: Path, timesteps: int, progress: Step | None) -> None:
        every = max(1, timesteps // PARTS // model.n_envs)
        super().__init__(every, str(out / CHECKPOINTS), save_vecnormalize=True)
        self._out, self._timesteps, self._progress = out, timesteps, progress
        steered = model.get_vec_normalize_env().unwrapped.env
        assert isinstance(steered, Steered)
        self._curriculum = steered.curriculum
        self._curriculum.ceiling = getattr(model, "payload_ceiling", self._curriculum.ceiling)

    def _on_step(self) -> bool:
        model: Any = self.model
        model.payload_ceiling = self._curriculum.ceiling
        if self._progress is not None:
            self._progress(min(self.num_timesteps, self._timesteps), self._timesteps)
        if self.n_calls % self.save_freq == 0:
            save_policy(model, self._out / POLICY)
        return super()._on_step()

    def _on_training_end(self) -> None:
        self.n_calls = 0  # saved at multiples of the frequency
        self._on_step()

    def _on_rollout_end(self) -> None:
        self.logger.record("rollout/payload_ceiling", self._curriculum.ceiling)
