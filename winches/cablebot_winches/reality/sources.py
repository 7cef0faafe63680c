"""Files of public logs: their addresses and hashes, and how they are found or downloaded. The files
are not part of this project."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from http.client import HTTPException
from importlib.resources import files
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote
from urllib.request import urlopen

from cablebot_gym.utils.console import progress
from cablebot_gym.utils.files import atomic_write, cache_folder, read_cached

TIMEOUT = 30.0
"""Longest time without an answer of the server [s]."""

LARGEST_FILE = 64 << 20
"""Largest size of a file that is downloaded [bytes]."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """Files of a repository on GitHub."""

    repository: str
    """Owner and name."""
    commit: str
    """Full hash of the commit."""
    license: str
    """License of the repository."""
    files: dict[str, str]
    """SHA-256 of each file by its path in the repository."""
    other_commits: dict[str, str] = field(default_factory=dict)
    """Full hash of the commit of files that :attr:`commit` does not have, or not in this
    version."""

    def url(self, path: str) -> str:
        """Address of a file."""
        commit = self.other_commits.get(path, self.commit)
        return f"https://raw.githubusercontent.com/{self.repository}/{commit}/{quote(path)}"


def _sources() -> dict[str, Source]:
    text = (files("cablebot_winches.reality") / "sources.toml").read_text(encoding="utf-8")
    return {name: Source(**data) for name, data in tomllib.loads(text).items()}


SOURCES = _sources()
"""Sources by the name of the study."""


def read_logs(
    source: Source, folder: str | Path | None = None, open_url: Callable[..., Any] = urlopen
) -> dict[str, bytes]:
    """Contents of the files of a source by their paths in the repository.

    Args:
        source: the source.
        folder: folder with the files, below it in any layout; None to download them into the cache.
        open_url: opens an address as :func:`urllib.request.urlopen` does.

    Raises:
        OSError: if a file cannot be read or downloaded.
        ValueError: if the folder does not have a file, or if a file is another version.
    """
    logs = {}
    with progress("reading logs", "files") as step:
        for number, path in enumerate(source.files):
            step(number, len(source.files))
            if folder is None:
                logs[path] = _downloaded(source, path, open_url)
            else:
                logs[path] = _found(source, path, folder)
    return logs


def _found(source: Source, path: str, folder: str | Path) -> bytes:
    """Content of a file below a folder. The hash decides: the names of files of different folders
    are the same, and a copy may have a prefix."""
    name = PurePosixPath(path).name
    others = 0
    for candidate in sorted(Path(folder).rglob(f"*{name}")):
        if candidate.is_file():
            content = candidate.read_bytes()
            if _digest(content) == source.files[path]:
                return content
            others += 1
    problem = f"folder {str(folder)!r} has no file {name}"
    if others:
        problem = f"no file {name} in {str(folder)!r} has the SHA-256 of the version compared here"
    raise ValueError(f"{problem}. Download {source.url(path)}, or leave --logs out")


def _downloaded(source: Source, path: str, open_url: Callable[..., Any]) -> bytes:
    """Content of a file from the cache or from its address."""
    digest = source.files[path]
    url = source.url(path)
    cached = cache_folder() / "logs" / source.repository / source.commit / path
    content = read_cached(cached, partial(_checked, digest=digest))
    if content is not None:
        return content
    try:
        with open_url(url, timeout=TIMEOUT) as response:
            content = response.read(LARGEST_FILE)
    except (OSError, HTTPException) as error:
        raise ConnectionError(
            f"cannot download {url} ({error}). Download the repository elsewhere, and name its "
            "folder with --logs"
        ) from None
    content = _checked(content, digest=digest, name=url)
    atomic_write(cached, lambda temporary: temporary.write_bytes(content))
    return content


def _checked(content: bytes, *, digest: str, name: str = "the file") -> bytes:
    """The content if it has the digest.

    Raises:
        ValueError: if it has another one.
    """
    if _digest(content) != digest:
        raise ValueError(
            f"{name} does not have the expected SHA-256: the download is damaged or the file has "
            "changed; try again, or name a folder with the right version with --logs"
        )
    return content


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
