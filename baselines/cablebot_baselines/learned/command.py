"""``cablebot train``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from cablebot_gym.utils.console import command_line, notes_console, progress

EnvId = Annotated[
    str, typer.Argument(metavar="ID", help="Environment, such as CableBot-Spatial-v0.")
]
Out = Annotated[
    Path, typer.Option(help="Folder of the run: checkpoint, policies, evaluations, logs.")
]
Algo = Annotated[
    str | None,
    typer.Option(help="ppo, sac, tqc or planner (a network plans accelerations). Default: ppo."),
]
Config = Annotated[
    Path | None,
    typer.Option(help="YAML file of hyperparameters by environment, or the name of a shipped one."),
]
Seed = Annotated[
    int | None, typer.Option(help="Seed of weights, exploration and environments. Default: 0.")
]
Timesteps = Annotated[
    int | None,
    typer.Option(
        help="Number of actions over all environments. Default: n_timesteps of the configuration."
    ),
]
Resume = Annotated[
    bool,
    typer.Option(
        "--resume", help="Continue the run in --out from its checkpoint, with its settings."
    ),
]
EvalEvery = Annotated[
    int | None,
    typer.Option(help="Timesteps between two evaluations. Default: 1/20 of all timesteps."),
]
CheckpointEvery = Annotated[
    int | None,
    typer.Option(help="Timesteps between two checkpoints. Default: 1/20 of all timesteps."),
]
Evaluation = Annotated[
    str | None,
    typer.Option(
        help='Keyword arguments of evaluate_dlcc as JSON, such as \'{"uncertainty": "table6", "draws": 32}\'.'
    ),
]
Threads = Annotated[int | None, typer.Option(help="Number of torch's threads. Default: 1.")]


def train(
    env_id: EnvId,
    out: Out,
    algo: Algo = None,
    config: Config = None,
    seed: Seed = None,
    timesteps: Timesteps = None,
    resume: Resume = False,
    eval_every: EvalEvery = None,
    checkpoint_every: CheckpointEvery = None,
    evaluation: Evaluation = None,
    threads: Threads = None,
) -> None:
    """Train a learned policy and write the one with the largest DLCC to best.zip.

    The same seed on the same machine gives the same policy. Ctrl-C writes a checkpoint and stops.
    --resume continues from the last checkpoint with new episodes, so that the result is not exactly
    that of an uninterrupted run.

    Examples:

    cablebot train CableBot-Spatial-v0 --algo ppo --seed 0 --out runs/spatial

    cablebot train CableBot-Spatial-v0 --out runs/spatial --resume

    cablebot train CableBot-Planar-v0 --algo planner --out runs/planar
    """
    from cablebot_baselines.learned.planner_run import ALGORITHM
    from cablebot_baselines.learned.runs import Interrupted, TrainingResult
    from cablebot_baselines.learned.training import find_trainer

    if algo is None:
        algo = TrainingResult.load(out).settings["algorithm"] if resume else "ppo"
    run_training = find_trainer(algo)
    options: dict[str, Any] = {
        "timesteps": timesteps,
        "evaluation": _evaluation(evaluation),
        "eval_every": eval_every,
        "checkpoint_every": checkpoint_every,
    }
    options = {name: value for name, value in options.items() if value is not None}
    if algo == ALGORITHM and options:
        option = next(iter(options)).replace("_", "-")
        raise ValueError(
            f"--{option} is for ppo, sac and tqc: for planner, set it in the --config file"
        )
    options |= {"config": config, "seed": seed, "threads": threads, "resume": resume}
    say = notes_console().print
    try:
        with progress("training", "timesteps") as step:
            result = run_training(env_id, out=out, progress=step, say=say, **options)
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
