"""Ships the median of the trainings with several seeds: its weights, and a card with the command and
the learning curves of all.

python scripts/ship.py plan CableBot-Planar-v0 0=RUN 1=RUN …    # of `cablebot train-plan`
python scripts/ship.py ppo CableBot-Planar-v0 0=RUN 1=RUN …     # of `cablebot train`

The seeds that are not named stay as the card has them: delete it after a change of the training. The
measure is the payload on the held-out motions: of a network that plans as a fraction of the optimum
without margins, of PPO in payloads of exact tracking, both with exactly known robots.
"""

from __future__ import annotations

import argparse
import csv
import json
import shutil
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from cablebot_baselines.learned.plan_training import HELD_OUT, PLAN
from cablebot_baselines.learned.shipped import WEIGHTS
from cablebot_baselines.learned.steering import Steering
from cablebot_baselines.learned.training import POLICY
from cablebot_baselines.planners.rehearsed import first_optimum
from cablebot_gym import evaluate_dlcc
from cablebot_gym.envs import env_robot
from cablebot_gym.motions import random_loop
from cablebot_gym.planning import Infeasible, Margins
from cablebot_gym.robots import find_robot
from cablebot_gym.utils.files import atomic_write_text, json_text


def plan_run(folder: Path, optima: list[float | None]) -> dict[str, Any]:
    """Learning curve of ``train-plan`` on the motions whose optimum is known."""
    rows = np.loadtxt(folder / "progress.csv", delimiter=",", ndmin=2, skiprows=1)
    optimum = np.array(optima, float)
    fractions = (rows[:, 2:] / optimum)[:, np.isfinite(optimum)]
    return {
        "steps": int(rows[-1, 0]),
        "minutes": (rows[:, 1] / 60).round(2).tolist(),
        "payload": fractions.mean(axis=1).round(4).tolist(),
        "last": fractions[-1].round(4).tolist(),
        "mean": round(float(rows[-1, 2:].mean()), 3),  # [kg], as train-plan prints it
    }


def optimal_payloads(env_id: str) -> list[float | None]:
    """Optimal payloads of the held-out motions, without margins [kg]; None where the program fails."""
    robot = find_robot(env_robot(env_id))
    payloads: list[float | None] = []
    for seed in HELD_OUT:
        task = gym.make(env_id, trajectory=random_loop(robot.kind, seed)).unwrapped.task
        try:
            _, plan = first_optimum(robot, task, Margins(), 0.0)
            payloads.append(plan.payload)
        except Infeasible:
            payloads.append(None)
        print(f"optimum of motion {seed}: {payloads[-1]} kg", flush=True)
    return payloads


def ppo_run(env_id: str, folder: Path) -> dict[str, Any]:
    """Learning curve of ``train``: the ceiling of its payloads."""
    with (folder / "log" / "progress.csv").open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if row["rollout/payload_ceiling"]]
    return {
        "steps": int(rows[-1]["time/total_timesteps"]),
        "minutes": [round(float(row["time/time_elapsed"]) / 60, 2) for row in rows],
        "payload": [round(float(row["rollout/payload_ceiling"]), 3) for row in rows],
        "last": steered_payloads(env_id, folder / POLICY),
    }


def steered_payloads(env_id: str, policy: Path) -> list[float]:
    """Payloads of the held-out motions in those of exact tracking."""
    steering = Steering(find_robot(env_robot(env_id)))
    payloads = []
    for seed in HELD_OUT:
        motion = random_loop(steering.robot.kind, seed)
        steering.reset([gym.make(env_id, trajectory=motion).unwrapped.task])
        result = evaluate_dlcc(str(policy), env_id, trajectory=motion, payload_known=False)
        carried = result.payload or 0.0  # None if it fails unloaded
        payloads.append(round(carried / steering.exact_payloads.item(), 4))
        print(f"motion {seed}: {payloads[-1]:.3f} of exact tracking", flush=True)
    return payloads


def ship(kind: str, env_id: str, folders: dict[int, Path]) -> None:
    """Writes the weights and the card.

    Raises:
        SystemExit: if the median is an earlier training, whose weights are lost.
    """
    card_path = WEIGHTS / f"{kind}-{env_id}.json"
    card: dict[str, Any] = {"runs": {}}
    if card_path.exists():
        card = json.loads(card_path.read_text(encoding="utf-8"))
    if kind == "plan" and "optima" not in card:
        card["optima"] = optimal_payloads(env_id)
    runs = card["runs"]
    for seed, folder in folders.items():
        if kind == "plan":
            runs[str(seed)] = plan_run(folder, card["optima"])
        else:
            runs[str(seed)] = ppo_run(env_id, folder)
    order = sorted(runs, key=lambda seed: np.mean(runs[seed]["last"]))
    for seed in order:
        print(f"seed {seed}: {np.mean(runs[seed]['last']):.3f}")
    median = order[(len(order) - 1) // 2]
    if int(median) in folders:
        weights = folders[int(median)] / {"plan": PLAN, "ppo": POLICY}[kind]
        shutil.copyfile(weights, WEIGHTS / f"{kind}-{env_id}.zip")
    elif median != str(card["seed"]):
        raise SystemExit(f"the median is seed {median}, whose weights are lost: train it again")
    command = f"train {env_id}"
    if kind == "plan":
        command = f"train-plan {env_id} --steps {runs[median]['steps']}"
    card["command"] = f"cablebot {command} --seed {median} --out RUN"
    card["seed"] = int(median)
    atomic_write_text(card_path, json_text(card))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("kind", choices=("plan", "ppo"))
    parser.add_argument("env_id")
    parser.add_argument("runs", nargs="+", metavar="SEED=RUN")
    arguments = parser.parse_args()
    pairs = [text.partition("=") for text in arguments.runs]
    runs = {int(seed): Path(folder) for seed, _, folder in pairs}
    ship(arguments.kind, arguments.env_id, runs)
