"""Entries of others: makes the folder of an entry, and compares its claims with a rerun."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import packages_distributions, version
from pathlib import Path
from typing import Any

from cablebot_gym.benchmark.cells import Cell, PolicyCell, TimingCell, processor
from cablebot_gym.benchmark.leaderboard import CARD_FIELDS, EntryNote, Results
from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.benchmark.records import Record
from cablebot_gym.benchmark.suites import find_suite, suite_cells
from cablebot_gym.benchmark.tables import task_title
from cablebot_gym.isolation.sandbox import sandbox_name
from cablebot_gym.policies import PolicySpec
from cablebot_gym.policies.entry import (
    CARD,
    LONGEST_NAME,
    PACKAGES,
    POLICY,
    POLICY_SUFFIXES,
    Entry,
    digests,
    package_root,
    plain_files,
    read_entry,
)
from cablebot_gym.utils.code_hash import source_files
from cablebot_gym.utils.files import atomic_write_text, read_text
from cablebot_gym.utils.foreign import brief, foreign_digest, foreign_text
from cablebot_gym.utils.imports import split_name

CLAIMS, VERIFICATION = "results.json", "verification.json"
"""Names in the folder of an entry: the results of its authors, and the record of the last
verification."""

_MOST_NAMED = 5
"""Largest number of unknown files in a message."""

MACHINES = 0.01
"""Largest excess of a claimed total mass over the rerun, as a fraction: rounding differs between
machines."""

DRAWS = 0.02
"""The same for a payload that is a tolerance bound from random draws, which scatters."""


def make_entry(
    folder: Path, policy: str, env_ids: Sequence[str], texts: Mapping[str, str]
) -> Entry:
    """Writes the card of an entry, and the files of its policy unless a package has them. An equal
    entry may exist.

    Args:
        folder: folder of the entry; its name is that of the entry.
        policy: name of the policy, as on the command line.
        env_ids: environments.
        texts: the other fields of the card.

    Raises:
        ValueError: if the policy belongs to this project or has no files, or if the folder has
            another entry.
    """
    root, paths, target, package = _policy_files(policy)
    entry = Entry(
        name=folder.absolute().name,
        env_ids=tuple(env_ids),
        policy=target,
        package=package,
        files=digests(root, paths),
        **texts,
    )
    card = folder / CARD
    if card.exists():
        if read_text(card) != entry.to_json():
            raise ValueError(
                f"{str(folder)!r} has another entry, or an older one: choose another folder or delete it"
            )
        return entry
    for name in entry.files if package is None else ():
        (folder / POLICY / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(root / name, folder / POLICY / name)
    atomic_write_text(card, entry.to_json())
    return entry


def _policy_files(policy: str) -> tuple[Path, list[Path], str, str | None]:
    """Folder and files of a policy, its name in the entry, and the requirement of its package if it
    has one."""
    if policy.endswith(POLICY_SUFFIXES):
        return Path(policy).parent, list(policy_source(policy)[1]), Path(policy).name, None
    spec = PolicySpec.parse(policy)
    if spec.own:
        raise ValueError(
            f"policy {policy!r} belongs to this project, and is on the leaderboard already"
        )
    point = spec.points[0] if spec.points else None
    name = policy if point is None else point.value
    module, _ = split_name(name)
    top = module.partition(".")[0]
    source = package_root(top)
    if source is None:
        raise ValueError(
            f"policy {policy!r} has no source: give an installed name, module:factory, file.py:factory"
        )
    root, files = source
    target = f"{module}:{policy.rpartition(':')[2]}" if point is None else point.value
    dist = next(iter(packages_distributions().get(top, ())), None)
    if point is not None and point.dist is not None:
        dist = point.dist.name
    package = None if dist is None else f"{dist}=={version(dist)}"
    if files.is_dir() or package is not None:
        return root, plain_files(files), target, package
    modules = [path for path in source_files(module).values() if path.parent == root]
    return root, [*modules, *policy_source(policy)[1]], target, None


def renamed(records: Sequence[Record], policy: str) -> list[Record]:
    """Records with another name of their only policy, such as the name of an entry in place of its
    folder."""
    changed = []
    for record in records:
        if isinstance(record.cell, PolicyCell | TimingCell):
            record = replace(record, cell=replace(record.cell, policy=policy))
        changed.append(record)
    return changed


def entry_cells(
    folder: Path, suite: str, *, seed: int, claims_only: bool = False
) -> dict[str, Cell]:
    """The cells of an entry in a suite without hidden motions, by key.

    Args:
        folder: folder of the entry.
        suite: name of the suite.
        seed: evaluation seed.
        claims_only: whether to leave out what no claim is compared with: best known payloads and
            computing times.

    Raises:
        ValueError: if the suite has hidden motions, which belong to boards, or lacks an environment
            of the entry.
    """
    cells_of_suite = find_suite(suite)
    entry = read_entry(folder)
    if cells_of_suite.hidden:
        raise ValueError(
            f"suite {suite!r} has hidden motions, which belong to boards: choose smoke, standard or full"
        )
    lacking = [env_id for env_id in entry.env_ids if env_id not in cells_of_suite.env_ids]
    if lacking:
        raise ValueError(f"suite {suite!r} lacks {', '.join(lacking)}: choose standard or full")
    if claims_only:
        cells_of_suite = replace(cells_of_suite, best_known=False, timing=False)
    policies = {env_id: (str(folder),) for env_id in entry.env_ids}
    return suite_cells(cells_of_suite, policies, seed=seed)


def note(folder: Path, status: str) -> EntryNote:
    """The card of an entry as the leaderboard shows it."""
    entry = read_entry(folder)
    card = {name: getattr(entry, name) for name in CARD_FIELDS}
    return EntryNote(policy=str(folder), package=entry.package, status=status, **card)


def status(folder: Path, records: Sequence[Record]) -> str:
    """Status of an entry that a benchmark has rerun: ``verified``, or ``unverified`` with the
    reason."""
    try:
        reasons = refuted(read_claims(folder), records)
    except ValueError as error:
        reasons = [str(error)]
    if sandbox_name() is None:
        reasons.append("it ran without a sandbox")
    return f"unverified: {reasons[0]}" if reasons else "verified"


def read_claims(folder: Path) -> Results:
    """The results of the authors of an entry, with the folder as the name of the policy.

    Raises:
        ValueError: if they cannot be read, or if their cells are not all cells of their suite.
    """
    path = folder / CLAIMS
    results = _read_results(path)
    try:
        claims = replace(results, records=renamed(results.records, str(folder)))
        cells = entry_cells(folder, claims.suite, seed=0, claims_only=True).values()
    except ValueError as error:
        raise ValueError(f"{str(path)!r} holds no results of an entry: {brief(error)}") from error
    claimed = []
    for record in claims.records:
        if isinstance(record.cell, PolicyCell):
            claimed.append((record.cell, record.result.get("payload")))
    expected = {_without_seed(cell) for cell in cells}
    if sorted(_without_seed(cell) for cell, _ in claimed) != sorted(expected):
        raise ValueError(f"{str(path)!r} does not have the cells of suite {claims.suite!r}")
    for cell, payload in claimed:
        if isinstance(payload, bool) or not isinstance(payload, float | int | None):
            raise ValueError(f"{str(path)!r} has a payload that is no number: {_title(cell)}")
    return claims


def _read_results(path: Path) -> Results:
    try:
        return Results.from_json(foreign_text(path))
    except (OSError, ValueError) as error:
        raise ValueError(f"{str(path)!r} holds no results of an entry: {brief(error)}") from error


def refuted(claims: Results, records: Sequence[Record]) -> list[str]:
    """One sentence for each claim that is larger than the payload of a rerun under the same
    conditions.

    Raises:
        ValueError: if no record has the conditions of a claim.
    """
    reruns = {}
    for record in records:
        if isinstance(record.cell, PolicyCell):
            reruns[_without_seed(record.cell)] = record
    sentences = []
    compared = 0
    for claim in claims.records:
        rerun = reruns.get(_without_seed(claim.cell))
        if rerun is None or not isinstance(claim.cell, PolicyCell):
            continue
        compared += 1
        claimed = claim.result.get("payload")
        carried = rerun.result.get("payload")
        if claimed is None:
            continue
        if carried is None or not claimed <= carried + _tolerance(rerun.result):
            now = "it fails unloaded" if carried is None else f"it carries {carried:.3f} kg"
            sentences.append(
                f"{_title(claim.cell)}: {claimed:.3f} kg claimed; rerun: {rerun.error or now}"
            )
    if not compared:
        raise ValueError("the rerun has no conditions of the claims")
    return sentences


def _tolerance(result: Mapping[str, Any]) -> float:
    """Largest excess of a claim over the payload of a rerun that is no contradiction [kg]."""
    scatter = MACHINES if result.get("assured") is None else DRAWS
    resolution = float(result.get("resolution") or 0.0)
    return resolution + scatter * float(result.get("total_mass") or 0.0)


def verification(
    folder: Path, seed: int, records: Sequence[Record], reasons: Sequence[str]
) -> dict[str, Any]:
    """JSON-able record of a verification.

    Args:
        folder: folder of the entry.
        seed: evaluation seed of the rerun.
        records: records of the rerun; empty if there was none.
        reasons: why the entry is refused; empty if its claims hold.
    """
    sandbox = sandbox_name()
    outcome = "verified" if sandbox else "reproduced without a sandbox"
    if reasons:
        outcome = "refused"
    hashes = {}
    for name in (CARD, CLAIMS):
        with suppress(OSError, ValueError):  # the reason of a refusal can be that it is no file
            hashes[name] = foreign_digest(folder / name)
    payloads = []
    for record in records:
        if isinstance(record.cell, PolicyCell):
            payload = record.result.get("payload")
            title = _title(record.cell)
            payloads.append({"conditions": title, "payload": payload, "error": record.error})
    return {
        "outcome": outcome,
        "reasons": list(reasons),
        "date": datetime.now(UTC).date().isoformat(),
        "sandbox": sandbox,
        "network": "cut" if sandbox else "open",
        "seed": seed,
        "sha256": hashes,
        "source": records[0].source if records else None,
        "versions": dict(records[0].versions) if records else {},
        "processor": processor(),
        "payloads": payloads,
    }


def check_entry(folder: Path) -> Entry:
    """Checks card and files of an entry.

    Raises:
        ValueError: if a file is missing, changed or unknown, or a field of the card is invalid.
    """
    entry = read_entry(folder)
    files = PACKAGES if entry.package is not None else POLICY
    known = {CARD, CLAIMS, VERIFICATION, "README.md", files}
    unknown = []
    for path in folder.iterdir():
        kind = path.lstat().st_mode
        is_plain = stat.S_ISDIR(kind) if path.name == files else stat.S_ISREG(kind)
        if path.name not in known or not is_plain:
            unknown.append(path.name)
            if len(unknown) == _MOST_NAMED:
                break
    if unknown:
        raise ValueError(
            f"entry {entry.name!r} has files that are unknown or links: "
            f"{brief(', '.join(sorted(unknown)))}"
        )
    entry.paths(folder)
    return entry


def find_entries(folder: Path) -> tuple[dict[str, Entry], dict[str, str]]:
    """The checked entries in the subfolders of a folder by their paths, and the reasons of the
    invalid ones by their paths.

    An entry that is invalid costs the others nothing.

    Raises:
        ValueError: if there is none.
    """
    entries = {}
    invalid = {}
    for path in sorted(folder.iterdir()):
        if not os.path.lexists(path / CARD):
            continue
        try:
            if path.is_symlink():
                raise ValueError("its folder is a link")
            entry = check_entry(path)
            if (path / CLAIMS).exists():  # before hours of computation, not after them
                _read_results(path / CLAIMS)
            entries[str(path)] = entry
        except (OSError, ValueError, ImportError) as error:
            # the name of the folder can hold anything
            invalid[ascii(str(path))[1:-1][:LONGEST_NAME]] = brief(error)
    if not entries and not invalid:
        raise ValueError(
            f"{str(folder)!r} has no entries: give the folder that holds their folders"
        )
    return entries, invalid


def invalid_note(path: str, reason: str) -> EntryNote:
    """An entry that was not run, as the leaderboard shows it.

    Args:
        path: folder of the entry.
        reason: why it is invalid.
    """
    absent = dict.fromkeys(CARD_FIELDS, "–")
    return EntryNote(policy=path, package=None, status=f"invalid: {reason}", **absent)


def _without_seed(cell: Cell) -> str:
    """Key of the conditions of a cell: the same for all seeds."""
    if isinstance(cell, PolicyCell):
        cell = replace(cell, seed=0)
    return cell.key


def _title(cell: PolicyCell) -> str:
    words = [
        cell.env_id,
        task_title(cell),
        cell.payload_model,
        cell.uncertainty or "",
        f"{cell.criterion} criterion",
    ]
    return ", ".join(word for word in words if word)
