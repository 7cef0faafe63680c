"""``cablebot report``."""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from cablebot_gym.cli.options import Workers, counted
from cablebot_gym.utils.console import progress, say

TITLE = "Payloads of cable robots"
"""Title of the page."""


def report(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULTS…",
            help="Folders that `cablebot benchmark` wrote, or files of them.",
        ),
    ],
    out: Annotated[Path, "File of the page, ending in .html."] = Path("report.html"),
    episodes: Annotated[
        bool,
        typer.Option(
            "--episodes/--no-episodes", help="Whether to record and show one episode of every row."
        ),
    ] = True,
    workers: Workers = None,
) -> None:
    """Write benchmark results as one HTML page with leaderboard and an episode of every row.

    The page works offline. Recording an episode takes a second or two, and longer for policies that
    plan.

    Examples:

    cablebot report results --out report.html

    cablebot report results robots --workers 8 --out report.html
    """
    from cablebot_gym.benchmark.store import read_all
    from cablebot_gym.report.page import html, merged_rows, replay_queries
    from cablebot_gym.report.replay import Replay, record_row
    from cablebot_gym.utils.files import atomic_write_text, check_writable_file
    from cablebot_gym.utils.workers import WorkerDied, check_workers, run

    processes = check_workers(workers)
    if out.suffix != ".html":
        raise ValueError(f"--out must end in .html, such as report.html, not {str(out)!r}")
    sources = [suite for path in results for suite in read_all(path)]
    check_writable_file(out)
    replays: dict[str, list[Replay] | str] = {}
    if episodes:
        jobs = {}
        for key, row in replay_queries(merged_rows(sources)).items():
            jobs[key] = partial(record_row, row)
        with progress("recording", "episodes") as step:
            for key, recorded in run(jobs, workers=processes):
                replays[key] = str(recorded) if isinstance(recorded, WorkerDied) else recorded
                step(len(replays), len(jobs))
    page = html(TITLE, sources, replays)
    atomic_write_text(out, page)
    failures = Counter(replay for replay in replays.values() if isinstance(replay, str))
    for reason, count in failures.items():
        say(f"{counted(count, 'row')}: {reason}")
    print(f"wrote {out}, {len(page.encode()) / 1e6:.1f} MB. Open it in a browser.")
