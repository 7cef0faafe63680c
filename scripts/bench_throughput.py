"""Measures the throughput of the environments and of MuJoCo's RK4 with the same robots in one run.

In each round, all contenders run for a short time one after the other, so that changes of the
machine's speed affect all of them. The table shows medians over the rounds, and medians of the
ratios within a round. Steps of this package's environments are complete: they include observation,
reward, termination and info.

Example: python scripts/bench_throughput.py --rounds 7 --search
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

import cablebot_gym  # noqa: F401 - registers the ids
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.evaluation.batch import Batch
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Robot, find_robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import Dwell

sys.path.insert(0, str(Path(__file__).parent))  # for mujoco_peer next to this file
try:
    from mujoco_peer import MujocoCableBotEnv, holding_torques, home_table
    from oracles.mujoco_model import MujocoRobot
except ImportError as error:
    raise SystemExit(
        f"the MuJoCo environment cannot be imported ({error}): pip install 'cablebot-gym[mujoco]'"
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

RANDOM_SIZE = 1024
"""Size of the vector environment for the measurement with random parameters."""

SEARCHES = {"CableBot-Spatial-v0": "fl", "CableBot-FlexSpatial-v0": "composite"}
"""Policies whose payload batches ``--search`` measures."""

Turn = Callable[[], int]
"""Function that does some work and returns the number of units of work."""

PEER = "MuJoCo RK4, 300 steps a call"
PEER_ENV = "MuJoCo env, torques clipped in each RK4 step"
PEER_ENV_ONCE = "MuJoCo env, one call, no clipping"
OURS_ENV = "our env"


def vector_name(count: int) -> str:
    """Name of the contender for a size of our vector environment."""
    return f"our vector env, N = {count}"


RANDOM = f"{vector_name(RANDOM_SIZE)}, random parameters"


def action_near_holding(robot: Robot) -> np.ndarray:
    """Actions near equilibrium, under which the robot moves and rotates a little; a robot at rest
    could be faster."""
    return holding_torques(robot) / robot.stall_torque * np.linspace(0.998, 1.002, robot.cables)


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


def env_turn(env: gym.Env[Any, Any], robot: Robot) -> Turn:
    """A turn of calls of ``env.step``, including resets."""
    action = action_near_holding(robot)
    env.reset(seed=0)

    def turn() -> int:
        for _ in range(100):
            _, _, terminated, truncated, _ = env.step(action)
            if terminated or truncated:
                env.reset()
        return 100

    return turn


def vector_turn(robot: Robot, count: int, *, drawn: bool = False) -> Turn:
    """A turn of RK4 steps in our vector environment with episodes of 1 s; ``drawn``: with random
    parameters."""
    keywords = keywords_of(robot)
    if drawn:
        tenth = {"low": -0.1, "high": 0.1}
        names = ["platform_mass", "motor_strength", "damping"]
        if robot.flexible:
            names.append("stiffness")
        keywords["uncertainty"] = {"parameters": dict.fromkeys(names, tenth)}
    env = gym.make_vec(fitting_env_id(robot), num_envs=count, max_episode_steps=100, **keywords)
    actions = np.tile(action_near_holding(robot), (count, 1))
    env.reset(seed=0)

    def turn() -> int:
        for _ in range(5):
            env.step(actions)
        return 5 * SUBSTEPS * count

    return turn


def our_env(robot: Robot) -> gym.Env[Any, Any]:
    """Our single environment with ten RK4 steps of 1 ms in each control step."""
    return gym.make(fitting_env_id(robot), **keywords_of(robot)).unwrapped


def keywords_of(robot: Robot) -> dict[str, Any]:
    """Keywords of our environments, in which the robot stays at its home pose."""
    motion = Dwell(name="home", pose=robot.home_pose)
    return {"robot": robot, "control_frequency": 100.0, "substeps": SUBSTEPS, "trajectory": motion}


def search_seconds(env_id: str, policy: str) -> dict[str, float]:
    """Wall time of 64 payloads × 256 draws of table6 × 1 s at 500 Hz, including the law [s].

    It is measured with the usual error bounds and payloads up to 20 kg, of which most fail early,
    and with wide error bounds and light payloads, of which none fails.
    """
    seconds = {}
    for name, error_bounds, top in (
        ("usual", ErrorBounds(), 20.0),
        ("none fails", ErrorBounds(position=10.0, rotation=10.0), 1.0),
    ):
        conditions = Conditions.of(
            env_id, error_bounds=error_bounds, uncertainty="table6", draws=256
        )
        batch = Batch(policy, conditions)
        batch.run([(0.0, 0)])  # compiles and warms up
        payloads = np.linspace(0.0, top, 64).tolist()
        start = time.perf_counter()
        batch.run(list(product(payloads, batch.seeds)))
        seconds[name] = time.perf_counter() - start
    return seconds


def rate(turn: Turn, seconds: float) -> float:
    """Units of work per second of one contender."""
    units = 0
    spent = 0.0
    start = time.perf_counter()
    while spent < seconds:
        units += turn()
        spent = time.perf_counter() - start
    return units / spent


def warm_start_seconds(env_id: str) -> float:
    """Wall time of a new process that imports the package, and makes, resets and steps an
    environment [s]."""
    code = f"import gymnasium, cablebot_gym; e = gymnasium.make({env_id!r}); e.reset(); e.step(e.action_space.sample())"
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
    return time.perf_counter() - start


def contenders_for(robot: Robot) -> dict[str, Turn]:
    """The contenders for a robot by name."""
    contenders = {
        PEER: mujoco_turn(robot),
        **{vector_name(count): vector_turn(robot, count) for count in SIZES},
        RANDOM: vector_turn(robot, RANDOM_SIZE, drawn=True),
    }
    if not robot.flexible:  # the MuJoCo environment has no joint springs
        table = home_table(robot)
        contenders |= {
            PEER_ENV: env_turn(
                MujocoCableBotEnv(robot, table, substeps=SUBSTEPS, clip_each_step=True), robot
            ),
            PEER_ENV_ONCE: env_turn(MujocoCableBotEnv(robot, table, substeps=SUBSTEPS), robot),
            OURS_ENV: env_turn(our_env(robot), robot),
        }
    return contenders


def measure(env_ids: list[str], rounds: int, seconds: float, *, search: bool) -> dict[str, Any]:
    """Medians and ratios for the robots of ``env_ids``."""
    report: dict[str, Any] = {}
    for env_id in env_ids:
        robot = ROBOTS[env_id]
        contenders = contenders_for(robot)
        for turn in contenders.values():
            turn()  # compiles and warms up
        rates: dict[str, list[float]] = {name: [] for name in contenders}
        for _ in track(
            range(rounds), f"{robot.name} robot", console=Console(stderr=True), transient=True
        ):
            for name, turn in contenders.items():
                rates[name].append(rate(turn, seconds))
        rows = []
        for name, values in rates.items():
            unit = "RK4 steps/s"
            peer = PEER
            if name in (OURS_ENV, PEER_ENV, PEER_ENV_ONCE):
                unit = "env.step/s"
                peer = PEER_ENV
            elif name == RANDOM:
                peer = vector_name(RANDOM_SIZE)
            ratios = [ours / theirs for ours, theirs in zip(values, rates[peer], strict=True)]
            rows.append(
                {
                    "contender": name,
                    "unit": unit,
                    "median": statistics.median(values),
                    "ratio": statistics.median(ratios),
                    "to": peer,
                }
            )
        starts = [warm_start_seconds(fitting_env_id(robot)) for _ in range(rounds)]
        report[env_id] = {"rows": rows, "warm_start_seconds": statistics.median(starts)}
        if search and env_id in SEARCHES:
            report[env_id]["search_seconds"] = search_seconds(env_id, SEARCHES[env_id])
    packages = ("cablebot-gym", "mujoco", "numba", "numpy", "gymnasium")
    report["versions"] = {
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }
    report["rounds"], report["seconds"] = rounds, seconds
    return report


def print_report(report: dict[str, Any]) -> None:
    """Prints the medians as tables."""
    console = Console()
    if not console.is_terminal:
        console.width = 130
    for env_id, entry in report.items():
        if not isinstance(entry, dict) or "rows" not in entry:
            continue
        table = Table(title=f"{env_id}: medians of {report['rounds']} rounds", title_justify="left")
        table.add_column("contender")
        table.add_column("unit")
        table.add_column("per second", justify="right")
        table.add_column("×", justify="right")
        table.add_column("of")
        for row in entry["rows"]:
            table.add_row(
                row["contender"],
                row["unit"],
                f"{row['median']:,.0f}",
                f"{row['ratio']:.3g}",
                row["to"],
            )
        console.print(table)
        console.print(
            f"new process to first step, with cached compilation: {entry['warm_start_seconds']:.2f} s"
        )
        for name, spent in entry.get("search_seconds", {}).items():
            console.print(
                f"64 payloads × 256 draws × 1 s, {SEARCHES[env_id]}, {name}: {spent:.1f} s",
                highlight=False,
            )
        console.print()


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
    parser.add_argument(
        "--search",
        action="store_true",
        help="also measure the batch of a payload search over draws",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    arguments = parser.parse_args()
    if arguments.rounds < 1 or arguments.seconds <= 0:
        parser.error("--rounds must be at least 1 and --seconds greater than 0")
    report = measure(arguments.ids, arguments.rounds, arguments.seconds, search=arguments.search)
    if arguments.json:
        print(json.dumps(report, indent=2))
    else:
        print_report(report)


if __name__ == "__main__":
    main()
