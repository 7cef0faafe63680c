# /// script
# dependencies = ["cablebot-gym[sb3]", "onnxscript", "onnxruntime"]
# ///
"""ONNX: a trained actor as a file, and ONNX Runtime as a policy."""

import numpy as np
import onnxruntime
import torch
from stable_baselines3 import PPO

from cablebot_baselines.learned.vec_env import make_sb3_vec_env
from cablebot_gym import evaluate_dlcc

ENV_ID = "CableBot-Planar-v0"

envs = make_sb3_vec_env(ENV_ID, 16, seed=0, terminate_on_violation=True)
model = PPO("MlpPolicy", envs, n_steps=128, batch_size=512, seed=0, device="cpu")
model.learn(20_000)
actor = torch.nn.Sequential(
    model.policy.features_extractor,
    model.policy.mlp_extractor.policy_net,
    model.policy.action_net,
    torch.nn.Hardtanh(),  # the bounds of the action
)
row = torch.zeros(1, envs.observation_space.shape[0])
torch.onnx.export(actor.eval(), (row,), "actor.onnx", input_names=["observation"], external_data=False)
session = onnxruntime.InferenceSession("actor.onnx")


def policy(observation):
    """One number per motor, computed without torch."""
    row = observation[None].astype(np.float32)
    return session.run(None, {"observation": row})[0][0]


print(evaluate_dlcc(policy, ENV_ID, resolution=0.5))
(observation, *_) = envs.reset()
expected, _ = model.predict(observation, deterministic=True)
print(f"actions differ by at most {np.abs(policy(observation) - expected).max():.1g}")
