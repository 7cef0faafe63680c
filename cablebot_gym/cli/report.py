"""``cablebot report``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cablebot_gym.utils.console import counting, notes_console

if TYPE_CHECKING:
    from cablebot_gym.report.page import Source
    from cablebot_gym.report.recording import Seen


def report(
    results: Annotated[
        list[Path], typer.Argument(metavar="RESULTS…", help="Folders that `cablebot benchmark` wrote, or their .json.")
    ],
    out: Annotated[Path, typer.Option(help="The page to write, ending in .html.")] = Path("report.html"),
    title: Annotated[str, typer.Option(help="Heading of the page.")] = "Payloads of cable robots",
    episodes: Annotated[
        bool, typer.Option("--episodes/--no-episodes", help="Whether to record an episode of every cell.")
    ] = True,
    workers: Annotated[int | None, typer.Option(help="Processes; one per core if not given.")] = None,
) -> None:
    """A benchmark as one page that needs no network: leaderboard, maps, and an episode of every cell to look at.

    Episodes are recorded anew, a second or two each (policies that plan take longer), and kept beside the results in
    the folder `episodes`: the same command goes on where it was interrupted.

    Examples:

    cablebot report results --out report.html

    cablebot report results maps --title "My controller" --workers 8 --out report.html
    """
    from cablebot_gym.cli.benchmark import JSON
    from cablebot_gym.report.page import html, merged, replayed
    from cablebot_gym.report.recording import FOLDER, record_all
    from cablebot_gym.utils.files import usable_file, usable_folder, write_text_whole
    from cablebot_gym.utils.workers import check_workers

    processes = check_workers(workers)
    if out.suffix != ".html":
        raise ValueError(f"--out: the page's name has to end in .html, not {str(out)!r}")
    paths = [path / JSON if path.is_dir() else path for path in results]
    sources = [_source(path) for path in paths]
    usable_file(out)
    folder = paths[0].parent / FOLDER
    errors = notes_console()
    seen: dict[str, Seen] = {}
    if episodes:
        usable_folder(folder)
        asked = replayed(merged(sources))
        with counting(errors, "episodes") as bar:
            task = bar.add_task("recording", total=len(asked))
            for key, one in record_all(asked, folder, workers=processes, say=errors.print):
                seen[key] = one
                bar.update(task, completed=len(seen))
    page = html(title, sources, seen)
    write_text_whole(out, page)
    why: dict[str, int] = {}
    for one in seen.values():
        if isinstance(one, str):
            why[one] = why.get(one, 0) + 1
    for text, count in why.items():
        errors.print(f"{count} {'cell' if count == 1 else 'cells'}: {text}")
    print(f"wrote {out}, {len(page.encode()) / 1e6:.1f} MB: open it in a browser")


def _source(path: Path) -> Source:
    """What a benchmark's results hold.

    Raises:
        ValueError: if they cannot be read; the message says how to make some.
    """
    from cablebot_gym.benchmark.leaderboard import read_results
    from cablebot_gym.report.page import Source

    made = "name a folder that `cablebot benchmark --out FOLDER` wrote"
    try:
        suite, command, records = read_results(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"cannot read {str(path)!r} ({getattr(error, 'strerror', None) or error}): {made}") from error
    except (json.JSONDecodeError, KeyError, TypeError, IndexError, ValueError) as error:
        raise ValueError(f"{str(path)!r} holds no results of a benchmark ({error!r}): {made}") from error
    if not records:
        raise ValueError(f"{str(path)!r} holds no cells: {made}")
    return Source(suite, command, records)
