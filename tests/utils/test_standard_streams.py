"""Standard streams of all kinds: a command ends without a traceback, and its results are not
lost."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

RUN = r"""
import io, json, os, sys, traceback
from pathlib import Path
import typer
from cablebot_gym.cli import app as cli, listing
from cablebot_gym.cli import doctor, dlcc, robot

@cli.app.command(name="toy")
def toy():
    "Prints more than a pipe holds, and then writes a file."
    print("1.911 kg \u2013 paper\n" * 10_000)
    Path("result.json").write_text("{}")

def redirect(stream):
    '''Sets the streams as a shell and the start of Python would.'''
    null = os.open(os.devnull, os.O_RDWR)
    kind, _, encoding = stream.partition(" ")
    if "full" in kind:
        os.dup2(os.open("/dev/full", os.O_WRONLY), 2 if "error" in kind else 1)
    if kind == "reader-gone":
        reader, writer = os.pipe()
        os.close(reader)
        os.dup2(writer, 1)
    for number, name in ((0, "stdin"), (1, "stdout"), (2, "stderr")):
        if kind == f"closed-{name}" or kind == "all-closed":
            os.close(number)
            setattr(sys, name, None)
            setattr(sys, f"__{name}__", None)
    if kind == "encoding":
        sys.stdout.reconfigure(encoding=encoding, errors="strict")
    if kind == "narrow":
        os.environ["COLUMNS"] = "1"
    if kind == "dumb":
        os.environ["TERM"] = "dumb"

def run(folder, stream, command):
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    folder.mkdir(parents=True)
    os.chdir(folder)
    for number, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT), number)
    status = 1
    try:
        redirect(stream)
        sys.argv = ["cablebot", *command.split()]
        cli.main()
    except SystemExit as ended:
        status = ended.code or 0
    except BaseException:
        with open(folder / "traceback", "w") as file:
            traceback.print_exc(file=file)
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(status)

root, cases = Path(sys.argv[1]), json.loads(sys.argv[2])
cli.atexit.register = lambda function: None
os.chdir(root)
sys.stdout, sys.stderr = io.StringIO(), io.StringIO()
for command in {command for _, command in cases}:  # loads what the forks would load
    sys.argv = ["cablebot", *command.split()]
    try:
        cli.main()
    except SystemExit:
        pass
sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__
print(json.dumps([run(root / str(number), *case) for number, case in enumerate(cases)]))
"""
"""Runs commands in forks of one process, because a start takes a second."""

CASES = {
    "toy": (
        *("full", "full-error", "reader-gone", "closed-stdin", "closed-stdout", "closed-stderr"),
        *("all-closed", "encoding ascii", "encoding cp1252", "encoding utf-16", "narrow", "dumb"),
    ),
    "dlcc nosuch": ("full-error", "closed-stderr", "encoding ascii"),
    "list": (
        *("full", "closed-stdout", "all-closed", "encoding utf-16", "encoding ascii", "narrow"),
    ),
    "dlcc --help": ("encoding ascii", "narrow"),
}
"""Streams by command."""


@pytest.mark.landing
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="/dev/full of Linux")
def test_no_stream_ends_a_command(tmp_path):
    cases = [(stream, command) for command, streams in CASES.items() for stream in streams]
    command = [sys.executable, "-c", RUN, str(tmp_path), json.dumps(cases)]
    statuses = json.loads(
        subprocess.run(command, capture_output=True, text=True, check=True).stdout
    )
    for number, ((stream, typed), status) in enumerate(zip(cases, statuses, strict=True)):
        folder = tmp_path / str(number)
        case = f"{typed!r} with {stream}"
        out = (folder / "out").read_bytes()
        err = (folder / "err").read_bytes()
        assert not (folder / "traceback").exists(), (folder / "traceback").read_text()
        assert b"Traceback" not in out + err, case
        assert b"Exception ignored" not in err, case
        expected = 2 if typed == "dlcc nosuch" else 0
        is_lost = stream == "full" and expected == 0
        assert status == (1 if is_lost else expected), (case, err)
        if is_lost:
            assert b"cannot write to standard output: No space left on device" in err, case
        if typed == "toy":
            assert (folder / "result.json").exists(), case
            if stream == "full":
                assert err.count(b"1.911 kg") == 10_000
        if typed == "list" and stream.startswith("encoding "):
            assert "stiffness" in out.decode(stream.removeprefix("encoding ")), case
