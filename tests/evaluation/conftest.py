"""A policy that drops payloads, and an episode in a single environment."""

import numpy as np

from cablebot_baselines.laws import FeedbackLinearization
from cablebot_gym.robots import SPATIAL


class Dropping(FeedbackLinearization):
    """FL that returns zero actions for certain model payloads."""

    def __init__(self, lets_go, robot=SPATIAL):
        super().__init__(robot)
        self.lets_go = lets_go

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state, episode_start, deterministic)
        payload = self.split(np.array(observation))["model_payload"][..., 0]
        return np.where(self.lets_go(payload)[..., None], 0.0, action), state


def play(env, policy, options=None, seed=0):
    """The verdict of a monitor on a whole motion, or until it ends."""
    observation, _ = env.reset(seed=seed, options=options)
    terminated = False
    while not (env.verdict.carried or env.verdict.violation or terminated):
        observation, _, terminated, _, _ = env.step(policy.predict(observation)[0])
    return env.verdict
