"""Objects that users name as ``package.module:name`` or ``file.py:name``."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from pathlib import Path
from typing import Any

MOST_NAMES = 10
"""Largest number of names of a module in a message."""


def import_object(text: str) -> Any:
    """The object that ``package.module:name`` or ``folder/file.py:name`` names.

    Raises:
        ValueError: if there is no such file or name; the message lists names of the module.
        BaseException: whatever the code of the module raises.
    """
    module_name, attribute = split_name(text)
    module = importlib.import_module(module_name)
    if not hasattr(module, attribute):
        names = []
        for name, value in vars(module).items():
            if getattr(value, "__module__", "") == module_name and not name.startswith("_"):
                names.append(name)
        message = f"module {module_name!r} has no attribute {attribute!r}"
        if names:
            message += f"; it has {', '.join(names[:MOST_NAMES])}"
        raise ValueError(message)
    return getattr(module, attribute)


def split_name(text: str) -> tuple[str, str]:
    """Module and name of an object. The folder of a ``file.py`` is added to ``sys.path``, so
    workers find it too.

    Raises:
        ValueError: if the name is missing, the file does not exist, or another module hides it.
    """
    if text.endswith(".py"):
        raise ValueError(f"{text!r} needs the name of an object in this file: {text}:NAME")
    source, _, attribute = text.rpartition(":")
    if not source.endswith(".py"):
        return source, attribute
    path = Path(source).absolute()
    if not path.is_file():
        raise ValueError(f"file {source!r} does not exist")
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
        importlib.invalidate_caches()
    spec = importlib.util.find_spec(path.stem)
    if spec is None or spec.origin is None or not path.samefile(spec.origin):
        raise ValueError(f"another module is named {path.stem!r}: rename {source!r}")
    return path.stem, attribute
