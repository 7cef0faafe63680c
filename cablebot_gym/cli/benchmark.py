"""``cablebot benchmark``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablebot_gym.cli.options import split_names
from cablebot_gym.utils.console import counting, notes_console

if TYPE_CHECKING:
    from cablebot_gym.benchmark.engine import Backend

MARKDOWN, CSV, JSON = "leaderboard.md", "results.csv", "results.json"
"""Names of the files in the folder of results."""


def benchmark(
    suite: Annotated[
        str, typer.Option(help="smoke (two minutes), standard (half an hour), full (hours) or maps (an hour).")
    ] = "smoke",
    policies: Annotated[
        str | None, typer.Option(help="Names as for `dlcc --policy`, separated by commas; all installed if not given.")
    ] = None,
    ids: Annotated[
        str | None, typer.Option(help="Environments, separated by commas; the suite's if not given.")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Processes; one per core if not given.")] = None,
    ray: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A Ray cluster instead: its address, auto, or local (extra ray)."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the tables and for every finished cell.")] = Path("benchmark"),
    page: Annotated[Path | None, typer.Option(help=f"The page; {MARKDOWN} in the folder if not given.")] = None,
    any_source: Annotated[
        bool, typer.Option("--any-source", help="Take finished cells of other code where there are none of this.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help=f"Print what {JSON} holds.")] = False,
) -> None:
    """Every policy's payload as a share of the best found, on the paper's circle and on held-out motions.

    Finished cells stay in the folder, one file each: the same command goes on where it was interrupted, and computes
    only what is missing, broken or of other code: this package's, or the policy's own package or folder.
    The exit status is 1 if a cell failed.

    Examples:

    cablebot benchmark --suite smoke --out results

    cablebot benchmark --suite standard --policies fl,mypackage.mine:make_policy --workers 8 --out results

    cablebot benchmark --suite full --ray auto --out results
    """
    from cablebot_gym.benchmark.engine import run_cells
    from cablebot_gym.benchmark.leaderboard import markdown, results_json
    from cablebot_gym.benchmark.store import Store
    from cablebot_gym.benchmark.suites import find_env_ids, find_policies, find_suite, suite_cells
    from cablebot_gym.benchmark.tables import csv_text, failures, print_benchmark
    from cablebot_gym.utils.files import write_text_whole

    compute_on = _backend(workers, ray)
    chosen = find_suite(suite)
    env_ids = find_env_ids(chosen, split_names(ids))
    cells = suite_cells(chosen, find_policies(split_names(policies), env_ids))
    files = (out / JSON, out / CSV, page or out / MARKDOWN)
    _check_writable(out, files)
    command = _command(suite=suite, policies=policies, ids=ids, out=str(out), page=None if page is None else str(page))
    errors = notes_console()
    store = Store(out, say=errors.print, any_source=any_source)
    with counting(errors, "cells") as bar:
        task = bar.add_task("computing", total=len(cells))
        try:
            records = run_cells(
                cells,
                store,
                compute_on,
                progress=lambda done, expected: bar.update(task, completed=done, total=expected),
                say=errors.print,
            )
        except KeyboardInterrupt:
            done = int(bar.tasks[task].completed)
            kept = (
                f"{done} of {len(cells)} cells are in {out}; go on" if done else "no cell was finished yet; start again"
            )
            errors.print(f"{kept} with: {command}")
            raise
    text = results_json(suite, command, records)
    for path, content in zip(files, (text, csv_text(records), markdown(suite, command, records)), strict=True):
        write_text_whole(path, content)
    if store.foreign:
        how = "taken as they are" if any_source else "computed anew and kept beside them (--any-source takes them)"
        errors.print(f"{store.foreign} cells were there by other code alone: {how}")
    errors.print("wrote " + ", ".join(map(str, files)))
    if as_json:
        print(text, end="")
    else:
        print_benchmark(records)
    if failures(records):
        raise typer.Exit(1)


def _backend(workers: int | None, ray: str | None) -> Backend:
    from cablebot_gym.benchmark.engine import local
    from cablebot_gym.utils.workers import check_workers

    if ray is None:
        return local(check_workers(workers))
    if workers is not None:
        raise ValueError("--workers and --ray exclude each other: a Ray cluster has workers of its own")
    from cablebot_gym.benchmark.ray_backend import on_ray

    return on_ray(ray)


def _check_writable(out: Path, files: tuple[Path, ...]) -> None:
    from cablebot_gym.benchmark.store import FOLDER
    from cablebot_gym.utils.files import usable_file, usable_folder

    usable_folder(out / FOLDER)
    for path in files:
        usable_file(path)


def _command(**options: str | None) -> str:
    given = (f"--{name} {shlex.quote(value)}" for name, value in options.items() if value is not None)
    return " ".join(["cablebot benchmark", *given])
