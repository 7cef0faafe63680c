"""All commands, those of installed packages included: help, exit status, bad input, interrupts and progress."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import typer
from cli.conftest import Ended, names

from cablebot_gym import ENV_IDS
from cablebot_gym.cli import app as cli
from cablebot_gym.utils import console

PLANAR, SPATIAL = "CableBot-Planar-v0", "CableBot-Spatial-v0"
POLICY = ("--policy", "fl")
ROLLOUT = ("rollout", PLANAR, *POLICY, "--out", "run.csv")
README = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")

cli.add_commands(cli.command_points())
COMMANDS = typer.main.get_command(cli.app).commands


def examples_of(help_text):
    """The lines of a help that can be typed."""
    return re.findall(r"^(?:Example: )?cablebot (.+)$", help_text, re.MULTILINE)


def parse(line):
    """Parses a line without running it."""
    name, *arguments = shlex.split(line, comments=True)
    return COMMANDS[name].make_context(name, arguments)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_valid_examples_and_a_text_for_every_option(cablebot, name):
    ended = cablebot(name, "--help")
    assert (ended.status, ended.err) == (0, "")
    examples = examples_of(COMMANDS[name].help)
    assert examples
    for example in examples:
        assert example.split()[0] == name
        parse(example)
    assert [option.name for option in COMMANDS[name].params if not getattr(option, "help", None)] == []
    line = cablebot(name, "--no-such-option").message(2)
    assert line == f"cablebot: No such option: --no-such-option. Example: cablebot {examples[0]}\n"


def test_help_lists_every_command_with_its_first_sentence(cablebot, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = cablebot("--help").out
    assert max(map(len, text.splitlines())) <= 80
    words = " ".join(text.split())
    for name, command in COMMANDS.items():
        sentence = re.match(r".+?\.(?=\s|$)", " ".join(command.help.split()))[0]
        assert f" {name} {sentence}" in words
    for status, meaning in ((0, "success"), (1, "failure"), (2, "invalid input"), (130, "interrupted")):
        assert f" {status} {meaning}" in words
    valid = cablebot("nosuch").message(2).partition("The commands are ")[2]
    assert valid == ", ".join([*cli.BUILT_IN, "reproduce", "train"]) + ".\n"


def test_commands_of_the_readme_are_valid():
    lines = re.findall(r"^cablebot ((?!--).+)$", README, re.MULTILINE)
    assert len(lines) > 5
    for line in lines:
        parse(line)
    with pytest.raises(Exception, match="No such option"):
        parse("dlcc CableBot-Planar-v0 --polcy fl")


FL = ("dlcc", SPATIAL, *POLICY)
MISTAKES = [
    (("nosuch",), "nosuch"),
    (("list", "more"), ""),
    (("dlcc", "CableBot-Cubic-v0", *POLICY), "choose one of CableBot-Planar-v0, CableBot-Spatial-v0"),
    (("dlcc", SPATIAL, "--policy", "lqr"), "unknown policy 'lqr'; choose one of "),
    (("dlcc", SPATIAL, "--policy", "nowhere.zip"), "'nowhere.zip' does not exist"),
    (("dlcc", SPATIAL, "--policy", "os:nosuch"), "'os' has no attribute 'nosuch'"),
    (("dlcc", SPATIAL, "--policy", "nowhere.to:find"), "No module named 'nowhere'"),
    ((*FL, "--criterion", "both of them"), "--criterion"),
    ((*FL, "--trajectory", "spiral"), "unknown trajectory 'spiral'; choose one of paper-spatial"),
    ((*FL, "--trajectory", "{"), "--trajectory is not valid JSON"),
    ((*FL, "--position-bound", "0"), "position"),
    ((*FL, "--payload-max", "-1"), "payload-max"),
    ((*FL, "--resolution", "0"), "resolution"),
    ((*FL, "--control-frequency", "0"), "control-frequency"),
    ((*FL, "--seed", "-1"), "seed"),
    ((*FL, "--uncertainty", "table5"), "unknown uncertainty 'table5'"),
    ((*FL, "--uncertainty", "table6", "--draws", "2.5"), "--draws"),
    ((*FL, "--draws", "4"), "all 4 draws would be equal"),
    ((*FL, "--confidence", "0"), "confidence"),
    ((*FL, "--out", "file/below"), "cannot write to folder"),
    (("compare", SPATIAL), "--policies"),
    (("compare", SPATIAL, "--policies", " , "), "there is no policy to compare"),
    (("compare", SPATIAL, "--policies", "fl, fl"), "every policy needs its own name"),
    ((*ROLLOUT[:-2],), "--out"),
    ((*ROLLOUT, "--payload", "nan"), "payload"),
    ((*ROLLOUT[:-1], "file/run.csv"), "cannot write to folder"),
    (("watch", PLANAR), "give either --policy with one name, or --policies with several"),
    (("video", PLANAR, "video.gif", *POLICY, "--size", "100000x100000"), ""),
    (("video", PLANAR, "file/video.gif", *POLICY), "cannot write to folder"),
    (("benchmark", "--suite", "huge"), "unknown suite 'huge'; choose one of smoke, standard, full"),
    (("benchmark", "--policies", "nosuch"), "unknown policy 'nosuch'"),
    (("benchmark", "--workers", "-1"), "workers must be"),
    (("benchmark", "--ray", "auto", "--workers", "1"), "--workers and --ray exclude each other"),
    (("benchmark", "--out", "file/below"), "cannot write to folder"),
    (("train", PLANAR, "--out", "file/below"), ""),
    (("reproduce", "--only", "fig4"), "unknown part 'fig4'"),
    (("reproduce", "--minimum-tension", "-1"), "minimum-tension"),
    (("reproduce", "--planar-apex", "sideways"), "sideways"),
]


@pytest.mark.parametrize(
    ("typed", "message"), MISTAKES, ids=lambda value: " ".join(value) if isinstance(value, tuple) else ""
)
def test_bad_input_ends_with_status_2_one_line_and_no_file(cablebot, tmp_path, typed, message):
    (tmp_path / "work" / "file").write_text("kept", encoding="utf-8")
    assert message in cablebot(*typed).message(2)
    assert names(tmp_path / "work") == ["file"]


@pytest.mark.parametrize(
    ("module", "extra", "typed"),
    [
        ("matplotlib", "plot", (*FL, "--out", "results")),
        ("matplotlib", "plot", ("reproduce", "--only", "fig1", "--out", "results")),
        ("casadi", "optimal", ("best-known", PLANAR)),
        ("pygame", "render", ("video", PLANAR, "video.gif", *POLICY)),
        ("ray", "ray", ("benchmark", "--policies", "fl", "--ray", "local")),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_missing_extra_ends_with_the_command_that_installs_it(cablebot, monkeypatch, cache, module, extra, typed):
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    assert f"pip install 'cablebot-gym[{extra}]'" in cablebot(*typed).message(2)


def test_progress_in_a_log_has_the_time_left(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    with console.progress("recording", "episodes") as step:
        for done in range(100, 201):  # 100 are stored already
            step(done, 200)
            now[0] += 1.0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "recording: 104 of 200 episodes, 96 s left"
    assert 8 < len(lines) < 20
    with console.progress("computing") as step:
        step(1, 4, "first part")
        now[0] += 300.0
        step(2, 4)
    assert capsys.readouterr().err == "first part: 50%, 10 min left\n"


# --- processes --------------------------------------------------------------------------------------------------------

START = f"import signal, cablebot_gym.cli.app as c; signal.signal({int(signal.SIGINT)}, signal.default_int_handler); "
"""A shell that starts jobs in the background may have them ignore the signal."""


@pytest.mark.slow
def test_installed_module_runs():
    command = [sys.executable, "-m", "cablebot_gym.cli.app", "list", "--json"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert Ended(ran.returncode, ran.stdout, ran.stderr).data["env_ids"] == list(ENV_IDS)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="terminals of POSIX")
@pytest.mark.parametrize(
    ("typed", "words"),
    [
        (("dlcc", PLANAR, *POLICY), "paper criterion"),
        (("video", PLANAR, "video.gif", *POLICY, "--speed", "10"), "frames"),
    ],
    ids=["dlcc", "video"],
)
def test_terminal_shows_a_bar_with_the_time_left(tmp_path, typed, words):
    terminal, end = os.openpty()
    command, environment = [sys.executable, "-m", "cablebot_gym.cli.app", *typed], os.environ | {"TERM": "xterm"}
    ran = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=end, cwd=tmp_path, env=environment, text=True)
    os.close(end)
    shown = b""
    try:
        while part := os.read(terminal, 1 << 16):
            shown += part
    except OSError:  # Linux, at the end
        pass
    os.close(terminal)
    out, _ = ran.communicate()
    assert ran.returncode == 0, shown
    assert all(part in shown.decode() for part in (words, "━", "left"))
    assert "\x1b" not in out


def is_alive(group):
    """Whether a process of the group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(
    ("typed", "finished", "words"),
    [
        (("reproduce", "--only", "fig3,scan"), "fig3.svg", "--only scan"),
        (
            ("benchmark", "--suite", "standard", "--ids", PLANAR, "--policies", "fl"),
            "cells/*-fl-*",
            "Resume with: cablebot benchmark --suite standard",
        ),
    ],
    ids=["reproduce", "benchmark"],
)
def test_interrupt_keeps_results_and_leaves_no_process(tmp_path, typed, finished, words):
    command = [sys.executable, "-c", START + "c.main()", *typed, "--workers", "2", "--out", str(tmp_path)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, start_new_session=True, **pipes)
    deadline = time.monotonic() + 120
    while not any(tmp_path.glob(finished)) and time.monotonic() < deadline:
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert words in " ".join(err.split())
    while is_alive(process.pid) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not is_alive(process.pid)


# --- reproduce --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_reproduction_writes_its_files_and_takes_its_options(cablebot, tmp_path):
    arguments = ("reproduce", "--only", "fig1", "--out", tmp_path / "out", "--workers", "1", "--json")
    rows = json.loads(cablebot(*arguments, "--planar-apex", "left", "--minimum-tension", "2").out)
    assert all("key" in row for row in rows)
    made = {"results.json", "reproduction.md", "reproduction.html", "fig1.png", "fig1.svg"}
    assert set(names(tmp_path / "out")) == made
    data = json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
    choices = data["interpretation"]
    assert (choices["planar_apex"], choices["minimum_tension"]) == ("left", 2.0)
