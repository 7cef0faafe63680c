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
    typer.Option(help="ppo, sac or tqc. Default: ppo."),
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
                algorithm=algo,
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
