"""Measures the planning time of ``nmpc``: percentiles over whole episodes, for each robot.

Requires pip install 'cablebot-gym[optimal]'. Example: python scripts/bench_nmpc.py --payload 2.5
--robots planar
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.table import Table

import cablebot_gym  # noqa: F401 - registers the environments
from cablebot_baselines.optimal.nmpc import NonlinearMPC
from cablebot_gym.robots import PLANAR, SPATIAL

ROBOTS = {
    "planar": ("CableBot-Planar-v0", PLANAR, 2.5),
    "spatial": ("CableBot-Spatial-v0", SPATIAL, 6.0),
}
"""Environment, robot and default payload by name; the payload is feasible, but close to the action
limits [kg]."""

PERCENTILES = (5, 50, 95, 99, 100)


def solve_times(name: str, payload: float | None, episodes: int) -> np.ndarray:
    """Wall-clock times of all plans of ``episodes`` episodes [s], including the first plan of each
    episode."""
    env_id, robot, default_payload = ROBOTS[name]
    policy = NonlinearMPC(robot)
    times = []
    plan = policy.program.plan

    def timed(*args: Any, **keywords: Any) -> Any:
        start = time.perf_counter()
        try:
            return plan(*args, **keywords)
        finally:
            times.append(time.perf_counter() - start)

    policy.program.plan = timed  # type: ignore[method-assign]
    if payload is None:
        payload = default_payload
    env = gym.make_vec(env_id, num_envs=1, payload=payload, max_episode_steps=None)
    for seed in range(episodes):
        observation, _ = env.reset(seed=seed)
        policy.reset(env.unwrapped.tasks)  # type: ignore[attr-defined]
        state = None
        for _ in range(env.unwrapped.tasks[0].steps):  # type: ignore[attr-defined]
            action, state = policy.predict(observation, state=state)
            observation, *_ = env.step(action)
    env.close()
    return np.array(times)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--robots",
        nargs="+",
        choices=ROBOTS,
        default=list(ROBOTS),
        help="robots to benchmark; default: all",
    )
    parser.add_argument(
        "--payload", type=float, help="payload [kg]; default: 2.5 for planar, 6 for spatial"
    )
    parser.add_argument(
        "--episodes", type=int, default=5, help="number of episodes for each robot; default: 5"
    )
    options = parser.parse_args()
    table = Table(title="Planning time [ms]")
    for column in ("robot", "plans", *(f"{p} %" for p in PERCENTILES)):
        table.add_column(column, justify="right")
    for name in options.robots:
        times = 1e3 * solve_times(name, options.payload, options.episodes)
        table.add_row(
            name, str(len(times)), *(f"{value:.2f}" for value in np.percentile(times, PERCENTILES))
        )
    Console().print(table)


if __name__ == "__main__":
    main()
