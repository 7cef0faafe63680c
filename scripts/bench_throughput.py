"""Measures the throughput of the environments and of MuJoCo's RK4 with the same robots in one run.

In each round, all contenders run for a short time one after the other, so that changes of the
machine's speed affect all of them. The table shows medians over the rounds, and medians of the
ratios within a round. Steps of this package's environments are complete: they include observation,
reward, termination and info.

Example: python scripts/bench_throughput.py --rounds 7
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import cablebot_gym  # noqa: F401 - registers the ids
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Robot, find_robot
from cablebot_gym.trajectories import Dwell

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
try:
    from oracles.mujoco_model import MujocoRobot
except ImportError as error:
    raise SystemExit(
        f"MuJoCo's model cannot be imported ({error}): pip install 'cablebot-gym[mujoco]'"
    ) from error

SUBSTEPS = 10
"""RK4 steps of 1 ms in each control step."""

SIZES = (1, 64, 1024, 8192)
"""Sizes of the vector environment."""


def plain(name: str) -> Robot:
    """A robot of the library as MuJoCo can have it: rigid cables, no swivel pulleys, no Coulomb
    friction."""
    robot = find_robot(name).with_rigid_cables()
    transmission = robot.transmission.replace(coulomb_friction=0.0)
    return robot.replace(name=f"plain {name}", swivel_radius=0.0, transmission=transmission)


ROBOTS = {
    "CableBot-Planar-v0": PLANAR,
    "CableBot-Spatial-v0": SPATIAL,
    "CableBot-FlexPlanar-v0": FLEX_PLANAR,
    "CableBot-FlexSpatial-v0": FLEX_SPATIAL,
    "eight-cables": plain("cogiro"),
    "point": plain("stadium-camera"),
    "planar-platform": plain("ttk4900"),
}

Turn = Callable[[], int]
"""Function that makes some RK4 steps and returns their number."""

PEER = "MuJoCo, 300 steps a call"
SINGLE = "our env"


def action_near_holding(robot: Robot) -> np.ndarray:
    """Actions near equilibrium, under which the robot moves and rotates a little; a robot at rest
    could be faster."""
    minimum = textbook.allocated_minimum(robot, 10.0)
    torques = textbook.static_torque(robot, robot.mass, robot.home, minimum=minimum)
    return torques / robot.stall_torque * np.linspace(0.998, 1.002, robot.cables)


def mujoco_turn(robot: Robot) -> Turn:
    """A turn of RK4 steps in MuJoCo without an environment."""
    plant = MujocoRobot(robot)
    torques = action_near_holding(robot) * robot.stall_torque

    def turn() -> int:
        plant.set_state(robot.home, np.zeros(robot.coordinates))
        if robot.flexible:
            plant.set_motors(torques / robot.stiffness, np.zeros(robot.cables))
        plant.step(torques, 300)
        return 300

    return turn


def single_turn(robot: Robot) -> Turn:
    """A turn of our single environment, including resets."""
    env = gym.make(fitting_env_id(robot), **keywords_of(robot)).unwrapped
    action = action_near_holding(robot)
    env.reset(seed=0)

    def turn() -> int:
        for _ in range(100):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return 100 * SUBSTEPS

    return turn


def vector_turn(robot: Robot, count: int) -> Turn:
    """A turn of our vector environment with episodes of 1 s."""
    keywords = keywords_of(robot)
    env = gym.make_vec(fitting_env_id(robot), num_envs=count, max_episode_steps=100, **keywords)
    actions = np.tile(action_near_holding(robot), (count, 1))
    env.reset(seed=0)

    def turn() -> int:
        for _ in range(5):
            env.step(actions)
        return 5 * SUBSTEPS * count

    return turn


def keywords_of(robot: Robot) -> dict[str, Any]:
    """Keywords of our environments, in which the robot stays at its home pose."""
    motion = Dwell(name="home", pose=robot.home_pose)
    return {"robot": robot, "control_frequency": 100.0, "substeps": SUBSTEPS, "trajectory": motion}


def rate(turn: Turn, seconds: float) -> float:
    """RK4 steps per second of one contender."""
    steps = 0
    spent = 0.0
    start = time.perf_counter()
    while spent < seconds:
        steps += turn()
        spent = time.perf_counter() - start
    return steps / spent


def contenders_for(robot: Robot) -> dict[str, Turn]:
    """The contenders for a robot by name."""
    contenders = {PEER: mujoco_turn(robot), SINGLE: single_turn(robot)}
    for count in SIZES:
        contenders[f"our vector env, N = {count}"] = vector_turn(robot, count)
    for turn in contenders.values():
        turn()  # compiles and warms up
    return contenders


def measure(robot: Robot, rounds: int, seconds: float) -> dict[str, list[float]]:
    """RK4 steps per second in each round, by contender."""
    contenders = contenders_for(robot)
    rates: dict[str, list[float]] = {name: [] for name in contenders}
    console = Console(stderr=True)
    for _ in track(range(rounds), f"{robot.name} robot", console=console, transient=True):
        for name, turn in contenders.items():
            rates[name].append(rate(turn, seconds))
    return rates


def table_of(name: str, rates: dict[str, list[float]]) -> Table:
    """Table of the medians of a robot."""
    table = Table(title=f"{name}: medians of the rounds", title_justify="left")
    for heading in ("contender", "RK4 steps per second", "× MuJoCo"):
        table.add_column(heading)
    for contender, values in rates.items():
        ratios = [ours / theirs for ours, theirs in zip(values, rates[PEER], strict=True)]
        median = f"{statistics.median(values):,.0f}"
        table.add_row(contender, median, f"{statistics.median(ratios):.3g}")
    return table


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=7, help="number of rounds (default: 7)")
    parser.add_argument(
        "--seconds",
        type=float,
        default=0.3,
        help="time of a contender in each round (default: 0.3)",
    )
    parser.add_argument(
        "--ids", nargs="+", choices=ROBOTS, default=list(ROBOTS), help="robots (default: all)"
    )
    arguments = parser.parse_args()
    if arguments.rounds < 1 or arguments.seconds <= 0:
        parser.error("--rounds must be at least 1 and --seconds greater than 0")
    console = Console()
    if not console.is_terminal:
        console.width = 130
    for name in arguments.ids:
        rates = measure(ROBOTS[name], arguments.rounds, arguments.seconds)
        console.print(table_of(name, rates))


if __name__ == "__main__":
    main()
