# /// script
# dependencies = ["cablebot-gym", "tianshou[eval]>=2"]
# [tool.clients]
# constraints = "constraints/clients.txt"
# ///
"""Tianshou 2: PPO by the high-level interface."""

from tianshou.highlevel.config import OnPolicyTrainingConfig
from tianshou.highlevel.env import EnvFactoryRegistered, VectorEnvType
from tianshou.highlevel.experiment import ExperimentConfig, PPOExperimentBuilder

import cablebot_gym

options = {"normalised_observation": True, "terminate_on_violation": True, "render_mode_watch": None}
envs = EnvFactoryRegistered(task=cablebot_gym.ENV_IDS[0], venv_type=VectorEnvType.DUMMY, **options)
training = OnPolicyTrainingConfig(
    max_epochs=2,
    epoch_num_steps=2048,
    collection_step_num_env_steps=1024,
    num_training_envs=4,
    num_test_envs=2,
)
experiment = PPOExperimentBuilder(envs, ExperimentConfig(persistence_enabled=False), training).build()
result = experiment.run().trainer_result
print(f"best return {result.best_reward:.1f}")
