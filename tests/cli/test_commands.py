"""All commands, those of installed packages included: help, exit status, bad input and interrupts."""

import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import typer
from cli.conftest import names
from clock import HANG, wait_until

from cablebot_gym.cli import app as cli

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"
POLICY = "--policy fl"
README = (Path(__file__).parents[2] / "README.md").read_text()


def named_commands(group, prefix=""):
    """The commands of a group and of the groups in it, by what is typed."""
    commands = {}
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            commands |= named_commands(command, f"{prefix}{name} ")
        else:
            commands[prefix + name] = command
    return commands


cli.add_commands(cli.command_points())
COMMANDS = named_commands(typer.main.get_command(cli.app))


def parse(line):
    """Parses a line without running it."""
    words = shlex.split(line, comments=True)
    name = words[0] if words[0] in COMMANDS else " ".join(words[:2])
    return COMMANDS[name].make_context(name, words[len(name.split()) :])


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_valid_examples_and_a_text_for_every_option(cablebot, name):
    ended = cablebot(name, "--help")
    assert (ended.status, ended.err) == (0, "")
    examples = re.findall(r"^(?:Example: )?cablebot (.+)$", COMMANDS[name].help, re.MULTILINE)
    assert examples
    for example in examples:
        assert f"{example} ".startswith(f"{name} ")
        parse(example)
    for option in COMMANDS[name].params:
        assert getattr(option, "help", None), option.name
    line = cablebot(name, "--no-such-option").message(2)
    assert line == f"cablebot: No such option: --no-such-option. Example: cablebot {examples[0]}\n"


def test_commands_of_the_readme_are_valid():
    lines = re.findall(r"^cablebot ((?!--).+)$", README, re.MULTILINE)
    assert len(lines) > 3
    for line in lines:
        parse(line)
    with pytest.raises(Exception, match="No such option"):
        parse("dlcc CableBot-Planar-v0 --polcy fl")


ROLLOUT = f"rollout {PLANAR} {POLICY} --out "
FL = f"dlcc {SPATIAL} {POLICY} "
PAIR = f"compare {PLANAR} --policies fl,robust "
EXPORT = "robot export cogiro --out "
TRAIN = f"train {PLANAR} --out "
ERRORS = (
    ("nosuch", 2, "nosuch"),
    ("robot", 2, "Missing command. The commands are "),
    ("robot nosuch", 2, "robot check"),
    ("dlcc --policy fl", 2, "give an environment id, one of"),
    (f"dlcc CableBot-Cubic-v0 {POLICY}", 2, "choose one of CableBot-Planar-v0, CableBot-Spatial"),
    (FL + "--trajectory {", 2, "--trajectory is not valid JSON"),
    (FL + "--payload-max -1", 2, "payload_max must be"),
    (FL + "--uncertainty table6 --draws 2.5", 2, "--draws"),
    (FL + "--out file/below", 2, "cannot write to folder"),
    (f"compare {SPATIAL} --policies ,", 2, "name at least one policy, such as fl"),
    (PAIR + "--wrapper x.pkl", 2, "--wrapper does not apply to installed policies, such as fl"),
    (PAIR + "--payload ''", 2, "--payload must be a number, a list such as 0,1,2, or FIRST:"),
    (PAIR + "--payload 2,1", 2, "payloads must"),
    (ROLLOUT.replace("--out", ""), 2, "--out"),
    (ROLLOUT + "folder.csv", 2, "it is a folder"),
    (ROLLOUT + "run", 2, "must end in .npz or .csv or .png"),
    (f"video {PLANAR} --out video.mp4 {POLICY} --size 641x481", 2, "even number"),
    (f"video {PLANAR} --out video.mp4 {POLICY} --speed nan", 2, "speed must"),
    (f"video {PLANAR} --out video.avi {POLICY}", 2, "end in .mp4 or .gif or .png"),
    (
        f"video {PLANAR} --out a.gif {POLICY} --time 1",
        2,
        "--time is for a picture: name a .png file",
    ),
    (
        f"video {PLANAR} --out a.png {POLICY} --time 9",
        2,
        "time must be a finite number at least 0 and at most 1.6 s",
    ),
    (
        "benchmark --suite huge",
        2,
        "unknown suite 'huge'; choose one of smoke, ranked",
    ),
    ("benchmark --suite ranked --policies fl", 2, "add --seed-text TEXT"),
    ("benchmark --ray auto --workers 1", 2, "--workers and --ray exclude each other"),
    ("benchmark --policies fl --out .", 2, "it is a folder"),
    ("report file", 2, "'file' holds no results"),
    ("report . --out page.pdf", 2, "--out must end in .html"),
    ("robot check cogyro", 2, "did you mean 'cogiro'"),
    ("robot check cogiro --out my.txt", 2, "must end in .svg"),
    (EXPORT + "my.toml", 2, "--out must end in .xml, not 'my.toml'"),
    (EXPORT + "my.xml --payload -1", 2, "at least 0 kg"),
    (TRAIN + "run --timesteps 0", 2, "timesteps must be"),
    (f"best-known {PLANAR} --position-bound 0.01", 2, "position"),
)
"""What is typed, the exit status, and words of the message."""


