"""Files that people bring, result files and cache files: checked reads, checks before the work, and
atomic writes."""

from __future__ import annotations

import csv
import json
import logging
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from cablebot_gym.utils.foreign import foreign_bytes, foreign_text

CACHE_VARIABLE = "CABLEBOT_CACHE"
"""Environment variable for another cache folder."""

_LOGGER = logging.getLogger("cablebot_gym")

_Value = TypeVar("_Value")


@contextmanager
def empty_cache() -> Iterator[None]:
    """A new cache folder within the context, for this process and those that it starts."""
    before = os.environ.get(CACHE_VARIABLE)
    with tempfile.TemporaryDirectory() as folder:
        os.environ[CACHE_VARIABLE] = folder
        try:
            yield
        finally:
            del os.environ[CACHE_VARIABLE]
            if before is not None:
                os.environ[CACHE_VARIABLE] = before


def cache_folder() -> Path:
    """Cache folder: ``$CABLEBOT_CACHE``, or ``cablebot_gym`` in the user's cache folder."""
    folder = os.environ.get(CACHE_VARIABLE)
    if folder:
        return Path(folder)
    user_cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if user_cache.startswith("~"):  # a user without home, as in containers
        user_cache = tempfile.gettempdir()
    return Path(user_cache) / "cablebot_gym"


def read_cached(path: str | Path, decode: Callable[[bytes], _Value]) -> _Value | None:
    """The content of a cache file, decoded; None if it is missing or damaged. A log line reports a
    damaged file.

    Args:
        path: file in a cache.
        decode: decodes the bytes of the file. Any exception means that the file is damaged.
    """
    if not os.path.exists(path):
        return None
    try:
        return decode(foreign_bytes(path))
    except Exception as error:
        _LOGGER.warning(
            "%s is damaged (%s); it is ignored, and its content is computed again", path, error
        )
        return None


JSON_FORM = "a .json file on the command line, and its data in Python"
"""Form of files with data of an uncertainty or a measurement, in messages."""


def read_text(path: str | Path) -> str:
    """The text of a file that a person gives by its path.

    Raises:
        OSError, ValueError: see :func:`~cablebot_gym.utils.foreign.foreign_text`.
    """
    return foreign_text(path)


def check_not_a_file(kind: str, name: object, forms: str) -> None:
    """Checks that an unknown name is not that of an existing file or folder, which is not unknown
    but of another form.

    Args:
        kind: kind of the named thing, such as ``robot``.
        name: the name that the user gave.
        forms: valid forms of files, such as ``a .toml file``.

    Raises:
        ValueError: if there is such a file or folder.
    """
    if isinstance(name, (str, Path)) and os.path.exists(name):
        form = "folder" if os.path.isdir(name) else "file"
        raise ValueError(f"{form} {str(name)!r} has no form of a {kind}; use {forms}")


def check_writable_dir(folder: str | Path) -> None:
    """Checks that files can be written to a folder, or that the folder can be created. Nothing is
    left behind.

    Raises:
        ValueError: if files cannot be written.
    """
    existing = Path(folder).absolute()
    # Path.exists raises in closed folders.
    while not os.path.exists(existing) and existing != existing.parent:
        existing = existing.parent
    try:
        with tempfile.TemporaryFile(dir=existing):
            pass
    except OSError as error:
        raise ValueError(
            f"cannot write to folder {str(folder)!r}: {error.strerror or error}; choose another folder"
        ) from error


def is_writable_dir(folder: str | Path) -> bool:
    """Whether files can be written to a folder, or the folder can be created."""
    try:
        check_writable_dir(folder)
    except ValueError:
        return False
    return True


def check_new_file(path: str | Path) -> None:
    """Checks that a file that a user may edit later is not there yet, and can be written.

    Raises:
        ValueError: if it is there.
        OSError: if it cannot be written.
    """
    if os.path.exists(path):
        raise ValueError(
            f"{str(path)!r} exists and may have been edited: delete it, or choose another --out"
        )
    check_writable_file(path)


def check_writable_file(path: str | Path) -> None:
    """Checks that a file can be written. Nothing is left behind.

    Raises:
        ValueError: if the folder is not writable, or ``path`` is a folder.
    """
    path = Path(path)
    check_writable_dir(path.parent)
    if path.is_dir():
        raise ValueError(f"cannot write {str(path)!r}: it is a folder; choose another name")


def json_text(data: Any) -> str:
    """Data as indented JSON; NaN and infinity raise an error."""
    return json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False)


def atomic_write(path: str | Path, write: Callable[[Path], object]) -> None:
    """Calls ``write`` with a temporary file beside ``path`` and then moves the file to ``path``.

    A missing folder is created. After an interrupt or an error the previous file at ``path`` is
    unchanged. The temporary file has the same suffix because some writers choose the format by
    suffix.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        # The mode of an ordinary new file: temporary files are private.
        mask = os.umask(0)  # it is read by setting it
        os.umask(mask)
        os.chmod(temporary, 0o666 & ~mask)
        os.replace(temporary, path)
    except BaseException as error:
        temporary.unlink(missing_ok=True)
        if isinstance(error, OSError):
            error.filename = str(path)  # a full disk has none, and the temporary name tells nothing
        raise


def write_csv(path: str | Path, rows: Iterable[Iterable[Any]]) -> None:
    """Writes rows as a CSV file in UTF-8, see :func:`atomic_write`."""

    def _write(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerows(rows)

    atomic_write(path, _write)


def atomic_write_text(path: str | Path, text: str) -> None:
    """Writes ``text`` to ``path`` in UTF-8, see :func:`atomic_write`."""
    atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
