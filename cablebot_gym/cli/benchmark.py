"""``cablebot benchmark``."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from cablebot_gym.cli.options import Workers, counted, split_names
from cablebot_gym.cli.records import Options
from cablebot_gym.utils.console import command_line, progress, say

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cablebot_gym.benchmark.cells import Cell
    from cablebot_gym.benchmark.engine import Backend
    from cablebot_gym.benchmark.leaderboard import Results
    from cablebot_gym.benchmark.records import Record
    from cablebot_gym.benchmark.store import Store

MARKDOWN, JSON = "leaderboard.md", "results.json"
"""Names of the files in the results folder."""

_MOST_NAMED = 10
"""Largest number of rows that a check names."""


@dataclass(frozen=True, kw_only=True)
class CellOptions(Options):
    """What is computed."""

    title: ClassVar[str] = "Cells"

    suite: Annotated[
        str,
        "Suite: smoke (minutes), standard (45 minutes on two cores), ranked (the leaderboard, hours), full "
        "(hours) or library (an hour).",
    ] = "smoke"
    policies: Annotated[
        str | None,
        "Policies as for `dlcc --policy`, separated by commas. The default is all installed policies.",
    ] = None
    ids: Annotated[
        str | None,
        "Environment ids, separated by commas. The default is those of the suite.",
    ] = None
    seed_text: Annotated[
        str | None,
        "Public text that determines the hidden motions of the suite ranked, and all noise and draws of every "
        "suite. Choose it after the policies are final, such as a headline of the day.",
    ] = None


def benchmark(
    selection: CellOptions,
    workers: Workers = None,
    ray: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Run on a Ray cluster: its address, auto, or local. Requires the extra ray.",
        ),
    ] = None,
    out: Annotated[Path, "Results folder, for the tables and all finished cells."] = Path(
        "benchmark"
    ),
    check: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Check the results in the folder --out and stop: every row of their suite is there, and N random "
            "rows, best known payloads among them, have the same payloads when they are computed again.",
        ),
    ] = None,
) -> None:
    """Score policies by their payload over the best known payload, on held-out motions and the
    paper's circle.

    The suite ranked makes the leaderboard. Its main number: on each hidden motion, the largest
    payload that several random robots all carry, as a fraction of the best known payload, on the
    mean over the motions.

    A policy that is not shipped with this project runs in a process of its own. Each finished cell
    is stored as a file in the results folder. The same command resumes an interrupted benchmark. It
    computes only cells that are missing, damaged or computed with different code: that of this
    package or of the policy. The exit status is 1 if a payload could not be computed, or if --check
    finds a difference.

    Examples:

    cablebot benchmark --suite smoke --out results

    cablebot benchmark --suite standard --policies fl,mypackage.mine:make_policy --workers 8 --out results

    cablebot benchmark --suite library --out robots

    cablebot benchmark --suite ranked --seed-text "A headline of 4 January 2027" --out board

    cablebot benchmark --check 20 --out board
    """
    backend = _backend(workers, ray)
    if check is not None:
        _check(out, check, backend)
        return
    resume = {"workers": workers, "ray": ray}
    results = _results(selection, out, backend, resume)
    _write(results, out)
    if _has_failures(results):
        raise typer.Exit(1)


def _results(
    selection: CellOptions, out: Path, backend: Backend, resume: Mapping[str, Any]
) -> Results:
    """The results of a suite, with the finished cells in a folder.

    Args:
        selection: what is computed.
        out: results folder.
        backend: see :mod:`cablebot_gym.benchmark.engine`.
        resume: further options of the command that resumes the computation.

    Raises:
        ValueError: if a name is unknown, or the results cannot be written.
    """
    from cablebot_gym.benchmark.leaderboard import Results
    from cablebot_gym.benchmark.seeds import evaluation_seed
    from cablebot_gym.benchmark.store import FOLDER, Store
    from cablebot_gym.benchmark.suites import find_suite, suite_cells
    from cablebot_gym.utils.files import check_writable_dir, check_writable_file

    suite = find_suite(selection.suite)
    policies = _policies(selection)
    check_writable_dir(out / FOLDER)
    for name in (JSON, MARKDOWN):
        check_writable_file(out / name)
    seed = evaluation_seed(selection.seed_text)
    cells = suite_cells(suite, policies, seed=seed, seed_text=selection.seed_text)
    store = Store(out, say=say)
    typed = asdict(selection) | {"out": out}
    records = computed(cells, store, out, backend, command_line("benchmark", **typed, **resume))
    return Results(
        suite=selection.suite,
        command=command_line("benchmark", **typed),
        records=records,
        seed_text=selection.seed_text,
    )


def _has_failures(results: Results) -> bool:
    """Whether a payload could not be computed."""
    from cablebot_gym.benchmark.cells import TimingCell
    from cablebot_gym.benchmark.tables import failures

    payloads = [record for record in results.records if not isinstance(record.cell, TimingCell)]
    return bool(failures(payloads))


def _policies(selection: CellOptions) -> dict[str, tuple[str, ...]]:
    """Names of the policies by environment."""
    from cablebot_gym.benchmark.suites import (
        check_evaluated,
        find_env_ids,
        find_policies,
        find_suite,
    )

    suite = find_suite(selection.suite)
    env_ids = find_env_ids(suite, split_names(selection.ids))
    policies = find_policies(split_names(selection.policies), env_ids)
    check_evaluated(suite, policies)
    return policies


def _write(results: Results, out: Path) -> None:
    """Writes results and leaderboard, and prints the leaderboard."""
    from cablebot_gym.benchmark.leaderboard import markdown, print_page
    from cablebot_gym.utils.files import atomic_write_text

    page = markdown(results)
    atomic_write_text(out / JSON, results.to_json())
    atomic_write_text(out / MARKDOWN, page)
    say(f"wrote {out / JSON}, {out / MARKDOWN}")
    print_page(page)


def computed(
    cells: Mapping[str, Cell], store: Store, out: Path, backend: Backend, command: str
) -> Sequence[Record]:
    """Computes cells with progress. After an interrupt it says with which command to resume.

    Args:
        cells: cells by key.
        store: finished cells.
        out: folder of the store.
        backend: see :mod:`cablebot_gym.benchmark.engine`.
        command: command line that resumes the computation.
    """
    from cablebot_gym.benchmark.engine import run_cells

    finished = 0
    with progress("computing", "cells") as step:

        def count(done: int, expected: int) -> None:
            nonlocal finished
            finished = done
            step(done, expected)

        try:
            return run_cells(cells, store, backend, progress=count, say=say)
        except KeyboardInterrupt:
            state = f"{finished} of {len(cells)} cells are finished and stored in {out}. Resume"
            say(f"{state if finished else 'No cell is finished yet. Start again'} with: {command}")
            raise


def read_results(folder: Path) -> Results:
    """The results in a folder that `cablebot benchmark --out` wrote, or in its results.json.

    Raises:
        ValueError: if they cannot be read. The message says how to create results.
    """
    from cablebot_gym.benchmark.leaderboard import Results
    from cablebot_gym.utils.files import read_text

    path = folder / JSON if folder.is_dir() else folder
    advice = "Give a folder that `cablebot benchmark --out FOLDER` wrote."
    try:
        text = read_text(path)
    except OSError as error:
        raise ValueError(
            f"cannot read {str(path)!r} ({error.strerror or error}). {advice}"
        ) from error
    try:
        results = Results.from_json(text)
    except ValueError as error:
        raise ValueError(
            f"{str(path)!r} does not hold benchmark results ({error!r}). {advice}"
        ) from error
    if not results.records:
        raise ValueError(f"{str(path)!r} holds no cells. {advice}")
    return results


def _check(folder: Path, count: int, backend: Backend) -> None:
    """Prints how the results in a folder differ from their suite, and random rows that are computed
    again without plans and payloads of the cache folder."""
    import os
    from tempfile import TemporaryDirectory

    from cablebot_gym.benchmark.check import compare_rows, recompute
    from cablebot_gym.utils.checks import whole
    from cablebot_gym.utils.files import CACHE_VARIABLE

    results = read_results(folder)
    count = whole("--check", count, least=1)
    rows = compare_rows(results)
    for name in rows.not_installed:
        print(f"not checked, because it is not installed: {name}")
    for title, cells in (("missing", rows.missing), ("not in the suite", rows.unexpected)):
        for cell in cells[:_MOST_NAMED]:
            print(f"{title}: {cell.stem}")
        if cells:
            print(f"{title}: {counted(len(cells), 'row')}")
    different = 0
    with progress("computing", "rows") as step, TemporaryDirectory() as cache:
        os.environ[CACHE_VARIABLE] = cache
        for finished, row in enumerate(recompute(results.records, count, backend, say=say), 1):
            print(row)
            different += not row.is_equal
            step(finished, count)
    if rows.missing or rows.unexpected or different:
        say(
            f"the check failed: {counted(len(rows.missing), 'row')} missing, {len(rows.unexpected)} "
            f"not in the suite, {different} with another payload"
        )
        raise typer.Exit(1)
    print("all rows of the suite are there, and the computed ones have the stored payloads")


def _backend(workers: int | None, ray: str | None) -> Backend:
    from cablebot_gym.benchmark.engine import local
    from cablebot_gym.utils.workers import check_workers

    if ray is None:
        return local(check_workers(workers))
    if workers is not None:
        raise ValueError(
            "--workers and --ray exclude each other: a Ray cluster has its own workers"
        )
    from cablebot_gym.benchmark.ray_backend import on_ray

    return on_ray(ray)
