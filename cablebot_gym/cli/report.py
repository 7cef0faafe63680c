"""``cablebot report``."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablebot_gym.cli.options import Workers, counted
from cablebot_gym.utils.console import progress, say

if TYPE_CHECKING:
    from cablebot_gym.report.recording import ReplayResult

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
    plan. Recordings are stored in the folder `episodes` beside the results. The same command
    resumes an interrupted recording.

    Examples:

    cablebot report results --out report.html

    cablebot report results robots --workers 8 --out report.html
    """
    from cablebot_gym.benchmark.store import read_all
    from cablebot_gym.report.page import html, merged_rows, replay_queries
    from cablebot_gym.report.recording import FOLDER, record_all
    from cablebot_gym.utils.files import atomic_write_text, check_writable_dir, check_writable_file
    from cablebot_gym.utils.workers import check_workers

    processes = check_workers(workers)
    if out.suffix != ".html":
        raise ValueError(f"--out must end in .html, such as report.html, not {str(out)!r}")
    sources = [suite for path in results for suite in read_all(path)]
    check_writable_file(out)
    folder = results[0]
    if not folder.is_dir():
        folder = folder.parent
    folder /= FOLDER
    replays: dict[str, ReplayResult] = {}
    if episodes:
        check_writable_dir(folder)
        queries = replay_queries(merged_rows(sources))
        with progress("recording", "episodes") as step:
            for key, replay in record_all(queries, folder, workers=processes, say=say):
                replays[key] = replay
                step(len(replays), len(queries))
    page = html(TITLE, sources, replays)
    atomic_write_text(out, page)
    failures = Counter(replay for replay in replays.values() if isinstance(replay, str))
    for reason, count in failures.items():
        say(f"{counted(count, 'row')}: {reason}")
    print(f"wrote {out}, {len(page.encode()) / 1e6:.1f} MB. Open it in a browser.")
