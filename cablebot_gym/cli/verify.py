"""``cablebot verify``."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Annotated

import typer

from cablebot_gym.cli.options import NoSandbox, Workers, choose_sandbox, counted
from cablebot_gym.utils.console import say


def verify(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the entry.")],
    out: Annotated[
        Path,
        "Folder for the finished cells of an unfinished verification, outside the entry.",
    ] = Path("verification"),
    no_sandbox: NoSandbox = False,
    workers: Workers = None,
) -> None:
    """Rerun an entry in a sandbox, and compare it with its local result.

    The policy runs without network, other processes, and files other than its own. Its noise and
    draws are fresh: they follow from a seed that is drawn when the verification starts. The outcome
    is written to verification.json in the folder of the entry. The exit status is 1 if files differ
    from the card, or if a claimed payload is not carried.

    Example: cablebot verify entries/my-law
    """
    from cablebot_gym.benchmark import entries
    from cablebot_gym.benchmark.board import RUN, run_seed
    from cablebot_gym.benchmark.engine import local
    from cablebot_gym.benchmark.store import FOLDER, Store
    from cablebot_gym.cli.benchmark import computed
    from cablebot_gym.utils.files import atomic_write_text, check_writable_dir
    from cablebot_gym.utils.foreign import brief
    from cablebot_gym.utils.workers import check_workers

    backend = local(check_workers(workers))
    choose_sandbox(no_sandbox)
    if not folder.is_dir():
        raise ValueError(f"{str(folder)!r} is no folder: give the folder of an entry")
    work = out / folder.absolute().name
    if work.absolute().is_relative_to(folder.absolute()):
        raise ValueError(
            f"{str(out)!r} is in the entry, which could have prepared it; choose another --out"
        )
    check_writable_dir(work)
    seed = 0
    records = []
    reasons = []
    try:
        entries.check_entry(folder)
        claims = entries.read_claims(folder)
    except (OSError, ValueError) as error:
        reasons = [brief(error)]
    else:
        seed = run_seed(work)
        cells = entries.entry_cells(folder, claims.suite, seed=seed, claims_only=True)
        command = f"cablebot verify {folder} --out {out}" + " --no-sandbox" * no_sandbox
        store = Store(work, say=say)
        records = [*computed(cells, store, work, backend, command)]
        reasons = entries.refuted(claims, records)
    record = entries.verification(folder, seed, records, reasons)
    atomic_write_text(
        folder / entries.VERIFICATION, json.dumps(record, indent=1, ensure_ascii=False) + "\n"
    )
    shutil.rmtree(work / FOLDER, ignore_errors=True)  # the next verification draws another seed
    (work / RUN).unlink(missing_ok=True)
    if reasons:
        say(f"cablebot: refused: {reasons[0]}", style="red")
        raise typer.Exit(1)
    protection = "with network and all files"
    if record["sandbox"]:
        protection = f"in {record['sandbox']}, without network"
    print(
        f"{folder}: {record['outcome']}; {counted(len(records), 'payload')} rerun {protection}, seed {seed}"
    )