@pytest.mark.parametrize(("typed", "status", "words"), ERRORS, ids=[row[0] for row in ERRORS])
def test_error_ends_with_its_status_and_one_line_and_keeps_the_folder(
    cablebot, tmp_path, typed, status, words
):
    work = tmp_path / "work"
    (work / "file").write_text("{}")
    for folder in ("folder.csv", "smoke.jsonl"):
        (work / folder).mkdir()
    assert words in cablebot(typed).message(status)
    assert names(work) == ["file", "folder.csv", "smoke.jsonl"]


@pytest.mark.parametrize(
    ("module", "extra", "typed"),
    [
        ("matplotlib", "plot", FL + "--out results"),
        ("casadi", "optimal", f"best-known {PLANAR}"),
        ("pygame", "render", f"video {PLANAR} --out video.gif {POLICY}"),
        ("ray", "ray", "benchmark --policies fl --ray local"),
    ],
)
def test_missing_extra_ends_with_the_command_that_installs_it(
    cablebot, monkeypatch, cache, module, extra, typed
):
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    assert f"pip install 'cablebot-gym[{extra}]'" in cablebot(typed).message(2)


# --- processes --------------------------------------------------------------------------------------------------------

START = f"import signal, cablebot_gym.cli.app as c; signal.signal({int(signal.SIGINT)}, signal.default_int_handler); "
"""A shell that starts jobs in the background may have them ignore the signal."""


def is_alive(group):
    """Whether a process of the group is left."""
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.landing
@pytest.mark.skipif(os.name != "posix", reason="a shell of POSIX")
@pytest.mark.parametrize(("reader", "printed"), [("cat", r"\u2013"), ("true", "")])
def test_output_without_reader_or_unicode_is_no_error(reader, printed):
    """The reader ``true`` ends before the command writes."""
    command = f"{shlex.quote(sys.executable)} -m cablebot_gym.cli.app list | {reader}"
    ended = subprocess.run(
        command,
        shell=True,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONIOENCODING": "ascii"},
    )
    assert ended.stderr == ""
    assert printed in ended.stdout


@pytest.mark.landing
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupt_keeps_results_and_leaves_no_process(tmp_path):
    typed = ("benchmark", "--policies", "fl", "--workers", "2", "--out", str(tmp_path))
    command = [sys.executable, "-c", START + "c.main()", *typed]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, start_new_session=True, **pipes)
    wait_until(lambda: any('"result"' in path.read_text() for path in tmp_path.glob("*.jsonl")))
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    _, err = process.communicate(timeout=HANG)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    words = " ".join(err.split())
    assert re.search(r"[1-9]\d* of \d+ rows are finished and stored in", words)
    resume = f"Resume with: cablebot benchmark --suite smoke --policies fl --out {tmp_path}"
    assert resume in words
    assert not (tmp_path / "smoke.md").exists()
    wait_until(lambda: not is_alive(process.pid))
