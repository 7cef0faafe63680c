"""A policy that drops payloads, made-up verdicts, and an episode in a single environment."""

import numpy as np

from cablebot_baselines.laws import FeedbackLinearization
from cablebot_gym.evaluation import Verdict
from cablebot_gym.robots import SPATIAL


class Law(FeedbackLinearization):
    """FL whose actions a test changes."""

    def __init__(self, robot=SPATIAL):
        super().__init__(robot)

    def act(self, observation):
        return super().predict(observation)[0]

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return self.act(np.array(observation)), state


class Dropping(Law):
    """Returns zero actions for certain model payloads."""

    def __init__(self, lets_go, robot=SPATIAL):
        super().__init__(robot)
        self.lets_go = lets_go

    def act(self, observation):
        payload = self.split(observation)["model_payload"][..., 0]
        return np.where(self.lets_go(payload)[..., None], 0.0, super().act(observation))


def verdict_of(violation=None):
    """The verdict of an episode with a violation, or with None."""
    return Verdict(
        carried=violation is None,
        violation=violation,
        payload=1.0,
        peak_action=(0.5, 0.5),
        position_peak=0.005,
        rotation_peak=0.01,
        least_tension=5.0,
        largest_tension=20.0,
    )


def play(env, policy, options=None, seed=0):
    """The verdict of a monitor on a whole motion, or until it ends."""
    observation, info = env.reset(seed=seed, options=options)
    terminated = False
    while not (info["dlcc_carried"] or env.verdict.violation or terminated):
        observation, _, terminated, _, info = env.step(policy.predict(observation)[0])
    return env.verdict
