"""Result files: a folder is tried before the work, and a file appears whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path


def usable_folder(folder: Path) -> None:
    """Finds out whether files can be written to a folder, or the folder be made; leaves nothing behind.

    Raises:
        ValueError: if not.
    """
    there = folder.absolute()
    while not there.exists() and there != there.parent:
        there = there.parent
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise ValueError(
            f"cannot write to folder {str(folder)!r}: {error.strerror or error}; choose another"
        ) from error


def usable_file(path: Path) -> None:
    """Finds out whether a file can be written; leaves nothing behind.

    Raises:
        ValueError: if its folder cannot be written to, or it is a folder itself.
    """
    usable_folder(path.parent)
    if path.is_dir():
        raise ValueError(f"cannot write {str(path)!r}: it is a folder; choose another name")


def write_whole(path: Path, write: Callable[[Path], None]) -> None:
    """Lets ``write`` fill a temporary file beside ``path`` and moves it there when it is complete.

    The folder is made if need be. An interrupt or an error leaves what was at ``path`` before. The temporary name keeps
    the suffix, by which some writers choose their format.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
    os.close(handle)
    temporary = Path(name)
    try:
        write(temporary)
        os.chmod(temporary, 0o666 & ~_umask())  # as an ordinary new file; temporary ones are private
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_text_whole(path: Path, text: str) -> None:
    """Writes ``text`` to ``path`` as :func:`write_whole` does, in UTF-8."""

    def write(temporary: Path) -> None:
        temporary.write_text(text, encoding="utf-8")

    write_whole(path, write)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
