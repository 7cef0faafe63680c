"""Boards of simulated policies: how often intervals cover the mean, and orders are false."""

from __future__ import annotations

import numpy as np

from cablebot_gym.benchmark.ranking import better_policies, fraction
from cablebot_gym.benchmark.yardstick import DRAWS, PROBABILITY, yardstick
from cablebot_gym.evaluation.survey import ROBOTS

FAMILIES = {
    "normal, 0.75 ± 0.1": lambda random, size: random.normal(0.75, 0.1, size).clip(0, 1),
    "beta(6, 2)": lambda random, size: random.beta(6, 2, size),
    "1 − exponential(0.1)": lambda random, size: 1 - random.exponential(0.1, size).clip(0, 0.95),
    "beta(20, 5), fails on 2 % of the motions": lambda random, size: _failing(random, size, 0.02),
    "beta(20, 5), fails on 30 %": lambda random, size: _failing(random, size, 0.3),
}
"""Distributions of the fractions of one policy over the motions."""


RATIOS = {
    "normal, 0.95 ± 0.035": lambda random, size: random.normal(0.95, 0.035, size),
    "the weakest of 6 motors": lambda random, size: _weakest(random, size),
    "1 − gamma(4, 0.0175)": lambda random, size: 1 - random.gamma(4, 0.0175, size),
    "5 % of the robots 0.1 lower": lambda random, size: _lower_tail(random, size),
    "normal, a third of the variance from the motion": lambda random, size: _of_motions(
        random, size
    ),
}
"""Distributions of the ratios of drawn to nominal best known payloads, (motions, draws)."""


TRUTH = 2_000_000
"""Number of motions of the true mean of fractions."""


CAPACITIES = {
    "normal, 4 ± 0.3 kg": lambda random, size: random.normal(4, 0.3, size),
    "steps of 0.5 kg": lambda random, size: np.floor(2 * random.normal(4, 0.3, size)) / 2,
    "3 % fail unloaded": lambda random, size: _with_failures(random, size),
}
"""Distributions of the largest payload that a random robot carries on a motion [kg]. Of all continuous
ones the promise is the same."""


FEWER_MOTIONS = 20
"""Number of motions of half of the policies of a board of surveys."""


def _with_failures(random, size):
    return np.where(random.random(size) < 0.03, 0.0, random.normal(4, 0.3, size))


def surveyed(capacities):
    """Payload of each motion, the least one of its robots, from an array (…, robots)."""
    return capacities.min(axis=-1).clip(0, None)


def promise(family, motions, seed=3):
    """Fraction of motions whose payload a further robot carries or that have none."""
    random = np.random.default_rng(seed)
    draw = CAPACITIES[family]
    payloads = surveyed(draw(random, (motions, ROBOTS)))
    is_carried = draw(random, motions) >= payloads
    return (is_carried | (payloads == 0)).mean()


def equal_surveys(random, failing, noise, policies=12, motions=100):
    """Fractions of equal policies on the same motions and robots, (policies, motions); NaN where
    the second half of the policies has no motion."""
    ease = random.normal(0.7, 0.1, motions)
    robots = random.normal(0, 0.05, (motions, ROBOTS))
    robots[random.random(robots.shape) < failing] = -np.inf
    capacities = robots + ease[:, None]
    values = surveyed(capacities + random.normal(0, noise, (policies, motions, ROBOTS)))
    values[policies // 2 :, FEWER_MOTIONS:] = np.nan
    return values


def false_surveys(failing, noise, boards, seed=4):
    """Fraction of boards of equal surveys with at least one order."""
    random = np.random.default_rng(seed)
    false = 0
    for _ in range(boards):
        false += better_policies(equal_surveys(random, failing, noise)).any()
    return false / boards


def _failing(random, size, rate):
    return np.where(random.random(size) < rate, 0.0, random.beta(20, 5, size))


def coverage(draw, motions, boards, truth_motions=TRUTH, seed=1):
    """Fractions of boards whose interval covers the true mean, lies below and lies above it.

    ``draw`` returns fractions of independent motions from a random generator and their number.
    """
    random = np.random.default_rng(seed)
    truth = draw(random, truth_motions).mean()
    below = above = 0
    for _ in range(boards):
        interval = fraction(draw(random, motions))
        below += interval.high < truth
        above += interval.low > truth
    return 1 - (below + above) / boards, below / boards, above / boards


def equal_policies(random, policies, motions, rate):
    """Fractions of equal policies, (policies, motions)."""
    difficulty = random.beta(6, 2, motions)
    values = (difficulty + random.normal(0, 0.03, (policies, motions))).clip(0, 1)
    values[random.random(values.shape) < rate] = 0.0
    return values


def false_boards(policies, motions, rate, boards, seed=2):
    """Fraction of boards of equal policies with at least one order."""
    random = np.random.default_rng(seed)
    false = 0
    for _ in range(boards):
        values = equal_policies(random, policies, motions, rate)
        false += better_policies(values).any()
    return false / boards


def _weakest(random, size):
    payload = random.uniform(-0.03, 0.03, size)
    motors = random.uniform(-0.03, 0.03, (*size, 6)).min(axis=-1)
    return 0.98 - payload + motors + random.normal(0, 0.02, size)


def _lower_tail(random, size):
    return random.normal(0.95, 0.03, size) - 0.1 * (random.random(size) < 0.05)


def _of_motions(random, size):
    motion = random.normal(0, 0.02, (size[0], 1))
    return 0.95 + motion + random.normal(0, 0.0285, size)


def yardstick_coverage(family, motions, boards, seed=3):
    """Fractions of boards whose interval of the yardstick covers the true quantile, lies below and
    lies above it, and its mean half width."""
    random = np.random.default_rng(seed)
    draw = RATIOS[family]
    truth = np.quantile(draw(random, (1_000_000, DRAWS)), PROBABILITY)
    below = above = width = 0
    for _ in range(boards):
        interval = yardstick(draw(random, (motions, DRAWS)).ravel().tolist())
        below += interval.high < truth
        above += interval.low > truth
        width += (interval.high - interval.low) / 2
    return 1 - (below + above) / boards, below / boards, above / boards, width / boards
