"""The view of a sandboxed policy. tests/attacks shows that the sandbox keeps it."""

import subprocess
import sys
from pathlib import Path

import pytest

import cablebot_gym
from cablebot_gym.isolation import IsolatedPolicy, sandbox
from cablebot_gym.isolation.system_calls import filter_descriptor
from cablebot_gym.physics.code_cache import code_folders
from cablebot_gym.robots import PLANAR


@pytest.fixture
def view(tmp_path, monkeypatch):
    """Returns the paths that a policy sees, by whether it can write to them; its working directory
    has results."""
    monkeypatch.setattr(sandbox, "check_sandbox", lambda: None)
    for name in (
        "work/results/run.json",
        "work/mine.py",
        "work/.env",
        "work/pack/__init__.py",
        "work/entries/law/results.json",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    (tmp_path / "work/entries/law/entry.json").write_text("{}")
    monkeypatch.chdir(tmp_path / "work")
    monkeypatch.setattr(sys, "path", [*sys.path, ""])

    def seen(spec):
        private = tmp_path / spec.replace("/", "-")
        private.mkdir()
        command = sandbox.sandboxed(["true"], [spec], private, 9)
        assert command[-2:] == ["--", "true"]
        bound = list(zip(command, command[1:], command[2:], strict=False))
        read = {Path(to) for option, _, to in bound if option == "--ro-bind-try"}
        written = {Path(to) for option, _, to in bound if option == "--bind"}
        return read, written, private

    return seen


def test_policy_sees_only_modules_of_the_working_directory(view, tmp_path):
    read, written, private = view("mine:make")
    assert {one.name for one in read if one.is_relative_to(tmp_path)} == {"mine.py", "pack"}
    assert Path(cablebot_gym.__file__).parent in read or Path(sys.prefix) in read
    assert Path.home() not in read
    assert written == {private, Path.home()}
    assert set(code_folders()) <= read


def test_missing_bubblewrap_is_named_with_its_install_command(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setattr(sandbox, "sandbox_problem", sandbox.sandbox_problem.__wrapped__)
    with pytest.raises(
        ValueError, match=r"there is no sandbox: bubblewrap is not installed .*apt-get install"
    ):
        IsolatedPolicy("fl", PLANAR, sandbox=True)


def test_machine_that_forbids_namespaces_says_so(monkeypatch):
    denied = subprocess.CompletedProcess(
        [], 1, "", "bwrap: setting up uid map: Permission denied\n"
    )
    monkeypatch.setattr("shutil.which", lambda name: name)
    monkeypatch.setattr("subprocess.run", lambda *_, **__: denied)
    assert sandbox.sandbox_problem.__wrapped__() == (
        "bubblewrap is not permitted here (bwrap: setting up uid map: Permission denied)"
    )


PROBES = {
    "a key in the keyring of its session": """
import ctypes, platform
first = {"x86_64": 248, "aarch64": 217}[platform.machine()]
call = ctypes.CDLL(None).syscall
call(first, b"user", b"cablebot-probe", b"1", 1, ctypes.c_long(-3))
left = call(first + 2, 10, ctypes.c_long(-3), b"user", b"cablebot-probe", 0) > 0
""",
    "the time of a device file": """
import os
devices = ["/dev/null", "/dev/zero", "/dev/full", "/dev/random", "/dev/urandom", "/dev/tty"]
before = [os.stat(device).st_mtime_ns for device in devices]
for device in devices:
    os.utime(device)
left = [os.stat(device).st_mtime_ns for device in devices] != before
""",
    "a setting of the kernel": """
import os, pathlib
paths = [path for path in pathlib.Path("/proc/sys").rglob("*") if path.is_file()]
assert paths
left = any(os.access(path, os.W_OK) for path in paths)
""",
}


@pytest.mark.skipif(sandbox.sandbox_problem() != "", reason=sandbox.sandbox_problem())
@pytest.mark.parametrize("what", PROBES)
def test_files_are_the_only_traces_of_a_sandboxed_process(what, tmp_path):
    with filter_descriptor() as descriptor:
        command = [sys.executable, "-I", "-c", PROBES[what] + "print(left)"]
        sandboxed_command = sandbox.sandboxed(command, ["fl"], tmp_path, descriptor)
        output = subprocess.run(
            sandboxed_command, pass_fds=(descriptor,), capture_output=True, text=True
        )
    assert (output.stdout, output.stderr) == ("False\n", "")
