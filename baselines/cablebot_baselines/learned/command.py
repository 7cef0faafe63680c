"""``cablebot train``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from cablebot_gym.utils.checks import choice
from cablebot_gym.utils.console import command_line, notes_console, progress


def train(
    env_id: Annotated[
        str, typer.Argument(metavar="ID", help="Environment, such as CableBot-Spatial-v0.")
    ],
    out: Annotated[
        Path, typer.Option(help="Folder of the run: checkpoint, policies, evaluations, logs.")
    ],
    algo: Annotated[
        str | None,
        typer.Option(
            help="ppo, sac, tqc or gradient (analytic policy gradient, APG). Default: ppo."
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            help="YAML file of hyperparameters by environment, or the name of a shipped one."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of weights, exploration and environments. Default: 0.")
    ] = None,
    timesteps: Annotated[
        int | None,
        typer.Option(
            help="Number of actions over all environments. Default: n_timesteps of the configuration."
        ),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume", help="Continue the run in --out from its checkpoint, with its settings."
        ),
    ] = False,
    eval_every: Annotated[
        int | None,
        typer.Option(help="Timesteps between two evaluations. Default: 1/20 of all timesteps."),
    ] = None,
    checkpoint_every: Annotated[
        int | None,
        typer.Option(help="Timesteps between two checkpoints. Default: 1/20 of all timesteps."),
    ] = None,
    evaluation: Annotated[
        str | None,
        typer.Option(
            help='Keyword arguments of evaluate_dlcc as JSON, such as \'{"uncertainty": "table6", "draws": 32}\'.'
        ),
    ] = None,
    threads: Annotated[
        int | None, typer.Option(help="Number of torch's threads. Default: 1.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the evaluations as JSON.")] = False,
) -> None:
    """Train a learned policy and write the one with the largest DLCC to best.zip.

    The same seed on the same machine gives the same policy. Ctrl-C writes a checkpoint and stops.
    --resume continues from the last checkpoint with new episodes, so that the result is not exactly
    that of an uninterrupted run.

    Examples:

    cablebot train CableBot-Spatial-v0 --algo ppo --seed 0 --out runs/spatial

    cablebot train CableBot-Spatial-v0 --out runs/spatial --resume

    cablebot train CableBot-Planar-v0 --algo gradient --out runs/planar
    """
    from cablebot_baselines.learned import gradient_run, training
    from cablebot_baselines.learned.config import ALGORITHMS
    from cablebot_baselines.learned.runs import Interrupted, TrainingResult

    if algo is None:
        algo = TrainingResult.load(out).settings["algorithm"] if resume else "ppo"
    choice("algorithm", algo, (*ALGORITHMS, gradient_run.ALGORITHM))
    try:
        conditions = None if evaluation is None else dict(json.loads(evaluation))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f'--evaluation must be a JSON object, {{"keyword": value}}: {error}'
        ) from error
    with progress("training", "timesteps") as step:
        common: dict[str, Any] = {
            "out": out,
            "config": config,
            "seed": seed,
            "resume": resume,
            "threads": threads,
        }
        common |= {"progress": step, "say": notes_console().print}
        options: dict[str, Any] = {"timesteps": timesteps, "evaluation": conditions}
        options |= {"eval_every": eval_every, "checkpoint_every": checkpoint_every}
        try:
            if algo == gradient_run.ALGORITHM:
                if given := [name for name, value in options.items() if value is not None]:
                    option = f"--{given[0].replace('_', '-')}"
                    raise ValueError(
                        f"{option} is for ppo, sac and tqc: for gradient, set it in the --config file"
                    )
                result = gradient_run.train_gradient(env_id, **common)
            else:
                result = training.train(env_id, algorithm=algo, **common, **options)
        except Interrupted as stop:
            again = command_line("train", env_id, out=out, resume=True)
            notes_console().print(f"stopped after {stop.timesteps} timesteps; to resume: {again}")
            raise
    print(json.dumps(result.to_dict(), indent=2) if as_json else result)
