"""``cablebot train``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from cablebot_gym.utils.console import progress


def train(
    env_id: Annotated[
        str, typer.Argument(metavar="ID", help="Environment, such as CableBot-Spatial-v0.")
    ],
    out: Annotated[Path, "Folder of the run: policies, checkpoints, log."],
    config: Annotated[
        Path | None,
        "YAML file of hyperparameters by environment. Default: the shipped one.",
    ] = None,
    seed: Annotated[
        int | None, "Seed of weights, exploration and environments. Default: 0."
    ] = None,
    timesteps: Annotated[
        int | None,
        "Number of actions over all environments. Default: n_timesteps of the configuration.",
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="Continue the run in --out from its checkpoint, with its settings."
        ),
    ] = False,
    eval_every: Annotated[
        int | None,
        "Timesteps between two evaluations, which checkpoints follow. Default: 1/20 of all.",
    ] = None,
    evaluation: Annotated[
        str | None,
        "Keyword arguments of evaluate_dlcc as JSON, such as "
        '\'{"uncertainty": "table6", "draws": 32}\'.',
    ] = None,
) -> None:
    """Train a learned policy and write the one with the largest DLCC to best.zip.

    The same seed on the same machine gives the same policy. Ctrl-C writes a checkpoint and stops.
    --resume continues from the last checkpoint with new episodes, so that the result is not exactly
    that of an uninterrupted run.

    Examples:

    cablebot train CableBot-Spatial-v0 --seed 0 --out runs/spatial

    cablebot train CableBot-Spatial-v0 --out runs/spatial --resume
    """
    from cablebot_baselines.learned import training

    options: dict[str, Any] = {
        "config": config,
        "seed": seed,
        "eval_every": eval_every,
        "evaluation": evaluation and _evaluation(evaluation),
    }
    given = {name: value for name, value in options.items() if value is not None}
    with progress("training", "timesteps") as step:
        if not resume:
            run = training.train(env_id, out=out, timesteps=timesteps, progress=step, **given)
        elif given:
            names = ", ".join(f"--{name.replace('_', '-')}" for name in given)
            raise ValueError(f"--resume continues with the settings of the run: leave out {names}")
        else:
            run = training.resume_training(env_id, out=out, timesteps=timesteps, progress=step)
    print(run)


def _evaluation(text: str) -> dict[str, Any]:
    """Value of ``--evaluation``."""
    try:
        return dict(json.loads(text))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f'--evaluation must be a JSON object, {{"keyword": value}}: {error}'
        ) from error


def train_plan(
    env_id: Annotated[
        str, typer.Argument(metavar="ID", help="Environment, such as CableBot-Planar-v0.")
    ],
    out: Annotated[Path, "Folder of the run: weights, checkpoint, learning curve."],
    steps: Annotated[int, "Number of training steps in all."] = 8000,
    seed: Annotated[int, "Seed of weights and batches."] = 0,
) -> None:
    """Train a network that plans motions, and write it to plan.zip.

    Ctrl-C keeps the last checkpoint; the same line continues from it.

    Example: cablebot train-plan CableBot-Planar-v0 --out runs/plan
    """
    from cablebot_baselines.learned.plan_training import train_plans

    with progress("training", "steps") as step:
        train_plans(env_id, out=out, steps=steps, seed=seed, progress=step)
