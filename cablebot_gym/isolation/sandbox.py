"""The sandbox of policies of others, made by bubblewrap: an isolated policy without network, files
and processes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from cablebot_gym.policies.sb3 import statistics_beside
from cablebot_gym.policies.spec import POLICY_SUFFIXES
from cablebot_gym.robots import Robot

_NAMESPACES = ("--unshare-all", "--die-with-parent", "--cap-drop", "ALL")
"""New namespaces for users, processes, network and others. The sandbox ends with the process that
started it."""

_SYSTEM = (
    *("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/nix", "/gnu"),
    *("/etc/ld.so.cache", "/etc/alternatives", "/etc/localtime", "/sys/devices/system/cpu"),
)
"""Files of the operating system that the policy can read, if they exist."""


@cache
def sandbox_problem() -> str:
    """Why this machine has no sandbox, as a clause; empty if it has one."""
    program = shutil.which("bwrap")
    if program is None:
        return "bubblewrap is not installed (`apt-get install bubblewrap`; Linux only)"
    bound = ("--ro-bind", "/", "/", "--proc", "/proc", "--dev", "/dev")
    tried = subprocess.run(
        [program, *_NAMESPACES, *bound, "true"], capture_output=True, text=True, errors="replace"
    )
    return f"bubblewrap is not permitted here ({tried.stderr.strip()})" if tried.returncode else ""


def check_sandbox() -> None:
    """Checks that this machine has a sandbox.

    Raises:
        ValueError: if there is none.
    """
    if problem := sandbox_problem():
        raise ValueError(f"there is no sandbox: {problem}")


def prepare_sandbox(robot: Robot) -> None:
    """Checks the sandbox, and compiles here the equations of a robot that the processes of its
    policies call.

    Raises:
        ValueError: if there is no sandbox.
    """
    # numba takes a second, which other commands save
    from cablebot_gym.physics.inverse import inverse_dynamics

    check_sandbox()
    pose = np.zeros(robot.coordinates)
    inverse_dynamics(robot, 1.0, pose, pose, pose)


def sandboxed(
    command: list[str], names: Sequence[str], folder: Path, filter_descriptor: int
) -> list[str]:
    """A command line that runs a command in the sandbox.

    The command has no network, sees no other process, and writes to no folder but ``folder`` and an
    empty home. It reads the operating system, Python, installed packages, compiled code, and the
    files of the policy.

    Args:
        command: the command.
        names: names of the policy and of its wrappers, as on the command line.
        folder: folder for temporary files.
        filter_descriptor: descriptor that the command inherits, with the filter of
            :mod:`cablebot_gym.isolation.system_calls`.

    Raises:
        ValueError: if there is no sandbox.
    """
    from cablebot_gym.physics.code_cache import code_folders  # as above

    check_sandbox()
    home = Path.home()
    working = Path.cwd()
    (folder / "home").mkdir()
    prefixes = {
        Path(prefix).absolute() for prefix in (sys.prefix, sys.exec_prefix, sys.base_prefix)
    }
    # The working directory may be below /usr, as in containers.
    empty = {working: ("--tmpfs", str(working)), home: ("--bind", str(folder / "home"), str(home))}
    options = [
        "bwrap",
        *_NAMESPACES,
        *("--seccomp", str(filter_descriptor)),
        *("--proc", "/proc"),
        # the administrator may write to these files without any capability
        *("--ro-bind", "/proc/sys", "/proc/sys"),
        *("--dev", "/dev"),
        *_readable(map(Path, _SYSTEM)),
    ]
    for path in sorted(empty):  # a folder before those in it
        if not any(Path(system).is_relative_to(path) for system in _SYSTEM):
            options += empty[path]
    options += _readable(
        path for path in sorted(prefixes) if not any(map(path.is_relative_to, _SYSTEM))
    )
    options += _readable(_sources(names, working, prefixes))
    options += _readable(code_folders())
    options += ["--bind", str(folder), str(folder), "--chdir", str(working)]
    if "--tmpfs" in options:
        options += ["--remount-ro", str(working)]
    return [*options, "--remount-ro", "/", "--", *command]


def _readable(paths: Iterable[Path]) -> list[str]:
    options = []
    for path in dict.fromkeys(paths):
        options += ["--ro-bind-try", str(path), str(path)]
    return options


def _sources(names: Sequence[str], working: Path, prefixes: set[Path]) -> Iterator[Path]:
    """Files and folders outside Python's own that the policy can read: those of modules, and its
    own."""
    folders = []
    for name in names:
        path = Path(os.path.abspath(name))
        if path.suffix in (*POLICY_SUFFIXES, ".pkl"):
            yield path
            statistics = statistics_beside(path)
            if statistics is not None:
                yield statistics
        elif path.suffix.partition(":")[0] == ".py":
            folders.append(path.parent)
    for text in sys.path:
        folder = Path(os.path.abspath(text or working))
        if not any(map(folder.is_relative_to, prefixes)):
            folders.append(folder)
    for folder in folders:
        # a .zip of modules; a folder of pip
        if not folder.is_dir() or any(folder.glob("*.dist-info")):
            yield folder
            continue
        # other subfolders may have results, and hidden files passwords
        for path in sorted(folder.iterdir()):
            if not path.name.startswith(".") and (
                path.is_file() or (path / "__init__.py").is_file()
            ):
                yield path
