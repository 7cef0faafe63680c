"""Tasks for the tests of policies."""

import gymnasium as gym


def tasks_of(env_id, **keywords):
    """The tasks of two robots."""
    env = gym.make_vec(env_id, num_envs=2, **keywords)
    env.reset(seed=0)
    return env.unwrapped.tasks
