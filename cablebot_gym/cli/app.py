"""``cablebot``: the table of its commands, and the conversion of errors to a message and an exit
status.

Exit status: 0 success, 1 failure, 2 invalid input, 130 interrupted. Results go to standard output,
everything else to standard error.
"""

from __future__ import annotations

import atexit
import gc
import os
import re
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import EntryPoint, entry_points
from io import TextIOWrapper
from typing import Annotated

import typer

from cablebot_gym.cli.records import with_options
from cablebot_gym.utils.console import say
from cablebot_gym.utils.user_code import sentence_of_user_code

COMMAND_GROUP = "cablebot_gym.commands"
"""Entry point group of commands. A package adds a command by an entry point that names a function
with typer's annotations. A name of two words, ``robot import``, is a command of a group."""

COMMANDS = {
    "dlcc": "cablebot_gym.cli.dlcc:dlcc",
    "compare": "cablebot_gym.cli.compare:compare",
    "best-known": "cablebot_gym.cli.best_known:best_known",
    "rollout": "cablebot_gym.cli.rollout:rollout",
    "video": "cablebot_gym.cli.video:video",
    "benchmark": "cablebot_gym.cli.benchmark:benchmark",
    "report": "cablebot_gym.cli.report:report",
    "list": "cablebot_gym.cli.listing:list_",
    "robot check": "cablebot_gym.cli.robot:check",
    "robot export": "cablebot_gym.cli.exporting:export",
}
"""Built-in commands. The module of a command is imported when the command is run."""

GROUPS = {"robot": "Check and export robots."}
"""Help of the groups of commands."""

INTERRUPTED = 130
"""Exit status after Ctrl-C."""


app = typer.Typer(
    name="cablebot",
    help=(
        "Evaluate controllers of cable-suspended robots by the largest payload that they carry along a "
        "trajectory, the dynamic load carrying capacity (DLCC).\n\n"
        "`cablebot COMMAND --help` shows the options of a command and examples.\n\n"
        "Exit status 0: success, whatever the payload is.\n\n"
        "Exit status 1: a policy raised an error, a file could not be written, a row of the benchmark failed, "
        "a best known payload was not verified, or a robot does not carry its payload.\n\n"
        "Exit status 2: invalid input, or a folder that is not writable.\n\n"
        "Exit status 130: interrupted."
    ),
    no_args_is_help=True,
    rich_markup_mode="markdown",
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        from cablebot_gym import __version__

        print(f"cablebot_gym {__version__}")


BUILT_IN = {name: EntryPoint(name, value, COMMAND_GROUP) for name, value in COMMANDS.items()}
"""Built-in commands by name."""


def command_points() -> dict[str, EntryPoint]:
    """All commands by name: first the built-in commands, then those that installed packages add."""
    return BUILT_IN | {
        point.name: point
        for point in entry_points(group=COMMAND_GROUP)
        if point.name not in BUILT_IN
    }


def add_commands(points: Mapping[str, EntryPoint]) -> None:
    """Loads commands into :data:`app`. A command that :data:`app` already has is not replaced."""
    for name, point in points.items():
        parent, _, last = name.rpartition(" ")
        group = _group(parent) if parent else app
        if last not in [item.name for item in group.registered_commands]:
            group.command(name=last)(with_options(point.load()))


def _group(name: str) -> typer.Typer:
    """The group of commands with a name, made if :data:`app` does not have it yet."""
    for item in app.registered_groups:
        if item.name == name and item.typer_instance is not None:
            return item.typer_instance
    group = typer.Typer(rich_markup_mode="markdown")
    app.add_typer(group, name=name, help=GROUPS.get(name))
    return group


def _points_of(typed: str) -> Mapping[str, EntryPoint]:
    """The command that is typed first, those of the group that is typed first, or else all: a broken
    command of another package does not stop the others."""
    if typed in BUILT_IN:
        return {typed: BUILT_IN[typed]}
    points = command_points()
    return {name: point for name, point in points.items() if name.split()[0] == typed} or points


def main() -> None:
    """Runs the command line. Converts errors to a message of one line and an exit status."""
    from cablebot_gym.policies import PolicyError

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # not in a notebook
            stream.reconfigure(errors="backslashreplace")
    # the last collection of the process would take 0.2 s and free nothing that matters
    atexit.register(gc.freeze)
    # package.module:factory of the working directory; last, so that no file there hides a package
    sys.path.append("")
    try:
        if len(sys.argv) < 2:
            sys.argv.append("--help")
        add_commands(_points_of(sys.argv[1]))
        # a number if the parser ended the command, for example after Ctrl-C
        status = app(standalone_mode=False)
        if status == INTERRUPTED:
            raise KeyboardInterrupt
        sys.stdout.flush()
        sys.exit(status if isinstance(status, int) else 0)
    except KeyboardInterrupt:
        _fail("interrupted. No file was left incomplete.", INTERRUPTED)
    except (ValueError, ImportError) as error:
        _fail(sentence_of_user_code(error) or str(error), 2)
    except BrokenPipeError:  # the reader wants no more, as in `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except OSError as error:
        message = str(error)
        if error.filename is not None:
            message = f"cannot write {error.filename!r}: {error.strerror}"
        _fail(message, 1)
    except PolicyError as error:
        _fail(str(error), 1)
    except Exception as error:
        # an error of the option parser has this method
        format_message = getattr(error, "format_message", None)
        if format_message is None:
            if sentence := sentence_of_user_code(error):
                _fail(sentence, 1)
            raise
        message = format_message()
        if not message.endswith((".", "?")):
            message += "."
        if message.startswith(("No such command", "Missing command")):
            message += f" The commands are {', '.join(command_points())}."
        elif example := _example(sys.argv[1:]):
            message += f" Example: {example}"
        _fail(message, getattr(error, "exit_code", 2))


def _example(arguments: Sequence[str]) -> str:
    """The first example in the docstring of the command that is typed; empty if there is none."""
    for name, point in _points_of(arguments[0]).items():
        words = name.split()
        if arguments[: len(words)] == words:
            text = point.load().__doc__ or ""
            match = re.search(r"^ *(?:Example: )?(cablebot .+)$", text, re.MULTILINE)
            return match[1] if match else ""
    return ""


def _fail(message: str, status: int) -> None:
    say(f"cablebot: {message}", style="red")
    sys.exit(status)


if __name__ == "__main__":
    main()
