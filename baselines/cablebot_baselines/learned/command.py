"""``cablebot train``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cablebot_gym.utils.checks import choice
from cablebot_gym.utils.console import command_line, notes_console, progress

if TYPE_CHECKING:
    from cablebot_baselines.learned.runs import TrainingResult


EnvId = Annotated[
    str, typer.Argument(metavar="ID", help="Environment, such as CableBot-Spatial-v0.")
]
Out = Annotated[
    Path, typer.Option(help="Folder of the run: checkpoint, policies, evaluations, logs.")
]
Algo = Annotated[
    str | None,
    typer.Option(help="ppo, sac, tqc or gradient (analytic policy gradient, APG). Default: ppo."),
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
Json = Annotated[bool, typer.Option("--json", help="Print the evaluations as JSON.")]


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
    as_json: Json = False,
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
    from cablebot_baselines.learned.runs import Interrupted, TrainingResult

    if algo is None:
        algo = TrainingResult.load(out).settings["algorithm"] if resume else "ppo"
    common = {"out": out, "config": config, "seed": seed, "resume": resume, "threads": threads}
    sb3_options = {
        "timesteps": timesteps,
        "evaluation": _evaluation(evaluation),
        "eval_every": eval_every,
        "checkpoint_every": checkpoint_every,
    }
    try:
        result = _run_training(env_id, algo, common, sb3_options)
    except Interrupted as stop:
        again = command_line("train", env_id, out=out, resume=True)
        notes_console().print(f"stopped after {stop.timesteps} timesteps; to resume: {again}")
        raise
    print(json.dumps(result.to_dict(), indent=2) if as_json else result)


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


def _run_training(
    env_id: str, algo: str, common: dict[str, Any], sb3_options: dict[str, Any]
) -> TrainingResult:
    """Trains with the trainer of an algorithm.

    Args:
        env_id: id of the environment.
        algo: algorithm.
        common: options of both trainers.
        sb3_options: options of the algorithms of Stable-Baselines3; None if not given.
    """
    from cablebot_baselines.learned import gradient_run, training
    from cablebot_baselines.learned.config import ALGORITHMS

    choice("algorithm", algo, (*ALGORITHMS, gradient_run.ALGORITHM))
    with progress("training", "timesteps") as step:
        common |= {"progress": step, "say": notes_console().print}
        if algo != gradient_run.ALGORITHM:
            return training.train(env_id, algorithm=algo, **common, **sb3_options)
        for name, value in sb3_options.items():
            if value is not None:
                raise ValueError(
                    f"--{name.replace('_', '-')} is for ppo, sac and tqc: for gradient, set it in the --config file"
                )
        return gradient_run.train_gradient(env_id, **common)
