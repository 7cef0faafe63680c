"""Options of commands as records: each field of a record becomes an option."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection
from copy import copy
from dataclasses import MISSING, dataclass, fields
from functools import wraps
from typing import Annotated, Any, ClassVar, get_type_hints

import typer
from typer.core import TyperCommand


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options that belong together. Each field of a subclass has a type that is annotated with its
    help, or with ``typer.Option``."""

    title: ClassVar[str]
    """Heading of the options in the help."""


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """The command for typer: parameters that are records are replaced by their options, and the help
    in an annotation by an option. ``Annotated[Record, names]`` has the options with these names
    alone."""
    parameters: list[inspect.Parameter] = []
    records: dict[str, tuple[type[Options], tuple[str, ...]]] = {}
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        annotation = parameter.annotation
        record = getattr(annotation, "__origin__", annotation)
        if isinstance(record, type) and issubclass(record, Options):
            names = tuple(item.name for item in fields(record))
            if record is not annotation:
                (names,) = annotation.__metadata__
            records[parameter.name] = record, names
            parameters += _parameters(record, names)
        else:
            # Options come in any order: no parameter has a position.
            parameters.append(
                parameter.replace(
                    kind=inspect.Parameter.KEYWORD_ONLY, annotation=_with_option(annotation)
                )
            )

    @wraps(command)
    def run(**values: Any) -> None:
        for name, (record, names) in records.items():
            options = {option: values.pop(option) for option in names}
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


def _parameters(record: type[Options], names: Collection[str]) -> list[inspect.Parameter]:
    types = get_type_hints(record, include_extras=True)
    parameters = []
    for item in fields(record):
        if item.name not in names:
            continue
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


class GroupedOptions(TyperCommand):
    """A command whose help groups the options by their record."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Writes the arguments, the options of the command alone, and those of each record."""
        groups: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            row = parameter.get_help_record(ctx)
            title = getattr(parameter, "rich_help_panel", None) or "Options"
            if parameter.param_type_name == "argument":
                title = "Arguments"
            if row is not None:
                groups.setdefault(title, []).append(row)
        for title, rows in groups.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)
