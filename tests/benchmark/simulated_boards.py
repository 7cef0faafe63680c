"""Boards of simulated policies: how often intervals cover the mean, and orders are false.

``python tests/benchmark/simulated_boards.py > docs/ranking.md`` writes the page.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cablebot_gym.benchmark.ranking import better_policies, fraction

FAMILIES = {
    "normal, 0.75 ± 0.1": lambda random, size: random.normal(0.75, 0.1, size).clip(0, 1),
    "beta(6, 2)": lambda random, size: random.beta(6, 2, size),
    "1 − exponential(0.1)": lambda random, size: 1 - random.exponential(0.1, size).clip(0, 0.95),
    "beta(20, 5), fails on 2 % of the motions": lambda random, size: _failing(random, size, 0.02),
    "beta(20, 5), fails on 5 %": lambda random, size: _failing(random, size, 0.05),
    "beta(20, 5), fails on 10 %": lambda random, size: _failing(random, size, 0.1),
    "beta(20, 5), fails on 30 %": lambda random, size: _failing(random, size, 0.3),
}
"""Distributions of the fractions of one policy over the motions."""

FAILURES = {12: (0.0, 0.02, 0.1), 25: (0.0, 0.05)}
"""Rates of failures of equal policies, by number of policies on a board."""

MOTIONS = (20, 100)

PAGE = """# How sure are intervals and ranks

A board has a random sample of motions. Its numbers are means over this sample, so another sample gives other numbers.
This page simulates many boards with known truth. `python tests/benchmark/simulated_boards.py` computes it.

## Intervals

An interval of the mean fraction combines two parts: the mid-P interval of the rate of motions that the policy carries,
and Student's interval of the mean over these motions. It allows for failures that the board has not seen. Where a
policy never fails, it is therefore wider than necessary, and covers more often than it states.

| fractions of a policy | motions | covered | mean too low | mean too high |
|---|---:|---:|---:|---:|
{coverage}
*Mean too low*: the interval lies below the true mean. {boards:,} simulated boards for each row.

## Orders of equal policies

All policies of a board are equal by construction: the same difficulty of each motion, and independent noise and
failures. A board is false if its simultaneous comparisons put any policy before another. At most 5 % may be.

| policies | motions | fail on | false boards |
|---:|---:|---:|---:|
{orders}
{order_boards:,} simulated boards for each row.
"""

DOCUMENT = Path(__file__).parents[2] / "docs" / "ranking.md"
"""The page in the documentation."""


def _failing(random, size, rate):
    return np.where(random.random(size) < rate, 0.0, random.beta(20, 5, size))


def coverage(family, motions, boards, seed=1):
    """Fractions of boards whose interval covers the true mean, lies below and lies above it."""
    random = np.random.default_rng(seed)
    draw = FAMILIES[family]
    truth = draw(random, 2_000_000).mean()
    below = above = 0
    for _ in range(boards):
        interval = fraction([draw(random, motions)])
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


def page(boards=4000, order_boards=4000):
    """The page with both tables."""
    rows = []
    for motions in MOTIONS:
        for family in FAMILIES:
            rates = coverage(family, motions, boards)
            texts = " | ".join(f"{rate:.1%}" for rate in rates)
            rows.append(f"| {family} | {motions} | {texts} |\n")
    orders = []
    for policies, rates in FAILURES.items():
        for motions in MOTIONS:
            for rate in rates:
                false = false_boards(policies, motions, rate, order_boards)
                orders.append(f"| {policies} | {motions} | {rate:.0%} | {false:.1%} |\n")
    return PAGE.format(
        coverage="".join(rows), orders="".join(orders), boards=boards, order_boards=order_boards
    )


if __name__ == "__main__":
    print(page(), end="")
