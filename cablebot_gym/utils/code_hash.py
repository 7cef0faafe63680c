"""Hash of the code that produced a result: the modules that it depends on, without comments and
docstrings."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

_NAMED = re.compile(r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$")
"""Matches ``package.module:attribute``, the notation of Gymnasium and of entry points."""


@cache
def source_hash(*modules: str, data: tuple[Path, ...] = (), without: tuple[str, ...] = ()) -> str:
    """Hash of modules, of their imports from their own packages and from ``cablebot_gym``, and of
    data files.

    For a module outside a package, imports from its folder count too, unless the folder is
    ``site-packages``. Two results come from the same code if their hashes are equal. Comments,
    docstrings and other modules have no effect.

    Args:
        modules: module names, such as ``cablebot_gym.evaluation.evaluator``, or names in modules,
            ``package.module:name``.
        data: data files that affect the result, such as weights.
        without: packages whose modules have no effect on the result.
    """
    files = source_files(*modules, without=without)
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(f"{name}\n{_parsed(files[name], name).tree}\n".encode())
    for path in sorted(data):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def source_files(*modules: str, without: tuple[str, ...] = ()) -> dict[str, Path]:
    """Files by name of the modules, of their imports from their own packages and from
    ``cablebot_gym``, except for the packages ``without``.

    A name that a package only imports, ``from package import name``, counts as the module that it
    comes from, so that the other modules of the package have no effect.
    """
    packages = {"cablebot_gym"}
    folders = set()
    for name in modules:
        module = name.partition(":")[0]
        packages.add(module.partition(".")[0])
        path = module_file(module)
        if path is not None and "." not in module:
            folders.add(path.parent)
    files: dict[str, Path] = {}
    pending = [_defining_module(*_split(name)) for name in modules]
    while pending:
        name = pending.pop()
        path = module_file(name)
        if name in files or path is None or name.startswith(without):
            continue
        if name.partition(".")[0] not in packages and not _in_folders(name, folders):
            continue
        files[name] = path
        for base, imported in _parsed(path, name).imports:
            pending.append(_defining_module(base, imported))
    return files


def _split(name: str) -> tuple[str, str]:
    """Module and name in it of ``package.module:name``; the name is empty for a module."""
    module, _, attribute = name.partition(":")
    return module, attribute


def _defining_module(module: str, name: str) -> str:
    """The module that defines a name of a module, or that is this name."""
    if not name:
        return module
    if module_file(f"{module}.{name}") is not None:
        return f"{module}.{name}"
    path = module_file(module)
    if path is not None and path.name == "__init__.py":
        origin = _parsed(path, module).origins.get(name)
        if origin is not None:
            return _defining_module(*origin)
    return module


def _in_folders(module: str, folders: set[Path]) -> bool:
    """Whether a module or its top-level package is in one of these folders."""
    path = module_file(module.partition(".")[0])
    if path is None:
        return False
    folder = path.parent
    if path.name == "__init__.py":
        folder = folder.parent
    return folder in folders and folder.name not in ("site-packages", "dist-packages")


@cache
def module_file(module: str) -> Path | None:
    """Source file of a module, found without importing it; None if it has no source."""
    top, *submodules = module.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None:
        return None
    if not spec.submodule_search_locations:
        if submodules or spec.origin is None or not spec.origin.endswith(".py"):
            return None
        return Path(spec.origin)
    for root in spec.submodule_search_locations:
        stem = Path(root, *submodules)
        for path in (stem / "__init__.py", stem.with_suffix(".py")):
            if path.is_file():
                return path
    return None


class _Parsed(NamedTuple):
    tree: str
    """Syntax tree of a module without comments and docstrings."""
    imports: frozenset[tuple[str, str]]
    """Modules that it may import, each with the name from it, which is empty for the whole
    module."""
    origins: dict[str, tuple[str, str]]
    """Module and name there, by the name that it has here."""


@cache
def _parsed(path: Path, module: str) -> _Parsed:
    tree = ast.parse(path.read_bytes())
    package = module.split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    imports: set[tuple[str, str]] = set()
    origins: dict[str, tuple[str, str]] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports |= {(alias.name, "") for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package[: len(package) - node.level + 1]
                base = ".".join([*above, base]).rstrip(".")
            for alias in node.names:
                imports.add((base, alias.name))
                origins[alias.asname or alias.name] = base, alias.name
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and _NAMED.match(node.value)
        ):
            imports.add(_split(node.value))
    text = ast.dump(_DocstringRemover().visit(tree))
    return _Parsed(text, frozenset(imports), origins)


class _DocstringRemover(ast.NodeTransformer):
    """Removes string expression statements: docstrings, including those of attributes."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        """Drops the statement if it is a string."""
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return None
        return node
