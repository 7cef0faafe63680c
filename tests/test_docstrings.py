"""Everything public says what it is, and what each of its parameters and fields means."""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import re
import textwrap
from collections.abc import Iterator
from itertools import pairwise
from types import ModuleType
from typing import Any

import baselines
import cablebot_gym

GLOSSARY = {
    name
    for line in re.findall(r"^    (\w[\w, ]*): ", str(cablebot_gym.__doc__), re.MULTILINE)
    for name in line.split(", ")
}
"""Parameters that mean the same everywhere; the package's docstring has what."""

INTERNAL = ("cablebot_gym.physics.kernel", "cablebot_gym.envs.outcome", "baselines.reproduction")
"""Compiled code, whose arrays are described once and row by row, and the parts of one command: docstrings, but no
parameter by parameter."""

REFERRED = re.compile(r"[Aa]rguments( and errors)? (are those of|as)\b")
"""A docstring that says where the arguments are described."""


def modules() -> Iterator[ModuleType]:
    """All that are public, of both packages."""
    for package in (cablebot_gym, baselines):
        yield package
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if not any(part.startswith("_") for part in found.name.split(".")):
                yield importlib.import_module(found.name)


def public(module: ModuleType) -> Iterator[tuple[str, Any, str]]:
    """Classes, functions and methods that are defined in a module: name, thing, docstring."""
    for name, item in vars(module).items():
        if name.startswith("_") or getattr(item, "__module__", None) != module.__name__:
            continue
        if inspect.isfunction(item):
            yield name, item, item.__doc__ or ""
        elif inspect.isclass(item):
            yield name, item, item.__dict__.get("__doc__") or ""
            yield from methods(item)


def methods(owner: type) -> Iterator[tuple[str, Any, str]]:
    """Public ones of a class; what overrides a method, such as Gymnasium's ``step``, has its docstring too."""
    for name, item in vars(owner).items():
        function = getattr(item, "__func__", getattr(item, "fget", item))
        if inspect.isfunction(function) and not name.startswith("_"):
            docs = [getattr(base, name).__doc__ or "" for base in owner.__mro__[1:] if hasattr(base, name)]
            yield f"{owner.__qualname__}.{name}", function, "\n".join([function.__doc__ or "", *docs]).strip()


def undocumented(item: Any, doc: str) -> list[str]:
    """Parameters of a function, or fields or arguments of a class, of which nothing tells the meaning."""
    if not inspect.isclass(item):
        wanted = parameters(item)
    elif dataclasses.is_dataclass(item):
        explained = fields_with_docstrings(item)
        own = inspect.get_annotations(item)
        wanted = {name: kind for name, kind in own.items() if not name.startswith("_") and name not in explained}
    else:
        wanted = parameters(item.__init__) if "__init__" in vars(item) and not is_protocol(item) else {}
    if REFERRED.search(doc):
        return []
    return [name for name, kind in wanted.items() if not (name in GLOSSARY or says(doc, name) or is_kind(name, kind))]


def is_protocol(item: type) -> bool:
    return bool(getattr(item, "_is_protocol", False))


def parameters(function: Any) -> dict[str, str]:
    """Names with annotations; an option of a command is documented by its ``help``."""
    named = inspect.signature(function).parameters.values()
    return {
        one.name: str(one.annotation)
        for one in named
        if one.name not in ("self", "cls") and not one.name.startswith("_") and not is_option(str(one.annotation))
    }


def is_option(annotation: str) -> bool:
    """Whether typer makes an option of it, which then has a help."""
    return "typer." in annotation or annotation.removesuffix(" | None") in OPTIONS


OPTIONS = {
    name
    for module in ("cablebot_gym.command_options", "cablebot_gym.cli", "cablebot_gym.films.command")
    for name, kind in vars(importlib.import_module(module)).items()
    if any(getattr(about, "help", None) for about in getattr(kind, "__metadata__", ()))
}
"""Types of options that several commands have."""


def fields_with_docstrings(item: type) -> set[str]:
    """Of a dataclass: those with a string on the next line."""
    (body,) = (node.body for node in ast.parse(textwrap.dedent(inspect.getsource(item))).body)
    return {
        node.target.id
        for node, after in pairwise(body)
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and is_text(after)
    }


def is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def says(doc: str, name: str) -> bool:
    """Whether a text has the name as a word, or as words: ``robot_name`` or its robot name, one of them or many."""
    stem = re.escape(name).replace("_", "[ _-]").removesuffix("s")
    return re.search(rf"(?<!\w){stem}(e?s|ed)?(?!\w)", doc, re.IGNORECASE) is not None


def is_kind(name: str, annotation: str) -> bool:
    """Whether the name is that of its class: ``result: DLCCResult``."""
    stem = name.replace("_", "").removesuffix("s").lower()
    return any(kind.lower().removesuffix("s").endswith(stem) for kind in re.findall(r"\b[A-Z]\w+", annotation))


def test_nothing_public_lacks_a_docstring():
    lacking = [module.__name__ for module in modules() if not module.__doc__]
    lacking += [f"{module.__name__}.{name}" for module in modules() for name, _, doc in public(module) if not doc]
    assert lacking == []


def test_no_public_parameter_is_undocumented():
    lacking = {
        f"{module.__name__}.{name}": names
        for module in modules()
        if not module.__name__.startswith(INTERNAL)
        for name, item, doc in public(module)
        if (names := undocumented(item, doc))
    }
    assert lacking == {}, "say in the docstring what they are, with units and shapes"


def hold(load: float, robot: Any, grip: str, *, hard: bool) -> None:
    """Holds a load [kg] in a grip."""


@dataclasses.dataclass
class Hand:
    """Holds a load."""

    load: float
    fingers: int
    """How many."""
    thumb: bool


def test_rule_does_not_let_a_parameter_or_a_field_through():
    assert undocumented(hold, str(hold.__doc__)) == ["hard"]
    assert undocumented(Hand, str(Hand.__doc__)) == ["thumb"]
    assert not says("its downloads", "load")
    assert "robot" in GLOSSARY
