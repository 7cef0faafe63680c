"""Boards of simulated policies: how often intervals cover the mean, and orders are false.

``python tests/benchmark/simulated_boards.py > docs/ranking.md`` writes the page.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from cablebot_gym.benchmark.ranking import better_policies, fraction
from cablebot_gym.benchmark.yardstick import DRAWS, PROBABILITY, yardstick
from cablebot_gym.evaluation.survey import ROBOTS

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

MOTIONS = (20, 100)

YARDSTICK_MOTIONS = (50, 100)
"""Numbers of motions of a yardstick. With less than 37 × 2 draws its interval has no lower end."""

TRUTH = 2_000_000
"""Number of motions of the true mean of fractions."""

SURVEYED_TRUTH = 400_000
"""Number of motions, each with its robots, of the true mean of surveys."""

CAPACITIES = {
    "normal, 4 ± 0.3 kg": lambda random, size: random.normal(4, 0.3, size),
    "lognormal, skewed to heavy payloads": lambda random, size: random.lognormal(1.2, 0.4, size),
    "5 kg − Student's t with 2 degrees": lambda random, size: 5 - abs(random.standard_t(2, size)),
    "3 % of the robots are weak": lambda random, size: _with_weak_robots(random, size, 0.5),
    "steps of 0.5 kg": lambda random, size: np.floor(2 * random.normal(4, 0.3, size)) / 2,
    "3 % fail unloaded": lambda random, size: _with_weak_robots(random, size, 0.0),
}
"""Distributions of the largest payload that a random robot carries on a motion [kg]."""

BEST_PAYLOAD = 6.0
"""Best payload of a motion of average difficulty [kg]."""

FEWER_MOTIONS = 20
"""Number of motions of half of the policies of a board of surveys."""

PAGE = """# How sure are intervals and ranks

A board has a random sample of motions. Its numbers are means over this sample, so another sample gives other numbers.
This page simulates many boards with known truth. `python tests/benchmark/simulated_boards.py` computes it.

## Payloads of surveys

The payload of a motion is the largest one that all {robots} random robots carry. A further random robot carries it with
a probability of at least 95 %, whatever the distribution over robots is: exactly 95 % without ties, and more with ties
or where the motion has no payload because a robot fails unloaded.

| largest payload of a random robot | a further robot carries it, or it is 0 | it is 0 | less than 85 % carry it |
|---|---:|---:|---:|
{promises}
{surveyed_motions:,} simulated motions for each row. The probability holds on the mean over motions only: on some
motions all {robots} robots are stronger than most (last column).

The interval of the mean of payload over best payload covers its expected value over motions and robots, because each
motion has its own robots: their scatter is part of the scatter over motions.

| largest payload of a random robot | motions | covered | mean too low | mean too high |
|---|---:|---:|---:|---:|
{surveyed_coverage}
Difficulties of motions differ by ± 15 %. {surveyed_boards:,} simulated boards for each row.

Twelve equal policies that meet the same motions and robots are seldom ordered, also if six of them have only the first
{fewer} motions. At most 5 % of the boards may have an order.

| robots that fail unloaded | noise of a policy on each robot | false boards |
|---:|---:|---:|
{surveyed_orders}
The fractions of the robots of a motion scatter by ± 0.05. {order_boards:,} simulated boards of 100 motions for each
row.

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

## Yardstick under uncertainty

The yardstick is the 5 % quantile of the ratios of drawn to nominal best known payloads. Its interval has order
statistics as ends, so it needs no distribution.

