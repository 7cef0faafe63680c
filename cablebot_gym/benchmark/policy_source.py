"""The modules and data files of a policy, from which its code hash is computed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from cablebot_gym.policies import FILE_ENTRY_POINT_GROUP, PolicyEntry, PolicySpec
from cablebot_gym.utils.code_hash import module_file
from cablebot_gym.utils.imports import split_name


@cache
def shipped_entry(name: str) -> PolicyEntry | None:
    """The entry of a policy of this project, also behind estimators of this project; None for all
    others, because no code of other packages runs in this process."""
    spec = PolicySpec.parse(name)
    if not spec.shipped:
        return None
    # the first entry point is that of this project: another package can use the same name
    return replace(spec, points=spec.points[:1]).entry()


@cache
def policy_source(policy: str) -> tuple[tuple[str, ...], tuple[Path, ...]]:
    """Names in modules, ``module:name``, and data files of a policy, given its name as on the command
    line.

    For a policy file, these are the modules of all installed loaders, and the file itself. Of
    a module outside a package, the data files are those next to it with a suffix or a
    name that its source contains, such as ``.npz``.
    """
    spec = PolicySpec.parse(policy)
    if spec.estimators:
        modules, files = policy_source(spec.target)
        return (*(estimator.value for estimator in spec.estimators), *modules), files
    if spec.kind == "unknown":
        return (), ()
    if spec.kind == "file":
        loaders = {point.value for point in entry_points(group=FILE_ENTRY_POINT_GROUP)}
        return tuple(sorted(loaders)), (Path(policy),)
    if spec.kind == "factory":
        module, name = split_name(policy)
    else:
        module = spec.points[0].module
        name = spec.points[0].attr
        entry = shipped_entry(policy)
        if entry is not None and entry.files is not None:
            return (f"{module}:{name}",), entry.files
    source = module_file(module)
    files = () if source is None else _data_files(source, _in_package(module))
    return (f"{module}:{name}",), files


def _in_package(module: str) -> bool:
    """Whether a module has the folder of its file for itself and for other modules of its
    package."""
    path = module_file(module)
    return path is not None and ("." in module or path.name == "__init__.py")


@cache
def _data_files(module: Path, package: bool) -> tuple[Path, ...]:
    """Files in the folder of a module, such as weights, except for its Python files."""
    paths = (path for path in module.parent.glob("**/*" if package else "*") if path.is_file())
    found = [
        path
        for path in paths
        if "__pycache__" not in path.parts and path.suffix not in {".py", ".pyc"}
    ]
    if not package:  # the folder has other files too, and some of them change during a run
        text = module.read_text(encoding="utf-8", errors="replace")
        found = [path for path in found if (path.suffix or path.name) in text]
    return tuple(sorted(found))
