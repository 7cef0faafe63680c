"""Which code made a result: a hash of the modules that it depends on, comments and docstrings aside."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import re
from functools import cache
from pathlib import Path

_NAMED = re.compile(r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$")
"""``package.module:attribute``, by which Gymnasium and entry points name what they load."""


@cache
def source_hash(*modules: str, data: tuple[Path, ...] = ()) -> str:
    """Of modules, of what they import from their own packages and from this one, and of data files.

    A module of no package imports from its own folder, unless it is installed among many others.

    A result is of the same code if these hashes agree. Neither comments nor docstrings nor other modules change them.

    Args:
        modules: names such as ``cablebot_gym.evaluation.evaluator``.
        data: files whose content matters, such as weights.
    """
    packages = frozenset({"cablebot_gym", *(name.partition(".")[0] for name in modules)})
    folders = frozenset(path.parent for name in modules if (path := module_file(name)) is not None and "." not in name)
    files: dict[str, Path] = {}
    open_ = list(modules)
    while open_:
        name = open_.pop()
        path = module_file(name)
        if name in files or path is None:
            continue
        if name.partition(".")[0] not in packages and not _beside(name, folders):
            continue
        files[name] = path
        parent = name.rpartition(".")[0]
        open_ += [*_meaning(path, name)[1], *([parent] if parent else [])]
    digest = hashlib.sha256()
    for name in sorted(files):
        digest.update(f"{name}\n{_meaning(files[name], name)[0]}\n".encode())
    for path in sorted(data):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _beside(module: str, folders: frozenset[Path]) -> bool:
    """Whether a module, or the package that it is of, lies in one of these folders."""
    path = module_file(module.partition(".")[0])
    if path is None:
        return False
    there = path.parent.parent if path.name == "__init__.py" else path.parent
    return there in folders and there.name not in ("site-packages", "dist-packages")


@cache
def module_file(module: str) -> Path | None:
    """Where a module is written, without importing it; None if it has no source."""
    top, *rest = module.split(".")
    try:
        spec = importlib.util.find_spec(top)
    except (ImportError, ValueError):
        return None
    if spec is None:
        return None
    if not spec.submodule_search_locations:
        return Path(spec.origin) if not rest and spec.origin and spec.origin.endswith(".py") else None
    for root in spec.submodule_search_locations:
        stem = Path(root, *rest)
        for path in (stem / "__init__.py", stem.with_suffix(".py")):
            if path.is_file():
                return path
    return None


@cache
def _meaning(path: Path, module: str) -> tuple[str, frozenset[str]]:
    """What a module says without comments and docstrings, and the names that it may import."""
    tree = ast.parse(path.read_bytes())
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            names |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and _NAMED.match(node.value):
            names.add(node.value.partition(":")[0])
    return ast.dump(_Bare().visit(tree)), frozenset(names)


class _Bare(ast.NodeTransformer):
    """Takes out the strings that stand alone: docstrings, of attributes too."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        """Nothing in place of a string."""
        return None if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str) else node
