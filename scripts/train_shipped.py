"""Trains and evaluates the shipped learned policies with several seeds; writes weights, cards and
docs/learned.md.

    python scripts/train_shipped.py --policy planner

Runs are kept in folders ``NAME-KIND-SEED`` under ``--runs``, evaluations in the folder ``judged``
next to them. The same command resumes after an interrupt. ``--page`` updates the best known
payloads of the existing cards from the leaderboard, and renders docs/learned.md. Needs the extra
``sb3``.
"""

from __future__ import annotations

import argparse
import io
import json
import shutil
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from cards.card import LEAST_SEEDS, Card, read_cards
from cards.making import (
    STANDARD,
    Evaluate,
    Protocol,
    known_on_held_out,
    make_card,
    read_best_known,
    with_best_known,
)
from cards.page import card_markdown

from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.runs import (
    BEST,
    LAST,
    STATE,
    Interrupted,
    TrainingResult,
    read_yaml,
)
from cablebot_baselines.learned.shipped import SHIPPED, WEIGHTS, Shipped, stem
from cablebot_gym.benchmark.cells import Cell
from cablebot_gym.benchmark.engine import local, run_cells
from cablebot_gym.benchmark.records import Record
from cablebot_gym.benchmark.store import Store
from cablebot_gym.utils.checks import choice
from cablebot_gym.utils.console import notes_console, progress
from cablebot_gym.utils.files import atomic_write, atomic_write_text, check_writable_dir
from cablebot_gym.utils.workers import check_workers
from cablebot_gym.utils.workers import run as run_tasks

ROOT = Path(__file__).resolve().parents[1]

DOCS = ROOT / "docs"

RESULTS = DOCS / "leaderboard" / "results.json"
"""Results of the leaderboard."""

EVALUATIONS = "judged"
"""Folder of finished evaluations, in the folder of the runs."""

LARGEST = 500_000
"""Largest size of a shipped file [bytes]."""

PAGE = "learned.md"

_EPISODE_STATE = (
    "_last_obs",
    "_last_original_obs",
    "_last_episode_starts",
    "ep_info_buffer",
    "ep_success_buffer",
)
"""Attributes of a model that are useless without its environments."""

_errors = notes_console()


def main() -> None:
    """Command line; errors exit with status 2, an interrupt with status 130."""
    arguments = _parser().parse_args()
    try:
        policies = list(SHIPPED.values())
        if arguments.policy:
            policies = [SHIPPED[choice("learned policy", arguments.policy, SHIPPED)]]
        pairs = [(policy, env_id) for policy in policies for env_id in policy.env_ids]
        if not arguments.page:
            ship_all(pairs, seeds=arguments.seeds, runs=arguments.runs, jobs=arguments.jobs)
        write_page()
    except (ValueError, ImportError, OSError, RuntimeError) as error:
        _errors.print(f"error: {error}")
        sys.exit(2)
    except KeyboardInterrupt:
        _errors.print("stopped; finished work is kept, and the same command resumes")
        sys.exit(130)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--policy", help=f"{', '.join(SHIPPED)} (default: all)")
    parser.add_argument("--seeds", type=int, default=LEAST_SEEDS, help="number of training seeds")
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="folder of the runs")
    parser.add_argument("--jobs", type=int, default=1, help="parallel trainings or evaluations")
    parser.add_argument("--page", action="store_true", help="only render the page again")
    return parser


