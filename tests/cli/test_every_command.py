"""What all commands promise, those of installed packages too: examples that can be typed, an exit status, a bar."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from cablebot_gym.cli import app as cli

PLANAR = "CableBot-Planar-v0"
POLICY = ("--policy", "fl")
ROLLOUT = ("rollout", PLANAR, *POLICY, "--out", "run.csv")


def every_command():
    """By name, as the parser has them."""
    cli.add_commands(cli.command_points())
    return typer.main.get_command(cli.app).commands


COMMANDS = every_command()
README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def cablebot(monkeypatch, capsys, tmp_path):
    """Runs a command in this process, in an empty folder: status, standard output, standard error."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["cablebot", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capsys.readouterr()
        return ended.value.code or 0, out, err

    return run


def examples_of(help_text):
    """The lines of a help that can be typed."""
    return re.findall(r"^(?:Example: )?cablebot (.+)$", help_text, re.MULTILINE)


def parsed(line):
    """What the parser makes of a line, without running it."""
    name, *arguments = shlex.split(line, comments=True)
    return COMMANDS[name].make_context(name, arguments)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_no_example_that_cannot_be_typed(name):
    examples = examples_of(COMMANDS[name].help)
    assert examples
    for example in examples:
        assert example.split()[0] == name
        parsed(example)


@pytest.mark.parametrize("name", COMMANDS)
def test_what_the_parser_refuses_comes_with_an_example_of_the_command(cablebot, name):
    status, _, said = cablebot(name, "--no-such-option")
    assert status == 2
    assert said.startswith("cablebot: No such option: --no-such-option")
    assert said.rstrip().partition(". Example: cablebot ")[2] == examples_of(COMMANDS[name].help)[0]


def test_readme_has_no_command_that_cannot_be_typed():
    lines = re.findall(r"^cablebot ((?!--).+)$", README, re.MULTILINE)
    assert len(lines) > 10
    for line in lines:
        parsed(line)


def test_an_example_with_an_option_that_does_not_exist_is_found():
    with pytest.raises(Exception, match="No such option"):
        parsed("dlcc CableBot-Planar-v0 --polcy fl")


@pytest.mark.parametrize("name", COMMANDS)
def test_no_option_lacks_a_help(name):
    assert [one.name for one in COMMANDS[name].params if not getattr(one, "help", None)] == []


def test_exit_statuses_are_in_the_help(cablebot):
    _, said, _ = cablebot("--help")
    statuses = ((0, "success"), (1, "failure"), (2, "invalid input"), (130, "interrupted"))
    assert all(f" {status} {words}" in " ".join(said.split()) for status, words in statuses)


MISTAKES = [
    *((name, "--nosuch") for name in COMMANDS),
    ("dlcc",),
    ("dlcc", "X", *POLICY),
    ("dlcc", PLANAR, "--policy", "os:nosuch"),
    ("dlcc", PLANAR, *POLICY, "--payload-max", "-1"),
    ("dlcc", PLANAR, *POLICY, "--out", "file/below"),
    ("dlcc", PLANAR, *POLICY, "--seed", "1e99"),
    ("compare", PLANAR, "--policies", "fl,fl"),
    ("compare", PLANAR, "--policies", "fl", "--draws", "0"),
    ("compare", PLANAR, "--policies", "fl", "--out", "file/below"),
    ("best-known", "X"),
    ("best-known", PLANAR, "--position-bound", "-1"),
    ("list", "more"),
    (*ROLLOUT, "--control-frequency", "-5"),
    (*ROLLOUT[:-1], "file/run.csv"),
    (*ROLLOUT[:-2],),
    ("rollout", PLANAR, "--policy", "nosuch.zip", "--out", "run.csv"),
    ("watch", "X", *POLICY),
    ("watch", PLANAR),
    ("watch", PLANAR, *POLICY, "--size", "0x0"),
    ("watch", PLANAR, *POLICY, "--payload", "-1"),
    ("video", PLANAR, "video.gif", *POLICY, "--size", "100000x100000"),
    ("video", PLANAR, "file/video.gif", *POLICY),
    ("benchmark", "--policies", "nosuch"),
    ("benchmark", "--workers", "-1"),
    ("benchmark", "--out", "file/below"),
    ("doctor", "more"),
    ("train", "X", "--out", "run"),
    ("train", PLANAR, "--out", "run", "--algo", "dqn"),
    ("train", PLANAR, "--out", "run", "--timesteps", "-5"),
    ("train", PLANAR, "--out", "file/below"),
    ("reproduce", "--only", "nosuch"),
    ("reproduce", "--workers", "-1"),
    ("reproduce", "--out", "file/below"),
    ("nosuch",),
]


