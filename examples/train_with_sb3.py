"""Trains PPO of Stable-Baselines3 with the shipped recipe, saves the policy, and evaluates it. Extra
sb3.

The policy shifts the reference of a control law within the error bounds. This training takes about
half a minute; `cablebot train` takes minutes and learns more.

Run it: python examples/train_with_sb3.py [FOLDER [TIMESTEPS]]
"""

import sys
from pathlib import Path

import torch
from stable_baselines3 import PPO

from cablebot_baselines.learned.recipe import make_training_envs, ppo_settings
from cablebot_baselines.learned.steered_policy import save_policy
from cablebot_gym import evaluate_dlcc

ENV_ID = "CableBot-Planar-v0"

if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/sb3")
    timesteps = int(sys.argv[2]) if len(sys.argv) > 2 else 100_000
    torch.set_num_threads(1)  # more threads do not speed up so small a network
    envs = make_training_envs(ENV_ID, 256, seed=0)
    model = PPO("MlpPolicy", envs, seed=0, verbose=1, **ppo_settings(256))
    model.learn(timesteps)
    file = folder / "policy.zip"
    save_policy(model, file)  # cablebot dlcc CableBot-Planar-v0 --policy runs/sb3/policy.zip
    print(evaluate_dlcc(str(file), ENV_ID))
