"""Options that several commands share, and functions that convert their values."""

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
    str, typer.Argument(metavar="ID", help="Environment id, such as CableBot-Spatial-v0. `cablebot list` shows all.")
]
_POLICY = typer.Option(
    "--policy", help="Name of an installed policy, a bundle or SB3 file ending in .zip, or package.module:factory."
)
PolicyName = Annotated[str, _POLICY]
PolicyNameOrNone = Annotated[str | None, _POLICY]
TrajectoryName = Annotated[
    str | None,
    typer.Option(
        "--trajectory",
        help='Name of a trajectory, or JSON such as \'{"name": "circle-spatial", "duration": 1.5}\'. '
        "`cablebot list` shows the fields. The default is the paper's trajectory for the robot.",
    ),
]
PayloadKnown = Annotated[
    bool, typer.Option("--payload-known/--payload-unknown", help="Whether the policy's model includes the payload.")
]
ModelPayloadFactor = Annotated[
    float, typer.Option("--model-payload-factor", help="Payload of the policy's model over the nominal payload.")
]
UncertaintyName = Annotated[
    str | None,
    typer.Option(
        "--uncertainty",
        help="Model error: a name such as table6, names joined by +, JSON, or a .json file. "
        "`cablebot list` shows the names and fields.",
    ),
]
Frequency = Annotated[float, typer.Option("--control-frequency", help="Control steps per second [Hz].")]
PositionBound = Annotated[float, typer.Option("--position-bound", help="Largest allowed position error [m].")]
RotationBound = Annotated[
    float,
    typer.Option("--rotation-bound", help="Largest allowed rotation error [rad]. Only the task criterion checks it."),
]
Seed = Annotated[int, typer.Option("--seed", help="Seed of the environments.")]


def as_data(option: str, text: str | None) -> Any:
    """The value of an option: JSON or the content of a .json file as data, and any other text unchanged.

    Raises:
        ValueError: if the file cannot be read, or the JSON is invalid.
    """
    if text is not None and text.endswith(".json"):
        try:
            text = Path(text).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise ValueError(f"{option}: cannot read {text!r} ({error})") from error
        if not text.lstrip().startswith("{"):
            raise ValueError(f"{option}: the file must hold a JSON object, {{…}}")
    if text is None or not text.lstrip().startswith("{"):
        return text
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{option} is not valid JSON: {error}") from error


def split_names(text: str | None) -> list[str]:
    """Names from a list separated by commas."""
    return [name.strip() for name in (text or "").split(",") if name.strip()]


def counted(count: int, noun: str) -> str:
    """A count with its noun, such as ``2 draws``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def note_unsupported(names: list[str], env_id: str) -> None:
    """Prints a note for each policy that does not list the environment as supported. Such a policy still runs."""
    from cablebot_gym.policies import policy_entries

    entries = policy_entries()
    for name in names:
        if name in entries and env_id not in entries[name].env_ids:
            supported = ", ".join(entries[name].env_ids)
            notes_console().print(f"note: {name} is designed for {supported}, not for {env_id}")


@contextmanager
def progress_bar() -> Iterator[Callable[[str, int, int, int, int], None]]:
    """Shows a progress bar on standard error.

    Yields a function of a description, the index of the current stage, the number of stages, the steps done and the
    steps expected in this stage.
    """
    errors = notes_console()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=errors, transient=True, disable=not errors.is_terminal) as bar:
        task = bar.add_task("preparing", total=1.0)

        def step(description: str, stage: int, stages: int, done: int, expected: int) -> None:
            bar.update(task, description=description, completed=stage + done / expected, total=stages)

        yield step
