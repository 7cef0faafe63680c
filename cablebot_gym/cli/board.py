"""Commitment and start of a board, for ``cablebot benchmark``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from cablebot_gym.cli.records import Options

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cablebot_gym.benchmark.board import Board
    from cablebot_gym.benchmark.suites import Suite


@dataclass(frozen=True, kw_only=True)
class BoardOptions(Options):
    """Commitment and start of a board."""

    title: ClassVar[str] = "Board"

    commit: Annotated[
        str | None,
        typer.Option(
            metavar="VERSION",
            help="Draw the salt of a new board, write its commitment to the folder and stop.",
        ),
    ] = None
    beacon: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Public value of --commit that will exist only later, such as `drand quicknet round 12345678`.",
        ),
    ] = None
    beacon_date: Annotated[
        str | None,
        typer.Option(
            metavar="DATE",
            help="Date or time from which the value exists, such as 2027-01-04T12:00Z.",
        ),
    ] = None
    beacon_value: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            help="The public value: starts the run of a board. With --verify, the value to compare with.",
        ),
    ] = None


def check_board_options(options: BoardOptions, suite: Suite) -> None:
    """Raises a ValueError if options of a board are missing, or have no effect."""
    names_beacon = options.beacon is not None and options.beacon_date is not None
    if options.commit is not None and not names_beacon:
        raise ValueError(
            "--commit needs a public value that will exist only later: add for example "
            '--beacon "drand quicknet round 12345678" --beacon-date 2027-01-04T12:00Z'
        )
    if options.commit is None and (options.beacon or options.beacon_date):
        raise ValueError("--beacon and --beacon-date belong to --commit VERSION")
    if options.commit is not None and options.beacon_value is not None:
        raise ValueError(
            "--commit and --beacon-value exclude each other: commit now, and start the run when "
            "the value is public"
        )
    if options.beacon_value is not None and not suite.hidden:
        raise ValueError("only a suite with hidden motions has a board: add --suite ranked")


def commit_board(
    options: BoardOptions, policies: Mapping[str, tuple[str, ...]], motions: int, out: Path
) -> None:
    """Writes the commitment of a new board and says what to do with it."""
    from cablebot_gym.benchmark import board as boards

    board = boards.commit(
        out,
        str(options.commit),
        policies,
        motions,
        beacon=str(options.beacon),
        beacon_date=str(options.beacon_date),
        now=boards.utc_now(),
    )
    print(f"board {board.version}: commitment {board.commitment}.")
    print(f"Publish {out / boards.BOARD} before {board.beacon_date}, and keep {out / boards.SALT}")
    print(
        f"secret until the results are published. When {board.beacon} is public, start the run "
        "with --beacon-value."
    )


def started_board(
    options: BoardOptions,
    names: Sequence[str],
    out: Path,
    *,
    chooses_results: bool,
) -> Board:
    """The board in the results folder with its public value.

    Raises:
        ValueError: if it cannot start, or if the options choose results: a seed, or results of
            other code.
    """
    from cablebot_gym.benchmark import board as boards

    boards.read_board(out).check_policies(names)
    if chooses_results:
        raise ValueError(
            "a board accepts neither --seed nor --any-source: its results are not chosen"
        )
    return boards.start(out, options.beacon_value, now=boards.utc_now())