@pytest.mark.parametrize("typed", MISTAKES, ids=" ".join)
def test_mistake_ends_with_status_2_one_line_and_no_file(cablebot, tmp_path, typed):
    (tmp_path / "file").write_text("kept", encoding="utf-8")
    status, out, err = cablebot(*typed)
    assert (status, out) == (2, "")
    assert err.startswith("cablebot: ")
    assert err.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize(
    ("module", "extra", "typed"),
    [
        ("matplotlib", "plot", ("dlcc", PLANAR, *POLICY, "--out", "results")),
        ("matplotlib", "plot", ("compare", PLANAR, "--policies", "fl", "--out", "results")),
        ("matplotlib", "plot", ("reproduce", "--only", "fig1", "--out", "results")),
        ("casadi", "optimal", ("best-known", PLANAR)),
        ("casadi", "optimal", (*ROLLOUT, "--policy", "trajopt")),
        ("pygame", "render", ("watch", PLANAR, *POLICY)),
        ("pygame", "render", ("video", PLANAR, "video.gif", *POLICY)),
        ("ray", "ray", ("benchmark", "--policies", "fl", "--ray", "local")),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_missing_extra_ends_with_the_command_that_installs_it(cablebot, monkeypatch, cache, module, extra, typed):
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    status, _, err = cablebot(*typed)
    assert status == 2
    assert f"pip install 'cablebot-gym[{extra}]'" in err
    assert "Traceback" not in err


def test_policy_that_fails_in_an_episode_ends_with_status_1(cablebot, tmp_path, monkeypatch):
    (tmp_path / "failing.py").write_text("def make(robot):\n    return lambda observation: 1 / 0\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    failing = ("--policy", "failing:make")
    for typed in (("dlcc", PLANAR, *failing), (*ROLLOUT[:2], *failing, *ROLLOUT[4:]), ("watch", PLANAR, *failing)):
        status, out, err = cablebot(*typed)
        assert (status, out) == (1, "")
        assert "division by zero" in err
        assert err.count("\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="terminals of POSIX")
@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (("dlcc", PLANAR, *POLICY), "paper criterion"),
        (("compare", PLANAR, "--policies", "fl"), "comparing"),
        (ROLLOUT, "of 500 steps"),
        (("video", PLANAR, "video.gif", *POLICY, "--speed", "10"), "frames"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_bar_is_shown_in_a_terminal_and_nowhere_else(tmp_path, typed, words):
    terminal, end = os.openpty()
    command, environment = [sys.executable, "-m", "cablebot_gym.cli.app", *typed], os.environ | {"TERM": "xterm"}
    ran = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=end, cwd=tmp_path, env=environment, text=True)
    os.close(end)
    shown = b"".join(iter(lambda: read_on(terminal), b"")).decode()
    os.close(terminal)
    said, _ = ran.communicate()
    assert ran.returncode == 0, shown
    assert words in shown
    assert "━" in shown
    assert "\x1b" not in said


def read_on(terminal):
    """What has come meanwhile; nothing at the end, for which Linux has an error."""
    try:
        return os.read(terminal, 1 << 16)
    except OSError:
        return b""
