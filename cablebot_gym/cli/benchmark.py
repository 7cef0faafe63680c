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
    from collections.abc import Sequence

    from cablebot_gym.benchmark.engine import Backend
    from cablebot_gym.benchmark.rows import Row
    from cablebot_gym.benchmark.store import Results, Store

PAGE_SUFFIX = ".md"
"""Suffix of the page of a suite, beside the file of its rows."""

_MOST_NAMED = 10
"""Largest number of rows that a check names."""


@dataclass(frozen=True, kw_only=True)
class RowOptions(Options):
    """What is computed."""

    title: ClassVar[str] = "Rows"

    suite: Annotated[
        str,
        "Suite: smoke (minutes), ranked (the leaderboard, hours), errors (hours) or library (an hour).",
    ] = "smoke"
    policies: Annotated[
        str | None,
        "Policies as for `dlcc --policy`, separated by commas. The default is all policies of this project.",
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
    selection: RowOptions,
    workers: Workers = None,
    ray: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Run on a Ray cluster: its address, auto, or local. Requires the extra ray.",
        ),
    ] = None,
    out: Annotated[Path, "Results folder, with the rows and the page of each suite."] = Path(
        "benchmark"
    ),
    due: Annotated[
        bool,
        "Compute the rows of the folder --out again whose code has changed: that of the plant or of the policy.",
    ] = False,
    check: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Check the results of the folder --out and stop: every row of a suite is there, and N random "
            "rows, optima among them, have the same payloads when they are computed again.",
        ),
    ] = None,
) -> None:
    """Score policies by their payload over the optimum of the motion, on held-out motions and the
    paper's circle.

    The suite ranked makes the leaderboard. Its main number: on each hidden motion, the largest
    payload that several random robots all carry, as a fraction of what a planner can hope for that
    knows each robot, on the mean over the motions.

    A policy that is not shipped with this project runs in a process of its own. Each finished row is
    stored in a file of the results folder. The same command resumes an interrupted benchmark. It
    computes only rows that are missing, damaged or computed with different code: that of the plant
    or of the policy. Rows of other policies stay. The exit status is 1 if a payload could not be
    computed, or if --check finds a difference.

    Examples:

    cablebot benchmark --suite smoke --out results

    cablebot benchmark --suite smoke --policies fl,mypackage.mine:make_policy --workers 8 --out results

    cablebot benchmark --suite ranked --seed-text "A headline of 4 January 2027" --out board

    cablebot benchmark --due --out board

    cablebot benchmark --check 20 --out board
    """
    backend = _backend(workers, ray)
    if check is not None:
        _check(out, check, backend)
        return
    resume = {"workers": workers, "ray": ray}
    if due:
        boards = _due(out, backend, command_line("benchmark", due=True, out=out, **resume))
    else:
        boards = [_computed(selection, out, backend, resume)]
    has_failures = False
    for results in boards:
        has_failures |= _write_page(results, out)
    if has_failures:
        raise typer.Exit(1)


def _computed(
    selection: RowOptions, out: Path, backend: Backend, resume: dict[str, Any]
) -> Results:
    """The results of a suite after its rows are computed.

    Args:
        selection: what is computed.
        out: results folder.
        backend: see :mod:`cablebot_gym.benchmark.engine`.
        resume: further options of the command that resumes the computation.

    Raises:
        ValueError: if a name is unknown, or the results cannot be written.
    """
    from cablebot_gym.benchmark.seeds import evaluation_seed
    from cablebot_gym.benchmark.store import Store, file_of
    from cablebot_gym.benchmark.suites import find_suite, suite_rows
    from cablebot_gym.utils.files import check_writable_dir, check_writable_file

    suite = find_suite(selection.suite)
    policies = _policies(selection)
    check_writable_dir(out)
    path = file_of(out, selection.suite)
    check_writable_file(path)
    check_writable_file(path.with_suffix(PAGE_SUFFIX))
    typed = asdict(selection) | {"out": out}
    store = Store(
        out,
        suite=selection.suite,
        command=command_line("benchmark", **typed),
        seed_text=selection.seed_text,
        say=say,
    )
    seed = evaluation_seed(selection.seed_text)
    rows = suite_rows(suite, policies, seed=seed, seed_text=selection.seed_text)
    _compute(rows, store, backend, command_line("benchmark", **typed, **resume))
    return store.close([row.key for row in rows])


