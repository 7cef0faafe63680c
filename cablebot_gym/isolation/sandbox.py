"""The sandbox of policies of others, made by bubblewrap: an isolated policy without network, files and processes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from cablebot_gym.policies.entry import CARD, PACKAGES, POLICY, is_entry
from cablebot_gym.policies.sb3 import statistics_beside
from cablebot_gym.robots import Robot

_NAMESPACES = ("--unshare-all", "--die-with-parent", "--cap-drop", "ALL")
"""New namespaces for users, processes, network and others. The sandbox ends with the process that started it."""

_SYSTEM = (
    *("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/nix", "/gnu"),
    *("/etc/ld.so.cache", "/etc/alternatives", "/etc/localtime", "/sys/devices/system/cpu"),
)
"""Files of the operating system that the policy can read, if they exist."""

_OPT_OUT = "CABLEBOT_SANDBOX"
"""Environment variable; ``off`` runs entries without a sandbox, in worker processes too."""


@cache
def sandbox_problem() -> str:
    """Why this machine has no sandbox, as a clause; empty if it has one."""
    program = shutil.which("bwrap")
    if program is None:
        return "bubblewrap is not installed (`apt-get install bubblewrap`; Linux only)"
    bound = ("--ro-bind", "/", "/", "--proc", "/proc", "--dev", "/dev")
    tried = subprocess.run([program, *_NAMESPACES, *bound, "true"], capture_output=True, text=True, errors="replace")
    return f"bubblewrap is not permitted here ({tried.stderr.strip()})" if tried.returncode else ""


def sandbox_name() -> str | None:
    """Name and version of the sandbox in which entries run; None if they run without one."""
    if opted_out():
        return None
    return subprocess.run(["bwrap", "--version"], capture_output=True, text=True, check=True).stdout.strip()


def check_sandbox() -> None:
    """Checks that this machine has a sandbox.

    Raises:
        ValueError: if there is none.
    """
    if problem := sandbox_problem():
        raise ValueError(f"there is no sandbox: {problem}")


def prepare_sandbox(robot: Robot) -> None:
    """Checks the sandbox, and compiles here the equations of a robot that the processes of its policies call.

    Raises:
        ValueError: if there is no sandbox.
    """
    from cablebot_gym.physics.inverse import inverse_dynamics  # numba takes a second, which other commands save

    check_sandbox()
    pose = np.zeros(robot.coordinates)
    inverse_dynamics(robot, 1.0, pose, pose, pose)


def opt_out() -> None:
    """Entries of this process and of its workers run without a sandbox."""
    os.environ[_OPT_OUT] = "off"


def opted_out() -> bool:
    """Whether entries run without a sandbox."""
    return os.environ.get(_OPT_OUT) == "off"


def sandboxed(command: list[str], specs: Sequence[str], folder: Path) -> list[str]:
    """A command line that runs a command in the sandbox.

    The command has no network, sees no other process, and writes to no folder but ``folder`` and an empty home. It
    reads the operating system, Python, installed packages, compiled code, and the files of the policy.

    Args:
        command: the command.
        specs: names of the policy and of its wrappers, as on the command line.
        folder: folder for temporary files.

    Raises:
        ValueError: if there is no sandbox.
    """
    from cablebot_gym.physics.code_cache import code_folders  # as above

    check_sandbox()
    home, working = Path.home(), Path.cwd()
    (folder / "home").mkdir()
    prefixes = {Path(prefix).absolute() for prefix in (sys.prefix, sys.exec_prefix, sys.base_prefix)}
    options = ["bwrap", *_NAMESPACES, "--proc", "/proc", "--dev", "/dev"]
    # The working directory may be below /usr, as in containers.
    options += _readable(map(Path, _SYSTEM))
    empty = {working: ["--tmpfs", str(working)], home: ["--bind", str(folder / "home"), str(home)]}
    empty = {path: words for path, words in empty.items() if not any(Path(one).is_relative_to(path) for one in _SYSTEM)}
    options += [word for path in sorted(empty) for word in empty[path]]  # a folder before those in it
    options += _readable(path for path in sorted(prefixes) if not any(path.is_relative_to(one) for one in _SYSTEM))
    options += _readable(_sources(specs, working, prefixes))
    options += _readable(code_folders())
    options += ["--bind", str(folder), str(folder), "--chdir", str(working)]
    options += ["--remount-ro", str(working)] if working in empty and working != home else []
    return [*options, "--remount-ro", "/", "--", *command]


def _readable(paths: Iterable[Path]) -> list[str]:
    return [word for path in dict.fromkeys(paths) for word in ("--ro-bind-try", str(path), str(path))]


def _sources(specs: Sequence[str], working: Path, prefixes: set[Path]) -> Iterator[Path]:
    """Files and folders outside Python's own that the policy can read: those of modules, and its own."""
    entry, folders = is_entry(specs[0]), []
    for spec in specs:
        path = Path(os.path.abspath(spec))
        if is_entry(spec):
            yield from (path / name for name in (CARD, POLICY, PACKAGES))
        elif path.suffix in (".zip", ".pkl"):
            yield from (one for one in (path, statistics_beside(path)) if one is not None)
        elif path.suffix.partition(":")[0] == ".py":
            folders.append(path.parent)
    for text in sys.path:
        folder = Path(os.path.abspath(text or working))
        if not (entry and folder == working) and not any(folder.is_relative_to(prefix) for prefix in prefixes):
            folders.append(folder)
    for folder in folders:
        if not folder.is_dir() or any(folder.glob("*.dist-info")):  # a .zip of modules; a folder of pip
            yield folder
        else:  # other subfolders may have results, and hidden files passwords
            found = (one for one in sorted(folder.iterdir()) if one.is_file() or (one / "__init__.py").is_file())
            yield from (one for one in found if not one.name.startswith("."))
