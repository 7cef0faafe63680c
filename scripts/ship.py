"""Ships the median of several trainings: its weights, and a card with the command and the learning
curves of all.

python scripts/ship.py plan CableBot-Planar-v0 RUN…    # of `cablebot train-plan`
python scripts/ship.py ppo CableBot-Planar-v0 RUN…     # of `cablebot train`

The runs have the seeds 0, 1, … in this order. The measure of plans is the payload that the network
alone carries on the held-out motions, as a fraction of the optimum without margins; that of PPO is the
ceiling of the payloads, in payloads of exact tracking, over the last quarter of a training.
"""

from __future__ import annotations

import argparse
import csv
import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from cablebot_baselines.learned.plan_training import HELD_OUT
from cablebot_baselines.learned.shipped import WEIGHTS
from cablebot_baselines.planners.rehearsed import first_optimum
from cablebot_gym.envs import env_robot
from cablebot_gym.motions import random_loop
from cablebot_gym.planning import Margins
from cablebot_gym.robots import find_robot
from cablebot_gym.utils.files import atomic_write_text, json_text


def plan_runs(env_id: str, folders: list[Path]) -> list[dict[str, Any]]:
    """Learning curves of ``train-plan``."""
    optimum = np.array(optima(env_id))
    runs = []
    for folder in folders:
        rows = np.loadtxt(folder / "progress.csv", delimiter=",", ndmin=2)
        fractions = rows[:, 2:] / optimum
        runs.append(
            {
                "steps": int(rows[-1, 0]),
                "minutes": (rows[:, 1] / 60).round(2).tolist(),
                "payload": fractions.mean(axis=1).round(4).tolist(),
                "last": fractions[-1].round(4).tolist(),
            }
        )
    return runs


def optima(env_id: str) -> list[float]:
    """Optimal payloads of the held-out motions, without margins [kg]."""
    robot = find_robot(env_robot(env_id))
    payloads = []
    for seed in HELD_OUT:
        motion = random_loop(robot.kind, seed)
        task = gym.make(env_id, trajectory=motion).unwrapped.task
        _, plan = first_optimum(robot, task, Margins(), 0.0)
        payloads.append(plan.payload)
        print(f"optimum of motion {seed}: {plan.payload:.3f} kg", flush=True)
    return payloads


def ppo_runs(folders: list[Path]) -> list[dict[str, Any]]:
    """Learning curves of ``train``."""
    runs = []
    for folder in folders:
        with (folder / "log" / "progress.csv").open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if row["rollout/payload_ceiling"]]
        ceilings = [round(float(row["rollout/payload_ceiling"]), 3) for row in rows]
        # It changes with the motions of a season.
        last = np.mean(ceilings[-len(rows) // 4 :])
        runs.append(
            {
                "steps": int(rows[-1]["time/total_timesteps"]),
                "minutes": [round(float(row["time/time_elapsed"]) / 60, 2) for row in rows],
                "payload": ceilings,
                "last": [round(float(last), 3)],
            }
        )
    return runs


def ship(kind: str, env_id: str, folders: list[Path]) -> None:
    """Writes the weights and the card."""
    runs = plan_runs(env_id, folders) if kind == "plan" else ppo_runs(folders)
    order = sorted(range(len(runs)), key=lambda seed: np.mean(runs[seed]["last"]))
    seed = order[(len(order) - 1) // 2]
    command, option = {"plan": ("train-plan", "steps"), "ppo": ("train", "timesteps")}[kind]
    steps = runs[seed]["steps"]
    card = {
        "command": f"cablebot {command} {env_id} --{option} {steps} --seed {seed} --out RUN",
        "seed": seed,
        "runs": runs,
    }
    shutil.copyfile(
        folders[seed] / {"plan": "plan.zip", "ppo": "policy.zip"}[kind],
        WEIGHTS / f"{kind}-{env_id}.zip",
    )
    atomic_write_text(WEIGHTS / f"{kind}-{env_id}.json", json_text(card))
    print(f"seed {seed}: {np.mean(runs[seed]['last']):.3f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("kind", choices=("plan", "ppo"))
    parser.add_argument("env_id")
    parser.add_argument("runs", nargs="+", type=Path)
    arguments = parser.parse_args()
    ship(arguments.kind, arguments.env_id, arguments.runs)
