"""``cablebot benchmark``."""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from cablebot_gym.cli.board import (
    BoardOptions,
    check_board_options,
    commit_board,
    started_board,
)
from cablebot_gym.cli.options import Workers, split_names
from cablebot_gym.cli.records import Options
from cablebot_gym.utils.console import command_line, progress, say

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cablebot_gym.benchmark.board import Board
    from cablebot_gym.benchmark.cells import Cell
    from cablebot_gym.benchmark.engine import Backend
    from cablebot_gym.benchmark.leaderboard import Results
    from cablebot_gym.benchmark.records import Record
    from cablebot_gym.benchmark.store import Store

MARKDOWN, JSON = "leaderboard.md", "results.json"
"""Names of the files in the results folder."""


@dataclass(frozen=True, kw_only=True)
class CellOptions(Options):
    """What is computed."""

    title: ClassVar[str] = "Cells"

    suite: Annotated[
        str,
        "Suite: smoke (minutes), standard (45 minutes on two cores), ranked (the leaderboard, hours), full "
        "(hours), maps, paper-maps or library (an hour).",
    ] = "smoke"
    policies: Annotated[
        str | None,
        "Policies as for `dlcc --policy`, separated by commas. The default is all installed policies.",
    ] = None
    ids: Annotated[
        str | None,
        "Environment ids, separated by commas. The default is those of the suite.",
    ] = None
    seed: Annotated[
        int | None,
        "Evaluation seed, to repeat a run. The default is drawn once and stored in the folder; that of a "
        "board follows from its public value.",
    ] = None
    real_time: Annotated[
        bool,
        typer.Option(
            "--real-time",
            help="Replace an action that is later than one control period by the last. The payloads then depend on the "
            "machine and on its load.",
        ),
    ] = False


@dataclass(frozen=True, kw_only=True)
class ComputingOptions(Options):
    """Where the cells are computed."""

    title: ClassVar[str] = "Computing"

    workers: Workers = None
    ray: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Run on a Ray cluster: its address, auto, or local. Requires the extra ray.",
        ),
    ] = None
    any_source: Annotated[
        bool,
        typer.Option(
            "--any-source", help="Reuse finished cells that were computed with different code."
        ),
    ] = False


@dataclass(frozen=True, kw_only=True)
class OutputOptions(Options):
    """Files of the results."""

    title: ClassVar[str] = "Results"

    out: Annotated[Path, "Results folder, for the tables and all finished cells."] = Path(
        "benchmark"
    )
    page: Annotated[
        Path | None,
        f"File of the leaderboard. The default is {MARKDOWN} in the results folder.",
    ] = None
    as_json: Annotated[bool, typer.Option("--json", help=f"Print the content of {JSON}.")] = False

    @property
    def files(self) -> tuple[Path, Path]:
        """Files of the results and of the leaderboard."""
        return self.out / JSON, self.page or self.out / MARKDOWN


@dataclass(frozen=True, kw_only=True)
class VerificationOptions(Options):
    """Fresh draws for stored results."""

    title: ClassVar[str] = "Verification"

    verify: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Confirm uncertain payloads of stored results with fresh draws and stop. With --policies and --ids, "
            "compute these rows again.",
        ),
    ] = None
    cells: Annotated[
        int,
        "Number of cells, and of motions of surveys, that --verify confirms.",
    ] = 20
    draws: Annotated[int, "Number of fresh draws of --verify."] = 1024


def benchmark(
    selection: CellOptions,
    computing: ComputingOptions,
    output: OutputOptions,
    board_options: BoardOptions,
    verification: VerificationOptions,
) -> None:
    """Score policies by their payload over the best known payload, on held-out motions and the
    paper's circle.

    The suite ranked makes a leaderboard. Its main number: on each hidden motion, the largest
    payload that several random robots all carry, as a fraction of the best known payload, on the
    mean over the motions.

    Every policy runs in a process of its own, except for policies of this project in surveys: all
    hidden motions in one cell. Each finished cell is stored as a file in the results
    folder. The same command resumes an interrupted benchmark. It computes only cells that are
    missing, damaged or computed with different code: that of this package or of the
    policy. The exit status is 1 if a payload could not be computed, or if
    --verify finds a broken promise.

    Examples:

    cablebot benchmark --suite smoke --out results

    cablebot benchmark --suite standard --policies fl,mypackage.mine:make_policy --workers 8 --out results

    cablebot benchmark --suite library --out robots

    cablebot benchmark --suite ranked --out board --commit 2027-1
    --beacon "NIST beacon 2.0 pulse at 2027-01-04T12:00Z" --beacon-date 2027-01-04T12:00Z

    cablebot benchmark --suite ranked --out board --beacon-value 8F3C…

    cablebot benchmark --verify board --cells 20 --draws 1024

    cablebot benchmark --verify board --policies fl --ids CableBot-Planar-v0
    """
    from cablebot_gym.benchmark.board import run_seed
    from cablebot_gym.benchmark.cells import TimingCell
    from cablebot_gym.benchmark.leaderboard import Results
    from cablebot_gym.benchmark.store import FOLDER
    from cablebot_gym.benchmark.suites import find_suite, suite_cells
    from cablebot_gym.benchmark.tables import failures
    from cablebot_gym.utils.files import check_writable_dir

    backend = _backend(computing.workers, computing.ray)
    if verification.verify is not None:
        value = board_options.beacon_value
        return _verify(verification.verify, backend, verification, selection, value)
    suite = find_suite(selection.suite)
    check_board_options(board_options, suite)
    policies = _policies(selection)
    names = sorted({name for supported in policies.values() for name in supported})
    out = output.out
    check_writable_dir(out / FOLDER)
    if board_options.commit is not None:
        return commit_board(board_options, policies, suite.hidden, out)
    board = None
    if suite.hidden:
        chooses_results = computing.any_source or selection.seed is not None
        board = started_board(board_options, names, out, chooses_results=chooses_results)
    store = _store(output, computing, board)
    if board is None:
        seed = run_seed(out, selection.seed)
    else:
        seed = board.evaluation_seed
    cells = suite_cells(suite, policies, seed=seed, board=board, real_time=selection.real_time)
    typed = _typed(selection, output, board)
    resume = command_line(
        "benchmark",
        **typed,
        workers=computing.workers,
        ray=computing.ray,
        any_source=computing.any_source,
        seed=selection.seed,
    )
    records = computed(cells, store, out, backend, resume)
    if board is not None:
        board.check_policies(names)  # files may have changed during the run
    if store.foreign:
        use = "they are computed again (--any-source reuses them)"
        if computing.any_source:
            use = "they are reused"
        say(f"{store.foreign} cells exist only with results of different code: {use}")
    results = Results(
        suite=selection.suite,
        command=command_line("benchmark", **typed),
        records=records,
        board=board,
    )
    _write(results, output)
    payloads = [record for record in records if not isinstance(record.cell, TimingCell)]
    if failures(payloads):
        raise typer.Exit(1)


