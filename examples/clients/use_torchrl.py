# /// script
# dependencies = ["cablebot-gym", "torchrl"]
# ///
"""TorchRL: a batch of environments, with everything in `info`, such as the cost, in the tensordict.

`auto_register_info_dict` needs the batch, because it reads arrays. Autoreset has to be disabled, or
SAME_STEP.
"""

import gymnasium as gym
import torch
from tensordict.nn import TensorDictModule
from torchrl.envs import GymEnv, GymWrapper, check_env_specs

import cablebot_gym

ENV_ID = cablebot_gym.ENV_IDS[0]
options = {"normalised_observation": True, "observation_dtype": "float32"}

check_env_specs(GymEnv(ENV_ID, **options))  # one environment, without info
envs = GymWrapper(
    gym.make_vec(ENV_ID, 16, autoreset_mode="Disabled", **options)
).auto_register_info_dict()
network = torch.nn.LazyLinear(3)
policy = TensorDictModule(torch.nn.Sequential(network, torch.nn.Tanh()), ["observation"], ["action"])
batch = envs.rollout(100, policy, break_when_any_done=False)
print(f"{batch.numel()} steps, mean cost {batch['next', 'cost'].mean():.2f}")
