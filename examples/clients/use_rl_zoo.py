# /// script
# dependencies = ["cablebot-gym[sb3]", "rl_zoo3"]
# [tool.clients]
# constraints = "constraints/clients.txt"
# ///
"""RL Baselines3 Zoo trains with the configurations that ship with the package."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from cablebot_baselines.learned.runs import HYPERPARAMS

ENV_ID = "CableBot-Planar-v0"

options = f"--algo ppo --env {ENV_ID} --gym-packages cablebot_gym --seed 0 --device cpu --n-eval-envs 1"
options += " --n-timesteps 4096 --eval-freq 2048 --eval-episodes 4"
options += " --log-folder logs --tensorboard-log tensorboard"
options += " --hyperparams n_envs:8 n_steps:128 batch_size:512"  # the file has 1024 environments
arguments = [*options.split(), "--conf-file", str(HYPERPARAMS)]
subprocess.run([sys.executable, "-m", "rl_zoo3.train", *arguments], check=True)
(file,) = Path("logs").rglob("evaluations.npz")
evaluations = np.load(file)
print(f"mean return {evaluations['results'][-1].mean():.1f} after {evaluations['timesteps'][-1]} steps")
