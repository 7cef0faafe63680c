# /// script
# dependencies = ["cablebot-gym[sb3]", "rl_zoo3"]
# [tool.clients]
# constraints = "constraints/clients.txt"
# ///
"""RL Baselines3 Zoo trains on the compiled batch, with the configurations that ship with the package."""

import sys
from pathlib import Path

import numpy as np
from rl_zoo3.exp_manager import ExperimentManager
from rl_zoo3.train import train

from cablebot_baselines.learned.recipe import HYPERPARAMS, make_training_envs

ENV_ID = "CableBot-Planar-v0"


def batch(functions, **_):
    """As many environments as functions that make one; RL-Zoo normalises them."""
    return make_training_envs(ENV_ID, len(functions)).venv


ExperimentManager.default_vec_env_cls = staticmethod(batch)
options = f"--algo ppo --env {ENV_ID} --gym-packages cablebot_gym --seed 0 --device cpu --n-eval-envs 1"
options += " --n-timesteps 4096 --eval-freq 2048 --eval-episodes 4"
options += " --log-folder logs --tensorboard-log tensorboard"
options += " --hyperparams n_envs:8 n_steps:128 batch_size:512"  # the file has 1024 environments
sys.argv[1:] = [*options.split(), "--conf-file", str(HYPERPARAMS)]
train()
(file,) = Path("logs").rglob("evaluations.npz")
evaluations = np.load(file)
print(f"mean return {evaluations['results'][-1].mean():.1f} after {evaluations['timesteps'][-1]} steps")