def ship_all(
    pairs: Sequence[tuple[Shipped, str]],
    *,
    seeds: int,
    runs: Path,
    protocol: Protocol = STANDARD,
    jobs: int = 1,
    weights: Path = WEIGHTS,
) -> None:
    """Runs the missing trainings, then evaluates and writes one policy after the other.

    Args:
        pairs: policies and environments.
        seeds: number of training seeds.
        runs: folder of the runs.
        protocol: sizes of the evaluation.
        jobs: number of parallel trainings or evaluations.
        weights: folder for weights and cards.

    Raises:
        ValueError: if a number is too small, or a run belongs to another policy or another
            configuration.
        RuntimeError: if an evaluation failed.
    """
    if seeds < LEAST_SEEDS:
        raise ValueError(
            f"--seeds must be at least {LEAST_SEEDS} for a meaningful interval, not {seeds}"
        )
    check_workers(jobs)
    check_writable_dir(runs / EVALUATIONS)
    check_writable_dir(weights)
    best_known = known_on_held_out(read_cards()) | read_best_known(RESULTS)
    train_missing(pairs, seeds=seeds, runs=runs, jobs=jobs)
    for shipped, env_id in pairs:
        card, best = make_card(
            shipped,
            env_id,
            [run_folder(runs, shipped, env_id, seed) for seed in range(seeds)],
            evaluate=_make_evaluate(stem(shipped.name, env_id), runs, jobs),
            best_known=best_known,
            command=f"python scripts/train_shipped.py --policy {shipped.name} --seeds {seeds}",
            protocol=protocol,
        )
        _write_files(card, best, weights)


def run_folder(runs: Path, shipped: Shipped, env_id: str, seed: int) -> Path:
    """Folder of a training."""
    return runs / f"{stem(shipped.name, env_id)}-{seed}"


# ------------------------------------------------------------------------------------------------------------- training


def train_missing(
    pairs: Sequence[tuple[Shipped, str]], *, seeds: int, runs: Path, jobs: int
) -> None:
    """Runs the trainings that are not finished; an interrupted run is resumed from its checkpoint.

    Raises:
        ValueError: if a finished run has another configuration, seed or environment.
    """
    tasks = {}
    for shipped, env_id in pairs:
        for seed in range(seeds):
            folder = run_folder(runs, shipped, env_id, seed)
            if is_finished(folder):
                check_run(folder, shipped, env_id, seed)
            else:
                tasks[folder.name] = partial(_train, shipped.name, env_id, seed, folder, jobs > 1)
    _errors.print(f"trainings: {len(pairs) * seeds - len(tasks)} finished, {len(tasks)} to do")
    results = run_tasks(tasks, workers=jobs, kind=_env_id, say=_errors.print)
    for done, (key, text) in enumerate(results, 1):
        _errors.print(f"trained {done} of {len(tasks)}: {key}: {text}")


def is_finished(folder: Path) -> bool:
    """Whether a training is finished."""
    return (folder / LAST).is_file() and (folder / BEST).is_file()


def check_run(folder: Path, shipped: Shipped, env_id: str, seed: int) -> None:
    """Checks that a finished run has the present environment, algorithm, seed and configuration.

    Raises:
        ValueError: if not; the message says what to do.
    """
    card = Bundle.load(folder / LAST).card
    config = read_yaml(env_id, Path(shipped.algorithm))
    expected = {
        "env_id": env_id,
        "algorithm": shipped.algorithm,
        "seed": seed,
        "config": json.loads(json.dumps(config)),
    }
    for name, value in expected.items():
        if card.get(name) != value:
            raise ValueError(
                f"the finished run {str(folder)!r} has another {name} than the present {shipped.name}: remove the "
                "folder, or choose another --runs"
            )


def _env_id(task: partial[str]) -> str:
    return str(task.args[1])


def _train(name: str, env_id: str, seed: int, folder: Path, quiet: bool) -> str:
    """Runs one training as `cablebot train` does, and returns its result as text."""
    from cablebot_baselines.learned.training import find_trainer

    shipped = SHIPPED[name]
    train = find_trainer(shipped.algorithm)
    options: dict[str, Any] = {
        "out": folder,
        "seed": seed,
        "resume": (folder / STATE).is_file(),
    }
    try:
        if quiet:
            return str(train(env_id, **options))
        with progress(folder.name, "steps") as step:
            return str(train(env_id, progress=step, say=_errors.print, **options))
    except ValueError as error:
        raise ValueError(
            f"{error}. In {str(folder)!r}: remove this folder, or choose another --runs"
        ) from error
    except Interrupted:
        if quiet:  # a worker process exits without a traceback
            sys.exit(1)
        raise


