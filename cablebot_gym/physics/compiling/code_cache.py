"""Compiled code on disk: one checked file for each function, form, signature and processor.

Numba's own cache stops every command where no folder is writable or a file is damaged, and it
misses changes of helpers in other files. Here a damaged file counts as absent, folders that are
only readable are read, and the name of a file is a hash of the source files that the code depends
on. Paths and file times have no effect, so copies of an installation share compiled code.
"""

from __future__ import annotations

import hashlib
import logging
import os
import pickle
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numba
from numba.core import config
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from cablebot_gym.utils.files import atomic_write, cache_folder, is_writable_dir, read_cached

PACKAGE = "cablebot_gym"

SHARED_CODE = "CABLEBOT_SHARED_CODE"
"""Environment variable with folders that compiled code is read from. New code is then written to the
cache folder only."""

REMEDY = "set NUMBA_CACHE_DIR to a writable folder"
"""Advice where compiled code cannot be stored."""

_DECORATORS = sorted(map(str, Path(__file__).parent.glob("*.py")))
"""Compiled code depends on these files, although no compiled function calls anything in them."""

_DIGEST = hashlib.sha256().digest_size

_LOGGER = logging.getLogger(PACKAGE)


class CodeCache(_Cache):
    """Compiled code of a function, in the interface by which numba's dispatchers use a cache."""

    def __init__(self, function: Any) -> None:
        self._function = function

    @property
    def cache_path(self) -> str:
        """Folder to which compiled code is written, or the last one that is read if none is
        writable."""
        return str(code_folders()[-1])

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Compiled code of a signature; None if there is none."""
        target_context.refresh()

        def rebuild(data: bytes) -> Any:
            return CompileResult._rebuild(target_context, *pickle.loads(_checked(data)))

        name = self._file_name(sig, target_context.codegen())
        for folder in code_folders():
            compiled = read_cached(folder / name, rebuild)
            if compiled is not None:
                return compiled
        _say_once(
            "compiling for this machine, once for each kind of robot: usually a few seconds each …"
        )
        return None

    def is_stored(self, sig: Any, target_context: Any) -> bool:
        """Whether a folder has a file for a signature. It is read, and checked, by the first
        call."""
        name = self._file_name(sig, target_context.codegen())
        return any((folder / name).exists() for folder in code_folders())

    def save_overload(self, sig: Any, data: Any) -> None:
        """Stores the compiled code of a signature, if a folder is writable."""
        content = dumps(data._reduce())
        path = code_folders()[-1] / self._file_name(sig, data.codegen)
        try:
            atomic_write(
                path,
                lambda temporary: temporary.write_bytes(hashlib.sha256(content).digest() + content),
            )
        except OSError as error:
            _say_once(
                f"cannot store compiled code in {path.parent} ({error.strerror or error}): {REMEDY}"
            )

    def enable(self) -> None:
        """Has no effect: stored code is read always."""

    def disable(self) -> None:
        """Has no effect, as :meth:`enable`."""

    def flush(self) -> None:
        """Has no effect: the files of other code have other names."""

    def _file_name(self, signature: Any, codegen: Any) -> str:
        key = [*_identity(self._function, set()), str(signature), str(codegen.magic_tuple())]
        key += [numba.__version__, str(sys.implementation.cache_tag)]
        key += map(_file_hash, _DECORATORS)
        module = self._function.__module__.rpartition(".")[2]
        return f"{module}.{self._function.__name__}-{hashlib.sha256(repr(key).encode()).hexdigest()[:24]}.nbc"


def code_folders() -> list[Path]:
    """Folders that compiled code is read from. It is written to the last one."""
    shared = os.environ.get(SHARED_CODE)
    if shared:
        return [*map(Path, shared.split(os.pathsep)), cache_folder() / "compiled"]
    named = str(config.CACHE_DIR)
    return list(_folders(named, cache_folder()))


@cache
def _folders(named: str, user_cache: Path) -> tuple[Path, ...]:
    """The candidates up to the first writable one."""
    candidates = [Path(named, PACKAGE)] if named else []
    candidates += [Path(__file__).parents[2] / "__pycache__", user_cache / "compiled"]
    for number, folder in enumerate(candidates, 1):
        if is_writable_dir(folder):
            return tuple(candidates[:number])
    return tuple(candidates)


def _checked(data: bytes) -> bytes:
    """The content of a file without its checksum.

    Raises:
        ValueError: if the file is truncated or changed.
    """
    digest = data[:_DIGEST]
    content = data[_DIGEST:]
    if hashlib.sha256(content).digest() != digest:
        raise ValueError("its checksum is wrong")
    return content


@cache
def _say_once(message: str) -> None:
    _LOGGER.warning(message)


def _identity(value: Any, seen: set[Any]) -> Iterator[str]:
    """What compiled code depends on: source files of functions that can call each other, and
    constants they use.

    Args:
        value: function, or an object that a function closes over or reads from its module.
        seen: functions that have been described.
    """
    function = getattr(value, "py_func", value)
    if isinstance(function, FunctionType):
        if function in seen:
            return
        seen.add(function)
        code = function.__code__
        yield f"{function.__qualname__}:{code.co_firstlineno} {_file_hash(code.co_filename)}"
        for cell in function.__closure__ or ():
            yield from _identity(cell.cell_contents, seen)
        for name in code.co_names:
            if name in function.__globals__:
                yield from _identity(function.__globals__[name], seen)
    elif isinstance(value, tuple):
        for item in value:
            yield from _identity(item, seen)
    elif value is None or isinstance(value, bool | int | float | str):
        yield repr(value)
    else:  # a module, a record, or an intrinsic
        name = (
            value.__name__
            if isinstance(value, ModuleType)
            else str(getattr(value, "__module__", ""))
        )
        if name.partition(".")[0] == PACKAGE:
            yield _file_hash(str(sys.modules[name].__file__))


@cache
def _file_hash(path: str) -> str:
    """Hash of a source file; empty if there is no file, as for functions of a notebook."""
    try:
        return hashlib.sha256(Path(path).read_bytes()).hexdigest()
    except OSError:
        return ""
