"""Options of commands as records: each field of a record becomes an option."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from copy import copy
from dataclasses import MISSING, dataclass, fields
from functools import wraps
from typing import Annotated, Any, ClassVar, get_type_hints

import typer


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options that belong together. Each field of a subclass has a type that is annotated with its
    help, or with ``typer.Option``."""

    title: ClassVar[str]
    """Heading of the options in the help."""


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """The command for typer: parameters that are records are replaced by their options, and the help
    in an annotation by an option."""
    parameters: list[inspect.Parameter] = []
    records: dict[str, type[Options]] = {}
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        annotation = parameter.annotation
        if isinstance(annotation, type) and issubclass(annotation, Options):
            records[parameter.name] = annotation
            parameters += _parameters(annotation)
        else:
            # Options come in any order: no parameter has a position.
            parameters.append(
                parameter.replace(
                    kind=inspect.Parameter.KEYWORD_ONLY, annotation=_with_option(annotation)
                )
            )

    @wraps(command)
    def run(**values: Any) -> None:
        for name, record in records.items():
            options = {option.name: values.pop(option.name) for option in fields(record)}
            values[name] = record(**options)
        command(**values)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run


def _with_option(annotation: Any) -> Any:
    """An annotation in which a help is replaced by an option."""
    metadata = getattr(annotation, "__metadata__", ())
    if metadata and isinstance(metadata[0], str):
        return Annotated[annotation.__origin__, typer.Option(help=metadata[0])]
    return annotation


def _parameters(record: type[Options]) -> list[inspect.Parameter]:
    types = get_type_hints(record, include_extras=True)
    parameters = []
    for item in fields(record):
        annotation = _with_option(types[item.name])
        (shared_option,) = annotation.__metadata__
        option = copy(shared_option)  # commands share it, each with its own heading
        option.rich_help_panel = record.title
        default = item.default
        if default is MISSING:
            default = inspect.Parameter.empty
        parameter = inspect.Parameter(
            item.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=default,
            annotation=Annotated[annotation.__origin__, option],
        )
        parameters.append(parameter)
    return parameters
