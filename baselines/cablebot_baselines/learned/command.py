"""``cablebot train`` and ``cablebot train-plan``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from cablebot_gym.utils.console import progress


def train(
    env_id: Annotated[
        str, typer.Argument(metavar="ID", help="Environment, such as CableBot-Spatial-v0.")
    ],
    out: Annotated[Path, "Folder of the run: policy, checkpoints, log."],
    timesteps: Annotated[
        int | None, "Number of actions over all robots. Default: that of the recipe."
    ] = None,
    seed: Annotated[int, "Seed of weights, exploration, robots and payloads."] = 0,
) -> None:
    """Train a policy with PPO of Stable-Baselines3, and write it to policy.zip.

    Ctrl-C keeps the last checkpoint; the same line continues from it, with new episodes.

    Example: cablebot train CableBot-Spatial-v0 --out runs/ppo
    """
    from cablebot_baselines.learned import recipe, training

    if timesteps is None:
        timesteps = recipe.TIMESTEPS
    with progress("training", "timesteps") as step:
        training.train(env_id, out=out, timesteps=timesteps, seed=seed, progress=step)


def train_plan(
    env_id: Annotated[
        str, typer.Argument(metavar="ID", help="Environment, such as CableBot-Planar-v0.")
    ],
    out: Annotated[Path, "Folder of the run: weights, checkpoint, learning curve."],
    steps: Annotated[int, "Number of training steps in all."] = 6000,
    seed: Annotated[int, "Seed of weights and batches."] = 0,
) -> None:
    """Train a network that plans motions, and write it to plan.zip.

    Ctrl-C keeps the last checkpoint; the same line continues from it. Robots with more coordinates
    need more steps: the page on training has the commands of the shipped networks.

    Example: cablebot train-plan CableBot-Planar-v0 --out runs/plan
    """
    from cablebot_baselines.learned.plan_training import PLAN, train_plans

    with progress("training") as step:
        payloads = train_plans(env_id, out=out, steps=steps, seed=seed, progress=step)
    mean = sum(payloads) / len(payloads)
    print(f"{out / PLAN}: {mean:.3f} kg, mean of {len(payloads)} motions that were not trained on")
