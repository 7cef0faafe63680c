"""Options that several commands have, and what their values stand for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

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
