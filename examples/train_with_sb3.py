"""Trains with Stable-Baselines3 on the compiled batch, saves the model, and evaluates it. Extra sb3.

The policy sets the torques 100 times per second. So short a training keeps it within the limits for
longer, but it still fails unloaded; with a million steps it carries a payload. `cablebot train` steers a
law instead.

Run it: python examples/train_with_sb3.py [FOLDER]
"""

import sys
from pathlib import Path

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from cablebot_baselines.learned.vec_env import make_sb3_vec_env
from cablebot_gym.evaluation import evaluate_dlcc

ENV_ID = "CableBot-Planar-v0"
STEPS = 131_072

if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/sb3")
    torch.set_num_threads(1)  # more threads do not speed up so small a network
    options = {"payload_range": (0, 2), "normalised_observation": True, "terminate_on_violation": True}
    envs = VecMonitor(make_sb3_vec_env(ENV_ID, n_envs=128, seed=0, control_frequency=100, **options))
    envs = VecNormalize(envs, norm_obs=False, gamma=0.98)  # scales the rewards
    learning = {"learning_rate": 1e-3, "gamma": 0.98, "n_steps": 64, "batch_size": 2048, "n_epochs": 8}
    network = {"net_arch": [64, 64], "log_std_init": -1.0}
    model = PPO("MlpPolicy", envs, policy_kwargs=network, seed=0, device="cpu", **learning)
    for share in (0.1, 1.0):
        model.learn(int(share * STEPS) - model.num_timesteps, reset_num_timesteps=False)
        returns = [episode["r"] for episode in model.ep_info_buffer]
        print(f"after {model.num_timesteps} steps: mean return {sum(returns) / len(returns):.1f}")
    folder.mkdir(parents=True, exist_ok=True)
    model.save(folder / "mine.zip")
    print(evaluate_dlcc(str(folder / "mine.zip"), ENV_ID, control_frequency=100))
