"""Entries of others with hostile files. The docstring of each function is its line in
docs/attacks.md."""

import json
import os
from dataclasses import dataclass
from pathlib import Path

from cablebot_gym.benchmark.entries import CLAIMS
from cablebot_gym.policies.entry import CARD

SPARSE = 200 << 30
"""Apparent size of a file without content [bytes]."""

HUGE = "1" + "0" * 400
"""A number beyond the largest float."""

BRACKETS = "[" * 200_000 + "]" * 200_000
"""JSON that a recursive reader cannot read."""


def huge_payload(entry):
    """claims a payload of 10^400 kg"""
    replace(entry / CLAIMS, '"payload": 1.0', f'"payload": {HUGE}')


def negative_payload(entry):
    """claims a payload of −1 kg"""
    replace(entry / CLAIMS, '"payload": 1.0', '"payload": -1.0')


def brackets_in_results(entry):
    """has 200,000 brackets in `results.json`"""
    (entry / CLAIMS).write_text(BRACKETS)


def brackets_on_card(entry):
    """has 200,000 brackets on its card"""
    (entry / CARD).write_text(BRACKETS)


def list_for_result(entry):
    """has a list in place of the result of a cell"""
    data = json.loads((entry / CLAIMS).read_text())
    data["cells"][0]["result"] = []
    (entry / CLAIMS).write_text(json.dumps(data))


def sparse_results(entry):
    """has a `results.json` of 200 GiB that takes no space on the disk"""
    sparse(entry / CLAIMS)


def sparse_weights(entry):
    """has weights of 200 GiB that take no space on the disk"""
    sparse(entry / "policy" / "weights.npz")


def pipe_for_results(entry):
    """has a named pipe in place of `results.json`"""
    (entry / CLAIMS).unlink()
    os.mkfifo(entry / CLAIMS)


def pipe_in_policy(entry):
    """has a named pipe among the files of its policy"""
    os.mkfifo(entry / "policy" / "weights.npz")


def link_for_card(entry):
    """has a link in place of its card"""
    (entry / CARD).rename(entry.parent / "card.json")
    (entry / CARD).symlink_to(entry.parent / "card.json")


def look_alike_name(entry):
    """has the name of another entry with one letter of another script"""
    name = "l\N{CYRILLIC SMALL LETTER A}w"
    edit(entry, name=name)
    entry.rename(entry.with_name(name))


def long_authors(entry):
    """has 1,000,000 characters of authors"""
    edit(entry, authors="A" * 1_000_000)


def reversed_authors(entry):
    """has authors that are written from right to left, over the next columns"""
    edit(entry, authors="A\N{RIGHT-TO-LEFT OVERRIDE}B")


def replace(path, old, new):
    """Replaces text in a file."""
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def edit(entry, **change):
    """Changes fields of a card."""
    card = json.loads((entry / CARD).read_text())
    (entry / CARD).write_text(json.dumps(card | change))


def sparse(path):
    """Makes a file of :data:`SPARSE` without content."""
    with Path(path).open("wb") as file:
        file.truncate(SPARSE)


@dataclass(frozen=True)
class HostileEntry:
    """A change of an honest entry, and its outcome."""

    change: object
    """Function that changes the folder of an entry."""
    before: str
    """What became of a run of `cablebot benchmark --entries`, measured at commit d241351."""
    now: str
    """Words of the reason for which the entry is invalid."""

    @property
    def name(self):
        """Name of the change."""
        return self.change.__name__


AFTER_ALL_CELLS = "after the last cell"

HOSTILE_ENTRIES = (
    HostileEntry(
        huge_payload,
        before=f"ended {AFTER_ALL_CELLS}: OverflowError",
        now="an integer has 401 digits; at most 40 are valid",
    ),
    HostileEntry(
        negative_payload,
        before="listed, and verified",
        now="payload must be a finite number at least 0",
    ),
    HostileEntry(
        brackets_in_results,
        before=f"ended {AFTER_ALL_CELLS}: RecursionError",
        now="JSON with more than 32 levels",
    ),
    HostileEntry(
        brackets_on_card,
        before="ended at its start: RecursionError",
        now="JSON with more than 32 levels",
    ),
    HostileEntry(
        list_for_result,
        before=f"ended {AFTER_ALL_CELLS}: AttributeError",
        now="a result must be an object, not []",
    ),
    HostileEntry(
        sparse_results,
        before=f"ended {AFTER_ALL_CELLS}: MemoryError",
        now="has 214,748,364,800 bytes; at most 67,108,864 are valid",
    ),
    HostileEntry(
        sparse_weights,
        before="ended at its start: MemoryError",
        now="has more than 1,073,741,824 bytes in all its files",
    ),
    HostileEntry(
        pipe_for_results,
        before=f"never ended {AFTER_ALL_CELLS}",
        now="has files that are unknown or links: results.json",
    ),
    HostileEntry(
        pipe_in_policy,
        before="did not notice the file",
        now="is neither a file nor a folder",
    ),
    HostileEntry(
        link_for_card,
        before="ended at its start: the link was refused",
        now="is a link: give the file itself",
    ),
    HostileEntry(
        look_alike_name,
        before="listed, and verified, beside the other",
        now="name must be ASCII letters, digits",
    ),
    HostileEntry(
        long_authors,
        before="listed, and verified",
        now="authors has 1,000,000 characters; at most 500 are valid",
    ),
    HostileEntry(
        reversed_authors,
        before="listed, and verified",
        now="authors must be one line of printable characters",
    ),
)
