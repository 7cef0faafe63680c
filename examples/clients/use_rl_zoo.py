# /// script
# dependencies = ["cablebot-gym[sb3]", "rl_zoo3"]
# [tool.clients]
# constraints = "constraints/clients.txt"
# ///
"""RL Baselines3 Zoo trains on the compiled batch, with the environments of the shipped recipe."""

import sys
from pathlib import Path

import numpy as np
from rl_zoo3.exp_manager import ExperimentManager
from rl_zoo3.train import train

from cablebot_baselines.learned.recipe import make_training_envs

ENV_ID = "CableBot-Planar-v0"
SETTINGS = f"""
{ENV_ID}:
  n_timesteps: 4096
  n_envs: 8
  policy: MlpPolicy
  n_steps: 128
  batch_size: 512
  learning_rate: lin_1e-3
  use_sde: true
"""


def batch(functions, **_):
    """As many environments as functions that make one; RL-Zoo normalises them."""
    return make_training_envs(ENV_ID, len(functions)).venv


Path("ppo.yaml").write_text(SETTINGS, encoding="utf-8")
ExperimentManager.default_vec_env_cls = staticmethod(batch)
options = f"--algo ppo --env {ENV_ID} --gym-packages cablebot_gym --seed 0 --device cpu --n-eval-envs 1"
options += " --eval-freq 2048 --eval-episodes 4 --conf-file ppo.yaml"
options += " --log-folder logs --tensorboard-log tensorboard"
sys.argv[1:] = options.split()
train()
(file,) = Path("logs").rglob("evaluations.npz")
evaluations = np.load(file)
print(f"mean return {evaluations['results'][-1].mean():.1f} after {evaluations['timesteps'][-1]} steps")
