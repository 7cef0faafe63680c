"""``cablebot submit``."""

from __future__ import annotations

import shlex
import shutil
import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from cablebot_gym.cli.options import Workers, counted, split_names
from cablebot_gym.cli.records import Options
from cablebot_gym.utils.console import say

if TYPE_CHECKING:
    from cablebot_gym.benchmark.engine import Backend
    from cablebot_gym.benchmark.leaderboard import Results

WORK = "work"
"""Folder of finished cells in the folder of an unfinished entry."""


@dataclass(frozen=True, kw_only=True)
class CardOptions(Options):
    """Fields of the card of an entry."""

    title: ClassVar[str] = "Card"

    authors: Annotated[str, "Authors."]
    licence: Annotated[str, "Licence of code and weights, such as MIT."]
    compute: Annotated[
        str,
        "Compute for training and tuning, such as '3 h on 8 cores', or none.",
    ]
    data: Annotated[str, "Data and motions for training and tuning, or none."]
    seeds: Annotated[str, "Seeds of the training, or none."]


def submit(
    policy: Annotated[
        str,
        typer.Argument(
            help="Policy: a name or package.module:factory of an installed package, module:factory or file.py:factory, "
            "or a .zip file."
        ),
    ],
    ids: Annotated[str, typer.Option("--id", help="Environment ids, separated by commas.")],
    out: Annotated[Path, "Folder of the entry; its name is the name in the table."],
    card: CardOptions,
    suite: Annotated[
        str,
        "Suite of the local result: smoke (planar robot only), standard, or full.",
    ] = "standard",
    workers: Workers = None,
) -> None:
    """Make an entry for the leaderboard: a folder with policy, card and local result.

    The folder has the files of the policy with their SHA-256, or the name and version of its
    package. The entry is unverified until `cablebot verify` has rerun it. An interrupted command
    resumes. The exit status is 1 if the policy fails.

    Example:

    cablebot submit p:make --id CableBot-Planar-v0 --out p --authors A --licence MIT --compute 1h --data none --seeds 0
    """
    from cablebot_gym.benchmark import entries
    from cablebot_gym.benchmark.engine import local
    from cablebot_gym.benchmark.leaderboard import markdown, print_page
    from cablebot_gym.benchmark.suites import find_env_ids, find_policies, find_suite
    from cablebot_gym.benchmark.tables import failures
    from cablebot_gym.isolation import sandbox
    from cablebot_gym.policies.entry import CARD
    from cablebot_gym.utils.files import atomic_write_text, check_writable_dir
    from cablebot_gym.utils.workers import check_workers

    backend = local(check_workers(workers))
    env_ids = find_env_ids(find_suite(suite), split_names(ids))
    check_writable_dir(out)
    if problem := sandbox.sandbox_problem():
        say(f"note: your policy runs without a sandbox ({problem}); the verification has one")
        sandbox.opt_out()
    entry = entries.make_entry(out, policy, env_ids, asdict(card))
    find_policies([str(out)], env_ids)
    results = _results(out, entry.name, suite, backend)
    atomic_write_text(out / entries.CLAIMS, results.to_json())
    print_page(markdown(results))
    shutil.rmtree(out / WORK)
    say(
        f"wrote {counted(len(entry.files), 'file')} of the policy, {CARD} and {entries.CLAIMS} to {out}"
    )
    say(
        "The entry is unverified. To submit it, open a pull request that adds this folder to entries/."
    )
    if failures(results.records):
        raise typer.Exit(1)


def _results(folder: Path, name: str, suite: str, backend: Backend) -> Results:
    """The local results of an entry, with its name in place of its folder."""
    from cablebot_gym.benchmark import entries
    from cablebot_gym.benchmark.board import run_seed
    from cablebot_gym.benchmark.leaderboard import Results
    from cablebot_gym.benchmark.store import Store
    from cablebot_gym.cli.benchmark import computed

    work = folder / WORK
    cells = entries.entry_cells(folder, suite, seed=run_seed(work))
    command = shlex.join(["cablebot", *sys.argv[1:]])
    store = Store(work, say=say)
    records = computed(cells, store, work, backend, command)
    return Results(
        suite=suite,
        command=command,
        records=entries.renamed(records, name),
        entries=[replace(entries.note(folder, "unverified"), policy=name)],
    )
