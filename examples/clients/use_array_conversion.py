# /// script
# dependencies = ["cablebot-gym", "gymnasium[torch,jax]"]
# ///
"""Gymnasium's wrappers convert actions, results and info to torch or JAX."""

import gymnasium as gym
import jax.numpy as jnp
import numpy as np
import torch
from gymnasium.wrappers.vector import ArrayConversion, NumpyToTorch

import cablebot_gym

ENV_ID = cablebot_gym.ENV_IDS[0]

envs = NumpyToTorch(gym.make_vec(ENV_ID, 4, observation_dtype="float32"))
envs.reset(seed=0)
_, in_torch, *_, info = envs.step(torch.full((4, 3), 0.2))
assert all(isinstance(value, torch.Tensor) for value in info.values())

envs = ArrayConversion(gym.make_vec(ENV_ID, 4, observation_dtype="float32"), env_xp=np, target_xp=jnp)
envs.reset(seed=0)
_, in_jax, *_, info = envs.step(jnp.full((4, 3), 0.2))
assert all(isinstance(value, jnp.ndarray) for value in info.values())
print(f"rewards differ by at most {np.abs(in_torch.numpy() - np.asarray(in_jax)).max():.1g}")
