# /// script
# dependencies = ["cablebot-gym[sb3]", "sbx-rl"]
# ///
"""sbx: Stable-Baselines3's algorithms in JAX."""

import gymnasium as gym
from sbx import SAC

import cablebot_gym
from cablebot_gym import evaluate_dlcc

ENV_ID = cablebot_gym.ENV_IDS[0]

env = gym.make(ENV_ID, normalised_observation=True, terminate_on_violation=True)
model = SAC("MlpPolicy", env, learning_starts=200, seed=0)
model.learn(1000)
print(evaluate_dlcc(model, ENV_ID, resolution=0.5))
