"""Entries of installed policies, without code of other packages in this process."""

from __future__ import annotations

import logging
import pickle
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

from cablebot_gym.isolation.deadlines import DEADLINE, START_UP
from cablebot_gym.isolation.isolated import IsolatedPolicy, parse_json, search_path
from cablebot_gym.isolation.process import PolicyProcess, plain
from cablebot_gym.isolation.server import ANSWER, DESCRIBE
from cablebot_gym.policies.protocol import PolicyEntry
from cablebot_gym.policies.spec import PolicySpec, policy_names


def public_entries() -> dict[str, PolicyEntry]:
    """All installed policies by name, sorted, see :func:`public_entry`. A policy without entry is
    skipped."""
    entries = {name: public_entry(name) for name in policy_names()}
    return {name: entry for name, entry in entries.items() if entry is not None}


@cache
def public_entry(name: str) -> PolicyEntry | None:
    """The entry of an installed policy, without code of other packages; None if there is none.

    The package of another project is imported in a process of its own, which sends the environment
    ids, the data files and whether the policy is slow. The factory of such an entry makes an
    :class:`IsolatedPolicy`. A policy whose package cannot be imported is skipped with a warning.
    """
    spec = PolicySpec.parse(name)
    if spec.estimators:
        entry = public_entry(spec.target)
        return None if entry is None else replace(entry, name=name, unsaturated_actions=False)
    if not spec.installed:
        return None
    if spec.own:
        return replace(spec, points=spec.points[:1]).entry()
    try:
        return _described(name)
    except Exception as error:
        logging.getLogger("cablebot_gym").warning("policy %r is skipped: %s", name, error)
        return None


def _described(name: str) -> PolicyEntry:
    process = PolicyProcess()
    try:
        request = pickle.dumps((name, search_path()))
        kind, body = process.exchange(DESCRIBE, request, 0, START_UP * DEADLINE)
    finally:
        process.end()
    data = parse_json(body)
    if kind != ANSWER:
        raise ValueError(plain(data["error"]))
    files = None
    if data["files"] is not None:
        paths = [Path(str(path)) for path in data["files"]]
        files = tuple(path for path in paths if path.is_file())
    return PolicyEntry(
        name=name,
        kind="learned",
        env_ids=tuple(map(str, data["env_ids"])),
        factory=partial(IsolatedPolicy, name),
        summary="",
        slow=data["slow"] is True,
        files=files,
    )
