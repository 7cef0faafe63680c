# /// script
# dependencies = ["cablebot-gym", "skrl[torch]"]
# ///
"""skrl: PPO on the compiled batch."""

import gymnasium as gym
import torch
from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.trainers.torch import SequentialTrainer
from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model

import cablebot_gym

options = {
    "normalised_observation": True,
    "observation_dtype": "float32",
    "terminate_on_violation": True,
}
env = wrap_env(gym.make_vec(cablebot_gym.ENV_IDS[0], 16, **options))
spaces = {
    "observation_space": env.observation_space,
    "action_space": env.action_space,
    "device": env.device,
}
network = [{"name": "net", "input": "OBSERVATIONS", "layers": [64, 64], "activations": "elu"}]
models = {
    "policy": gaussian_model(**spaces, network=network, output="ACTIONS"),
    "value": deterministic_model(**spaces, network=network, output="ONE"),
}
memory = RandomMemory(memory_size=64, num_envs=env.num_envs, device=env.device)
agent = PPO(models=models, memory=memory, cfg=PPO_CFG(rollouts=64), **spaces)
SequentialTrainer(env=env, agents=agent, cfg={"timesteps": 512, "headless": True}).train()
observation, _ = env.reset()
rewards = []
for _ in range(64):
    with torch.no_grad():
        action = agent.act(observation, None, timestep=0, timesteps=0)[0]
    observation, reward, *_ = env.step(action)
    rewards.append(reward.mean())
print(f"mean reward {torch.stack(rewards).mean():.2f}")
