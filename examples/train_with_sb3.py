"""Trains with Stable-Baselines3 on the compiled batch, saves the model, and evaluates it like any other policy.

After so short a training the policy fails unloaded; `cablebot train` trains longer and steers a law. Extra sb3.

Run it: python examples/train_with_sb3.py [FOLDER]
"""

import sys
from pathlib import Path

import torch
from stable_baselines3 import PPO

from cablebot_baselines.learned.vec_env import make_sb3_vec_env
from cablebot_gym.evaluation import evaluate_dlcc

ENV_ID = "CableBot-Planar-v0"

if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/sb3")
    torch.set_num_threads(1)  # more threads do not speed up so small a network
    envs = make_sb3_vec_env(ENV_ID, n_envs=64, seed=0, payload_range=(0, 2))
    model = PPO("MlpPolicy", envs, n_steps=64, batch_size=1024, n_epochs=4, seed=0, device="cpu")
    model.learn(8_192)
    folder.mkdir(parents=True, exist_ok=True)
    model.save(folder / "mine.zip")
    print(evaluate_dlcc(str(folder / "mine.zip"), ENV_ID))