def _due(out: Path, backend: Backend, command: str) -> list[Results]:
    """The results of all suites in a folder after their due rows are computed again."""
    from cablebot_gym.benchmark.store import Store, read_all

    boards = []
    for before in read_all(out):
        store = Store(
            out,
            suite=before.suite,
            command=before.command,
            seed_text=before.seed_text,
            say=say,
        )
        _compute(before.rows, store, backend, command)
        boards.append(store.close([row.key for row in before.rows]))
    return boards


def _policies(selection: RowOptions) -> dict[str, tuple[str, ...]]:
    """Names of the policies by environment."""
    from cablebot_gym.benchmark.suites import find_env_ids, find_policies, find_suite

    suite = find_suite(selection.suite)
    env_ids = find_env_ids(suite, split_names(selection.ids))
    return find_policies(split_names(selection.policies), env_ids)


def _write_page(results: Results, out: Path) -> bool:
    """Writes and prints the page of a suite; whether a payload could not be computed."""
    from cablebot_gym.benchmark.leaderboard import markdown
    from cablebot_gym.benchmark.tables import failures
    from cablebot_gym.utils.files import atomic_write_text

    page = markdown(results)
    path = out / f"{results.suite}{PAGE_SUFFIX}"
    atomic_write_text(path, page)
    say(f"wrote {path}")
    print(page.partition("\n## Definitions\n")[0])
    return bool(failures([row for row in results.rows if row.measure != "time"]))


def _compute(rows: Sequence[Row], store: Store, backend: Backend, command: str) -> None:
    """Computes rows with progress. After an interrupt it says with which command to resume.

    Args:
        rows: the rows.
        store: finished rows.
        backend: see :mod:`cablebot_gym.benchmark.engine`.
        command: command line that resumes the computation.
    """
    from cablebot_gym.benchmark.engine import run_rows

    with progress("computing", "rows") as step:
        try:
            run_rows(rows, store, backend, progress=step)
        except KeyboardInterrupt:
            finished = sum(store.find(row) is not None for row in rows)
            state = (
                f"{finished} of {len(rows)} rows are finished and stored in {store.path}. Resume"
            )
            say(f"{state if finished else 'No row is finished yet. Start again'} with: {command}")
            raise


def _check(folder: Path, count: int, backend: Backend) -> None:
    """Prints how the results in a folder differ from their suites, and random rows that are computed
    again without plans and payloads of the cache folder."""
    from cablebot_gym.benchmark.check import compare_rows, recompute
    from cablebot_gym.benchmark.store import read_all
    from cablebot_gym.utils.checks import whole
    from cablebot_gym.utils.files import empty_cache

    boards = read_all(folder)
    count = whole("--check", count, least=1)
    missing = unexpected = different = 0
    for results in boards:
        difference = compare_rows(results)
        for name in difference.not_installed:
            print(f"not checked, because it is not installed: {name}")
        _name_rows("missing", difference.missing)
        _name_rows("not in the suite", difference.unexpected)
        missing += len(difference.missing)
        unexpected += len(difference.unexpected)
    rows = [row for results in boards for row in results.rows]
    with progress("computing", "rows") as step, empty_cache():
        for finished, again in enumerate(recompute(rows, count, backend), 1):
            print(again)
            different += not again.is_equal
            step(finished, count)
    if missing or unexpected or different:
        say(
            f"the check failed: {counted(missing, 'row')} missing, {unexpected} not in the suite, "
            f"{different} with another payload"
        )
        raise typer.Exit(1)
    print("all rows of the suite are there, and the computed ones have the stored payloads")


def _name_rows(title: str, rows: Sequence[Row]) -> None:
    """Prints the first of some rows and their number."""
    for row in rows[:_MOST_NAMED]:
        print(f"{title}: {row}")
    if rows:
        print(f"{title}: {counted(len(rows), 'row')}")


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
