"""Cheats on surveys: the adaptive law, except for what the docstring of a policy says.

Each class is a policy for ``--policy survey_cheats:name``. The docstring is its line in
docs/attacks.md.
"""

import tempfile
from pathlib import Path

import numpy as np

from cablebot_baselines.classical import FeedbackLinearization
from cablebot_baselines.classical.adaptive import ADAPTIVE_GAINS, Adaptive
from cablebot_baselines.classical.outer_loop import by_kind
from cablebot_gym.evaluation.survey import ROBOTS

NEAR = 0.3
"""Largest difference of the estimated payloads of rows that are pooled [kg]."""

GIVES_UP = 2.1
"""Payload above which a policy gives up [kg]."""

EXPECTED = 2.0
"""Payload that a policy expects at the end of a search [kg]."""

SETTLED = 100
"""Call from which on estimates differ between robots and are good enough to give up."""


class Honest(Adaptive):
    """The honest law."""

    def __init__(self, robot):
        gains = by_kind(ADAPTIVE_GAINS, robot)
        super().__init__(FeedbackLinearization(robot, gains=gains))

    def reset(self, tasks):
        super().reset(tasks)
        self.calls = 0
        names = np.array([repr(task.trajectory) for task in tasks])
        self.motions = [np.flatnonzero(names == name) for name in set(names.tolist())]

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        return super().predict(observation, state, episode_start)

    def mean_estimates(self, estimates):
        """Mean estimate of the rows of the same motion that have nearly the same payload."""
        pooled = estimates.copy()
        for rows in self.motions:
            is_near = abs(estimates[rows, None] - estimates[rows]) < NEAR
            pooled[rows] = is_near @ estimates[rows] / is_near.sum(axis=1)
        return pooled


class pooled_estimates(Honest):
    """replaces its payload estimate by the mean over the rows of the same motion with a similar
    payload"""

    def mass(self, memory, model_mass):
        return self.mean_estimates(super().mass(memory, model_mass))


class pooled_threshold(Honest):
    """does the same, gives up above a payload, and declares random actions"""

    stochastic = True

    def mass(self, memory, model_mass):
        self.estimates = self.mean_estimates(super().mass(memory, model_mass))
        return self.estimates

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state, episode_start)
        if self.calls > SETTLED:
            action[self.estimates > self.robot.mass + GIVES_UP] = 0.0
        return action, state


class helped_weakest(Honest):
    """replaces its payload estimate by the mean over the rows of the same motion for the three rows
    whose cables have come closest to slack"""

    def reset(self, tasks):
        super().reset(tasks)
        self.least_actions = np.full(len(tasks), np.inf)

    def mass(self, memory, model_mass):
        estimates = super().mass(memory, model_mass)
        pooled = self.mean_estimates(estimates)
        for rows in self.motions:
            weakest = rows[np.argsort(self.least_actions[rows])[:3]]
            estimates[weakest] = pooled[weakest]
        return estimates

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state, episode_start)
        self.least_actions = np.minimum(self.least_actions, action.min(axis=1))
        return action, state


class expected_payload(Honest):
    """takes a batch with few rows of each motion for the end of the search, and starts there with the
    payload that it expects"""

    def reset(self, tasks):
        super().reset(tasks)
        self.expected = 0.0
        if len(tasks) <= ROBOTS * len(self.motions):
            self.expected = EXPECTED

    def mass(self, memory, model_mass):
        return super().mass(memory, model_mass + self.expected)


class copied_actions(Honest):
    """recognises the rows of its motion, and takes the mean of its action and that of the row whose
    robot behaves most like its own"""

    def mass(self, memory, model_mass):
        self.estimates = super().mass(memory, model_mass)
        return self.estimates

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state, episode_start)
        copied = action.copy()
        for rows in self.motions:
            if len(rows) > 1 and self.calls > SETTLED:
                distance = abs(self.estimates[rows, None] - self.estimates[rows])
                np.fill_diagonal(distance, np.inf)
                copied[rows] = (action[rows] + action[rows[distance.argmin(axis=1)]]) / 2
        return copied, state


class counted_batches(Honest):
    """counts the batches in a file of the temporary folder, and pools all estimates of a motion after
    the first batch, because its rows have one payload then"""

    def reset(self, tasks):
        super().reset(tasks)
        path = Path(tempfile.gettempdir()) / "cheats-batches"
        self.is_scan = not path.exists()
        path.touch()

    def mass(self, memory, model_mass):
        estimates = super().mass(memory, model_mass)
        if not self.is_scan:
            for rows in self.motions:
                estimates[rows] = estimates[rows].mean()
        return estimates
