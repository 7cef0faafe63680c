"""Options that several commands have, and what their values stand for."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from cablebot_gym.utils.console import notes_console

EnvId = Annotated[
    str, typer.Argument(metavar="ID", help="Environment, such as CableBot-Spatial-v0; see `cablebot list`.")
]
_POLICY = typer.Option("--policy", help="Installed name, bundle or SB3 file ending in .zip, or package.module:factory.")
PolicyName = Annotated[str, _POLICY]
PolicyNameOrNone = Annotated[str | None, _POLICY]
TrajectoryName = Annotated[
    str | None,
    typer.Option("--trajectory", help='Name, or JSON such as \'{"name": "circle-spatial", "duration": 1.5}\'.'),
]
Known = Annotated[
    bool, typer.Option("--payload-known/--payload-unknown", help="Whether the policy is told the payload.")
]
UncertaintyName = Annotated[
    str | None,
    typer.Option(
        "--uncertainty",
        help="What the policy does not know: table6, sensors, joined by +, JSON, or a .json file.",
    ),
]
Frequency = Annotated[float, typer.Option("--control-frequency", help="Drive commands per second [Hz].")]
PositionBound = Annotated[float, typer.Option("--position-bound", help="Largest position error [m].")]
RotationBound = Annotated[float, typer.Option("--rotation-bound", help="Largest rotation error, task criterion [rad].")]
Seed = Annotated[int, typer.Option("--seed", help="Seed of the environments.")]


def as_data(option: str, text: str | None) -> Any:
    """The text of an option: a name as it is, JSON, or a file of it, as what it holds."""
    if text is not None and text.endswith(".json"):
        try:
            text = Path(text).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ValueError(f"{option}: cannot read {text!r} ({error})") from error
        if not text.lstrip().startswith("{"):
            raise ValueError(f"{option}: the file has to hold a JSON object, {{…}}")
    if text is None or not text.lstrip().startswith("{"):
        return text
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{option} is no valid JSON: {error}") from error


def split_names(text: str | None) -> list[str]:
    """Names separated by commas."""
    return [name.strip() for name in (text or "").split(",") if name.strip()]


def counted(count: int, thing: str) -> str:
    """A count in words, such as ``2 draws``."""
    return f"{count} {thing}{'' if count == 1 else 's'}"


def note_purpose(names: list[str], env_id: str) -> None:
    """Says so when a policy is made for other environments: it runs all the same, and seldom well."""
    from cablebot_gym.policies import policy_entries

    entries = policy_entries()
    for name in names:
        if name in entries and env_id not in entries[name].env_ids:
            meant = ", ".join(entries[name].env_ids)
            notes_console().print(f"note: {name} is made for {meant}, not for {env_id}")


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int, int, int], None]]:
    """A bar on standard error, moved by calls with description, place, places, steps done and steps expected."""
    errors = notes_console()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bar:
        task = bar.add_task("preparing", total=1.0)

        def step(description: str, place: int, places: int, done: int, expected: int) -> None:
            bar.update(task, description=description, completed=place + done / expected, total=places)

        yield step
