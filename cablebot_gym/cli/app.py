"""``cablebot``: the table of its commands, and how errors become one message and an exit status.

Exit status: 0 done, 1 ran and failed, 2 bad input, 130 interrupted. Results go to standard output, everything else to
standard error.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from cablebot_gym.utils.console import notes_console

COMMAND_GROUP = "cablebot_gym.commands"
"""Entry points of further commands: functions with typer's annotations."""

COMMANDS = {
    "Evaluate policies": {
        "dlcc": "cablebot_gym.cli.dlcc:dlcc",
        "compare": "cablebot_gym.cli.compare:compare",
        "best-known": "cablebot_gym.cli.best_known:best_known",
    },
    "Record and show episodes": {
        "rollout": "cablebot_gym.cli.rollout:rollout",
        "watch": "cablebot_gym.cli.watch:watch",
        "video": "cablebot_gym.cli.video:video",
    },
    "Benchmark": {
        "benchmark": "cablebot_gym.cli.benchmark:benchmark",
        "report": "cablebot_gym.cli.report:report",
    },
    "Look around": {
        "list": "cablebot_gym.cli.listing:list_",
        "doctor": "cablebot_gym.cli.doctor:doctor",
    },
}
"""Built-in commands by group; a module is imported when its command is typed."""

ADDED = "Commands of installed packages"
"""Group of the commands that entry points add."""

INTERRUPTED = 130
"""Exit status after Ctrl-C."""


class _GroupedCommands(TyperGroup):
    """Lists commands by group, each with its whole summary."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:  # click's types, of a copy inside typer or not
        added = [name for name in self.commands if not any(name in names for names in COMMANDS.values())]
        for title, names in {**COMMANDS, ADDED: added}.items():
            rows = [(name, self.commands[name].get_short_help_str(limit=1000)) for name in names]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


app = typer.Typer(
    name="cablebot",
    cls=_GroupedCommands,
    help=(
        "How many kilograms does a controller carry on a cable robot?\n\n"
        "Exit status: 0 done, whatever is carried; 1 ran and failed: a policy raised, a file could not be written, a "
        "cell of the benchmark failed, a best payload was not verified, or doctor found something wrong; 2 bad input, "
        "a folder that cannot be written to too; "
        "130 interrupted."
    ),
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def _version(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        from cablebot_gym import __version__

        print(f"cablebot_gym {__version__}")


BUILT_IN = {
    name: EntryPoint(name, value, COMMAND_GROUP) for group in COMMANDS.values() for name, value in group.items()
}
"""Built-in commands by name."""


def command_points() -> dict[str, EntryPoint]:
    """Every command by name: the built-in ones, then those that installed packages add."""
    return BUILT_IN | {point.name: point for point in entry_points(group=COMMAND_GROUP) if point.name not in BUILT_IN}


def add_commands(points: Mapping[str, EntryPoint]) -> None:
    """Loads commands into :data:`app`; a command that is there already stays."""
    present = {item.name for item in app.registered_commands}
    for name, point in points.items():
        if name not in present:
            app.command(name=name)(point.load())


def main() -> None:
    """Entry point: turns errors into one sentence and an exit status."""
    from cablebot_gym.policies import PolicyError

    sys.path.insert(0, "")  # so that package.module:factory is found in the folder in which one works
    try:
        if len(sys.argv) < 2:
            sys.argv.append("--help")
        typed = sys.argv[1]
        add_commands({typed: BUILT_IN[typed]} if typed in BUILT_IN else command_points())
        status = app(standalone_mode=False)  # a number where the parser ended the command itself, as Ctrl-C does
        if status == INTERRUPTED:
            raise KeyboardInterrupt
        sys.exit(status if isinstance(status, int) else 0)
    except KeyboardInterrupt:
        _fail("interrupted: nothing was left half-written", INTERRUPTED)
    except (ValueError, ImportError) as error:
        _fail(_as_typed(str(error)), 2)
    except OSError as error:
        _fail(f"cannot write {error.filename!r}: {error.strerror}", 1)
    except PolicyError as error:
        _fail(str(error), 1)
    except Exception as error:
        show = getattr(error, "format_message", None)  # what the option parser found wrong
        if show is None:
            raise
        message = show()
        if message.startswith("No such command"):
            message += f" The commands are {', '.join(command_points())}."
        elif example := _example(sys.argv[1]):
            message = f"{message.rstrip('.')}; for example: {example}"
        _fail(message, getattr(error, "exit_code", 2))


def _example(name: str) -> str:
    """The first in the docstring of a command; empty if there is no such command."""
    texts = [item.callback.__doc__ or "" for item in app.registered_commands if item.name == name and item.callback]
    found = re.search(r"^ *(?:Example: )?(cablebot .+)$", "\n".join(texts), re.MULTILINE)
    return found[1] if found else ""


def _as_typed(message: str) -> str:
    """A message about a keyword, about the option instead that gave it."""
    keyword = re.match(r"([a-z][a-z0-9_]*) must ", message)
    option = f"--{keyword[1].replace('_', '-')}" if keyword else ""
    typed = (argument.partition("=")[0] for argument in sys.argv)
    return option + message[len(keyword[1]) :] if keyword and option in typed else message


def _fail(message: str, status: int) -> None:
    notes_console().print(f"cablebot: {message}", style="red")
    sys.exit(status)


if __name__ == "__main__":
    main()
