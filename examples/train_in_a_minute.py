"""Trains a policy in less than a minute on one core. It carries half as much again as the paper's
law.

The policy is a small network that shifts the reference within the error bounds; the paper's law
tracks it. Gradients go through the inverse dynamics, so training needs no episodes. Needs the extra
sb3: pip install 'cablebot-gym[sb3]'.

Run it: python examples/train_in_a_minute.py [FOLDER]
"""

import sys
from pathlib import Path

from cablebot_baselines.learned.planner_run import train_gradient
from cablebot_gym import evaluate_dlcc

ENV_ID = "CableBot-Planar-v0"

if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/planar")
    trained = train_gradient(ENV_ID, out=folder, seed=0)
    for evaluation in trained.evaluations:
        print(f"after {evaluation.wall_s:5.1f} s: {evaluation.payload_kg:.2f} kg")
    for policy in ("fl", str(folder / "best.zip")):
        print(evaluate_dlcc(policy, ENV_ID))
