"""Entries: policies of others, each a folder with a card. `cablebot submit` makes it, and the
benchmark runs it."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from cablebot_gym.utils.checks import record
from cablebot_gym.utils.code_hash import module_file
from cablebot_gym.utils.foreign import (
    brief,
    foreign_digest,
    foreign_json,
    foreign_line,
    foreign_list,
    foreign_object,
    foreign_text,
    plain_paths,
)

POLICY_SUFFIXES = (".zip",)
"""Suffixes of policy files."""

CARD, POLICY, PACKAGES = "entry.json", "policy", "packages"
"""Names in the folder of an entry: the card, the files of the policy, and the packages that it
refers to, if they are not installed."""


LARGEST_CARD = 4 << 20
"""Largest size of a card [bytes]."""

LARGEST_ENTRY = 1 << 30
"""Largest size of all files of a policy [bytes]."""

MOST_FILES = 10_000
"""Largest number of files and folders of a policy."""

LONGEST_NAME, LONGEST_TEXT = 100, 500
"""Largest number of characters of names and of the other texts on a card."""

_NAMES = ("name", "policy", "package")
"""Fields that are names, which are ASCII: other scripts have letters that look the same."""

_FORMS = {
    "name": (r"[A-Za-z0-9][\w.-]*", "ASCII letters, digits, '.', '_' and '-'"),
    "policy": (
        r"[\w.]+:\w+|[\w.-]+\.zip",
        "module:factory or the name of a .zip file",
    ),
    "package": (r"[\w.-]+==[\w.+!-]+", "name==version, or null"),
}
"""Valid forms of fields, of which messages, tables and commands are made."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """Card of an entry. Every text says something: an entry without training has ``none`` there."""

    name: str
    """Name in tables, which is that of the folder."""
    env_ids: tuple[str, ...]
    """Environments for which the policy is made."""
    policy: str
    """``module:factory``, or a ``.zip`` file in the folder of the policy."""
    package: str | None
    """Requirement for pip of the package that has the policy, such as ``their-law==1.0``; None if
    the entry has its files."""
    files: Mapping[str, str]
    """SHA-256 of every file of the policy or of its package, by path."""
    authors: str
    """Authors."""
    licence: str
    """Licence of code and weights."""
    compute: str
    """Compute for training and tuning, such as ``3 h on 8 cores``."""
    data: str
    """Data and motions for training and tuning."""
    seeds: str
    """Seeds of the training."""

    def __post_init__(self) -> None:
        """Checks all fields.

        Raises:
            ValueError: if a field is empty or of another type.
        """
        object.__setattr__(self, "env_ids", tuple(self.env_ids))
        for env_id in self.env_ids:
            foreign_line("an environment id", env_id, LONGEST_NAME)
        for field in fields(self):
            value = getattr(self, field.name)
            largest = LONGEST_NAME if field.name in _NAMES else LONGEST_TEXT
            if field.type == "str" or (field.name == "package" and value is not None):
                foreign_line(field.name, value, largest)
        if not self.env_ids or not self.files or not isinstance(self.files, Mapping):
            raise ValueError("an entry needs env_ids and files")
        for digest in self.files.values():
            if not isinstance(digest, str) or not re.fullmatch("[0-9a-f]{64}", digest):
                raise ValueError(f"files must give a SHA-256 for each path, not {brief(digest)}")
        for name, (form, valid) in _FORMS.items():
            value = getattr(self, name)
            if value is not None and not re.fullmatch(form, value, re.ASCII):
                raise ValueError(f"{name} must be {valid}, not {value!r}")

    @property
    def _top(self) -> str:
        """Top-level module of the policy."""
        return self.policy.partition(":")[0].partition(".")[0]

    def to_json(self) -> str:
        """The card as text."""
        return json.dumps(asdict(self), indent=1, ensure_ascii=False) + "\n"

    def root(self, folder: Path) -> Path:
        """Folder of the files of the policy.

        Raises:
            ValueError: if the entry should have the files and has none.
            ImportError: if the package of the policy is not installed.
        """
        own = folder / (POLICY if self.package is None else PACKAGES)
        if own.is_dir():
            return own
        if self.package is None:
            raise ValueError(
                f"entry {self.name!r} has no files of its policy: restore the folder {str(own)!r}"
            )
        installed = package_root(self._top)
        if installed is None:
            command = f"pip install --no-deps --only-binary :all: --target {own} {self.package}"  # runs no code
            raise ImportError(
                f"entry {self.name!r} needs its package: `{command}` installs it for this entry only"
            )
        return installed[0]

    def paths(self, folder: Path) -> tuple[Path, ...]:
        """The card and all files of the policy.

        Raises:
            ValueError: if a file is missing or differs from the card, or if the policy has other
                files.
        """
        root = self.root(folder)
        owned = root if self.package is None else root / self._top
        owned = owned if owned.is_dir() else owned.with_suffix(".py")
        present = digests(root, plain_files(owned, compiled=self.package is None))
        if differing := sorted({name for name, _ in self.files.items() ^ present.items()}):
            raise ValueError(
                f"entry {self.name!r} does not match its card in {brief(', '.join(differing[:5]))}"
            )
        return (folder / CARD, *(root / name for name in present))


def is_entry(name: str) -> bool:
    """Whether the name of a policy is the folder of an entry."""
    return Path(name, CARD).is_file()


def read_entry(folder: Path) -> Entry:
    """The card of the entry in a folder.

    Raises:
        ValueError: if it cannot be read, or if a field is missing, unknown or empty.
    """
    try:
        data = foreign_object("the card", foreign_json(foreign_text(folder / CARD, LARGEST_CARD)))
        foreign_list("env_ids", data.get("env_ids", []))
        entry = record("the card", Entry, data)
        if entry.name != folder.absolute().name:
            raise ValueError(f"the folder must have the name of the entry, {entry.name!r}")
        return entry
    except (OSError, ValueError) as error:
        path = str(folder / CARD)
        raise ValueError(f"{path!r} is no card of an entry: {brief(error)}") from error


def entry_spec(name: str) -> str:
    """The policy of an entry as a name that can be loaded in this process, which has to be the
    policy's own.

    Its modules come first in the search path. Every other name of a policy is returned unchanged.

    Raises:
        ValueError: if the card is invalid, or if there are no files.
        ImportError: if the package of the policy is not installed.
    """
    if not is_entry(name):
        return name
    folder = Path(name)
    entry = read_entry(folder)
    if entry.policy.endswith(POLICY_SUFFIXES):
        return str(folder / POLICY / entry.policy)
    sys.dont_write_bytecode = True  # an entry has no file that is not on its card
    root = str(entry.root(folder).absolute())
    if root not in sys.path:
        sys.path.insert(0, root)
    return entry.policy


def package_root(top: str) -> tuple[Path, Path] | None:
    """The folder that has a top-level module, and the file or folder of this module; None if it is
    missing."""
    file = module_file(top)
    if file is None:
        return None
    owned = file.parent if file.name == "__init__.py" else file
    return owned.parent, owned


def plain_files(owned: Path, *, compiled: bool = False) -> list[Path]:
    """A file, or all files of a folder.

    Args:
        owned: the file or folder.
        compiled: whether to include the compiled code of Python.

    Raises:
        OSError: if a file cannot be read.
        ValueError: if a file is a link, a pipe or a device, or if there are more than
            :data:`MOST_FILES` or :data:`LARGEST_ENTRY`.
    """
    files = []
    for path in plain_paths(owned, count=MOST_FILES, size=LARGEST_ENTRY):
        if compiled or "__pycache__" not in path.parts:
            files.append(path)
    return files


def digests(root: Path, paths: Iterable[Path]) -> dict[str, str]:
    """SHA-256 of files by their paths relative to a folder.

    Raises:
        OSError: if a file cannot be read.
        ValueError: if a file is no regular file, or too large.
    """
    return {path.relative_to(root).as_posix(): foreign_digest(path) for path in paths}
