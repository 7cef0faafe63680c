"""Public entries of installed policies: no code of other packages runs in this process."""

from __future__ import annotations

import logging
import pickle
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from cablebot_gym.isolation.isolated import DEADLINE, IsolatedPolicy
from cablebot_gym.isolation.process import PolicyProcess, parse_json, plain, search_path
from cablebot_gym.isolation.server import ANSWER, DESCRIBE
from cablebot_gym.policies.protocol import PolicyEntry
from cablebot_gym.policies.spec import PolicySpec, policy_names


def public_entries() -> dict[str, PolicyEntry]:
    """Public entries of all installed policies by name, sorted, see :func:`public_entry`. A policy
    without one is left out."""
    entries = {}
    for name in policy_names():
        entry = public_entry(name)
        if entry is not None:
            entries[name] = entry
    return entries


# The cache also keeps None: the package of a skipped policy is not imported again for each question,
# and its warning appears once.
@cache
def public_entry(name: str) -> PolicyEntry | None:
    """The public entry of an installed policy: what evaluations may know of it without running code
    of other packages in this process.

    The entry of a policy of this project is imported. For a policy of another project, a separate
    process imports its package and sends the environment ids, the data files and whether the policy
    is slow; the factory of the entry makes an :class:`IsolatedPolicy`. A policy with estimators,
    such as ``ekf+fl``, has the entry of its target ``fl`` under its own name.

    Returns:
        None if the name is not that of an installed policy, or if its package cannot be imported.
        The latter logs a warning.
    """
    spec = PolicySpec.parse(name)
    if spec.estimators:
        entry = public_entry(spec.target)
        return None if entry is None else replace(entry, name=name)
    if not spec.installed:
        return None
    if spec.shipped:
        # A policy of another package can have the same name. The first entry point is that of this
        # project; only this one may be imported here.
        return replace(spec, points=spec.points[:1]).entry()
    try:
        return _entry_from_own_process(name)
    except Exception as error:  # whatever another package does, the other policies stay usable
        logging.getLogger("cablebot_gym").warning("policy %r is skipped: %s", name, error)
        return None


def _entry_from_own_process(name: str) -> PolicyEntry:
    """The entry of a policy of another package, which a process of its own imports.

    Raises:
        DeadlineError: if the process does not reply before the deadline.
        EndedError: if the process ends, or if its reply cannot be read.
        KeyError: if the reply lacks a value.
        TypeError: if a value of the reply is of a wrong type.
        ValueError: if the package cannot be imported, or if the reply is no JSON object.
    """
    process = PolicyProcess()
    try:
        request = pickle.dumps((name, search_path()))
        kind, body = process.exchange(DESCRIBE, request, 0, DEADLINE)
    finally:
        process.end()
    description = parse_json(body)
    if not isinstance(description, dict):
        raise ValueError("its process sent invalid data")
    if kind != ANSWER:
        raise ValueError(plain(description["error"]))
    files = None
    if description["files"] is not None:
        paths = [Path(str(path)) for path in description["files"]]
        # Hashes of results read these files, and a missing file would raise there.
        files = tuple(path for path in paths if path.is_file())
    return PolicyEntry(
        name=name,
        # The process does not send kind and summary: only lists show them, from imported entries.
        kind="learned",
        summary="",
        env_ids=tuple(map(str, description["env_ids"])),
        factory=partial(IsolatedPolicy, name),
        slow=description["slow"] is True,
        files=files,
    )
