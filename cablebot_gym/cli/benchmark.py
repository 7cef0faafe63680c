"""``cablebot benchmark``."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablebot_gym.cli.options import Workers, split_names
from cablebot_gym.utils.console import notes_console, progress

if TYPE_CHECKING:
    from cablebot_gym.benchmark.engine import Backend

MARKDOWN, CSV, JSON = "leaderboard.md", "results.csv", "results.json"
"""Names of the files in the results folder."""


def benchmark(
    suite: Annotated[
        str,
        typer.Option(
            help="Suite: smoke (two minutes), standard (half an hour), full (hours), maps or paper-maps (an hour)."
        ),
    ] = "smoke",
    policies: Annotated[
        str | None,
        typer.Option(
            help="Policies as for `dlcc --policy`, separated by commas. The default is all installed policies."
        ),
    ] = None,
    ids: Annotated[
        str | None, typer.Option(help="Environment ids, separated by commas. The default is those of the suite.")
    ] = None,
    workers: Workers = None,
    ray: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Run on a Ray cluster: its address, auto, or local. Requires the extra ray."
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Results folder, for the tables and all finished cells.")] = Path(
        "benchmark"
    ),
    page: Annotated[
        Path | None, typer.Option(help=f"File of the leaderboard. The default is {MARKDOWN} in the results folder.")
    ] = None,
    any_source: Annotated[
        bool, typer.Option("--any-source", help="Reuse finished cells that were computed with different code.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help=f"Print the content of {JSON}.")] = False,
) -> None:
    """Score policies by their payload over the best known payload, on the paper's circle and held-out trajectories.

    Each finished cell is stored as a file in the results folder. The same command resumes an interrupted benchmark. It
    computes only cells that are missing, damaged or computed with different code: that of this package, or of the
    package or folder of the policy. The exit status is 1 if a cell failed.

    Examples:

    cablebot benchmark --suite smoke --out results

    cablebot benchmark --suite standard --policies fl,mypackage.mine:make_policy --workers 8 --out results

    cablebot benchmark --suite full --ray auto --out results
    """
    from cablebot_gym.benchmark.engine import run_cells
    from cablebot_gym.benchmark.leaderboard import markdown, results_json
    from cablebot_gym.benchmark.store import FOLDER, Store
    from cablebot_gym.benchmark.suites import find_env_ids, find_policies, find_suite, suite_cells
    from cablebot_gym.benchmark.tables import csv_text, failures, print_benchmark
    from cablebot_gym.utils.files import atomic_write_text, check_writable_dir, check_writable_file

    backend = _backend(workers, ray)
    chosen = find_suite(suite)
    env_ids = find_env_ids(chosen, split_names(ids))
    cells = suite_cells(chosen, find_policies(split_names(policies), env_ids))
    files = (out / JSON, out / CSV, page or out / MARKDOWN)
    check_writable_dir(out / FOLDER)
    for path in files:
        check_writable_file(path)
    command = _command(suite=suite, policies=policies, ids=ids, out=out, page=page)
    say, finished = notes_console().print, 0
    store = Store(out, say=say, any_source=any_source)
    with progress("computing", "cells") as step:

        def count(done: int, expected: int) -> None:
            nonlocal finished
            finished = done
            step(done, expected)

        try:
            records = run_cells(cells, store, backend, progress=count, say=say)
        except KeyboardInterrupt:
            state = f"{finished} of {len(cells)} cells are finished and stored in {out}. Resume"
            say(f"{state if finished else 'No cell is finished yet. Start again'} with: {command}")
            raise
    text = results_json(suite, command, records)
    for path, content in zip(files, (text, csv_text(records), markdown(suite, command, records)), strict=True):
        atomic_write_text(path, content)
    if store.foreign:
        use = "they are reused" if any_source else "they are computed again (--any-source reuses them)"
        say(f"{store.foreign} cells exist only with results of different code: {use}")
    say("wrote " + ", ".join(map(str, files)))
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
        raise ValueError("--workers and --ray exclude each other: a Ray cluster has its own workers")
    from cablebot_gym.benchmark.ray_backend import on_ray

    return on_ray(ray)


def _command(**options: object) -> str:
    """The command line that repeats this benchmark."""
    given = (f"--{name} {shlex.quote(str(value))}" for name, value in options.items() if value is not None)
    return " ".join(["cablebot benchmark", *given])
