# /// script
# dependencies = ["cablebot-gym[sb3]", "stable-baselines3"]
# ///
"""Stable-Baselines3 trains on the compiled batch; `tensorboard --logdir logs` shows the log."""

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from cablebot_baselines.learned.vec_env import make_sb3_vec_env
from cablebot_gym import evaluate_dlcc

ENV_ID = "CableBot-Planar-v0"

options = {
    "normalised_observation": True,
    "terminate_on_violation": True,
    "observation_dtype": "float32",
}
envs = VecMonitor(make_sb3_vec_env(ENV_ID, 16, seed=0, **options))
model = PPO("MlpPolicy", envs, n_steps=128, batch_size=512, seed=0, device="cpu", tensorboard_log="logs")
model.learn(20_000)
print(evaluate_dlcc(model, ENV_ID, resolution=0.5))
