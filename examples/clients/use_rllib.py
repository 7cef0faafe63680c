# /// script
# dependencies = ["cablebot-gym", "torch", "ray[rllib]"]
# [tool.clients]
# constraints = "constraints/clients.txt"
# ///
"""RLlib: PPO; keywords of the environment are its env_config."""

import ray
from ray.rllib.algorithms.ppo import PPOConfig

options = {
    "normalised_observation": True,
    "terminate_on_violation": True,
    "observation_dtype": "float32",
}
ray.init(num_cpus=2, include_dashboard=False)
config = (
    PPOConfig()
    .environment("cablebot_gym:CableBot-Planar-v0", env_config=options)
    .env_runners(num_env_runners=0, num_envs_per_env_runner=8)
    .training(train_batch_size_per_learner=4096, minibatch_size=512, num_epochs=4)
)
algorithm = config.build_algo()
for _ in range(2):
    result = algorithm.train()["env_runners"]
print(f"mean return {result['episode_return_mean']:.1f} of {result['num_episodes']} episodes")
ray.shutdown()
