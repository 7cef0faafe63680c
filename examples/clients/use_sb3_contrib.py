# /// script
# dependencies = ["cablebot-gym[sb3]", "sb3-contrib"]
# ///
"""sb3-contrib: TQC. The saved model is a policy file: `cablebot dlcc ID --policy tqc.zip`."""

import gymnasium as gym
from sb3_contrib import TQC

import cablebot_gym
from cablebot_gym import evaluate_dlcc

ENV_ID = cablebot_gym.ENV_IDS[0]

env = gym.make(ENV_ID, normalised_observation=True, terminate_on_violation=True)
model = TQC("MlpPolicy", env, learning_starts=200, seed=0, device="cpu")
model.learn(600)
model.save("tqc.zip")
print(evaluate_dlcc("tqc.zip", ENV_ID, resolution=0.5))