| ratios | motions × draws | covered | quantile too low | quantile too high | half width |
|---|---:|---:|---:|---:|---:|
{yardsticks}
*Quantile too low*: the interval lies below the true quantile. {boards:,} simulated boards for each row.
"""

DOCUMENT = Path(__file__).parents[2] / "docs" / "ranking.md"
"""The page in the documentation."""


def _with_weak_robots(random, size, factor):
    payloads = random.normal(4, 0.3, size)
    return np.where(random.random(size) < 0.03, factor * payloads, payloads)


def surveyed(capacities):
    """Payload of each motion, the least one of its robots, from an array (…, robots)."""
    return capacities.min(axis=-1).clip(0, None)


def promise(family, motions, seed=3):
    """Fractions of motions whose payload a further robot carries or that have none, of motions
    without payload, and of motions whose payload less than 85 % of all robots carry."""
    random = np.random.default_rng(seed)
    draw = CAPACITIES[family]
    everything = np.sort(draw(random, 1_000_000))
    payloads = surveyed(draw(random, (motions, ROBOTS)))
    is_carried = draw(random, motions) >= payloads
    is_empty = payloads == 0
    weaker = np.searchsorted(everything, payloads) / len(everything)
    return (is_carried | is_empty).mean(), is_empty.mean(), (~is_empty & (weaker > 0.15)).mean()


def surveyed_fractions(family, random, motions):
    """Payloads of a survey as fractions of the best payloads."""
    ease = random.normal(1, 0.15, motions).clip(0.5, None)
    payloads = surveyed(CAPACITIES[family](random, (motions, ROBOTS))) * ease
    return payloads / (BEST_PAYLOAD * random.normal(1, 0.05, motions) * np.sqrt(ease))


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


def page(boards=4000, order_boards=4000, surveyed_boards=20_000, motions=200_000):
    """The page with all tables."""
    return PAGE.format(
        promises=_promise_rows(motions),
        surveyed_coverage=_surveyed_coverage_rows(surveyed_boards),
        surveyed_orders=_surveyed_order_rows(order_boards),
        coverage=_coverage_rows(boards),
        orders=_order_rows(order_boards),
        yardsticks=_yardstick_rows(boards),
        boards=boards,
        order_boards=order_boards,
        surveyed_boards=surveyed_boards,
        surveyed_motions=motions,
        robots=ROBOTS,
        fewer=FEWER_MOTIONS,
    )


def _promise_rows(motions):
    text = ""
    for family in CAPACITIES:
        carried, empty, misses = promise(family, motions)
        text += f"| {family} | {carried:.2%} | {empty:.1%} | {misses:.1%} |\n"
    return text


def _surveyed_coverage_rows(boards):
    text = ""
    for motions in MOTIONS:
        for family in CAPACITIES:
            draw = partial(surveyed_fractions, family)
            rates = coverage(draw, motions, boards, truth_motions=SURVEYED_TRUTH)
            text += _coverage_row(family, motions, rates)
    return text


def _yardstick_rows(boards):
    text = ""
    for motions in YARDSTICK_MOTIONS:
        for family in RATIOS:
            rates = yardstick_coverage(family, motions, boards)
            texts = " | ".join(f"{rate:.1%}" for rate in rates)
            text += f"| {family} | {motions} × {DRAWS} | {texts} |\n"
    return text


def _surveyed_order_rows(boards):
    text = ""
    for failing in (0.0, 0.002, 0.02):
        for noise in (0.01, 0.05):
            false = false_surveys(failing, noise, boards)
            text += f"| {failing:.1%} | ± {noise:g} | {false:.1%} |\n"
    return text


def _coverage_rows(boards):
    text = ""
    for motions in MOTIONS:
        for family, draw in FAMILIES.items():
            text += _coverage_row(family, motions, coverage(draw, motions, boards))
    return text


def _coverage_row(family, motions, rates):
    texts = " | ".join(f"{rate:.1%}" for rate in rates)
    return f"| {family} | {motions} | {texts} |\n"


def _order_rows(boards):
    text = ""
    for policies, rates in FAILURES.items():
        for motions in MOTIONS:
            for rate in rates:
                false = false_boards(policies, motions, rate, boards)
                text += f"| {policies} | {motions} | {rate:.0%} | {false:.1%} |\n"
    return text


if __name__ == "__main__":
    print(page(), end="")
