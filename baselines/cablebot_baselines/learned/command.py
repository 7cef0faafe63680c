"""``cablebot train``."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from cablebot_gym.utils.console import counting, notes_console
from cablebot_gym.utils.suggestions import no_such


def train(
    env_id: Annotated[str, typer.Argument(metavar="ID", help="Environment, such as CableBot-Spatial-v0.")],
    out: Annotated[Path, typer.Option(help="Folder of the run: checkpoint, policies, evaluations, logs.")],
    algo: Annotated[str | None, typer.Option(help="ppo, sac, tqc or gradient; ppo if not given.")] = None,
    config: Annotated[
        Path | None,
        typer.Option(help="YAML file of hyperparameters by environment, or the name of one that ships."),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Of weights, exploration and environments; 0 if not given.")] = None,
    timesteps: Annotated[
        int | None, typer.Option(help="Actions over all environments, instead of the configuration's n_timesteps.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the run in --out, as it was started.")] = False,
    eval_every: Annotated[
        int | None, typer.Option(help="Timesteps from one evaluation to the next: a twentieth of all.")
    ] = None,
    checkpoint_every: Annotated[
        int | None, typer.Option(help="Timesteps from one checkpoint to the next: a twentieth of all.")
    ] = None,
    evaluation: Annotated[
        str | None,
        typer.Option(help='Keywords of evaluate_dlcc as JSON, such as \'{"uncertainty": "table6", "draws": 32}\'.'),
    ] = None,
    threads: Annotated[int | None, typer.Option(help="Of torch; 1 if not given.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the evaluations as JSON.")] = False,
) -> None:
    """Trains a learned policy; the best by payload ends up in best.zip.

    The same seed on the same machine gives the same policy. Ctrl-C leaves a checkpoint; --resume goes on from there as
    if nothing had happened.

    Examples:

    cablebot train CableBot-Spatial-v0 --algo ppo --seed 0 --out runs/spatial

    cablebot train CableBot-Spatial-v0 --out runs/spatial --resume

    cablebot train CableBot-Planar-v0 --algo gradient --out runs/planar
    """
    from cablebot_baselines.learned import gradient_run, training
    from cablebot_baselines.learned.config import ALGORITHMS
    from cablebot_baselines.learned.runs import Interrupted

    if algo not in (None, *ALGORITHMS, gradient_run.ALGORITHM):
        raise ValueError(no_such("algorithm", algo, (*ALGORITHMS, gradient_run.ALGORITHM)))
    console = notes_console()
    with counting(console, "timesteps") as bar:
        task = bar.add_task("starting", total=1)

        def step(text: str, done: int, total: int) -> None:
            bar.update(task, description=text, completed=done, total=total)

        common: dict[str, Any] = {"out": out, "config": config, "seed": seed, "resume": resume, "threads": threads}
        asked: dict[str, Any] = {"timesteps": timesteps, "eval_every": eval_every, "checkpoint_every": checkpoint_every}
        asked |= {"evaluation": _mapping(evaluation)}
        try:
            if algo == gradient_run.ALGORITHM:
                if given := [name for name, value in asked.items() if value is not None]:
                    option = f"--{given[0].replace('_', '-')}"
                    raise ValueError(f"{option} is for ppo, sac and tqc: gradient takes it from its --config")
                trained = gradient_run.train_gradient(env_id, progress=step, **common)
            else:
                trained = training.train(env_id, algorithm=algo, progress=step, say=console.print, **common, **asked)
        except Interrupted as stop:
            words = ["cablebot", "train", env_id, *([] if algo is None else ["--algo", algo]), "--out", str(out)]
            console.print(f"stopped after {stop.timesteps} timesteps; to go on: {shlex.join([*words, '--resume'])}")
            raise
    if as_json:
        print(json.dumps(trained.to_dict(), indent=2))
        return
    print(trained)


def _mapping(text: str | None) -> dict[str, Any] | None:
    try:
        data = None if text is None else json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"--evaluation is no valid JSON: {error}") from error
    if data is not None and not isinstance(data, dict):
        raise ValueError(f'--evaluation has to be a JSON object, {{"keyword": value}}, not {text}')
    return data
