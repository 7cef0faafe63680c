"""Hash of the code that produced a result: the modules that it depends on, without comments and
docstrings."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import re
from functools import cache
from pathlib import Path

_NAMED = re.compile(r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$")
"""Matches ``package.module:attribute``, the notation of Gymnasium and of entry points."""


@cache
def source_hash(*modules: str, data: tuple[Path, ...] = ()) -> str:
    """Hash of modules, of their imports from their own packages and from ``cablebot_gym``, and of
    data files.

    For a module outside a package, imports from its folder count too, unless the folder is
    ``site-packages``. Two results come from the same code if their hashes are equal. Comments,
    docstrings and other modules have no effect.

    Args:
        modules: module names, such as ``cablebot_gym.evaluation.evaluator``.
        data: data files that affect the result, such as weights.
    """
    files = source_files(*modules)
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(f"{name}\n{_parsed(files[name], name)[0]}\n".encode())
    for path in sorted(data):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def source_files(*modules: str) -> dict[str, Path]:
    """Files by name of the modules, of their imports from their own packages and from
    ``cablebot_gym``."""
    packages = {"cablebot_gym"}
    folders = set()
    for name in modules:
        packages.add(name.partition(".")[0])
        path = module_file(name)
        if path is not None and "." not in name:
            folders.add(path.parent)
    files: dict[str, Path] = {}
    pending = list(modules)
    while pending:
        name = pending.pop()
        path = module_file(name)
        if name in files or path is None:
            continue
        if name.partition(".")[0] not in packages and not _in_folders(name, folders):
            continue
        files[name] = path
        pending += _parsed(path, name)[1]
        # Importing a module runs the __init__ of its packages.
        if "." in name:
            pending.append(name.rpartition(".")[0])
    return files


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


@cache
def _parsed(path: Path, module: str) -> tuple[str, frozenset[str]]:
    """Syntax tree of a module without comments and docstrings, and the names of modules that it may
    import."""
    tree = ast.parse(path.read_bytes())
    package = module.split(".")
    if path.name != "__init__.py":
        package = package[:-1]
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                above = package[: len(package) - node.level + 1]
                base = ".".join([*above, base]).rstrip(".")
            names.add(base)
            names |= {f"{base}.{alias.name}" for alias in node.names}
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and _NAMED.match(node.value)
        ):
            names.add(node.value.partition(":")[0])
    return ast.dump(_DocstringRemover().visit(tree)), frozenset(names)


class _DocstringRemover(ast.NodeTransformer):
    """Removes string expression statements: docstrings, including those of attributes."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        """Drops the statement if it is a string."""
        if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            return None
        return node
