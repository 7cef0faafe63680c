"""Entries of others: makes the folder of an entry, and compares its claims with a rerun."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from importlib.metadata import packages_distributions, version
from pathlib import Path
from typing import Any

from cablebot_gym.benchmark.cells import Cell, PolicyCell, Record, TimingCell, processor
from cablebot_gym.benchmark.leaderboard import EntryNote, Results
from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.benchmark.suites import find_suite, suite_cells
from cablebot_gym.benchmark.tables import task_title
from cablebot_gym.isolation.sandbox import sandbox_name
from cablebot_gym.policies import PolicySpec
from cablebot_gym.policies.entry import (
    CARD,
    PACKAGES,
    POLICY,
    Entry,
    digests,
    package_root,
    plain_files,
    read_entry,
)
from cablebot_gym.utils.code_hash import source_files
from cablebot_gym.utils.files import atomic_write_text, read_text
from cablebot_gym.utils.imports import split_name

CLAIMS, VERIFICATION = "results.json", "verification.json"
"""Names in the folder of an entry: the results of its authors, and the record of the last
verification."""

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
    if policy.endswith(".zip"):
        return Path(policy).parent, list(policy_source(policy)[1]), Path(policy).name, None
    spec = PolicySpec.parse(policy)
    if spec.own:
        raise ValueError(
            f"policy {policy!r} belongs to this project, and is on the leaderboard already"
        )
    point = spec.points[0] if spec.points else None
    module, _ = split_name(policy if point is None else point.value)
    top = module.partition(".")[0]
    found = package_root(top)
    if found is None:
        raise ValueError(
            f"policy {policy!r} has no source: give an installed name, module:factory, file.py:factory"
        )
    root, owned = found
    target = f"{module}:{policy.rpartition(':')[2]}" if point is None else point.value
    dist = next(iter(packages_distributions().get(top, ())), None)
    if point is not None and point.dist is not None:
        dist = point.dist.name
    package = None if dist is None else f"{dist}=={version(dist)}"
    if owned.is_dir() or package is not None:
        return root, plain_files(owned), target, package
    modules = [path for path in source_files(module).values() if path.parent == root]
    return root, [*modules, *policy_source(policy)[1]], target, None


def renamed(records: Sequence[Record], policy: str) -> list[Record]:
    """Records with another name of their only policy, such as the name of an entry in place of its
    folder."""
    return [
        replace(one, cell=replace(one.cell, policy=policy))
        if isinstance(one.cell, PolicyCell | TimingCell)
        else one
        for one in records
    ]


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
    chosen, entry = find_suite(suite), read_entry(folder)
    if chosen.hidden:
        raise ValueError(
            f"suite {suite!r} has hidden motions, which belong to boards: choose smoke, standard or full"
        )
    if lacking := [env_id for env_id in entry.env_ids if env_id not in chosen.env_ids]:
        raise ValueError(f"suite {suite!r} lacks {', '.join(lacking)}: choose standard or full")
    if claims_only:
        chosen = replace(chosen, best_known=False, timing=False)
    return suite_cells(chosen, {env_id: (str(folder),) for env_id in entry.env_ids}, seed=seed)


def note(folder: Path, status: str) -> EntryNote:
    """The card of an entry as the leaderboard shows it."""
    entry = read_entry(folder)
    texts = {
        name: getattr(entry, name)
        for name in ("package", "authors", "licence", "compute", "data", "seeds")
    }
    return EntryNote(policy=str(folder), status=status, **texts)


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
    try:
        results = Results.from_json(read_text(folder / CLAIMS))
        claims = replace(results, records=renamed(results.records, str(folder)))
        expected = {
            _conditions(cell)
            for cell in entry_cells(folder, claims.suite, seed=0, claims_only=True).values()
        }
    except (OSError, KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
        raise ValueError(
            f"{str(folder / CLAIMS)!r} holds no results of an entry: {error}"
        ) from error
    payloads = [
        (one.cell, one.result.get("payload"))
        for one in claims.records
        if isinstance(one.cell, PolicyCell)
    ]
    if sorted(_conditions(cell) for cell, _ in payloads) != sorted(expected):
        raise ValueError(
            f"{str(folder / CLAIMS)!r} does not have the cells of suite {claims.suite!r}"
        )
    if strange := [
        cell for cell, payload in payloads if not isinstance(payload, float | int | None)
    ]:
        raise ValueError(
            f"{str(folder / CLAIMS)!r} has a payload that is no number: {_title(strange[0])}"
        )
    return claims


def refuted(claims: Results, records: Sequence[Record]) -> list[str]:
    """One sentence for each claim that is larger than the payload of a rerun under the same
    conditions.

    Raises:
        ValueError: if no record has the conditions of a claim.
    """
    own = {_conditions(one.cell): one for one in records if isinstance(one.cell, PolicyCell)}
    sentences, compared = [], 0
    for claim in claims.records:
        rerun = own.get(_conditions(claim.cell))
        if rerun is None or not isinstance(claim.cell, PolicyCell):
            continue
        compared += 1
        claimed, carried = (one.result.get("payload") for one in (claim, rerun))
        if claimed is None:
            continue
        scatter = DRAWS if rerun.result.get("assured") is not None else MACHINES
        tolerance = float(rerun.result.get("resolution") or 0.0) + scatter * (
            rerun.result.get("total_mass") or 0.0
        )
        if carried is None or not claimed <= carried + tolerance:
            now = rerun.error or (
                "it fails unloaded" if carried is None else f"it carries {carried:.3f} kg"
            )
            sentences.append(f"{_title(claim.cell)}: {claimed:.3f} kg claimed; rerun: {now}")
    if not compared:
        raise ValueError("the rerun has no conditions of the claims")
    return sentences


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
    payloads = [
        {"conditions": _title(one.cell), "payload": one.result.get("payload"), "error": one.error}
        for one in records
        if isinstance(one.cell, PolicyCell)
    ]
    return {
        "outcome": "refused"
        if reasons
        else "verified"
        if sandbox
        else "reproduced without a sandbox",
        "reasons": list(reasons),
        "date": datetime.now(UTC).date().isoformat(),
        "sandbox": sandbox,
        "network": "cut" if sandbox else "open",
        "seed": seed,
        "sha256": {
            name: hashlib.sha256((folder / name).read_bytes()).hexdigest()
            for name in (CARD, CLAIMS)
            if (folder / name).is_file()
        },
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
    entry.paths(folder)
    known = {
        CARD,
        CLAIMS,
        VERIFICATION,
        "README.md",
        PACKAGES if entry.package is not None else POLICY,
    }
    if others := sorted(
        path.name for path in folder.iterdir() if path.name not in known or path.is_symlink()
    ):
        raise ValueError(
            f"entry {entry.name!r} has files that are unknown or links: {', '.join(others[:5])}"
        )
    return entry


def find_entries(folder: Path) -> dict[str, Entry]:
    """The checked entries in the subfolders of a folder, by their paths.

    Raises:
        ValueError: if there is none, or if one is invalid.
    """
    found = {
        str(path.parent): check_entry(path.parent) for path in sorted(folder.glob(f"*/{CARD}"))
    }
    if not found:
        raise ValueError(
            f"{str(folder)!r} has no entries: give the folder that holds their folders"
        )
    return found


def _conditions(cell: Cell) -> str:
    """Key of a cell without its seed."""
    return replace(cell, seed=0).key if isinstance(cell, PolicyCell) else cell.key


def _title(cell: PolicyCell) -> str:
    words = [
        cell.env_id,
        task_title(cell),
        cell.payload_model,
        cell.uncertainty or "",
        f"{cell.criterion} criterion",
    ]
    return ", ".join(word for word in words if word)
