"""The modules and data files of a policy, from which its code hash is computed."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

from cablebot_gym.policies import ENTRY_POINT_GROUP, FILE_ENTRY_POINT_GROUP, policy_entries
from cablebot_gym.utils.code_hash import module_file


@cache
def policy_source(policy: str) -> tuple[tuple[str, ...], tuple[Path, ...]]:
    """Modules and data files of a policy, given its name as on the command line.

    For a policy file, these are the modules of all installed loaders and the file itself.
    """
    if policy.endswith(".zip"):
        loaders = entry_points(group=FILE_ENTRY_POINT_GROUP)
        return tuple(sorted({point.module for point in loaders})), (Path(policy),)
    module = policy.partition(":")[0] if ":" in policy else ""
    for point in entry_points(group=ENTRY_POINT_GROUP, name=policy):
        module = point.module
    if not module:
        return (), ()
    entry = policy_entries().get(policy)
    if entry is not None and entry.files is not None:
        return (module,), entry.files
    path = module_file(module)
    folder = path.parent if path is not None and "." in module else None
    return (module,), _data_files(folder) if folder is not None else ()


@cache
def _data_files(folder: Path) -> tuple[Path, ...]:
    """All files in the folder of a package, such as weights, except for its Python files."""
    paths = (path for path in folder.rglob("*") if path.is_file() and "__pycache__" not in path.parts)
    return tuple(sorted(path for path in paths if path.suffix not in {".py", ".pyc"}))
