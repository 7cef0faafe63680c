"""The recipe of reinforcement learning: PPO of Stable-Baselines3 (SB3) for every environment.

``cablebot train`` uses the same functions::

    envs = make_training_envs("CableBot-Planar-v0", seed=0)
    model = PPO("MlpPolicy", envs, seed=0, **ppo_settings())
    model.learn(400_000)
    save_policy(model, "mine.zip")
"""

from __future__ import annotations

from typing import Any

from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from cablebot_baselines.learned.steered import Steered
from cablebot_baselines.learned.vec_env import CableBotVecEnv

N_ENVS = 512
"""Robots that step together."""

TIMESTEPS = 800_000
"""Actions of a training over all robots."""

GAMMA = 0.995
"""Discount of an action."""


def ppo_settings(n_envs: int = N_ENVS) -> dict[str, Any]:
    """Keyword arguments of SB3's ``PPO`` for N robots, without ``policy``, ``env`` and ``seed``.

    The CPU is faster than an accelerator for networks of this size.
    """
    return {
        "n_steps": 20,
        "batch_size": 4 * n_envs,
        "n_epochs": 4,
        "gamma": GAMMA,
        # Noise that changes with every action shakes the platform: this one changes with the state.
        "use_sde": True,
        "sde_sample_freq": 20,
        "learning_rate": LinearSchedule(1e-3, 0.0, 1.0),
        "policy_kwargs": {"net_arch": [64, 64], "log_std_init": -2.0},
        "device": "cpu",
    }


def make_training_envs(env_id: str, n_envs: int = N_ENVS, *, seed: int = 0) -> VecNormalize:
    """Makes the environments of a training, see :class:`~cablebot_baselines.learned.steered.Steered`.
    Their rewards are normalised.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        n_envs: number of robots N.
        seed: seed of robots and payloads.
    """
    vec_env = CableBotVecEnv(Steered(env_id, n_envs))
    vec_env.seed(seed)
    return VecNormalize(VecMonitor(vec_env), norm_obs=False, gamma=GAMMA)
