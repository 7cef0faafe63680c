"""``cablebot benchmark``."""

from __future__ import annotations

import json
import secrets
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablebot_gym.cli.options import NoSandbox, Workers, choose_sandbox, split_names
from cablebot_gym.utils.console import command_line, notes_console, progress

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cablebot_gym.benchmark.cells import Cell, Record
    from cablebot_gym.benchmark.engine import Backend
    from cablebot_gym.benchmark.leaderboard import Results
    from cablebot_gym.benchmark.store import Store

MARKDOWN, JSON = "leaderboard.md", "results.json"
"""Names of the files in the results folder."""


def benchmark(
    suite: Annotated[
        str,
        typer.Option(
            help="Suite: smoke (minutes), standard (45 minutes on two cores), ranked, full (hours), maps, paper-maps "
            "or library (an hour)."
        ),
    ] = "smoke",
    policies: Annotated[
        str | None,
        typer.Option(
            help="Policies as for `dlcc --policy`, separated by commas. The default is all installed policies."
        ),
    ] = None,
    ids: Annotated[
        str | None,
        typer.Option(
            help="Environment ids, separated by commas. The default is those of the suite."
        ),
    ] = None,
    entries: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of entries of others, which run in a sandbox, as further policies.",
        ),
    ] = None,
    no_sandbox: NoSandbox = False,
    workers: Workers = None,
    ray: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Run on a Ray cluster: its address, auto, or local. Requires the extra ray.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Results folder, for the tables and all finished cells.")
    ] = Path("benchmark"),
    page: Annotated[
        Path | None,
        typer.Option(
            help=f"File of the leaderboard. The default is {MARKDOWN} in the results folder."
        ),
    ] = None,
    any_source: Annotated[
        bool,
        typer.Option(
            "--any-source", help="Reuse finished cells that were computed with different code."
        ),
    ] = False,
    seed: Annotated[
        int | None,
        typer.Option(
            help="Evaluation seed, to repeat a run. The default is drawn once and stored in the folder."
        ),
    ] = None,
    real_time: Annotated[
        bool,
        typer.Option(
            "--real-time",
            help="Replace an action that is later than one control period by the last. The payloads then depend on the "
            "machine and on its load.",
        ),
    ] = False,
    commit: Annotated[
        str | None,
        typer.Option(
            metavar="VERSION",
            help="Draw the secret of a new board, write its commitment to the folder and stop.",
        ),
    ] = None,
    verify: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Confirm uncertain payloads of stored results with fresh draws and stop.",
        ),
    ] = None,
    cells: Annotated[int, typer.Option(help="Number of cells that --verify confirms.")] = 20,
    draws: Annotated[int, typer.Option(help="Number of fresh draws of --verify.")] = 1024,
    as_json: Annotated[bool, typer.Option("--json", help=f"Print the content of {JSON}.")] = False,
) -> None:
    """Score policies by their payload over the best known payload, on held-out motions and the
    paper's circle.

    Every policy runs in a process of its own. Each finished cell is stored as a file in the results
    folder. The same command resumes an interrupted benchmark. It computes only cells that are
    missing, damaged or computed with different code: that of this package, or of the package or
    folder of the policy. The exit status is 1 if a payload could not be computed, or if --verify
    finds a broken promise.

    Examples:

    cablebot benchmark --suite smoke --out results

    cablebot benchmark --suite standard --policies fl,mypackage.mine:make_policy --workers 8 --out results

    cablebot benchmark --suite library --out robots

    cablebot benchmark --suite ranked --out board --commit 2026-1

    cablebot benchmark --suite ranked --out board

    cablebot benchmark --suite ranked --out board --entries entries --commit 2026-2

    cablebot benchmark --verify board --cells 20 --draws 1024
    """
    from cablebot_gym.benchmark import board as boards
    from cablebot_gym.benchmark.cells import TimingCell
    from cablebot_gym.benchmark.entries import find_entries, note, status
    from cablebot_gym.benchmark.leaderboard import Results, markdown, print_page
    from cablebot_gym.benchmark.store import FOLDER, Store
    from cablebot_gym.benchmark.suites import find_env_ids, find_policies, find_suite, suite_cells
    from cablebot_gym.benchmark.tables import failures
    from cablebot_gym.isolation.installed import public_entries
    from cablebot_gym.utils.files import atomic_write_text, check_writable_dir, check_writable_file

    backend = _backend(workers, ray)
    if verify is not None:
        return _verify(verify, backend, cells, draws, seed)
    chosen = find_suite(suite)
    env_ids = find_env_ids(chosen, split_names(ids))
    names = split_names(policies)
    submitted: list[str] = []
    if entries is not None:
        choose_sandbox(no_sandbox)
        own = find_entries(entries)
        submitted = [name for name, entry in own.items() if set(entry.env_ids) & set(env_ids)]
        names = [*(names or public_entries()), *submitted]
    found = find_policies(names, env_ids)
    names = sorted({name for own in found.values() for name in own})
    check_writable_dir(out / FOLDER)
    if commit is not None:
        made = boards.commit(out, commit, found, chosen.hidden)
        print(
            f"board {made.version}: commitment {made.commitment}. Publish {out / boards.BOARD} before the run, and"
        )
        print(f"keep {out / boards.SECRET} secret until its results are published.")
        return
    board = boards.read_board(out) if chosen.hidden else None
    if board is not None:
        board.check_policies(names)
        if any_source or seed is not None:
            raise ValueError(
                "a board accepts neither --seed nor --any-source: its results are not chosen"
            )
    files = (out / JSON, page or out / MARKDOWN)
    for path in files:
        check_writable_file(path)
    todo = suite_cells(
        chosen, found, seed=boards.run_seed(out, seed), board=board, real_time=real_time
    )
    options = {
        "suite": suite,
        "policies": policies,
        "entries": entries,
        "no_sandbox": no_sandbox,
        "ids": ids,
    }
    options |= {"out": out, "page": page, "real_time": real_time}
    command = command_line("benchmark", **options)
    resume = command_line(
        "benchmark", **options, workers=workers, ray=ray, any_source=any_source, seed=seed
    )
    say = notes_console().print
    store = Store(out, say=say, any_source=any_source)
    records = computed(todo, store, out, backend, resume)
    if board is not None:
        board.check_policies(names)  # files may have changed during the run
    notes = [note(Path(name), status(Path(name), records)) for name in submitted]
    results = Results(suite=suite, command=command, records=records, board=board, entries=notes)
    contents = (results.to_json(), markdown(results))
    for path, content in zip(files, contents, strict=True):
        atomic_write_text(path, content)
    if store.foreign:
        use = (
            "they are reused"
            if any_source
            else "they are computed again (--any-source reuses them)"
        )
        say(f"{store.foreign} cells exist only with results of different code: {use}")
    say("wrote " + ", ".join(map(str, files)))
    if as_json:
        print(contents[0], end="")
    else:
        print_page(contents[1])
    if failures([record for record in records if not isinstance(record.cell, TimingCell)]):
        raise typer.Exit(1)


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

    say, finished = notes_console().print, 0
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
    except (json.JSONDecodeError, KeyError, TypeError, IndexError, ValueError) as error:
        raise ValueError(
            f"{str(path)!r} does not hold benchmark results ({error!r}). {advice}"
        ) from error
    if not results.records:
        raise ValueError(f"{str(path)!r} holds no cells. {advice}")
    return results


def _verify(folder: Path, backend: Backend, cells: int, draws: int, seed: int | None) -> None:
    """Checks the board and prints promised payloads with their success rate in fresh draws."""
    from cablebot_gym.benchmark.verification import broken, confirm
    from cablebot_gym.utils.checks import whole

    results = read_results(folder)
    whole("cells", cells, least=1)
    whole("draws", draws, least=1)
    if results.board is not None:
        results.check_board()
        print(
            f"board {results.board.version}: the secret matches the commitment and determines the motions"
        )
    seed = secrets.randbits(128) if seed is None else seed
    confirmations = []
    with progress("confirming", "cells") as step:
        for one in confirm(
            results.records, backend, cells=cells, draws=draws, seed=seed, say=notes_console().print
        ):
            confirmations.append(one)
            print(one)
            step(len(confirmations), cells)
    kept = sum(one.kept for one in confirmations)
    print(
        f"{kept} of {len(confirmations)} payloads keep their promise in {draws} fresh draws (--seed {seed})"
    )
    if sentence := broken(confirmations):
        notes_console().print(sentence)
        raise typer.Exit(1)


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
