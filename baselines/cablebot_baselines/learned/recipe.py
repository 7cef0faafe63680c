"""The shipped settings for a training of your own with Stable-Baselines3 (SB3): environments,
hyperparameters, export.

The settings are those of ``cablebot train`` for the environment, from
``hyperparams/ppo.yaml``::

    envs = make_training_envs("CableBot-Planar-v0", 256, seed=0)
    model = PPO("MlpPolicy", envs, seed=0, **ppo_settings("CableBot-Planar-v0", 256))
    model.learn(400_000)
    evaluate_dlcc(trained_policy(model), "CableBot-Planar-v0")
"""

from __future__ import annotations

from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.config import Config, make_config
from cablebot_baselines.learned.export import network_from_sb3
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.runs import HYPERPARAMS, read_yaml
from cablebot_baselines.learned.vec_env import CableBotVecEnv
from cablebot_baselines.learned.wrappers import SteeredVector, make_steered_vec


def find_config(env_id: str) -> Config:
    """The shipped settings of PPO for an environment."""
    return make_config(read_yaml(env_id, HYPERPARAMS))


def ppo_settings(env_id: str, n_envs: int | None = None) -> dict[str, Any]:
    """The shipped hyperparameters of PPO for an environment, as keyword arguments of SB3's ``PPO``.

    Without ``policy``, ``env`` and ``seed``. The CPU is faster than an accelerator for networks of
    this size.

    Args:
        env_id: as for :func:`make_training_envs`.
        n_envs: as for :func:`make_training_envs`; the batch size is proportional to it.
    """
    config = find_config(env_id)
    settings = {"device": "cpu", **config.model}
    del settings["policy"]
    if n_envs is not None:
        settings["batch_size"] = max(1, settings["batch_size"] * n_envs // config.n_envs)
    return settings


def make_training_envs(
    env_id: str, n_envs: int | None = None, *, seed: int = 0, config: Config | None = None
) -> VecNormalize:
    """Makes the environments of a training: the learner steers a law, and heavier payloads follow
    its success.

    Observations and rewards are normalised, and an episode ends at its first violation of a limit.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        n_envs: number of environments N; None for that of the settings.
        seed: environment i is seeded with ``seed + i``.
        config: the settings; None for those of :func:`find_config`.

    Raises:
        ValueError: if a setting is invalid.
    """
    if config is None:
        config = find_config(env_id)
    count = config.n_envs if n_envs is None else n_envs
    steered = make_steered_vec(
        env_id, count, wrappers=list(config.wrappers), seed=seed, **config.env_kwargs
    )
    try:
        return VecNormalize(VecMonitor(CableBotVecEnv(steered)), **config.normalize)
    except TypeError as error:
        raise ValueError(
            f"normalize: VecNormalize rejects the settings ({error}): correct the file"
        ) from error


def steered_env(model: PPO) -> SteeredVector:
    """The environments of :func:`make_training_envs` without normalisation, from a model that has
    them.

    Raises:
        ValueError: if the model has other environments.
    """
    envs: Any = model.get_vec_normalize_env()
    steered = getattr(getattr(envs, "unwrapped", None), "env", None)
    if not isinstance(steered, SteeredVector):
        raise ValueError(
            "the model must have the environments that it was trained on, from make_training_envs"
        )
    return steered


def trained_policy(model: PPO) -> LearnedPolicy:
    """The policy of a model that was trained on :func:`make_training_envs`, without exploration.

    ``trained_policy(model).bundle.save("mine.zip")`` stores it for ``cablebot dlcc ID --policy
    mine.zip``.

    Raises:
        ValueError: if the model has other environments, or its network cannot be exported.
    """
    env = steered_env(model)
    assert env.spec is not None
    steering = env.steering
    bundle = Bundle.of_steering(env.spec.id, steering, network_from_sb3(model))
    return LearnedPolicy(bundle, steering.robot)
