"""A page for each public module or package, which autodoc fills."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

import cablebot_gym
from generate.folder import Folder

BASELINES = (
    "cablebot_baselines.classical",
    "cablebot_baselines.optimal",
    "cablebot_baselines.learned",
    "cablebot_baselines.learned.wrappers",
)
"""Packages of the baselines that have a page; each shows all modules that stand directly in it."""


def pages() -> dict[str, list[str]]:
    """Pages, and the modules on each: a package comes first, and its public modules follow."""
    listed: dict[str, list[str]] = {}
    for module in cablebot_gym.PUBLIC:
        parts = module.split(".")
        listed.setdefault(".".join(parts[:2]), []).append(module)
    for package in BASELINES:
        found = pkgutil.iter_modules(importlib.import_module(package).__path__, f"{package}.")
        listed[package] = [package, *(one.name for one in found if not one.ispkg)]
    return listed


def write(folder: Folder) -> None:
    """All pages."""
    for name, modules in pages().items():
        folder.write(f"api/{name}.rst", page(name, modules))


def page(name: str, modules: list[str]) -> str:
    """The directives of a page."""
    text = f"{_title(name, '=')}\n"
    for module in modules:
        if module != name:
            text += f"\n{_title(module, '-')}\n"
        is_package = hasattr(importlib.import_module(module), "__path__")
        text += f".. automodule:: {module}\n" + ("" if is_package else "   :members:\n   :show-inheritance:\n")
        if module == "cablebot_gym":
            text += "".join(f"\n.. autodata:: {module}.{data}\n" for data in ("ENV_IDS", "PUBLIC"))
        if is_package:
            text += _exported(importlib.import_module(module))
    return text


def _exported(package: ModuleType) -> str:
    """Names that a package gives away itself."""
    names = getattr(package, "__all__", ())
    listed = ", ".join(f"``{name}``" for name in names)
    return f"\nTo import from ``{package.__name__}``: {listed}.\n" if names else ""


def _title(text: str, line: str) -> str:
    return f"{text}\n{line * len(text)}\n"