def _store(output: OutputOptions, computing: ComputingOptions, board: Board | None) -> Store:
    """The finished cells; those of a board have checksums with its salt as the key.

    Raises:
        ValueError: if results or leaderboard cannot be written.
    """
    from cablebot_gym.benchmark.store import Store
    from cablebot_gym.utils.files import check_writable_file

    for path in output.files:
        check_writable_file(path)
    key = ""
    if board is not None and board.salt is not None:
        key = board.salt
    return Store(output.out, say=say, any_source=computing.any_source, key=key)


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


def _typed(selection: CellOptions, output: OutputOptions, board: Board | None) -> dict[str, Any]:
    """The options that determine the results, for their command line."""
    beacon_value = None
    if board is not None:
        beacon_value = board.beacon_value
    return {
        "suite": selection.suite,
        "policies": selection.policies,
        "ids": selection.ids,
        "out": output.out,
        "page": output.page,
        "beacon_value": beacon_value,
        "real_time": selection.real_time,
    }


def _write(results: Results, output: OutputOptions) -> None:
    """Writes and prints results and leaderboard."""
    from cablebot_gym.benchmark.leaderboard import markdown, print_page
    from cablebot_gym.utils.files import atomic_write_text

    contents = (results.to_json(), markdown(results))
    for path, content in zip(output.files, contents, strict=True):
        atomic_write_text(path, content)
    say("wrote " + ", ".join(map(str, output.files)))
    if output.as_json:
        print(contents[0], end="")
    else:
        print_page(contents[1])


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


def _verify(
    folder: Path,
    backend: Backend,
    verification: VerificationOptions,
    selection: CellOptions,
    beacon_value: str | None,
) -> None:
    """Checks the board. Prints promised payloads with their success rate in fresh draws, or the
    rows of chosen policies, computed again."""
    from cablebot_gym.benchmark.verification import broken, confirm, outcome
    from cablebot_gym.utils.checks import whole

    results = read_results(folder)
    cells = whole("cells", verification.cells, least=1)
    draws = whole("draws", verification.draws, least=1)
    if results.board is not None:
        results.check_board(beacon_value)
        board = results.board
        print(
            f"board {board.version}: salt and policies match the commitment; motions and "
            "evaluation seed follow from it and from"
        )
        print(f"{board.beacon}, {board.beacon_value}: compare this value with its source")
        if results.due:
            print(f"committed, without results: {', '.join(results.due)}")
    if selection.policies is not None:
        return _reproduce(results, selection, backend)
    seed = selection.seed
    if seed is None:
        seed = secrets.randbits(128)
    confirmations = []
    with progress("confirming", "cells") as step:
        for confirmation in confirm(
            results.records, backend, cells=cells, draws=draws, seed=seed, say=say
        ):
            confirmations.append(confirmation)
            print(confirmation)
            step(len(confirmations), 2 * cells)
    print(f"{outcome(confirmations)} in {draws} fresh draws (--seed {seed})")
    sentence = broken(confirmations)
    if sentence:
        say(sentence)
        raise typer.Exit(1)


def _reproduce(results: Results, selection: CellOptions, backend: Backend) -> None:
    """Prints stored payloads of policies and the payloads of the same cells, computed again."""
    from cablebot_gym.benchmark.verification import reproduce

    names = split_names(selection.policies)
    env_ids = split_names(selection.ids)
    different = 0
    for reproduction in reproduce(results.records, names, env_ids, backend, say=say):
        print(reproduction)
        different += not reproduction.equal
    if different:
        say(f"{different} payloads differ from the stored ones by more than the resolution")
        raise typer.Exit(1)
    print("all payloads are those of the results")


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
