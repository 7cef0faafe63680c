"""Files that people bring: what is no regular file, too large, or of another form is a ValueError."""

from __future__ import annotations

import json
import math
import os
import stat
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

LARGEST_TEXT = 64 << 20
"""Largest size of a text file [bytes]."""

LARGEST_FILE = 1 << 30
"""Largest size of any file [bytes]."""

_SHOWN = 100
"""Number of characters of wrong data that messages repeat."""


def foreign_bytes(path: str | Path, largest: int = LARGEST_FILE) -> bytes:
    """The content of a file. A pipe or a device is refused: reading it could wait forever.

    Args:
        path: the file.
        largest: largest size of the file [bytes].

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is no regular file, or too large.
    """
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):
        raise ValueError(f"{str(path)!r} is no regular file: give one")
    if status.st_size > largest:
        raise ValueError(
            f"{str(path)!r} has {status.st_size:,} bytes; at most {largest:,} are valid"
        )
    return Path(path).read_bytes()


def foreign_text(path: str | Path) -> str:
    """The text of a file, UTF-8 with or without a byte order mark.

    Raises:
        OSError: if the file cannot be read.
        ValueError: if it is no regular file, too large, or of another encoding.
    """
    content = foreign_bytes(path, LARGEST_TEXT)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:  # UTF-16 without a mark decodes, but every other character is a zero
        raise ValueError(f"{str(path)!r} is not UTF-8 text: save it as UTF-8")
    return text


def foreign_json(text: str) -> Any:
    """The data of a JSON text whose numbers are finite.

    Raises:
        ValueError: if the text is no such JSON.
    """
    parse = partial(json.loads, parse_float=_finite, parse_constant=_finite)
    return _parsed("JSON", parse, text)


def foreign_toml(text: str) -> Any:
    """The data of a TOML text.

    Raises:
        ValueError: if the text is no TOML.
    """
    return _parsed("TOML", tomllib.loads, text)


def _parsed(form: str, parse: Callable[[str], Any], text: str) -> Any:
    try:
        return parse(text)
    except RecursionError:
        raise ValueError(f"{form} with too many levels") from None


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"the number {text[:_SHOWN]} is not finite")
    return value


def foreign_object(name: str, data: Any) -> dict[str, Any]:
    """Data that must be an object of JSON, with its name for the message.

    Raises:
        ValueError: if it is anything else.
    """
    if not isinstance(data, dict):
        raise ValueError(f"{name} must be an object, not {repr(data)[:_SHOWN]}")
    return data
