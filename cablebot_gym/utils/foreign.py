"""Files and JSON of strangers: limits are checked before anything is read, and every failure is a
ValueError."""

from __future__ import annotations

import hashlib
import json
import math
import os
import stat
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

LARGEST_TEXT = 64 << 20
"""Largest size of a text file [bytes]."""

LARGEST_FILE = 1 << 30
"""Largest size of any file [bytes]."""

DEPTH = 32
"""Largest depth of lists and objects in each other."""

DIGITS = 40
"""Largest number of characters of an integer: seeds have 128 bits."""

_CHUNK = 1 << 20
"""Number of bytes that are hashed at once."""

_MESSAGE = 400
"""Largest length of the message about a file of others: the file may have chosen its words."""


@contextmanager
def _opened(path: Path, largest: int, *, links: bool) -> Iterator[int]:
    """Descriptor of a regular file.

    The file is opened without waiting for the other end of a pipe and, unless ``links`` are
    allowed, without following one at its name. What was opened is then checked, so that nobody can
    replace it in between.
    """
    flags = os.O_RDONLY
    for name in ("O_NONBLOCK", "O_CLOEXEC", "O_NOCTTY", "O_BINARY"):
        flags |= getattr(os, name, 0)
    if not links:
        flags |= getattr(os, "O_NOFOLLOW", 0)
        if path.is_symlink():  # Windows has no O_NOFOLLOW, and other systems a message of their own
            raise ValueError(f"{str(path)!r} is a link: give the file itself")
    descriptor = os.open(path, flags)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise ValueError(f"{str(path)!r} is no regular file: give one")
        if status.st_size > largest:
            raise ValueError(
                f"{str(path)!r} has {status.st_size:,} bytes; at most {largest:,} are valid"
            )
        yield descriptor
    finally:
        os.close(descriptor)


def _chunks(path: Path, largest: int, *, links: bool = False) -> Iterator[bytes]:
    """The content of a regular file in pieces. A file that grows meanwhile is refused."""
    size = 0
    with _opened(path, largest, links=links) as descriptor:
        for chunk in iter(lambda: os.read(descriptor, _CHUNK), b""):
            size += len(chunk)
            if size > largest:
                raise ValueError(f"{str(path)!r} grows: it has more than {largest:,} bytes")
            yield chunk


def foreign_digest(path: Path) -> str:
    """SHA-256 of a file of at most :data:`LARGEST_FILE` bytes.

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is no regular file, or too large.
    """
    digest = hashlib.sha256()
    for chunk in _chunks(path, LARGEST_FILE):
        digest.update(chunk)
    return digest.hexdigest()


def foreign_bytes(path: Path, largest: int = LARGEST_FILE, *, links: bool = False) -> bytes:
    """The content of a file.

    Args:
        path: the file.
        largest: largest size of the file [bytes].
        links: whether ``path`` may be a link.

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is no regular file, or too large.
    """
    return b"".join(_chunks(path, largest, links=links))


def foreign_text(path: Path, largest: int = LARGEST_TEXT, *, links: bool = False) -> str:
    """The text of a file, UTF-8 with or without a byte order mark. For the arguments see
    :func:`foreign_bytes`.

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is no regular file, too large, or of another encoding.
    """
    content = foreign_bytes(path, largest, links=links)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:  # UTF-16 without a mark decodes, but every other character is a zero
        raise ValueError(f"{str(path)!r} is not UTF-8 text: save it as UTF-8")
    return text


def foreign_json(text: str) -> Any:
    """The data of a JSON text: finite numbers that are floats or fit in :data:`DIGITS` digits, at
    most :data:`DEPTH` levels, and no key twice in an object.

    Raises:
        ValueError: if the text is no such JSON.
    """
    parse = partial(
        json.loads,
        parse_int=_integer,
        parse_float=_finite,
        parse_constant=_finite,
        object_pairs_hook=_object,
    )
    return _parsed("JSON", parse, text)


