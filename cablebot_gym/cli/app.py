"""``cablebot``: the table of its commands, and the conversion of errors to a message and an exit
status.

Exit status: 0 success, 1 failure, 2 invalid input, 130 interrupted. Results go to standard output,
everything else to standard error.
"""

from __future__ import annotations

import atexit
import gc
import re
import sys
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from cablebot_gym.cli.records import GroupedOptions, with_options
from cablebot_gym.utils.console import say
from cablebot_gym.utils.streams import output_problem, protect_streams
from cablebot_gym.utils.user_code import sentence_of_user_code

COMMAND_GROUP = "cablebot_gym.commands"
"""Entry point group of commands. A package adds a command by an entry point that names a function
with typer's annotations."""

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
        "picture": "cablebot_gym.cli.picture:picture",
    },
    "Export policies": {
        "export-policy": "cablebot_gym.cli.export_policy:export_policy",
    },
    "Drive real winches": {
        "drive": "cablebot_gym.cli.drive:drive",
    },
    "Run benchmarks": {
        "benchmark": "cablebot_gym.cli.benchmark:benchmark",
        "report": "cablebot_gym.cli.report:report",
    },
    "Inspect the installation": {
        "list": "cablebot_gym.cli.listing:list_",
        "robot": "cablebot_gym.cli.robot:robot",
        "identify": "cablebot_gym.cli.identify:identify",
        "validate": "cablebot_gym.cli.validate:validate",
        "doctor": "cablebot_gym.cli.doctor:doctor",
    },
}
"""Built-in commands by group. The module of a command is imported when the command is run."""

ADDED = "Commands of other installed packages"
"""Title of the group of commands that entry points add."""

INTERRUPTED = 130
"""Exit status after Ctrl-C."""


class _GroupedCommands(TyperGroup):
    """Lists the commands by group, with the full first sentence of each help text."""

    def format_commands(
        self, ctx: Any, formatter: Any
    ) -> None:  # types of click, which typer may vendor
        added = [
            name for name in self.commands if not any(name in names for names in COMMANDS.values())
        ]
        for title, names in {**COMMANDS, ADDED: added}.items():
            rows = [(name, self.commands[name].get_short_help_str(limit=1000)) for name in names]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


app = typer.Typer(
    name="cablebot",
    cls=_GroupedCommands,
    help=(
        "Evaluate controllers of cable-suspended robots by the largest payload that they carry along a "
        "trajectory, the dynamic load carrying capacity (DLCC).\n\n"
        "`cablebot COMMAND --help` shows the options of a command and examples.\n\n"
        "\b\n"
        "Exit status:\n"
        "  0    success, whatever the payload is\n"
        "  1    failure: a policy raised an error, a file could not be written,\n"
        "       a benchmark cell failed, a best known payload was not verified,\n"
        "       doctor found a fault, a robot was refused or does not carry its\n"
        "       payload, or a drive stopped\n"
        "  2    invalid input, or a folder that is not writable\n"
        "  130  interrupted"
    ),
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        from cablebot_gym import __version__

        print(f"cablebot_gym {__version__}")


BUILT_IN = {
    name: EntryPoint(name, value, COMMAND_GROUP)
    for group in COMMANDS.values()
    for name, value in group.items()
}
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
    present = {item.name for item in app.registered_commands}
    for name, point in points.items():
        if name not in present:
            app.command(name=name, cls=GroupedOptions)(with_options(point.load()))


def main() -> None:
    """Runs the command line. Converts errors to a message of one line and an exit status."""
    protect_streams()
    try:
        _run()
    except SystemExit as ended:
        if (problem := output_problem()) and not ended.code:
            _fail(f"cannot write to standard output: {problem}. The lines above are the output.", 1)
        raise


def _run() -> None:
    from cablebot_gym.policies import PolicyError

    # the last collection of the process would take 0.2 s and free nothing that matters
    atexit.register(gc.freeze)
    # package.module:factory of the working directory; last, so that no file there hides a package
    sys.path.append("")
    try:
        if len(sys.argv) < 2:
            sys.argv.append("--help")
        typed = sys.argv[1]
        if typed in BUILT_IN:
            add_commands({typed: BUILT_IN[typed]})
        else:
            add_commands(command_points())
        # a number if the parser ended the command, for example after Ctrl-C
        status = app(standalone_mode=False)
        if status == INTERRUPTED:
            raise KeyboardInterrupt
        sys.exit(status if isinstance(status, int) else 0)
    except KeyboardInterrupt:
        _fail("interrupted. No file was left incomplete.", INTERRUPTED)
    except (ValueError, ImportError) as error:
        _fail(sentence_of_user_code(error) or _with_option_names(str(error)), 2)
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
        if message.startswith("No such command"):
            message += f" The commands are {', '.join(command_points())}."
        elif example := _example(sys.argv[1]):
            message += f" Example: {example}"
        _fail(message, getattr(error, "exit_code", 2))


def _example(name: str) -> str:
    """The first example in the docstring of a command; empty if there is no such command."""
    texts = [
        item.callback.__doc__ or ""
        for item in app.registered_commands
        if item.name == name and item.callback
    ]
    match = re.search(r"^ *(?:Example: )?(cablebot .+)$", "\n".join(texts), re.MULTILINE)
    return match[1] if match else ""


def _with_option_names(message: str) -> str:
    """Replaces the Python keyword at the start of an error message by the option that the user
    typed."""
    keyword = re.match(r"(?:error_bounds: )?([a-z][a-z0-9_]*)(?= must )", message)
    typed = {argument.partition("=")[0] for argument in sys.argv}
    if keyword is not None:
        name = keyword[1].replace("_", "-")
        for option in (f"--{name}", f"--{name}-bound"):
            if option in typed:
                return option + message[keyword.end() :]
    return message


def _fail(message: str, status: int) -> None:
    say(f"cablebot: {message}", style="red")
    sys.exit(status)


if __name__ == "__main__":
    main()
