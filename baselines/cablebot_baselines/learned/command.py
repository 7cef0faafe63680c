"""``cablebot train``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from cablebot_gym.utils.console import command_line, notes_console, progress


def train(
    env_id: Annotated[
        str, typer.Argument(metavar="ID", help="Environment, such as CableBot-Spatial-v0.")
    ],
    out: Annotated[Path, "Folder of the run: checkpoint, policies, evaluations, logs."],
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
        int | None, "Timesteps between two evaluations. Default: 1/20 of all timesteps."
    ] = None,
    checkpoint_every: Annotated[
        int | None, "Timesteps between two checkpoints. Default: 1/20 of all timesteps."
    ] = None,
    evaluation: Annotated[
        str | None,
        "Keyword arguments of evaluate_dlcc as JSON, such as "
        '\'{"uncertainty": "table6", "draws": 32}\'.',
    ] = None,
    threads: Annotated[int | None, "Number of torch's threads. Default: 1."] = None,
) -> None:
    """Train a learned policy and write the one with the largest DLCC to best.zip.

    The same seed on the same machine gives the same policy. Ctrl-C writes a checkpoint and stops.
    --resume continues from the last checkpoint with new episodes, so that the result is not exactly
    that of an uninterrupted run.

    Examples:

    cablebot train CableBot-Spatial-v0 --seed 0 --out runs/spatial

    cablebot train CableBot-Spatial-v0 --out runs/spatial --resume
    """
    from cablebot_baselines.learned.runs import Interrupted
    from cablebot_baselines.learned.training import train as run_training

    say = notes_console().print
    try:
        with progress("training", "timesteps") as step:
            result = run_training(
                env_id,
                out=out,
                resume=resume,
                progress=step,
                say=say,
                config=config,
                seed=seed,
                timesteps=timesteps,
                eval_every=eval_every,
                checkpoint_every=checkpoint_every,
                threads=threads,
                evaluation=_evaluation(evaluation),
            )
    except Interrupted as stop:
        again = command_line("train", env_id, out=out, resume=True)
        say(f"stopped after {stop.timesteps} timesteps; to resume: {again}")
        raise
    print(result)


def _evaluation(text: str | None) -> dict[str, Any] | None:
    """Value of ``--evaluation``."""
    if text is None:
        return None
    try:
        return dict(json.loads(text))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f'--evaluation must be a JSON object, {{"keyword": value}}: {error}'
        ) from error