def foreign_toml(text: str) -> Any:
    """The data of a TOML text of at most :data:`DEPTH` levels.

    Raises:
        ValueError: if the text is no such TOML.
    """
    return _parsed("TOML", tomllib.loads, text)


def _integer(text: str) -> int:
    if len(text) > DIGITS:
        raise ValueError(f"an integer has {len(text)} digits; at most {DIGITS} are valid")
    return int(text)


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:DIGITS]} is not finite")
    return value


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        raise ValueError("an object has a key twice")
    return data


def _parsed(form: str, parse: Callable[[str], Any], text: str) -> Any:
    """The data of a text. The number of levels is counted without a recursion that the data could
    exhaust."""
    too_deep = ValueError(f"{form} with more than {DEPTH} levels")
    try:
        data = parse(text)
    except RecursionError:
        raise too_deep from None
    level = [data]
    for _ in range(DEPTH + 1):
        below: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                below.extend(value.values())
            elif isinstance(value, list):
                below.extend(value)
        if not below:
            return data
        level = below
    raise too_deep


def foreign_object(name: str, data: Any) -> dict[str, Any]:
    """Data that must be an object of JSON, with its name for the message.

    Raises:
        ValueError: if it is anything else.
    """
    if not isinstance(data, dict):
        raise _wrong_type(name, "an object", data)
    return data


def foreign_list(name: str, data: Any) -> list[Any]:
    """Data that must be a list of JSON, with its name for the message.

    Raises:
        ValueError: if it is anything else.
    """
    if not isinstance(data, list):
        raise _wrong_type(name, "a list", data)
    return data


def _wrong_type(name: str, expected: str, data: Any) -> ValueError:
    return ValueError(f"{name} must be {expected}, not {brief(repr(data))}")


def foreign_line(name: str, text: Any, largest: int) -> str:
    """Data that must be a text of one line with something in it.

    Args:
        name: name of the text in the message.
        text: the data.
        largest: largest number of characters.

    Raises:
        ValueError: if it is no text, empty, too long, or has characters that cannot be printed,
            such as those that change the direction of writing.
    """
    if not isinstance(text, str) or not text.strip():
        raise _wrong_type(name, "a text that is not empty", text)
    if len(text) > largest:
        raise ValueError(f"{name} has {len(text):,} characters; at most {largest} are valid")
    if not text.isprintable():
        raise ValueError(f"{name} must be one line of printable characters, not {text!r}")
    return text


def plain_paths(owned: Path, *, count: int, size: int) -> list[Path]:
    """A file, or all files below a folder, sorted.

    Args:
        owned: the file or folder.
        count: largest number of files and folders.
        size: largest size of all files together [bytes].

    Raises:
        OSError: if a folder cannot be read.
        ValueError: if something is neither a regular file nor a folder, or if a limit is exceeded.
    """
    files = []
    waiting = [owned]
    total = 0
    number = 0
    while waiting:
        path = waiting.pop()
        status = path.lstat()
        number += 1
        if number > count:
            raise ValueError(f"{str(owned)!r} has more than {count:,} files and folders")
        if stat.S_ISLNK(status.st_mode):
            raise ValueError(f"{str(path)!r} is a link: an entry has plain files only")
        if stat.S_ISDIR(status.st_mode):
            # one more than the limit suffices to find that it is exceeded
            for _, child in zip(range(count + 1), path.iterdir(), strict=False):
                waiting.append(child)
        elif stat.S_ISREG(status.st_mode):
            files.append(path)
            total += status.st_size
        else:
            raise ValueError(
                f"{str(path)!r} is neither a file nor a folder: an entry has plain files only"
            )
        if total > size:
            raise ValueError(f"{str(owned)!r} has more than {size:,} bytes in all its files")
    return sorted(files)


def brief(text: object) -> str:
    """A text of strangers in one line of printable characters, of bounded length."""
    words = str(text)[: 4 * _MESSAGE]
    line = "".join(character if character.isprintable() else " " for character in words)
    line = " ".join(line.split())
    if len(line) > _MESSAGE:
        return line[: _MESSAGE - 1] + "…"
    return line