# ----------------------------------------------------------------------------------------------------------- evaluation


def _make_evaluate(name: str, runs: Path, jobs: int) -> Evaluate:
    """Makes a function that computes cells and stores each result immediately."""
    store = Store(runs / EVALUATIONS, say=_errors.print)

    def evaluate(cells: Mapping[str, Cell]) -> list[Record]:
        with progress(name, "evaluations") as step:
            return run_cells(cells, store, local(jobs), progress=step, say=_errors.print)

    return evaluate


# -------------------------------------------------------------------------------------------------------------- writing


def _write_files(card: Card, best: Path, weights: Path) -> None:
    """Writes the bundle, the card and, if it is small enough, the model of Stable-Baselines3."""
    sb3 = weights / f"{card.stem}-sb3.zip"
    model = sb3_model(best)
    if model is not None and len(model) > LARGEST:
        _errors.print(
            f"{card.stem}: its SB3 model is not shipped; {len(model)} bytes exceed the limit {LARGEST}"
        )
        model = None
    if model is None:
        sb3.unlink(missing_ok=True)
    else:
        atomic_write(sb3, partial(Path.write_bytes, data=model))
    atomic_write(weights / f"{card.stem}.zip", partial(shutil.copyfile, best))
    replace(card, sb3=model is not None).save(weights)
    payload = card.shipped.payloads[0] or 0
    _errors.print(
        f"{card.stem}: shipping seed {card.shipped_seed} of {len(card.seeds)} with {payload:.2f} kg"
    )


def sb3_model(best: Path) -> bytes | None:
    """The model in the checkpoint next to a run's best bundle, with the bundle's actor and without
    environments.

    The bundle is that of the best evaluation; critic and optimiser are those at the end of the run.
    None if the run has no PPO model.
    """
    if Bundle.load(best).card.get("algorithm") != "ppo":
        return None
    import torch
    from stable_baselines3 import PPO
    from torch import nn

    model = PPO.load(TrainingResult.load(best.parent).checkpoint / "model.zip", device="cpu")
    policy: Any = model.policy
    layers = [layer for layer in policy.mlp_extractor.policy_net if isinstance(layer, nn.Linear)]
    network = Bundle.load(best).network
    with torch.no_grad():
        for layer, weight, bias in zip(
            [*layers, policy.action_net], network.weights, network.biases, strict=True
        ):
            layer.weight.copy_(torch.as_tensor(weight))
            layer.bias.copy_(torch.as_tensor(bias))
    saved = io.BytesIO()
    compressed = io.BytesIO()
    model.save(saved, exclude=list(_EPISODE_STATE))
    with zipfile.ZipFile(saved) as source, zipfile.ZipFile(compressed, "w") as target:
        for name in source.namelist():
            if name != "system_info.txt":  # it describes the machine of the training
                target.writestr(zipfile.ZipInfo(name), source.read(name), zipfile.ZIP_DEFLATED)
    return compressed.getvalue()


def write_page() -> None:
    """Updates the best known payloads of all cards, and renders the page.

    Raises:
        ValueError: if there is no card, or one is damaged.
    """
    cards = read_cards()
    if not cards:
        raise ValueError(
            f"folder {WEIGHTS.name} contains no card. Make one: python scripts/train_shipped.py"
        )
    best_known = read_best_known(RESULTS)
    for index, card in enumerate(cards):
        cards[index] = with_best_known(card, best_known)
        if cards[index] != card:
            cards[index].save(WEIGHTS)
    atomic_write_text(DOCS / PAGE, card_markdown(cards))
    _errors.print(f"wrote {PAGE} from {len(cards)} cards")


if __name__ == "__main__":
    main()
