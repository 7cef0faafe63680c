# /// script
# dependencies = ["cablebot-gym", "torch", "tensorboard", "tyro"]
# [tool.clients]
# package = "CleanRL"
# repository = "https://github.com/vwxyzjn/cleanrl"
# ///
"""CleanRL: its scripts are files, not a package; run this in a clone of the repository.

The scripts are written for Gymnasium 0.29. Since Gymnasium 1.0, one of their wrappers needs the
observation space.
"""

import subprocess
import sys
from pathlib import Path

old = "np.clip(obs, -10, 10))"
script = Path("cleanrl/ppo_continuous_action.py").read_text(encoding="utf-8")
assert script.count(old) == 1
Path("ppo.py").write_text(
    script.replace(old, "np.clip(obs, -10, 10), env.observation_space)"), encoding="utf-8"
)

arguments = [
    "--env-id",
    "cablebot_gym:CableBot-Planar-v0",
    "--num-envs",
    "4",
    "--total-timesteps",
    "16384",
    "--no-cuda",
]
ran = subprocess.run(
    [sys.executable, "ppo.py", *arguments], check=True, stdout=subprocess.PIPE, text=True
)
print("16384 steps;", ran.stdout.splitlines()[-1], "(steps per second)")
