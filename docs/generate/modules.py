"""A page for each public module or package, which autodoc fills."""

from __future__ import annotations

import importlib
from types import ModuleType

from generate.folder import Folder

MODULES: dict[str, tuple[str, ...]] = {
    "cablebot_gym": ("",),
    "cablebot_gym.envs": ("", "single", "vector", "observation", "settings"),
    "cablebot_gym.robots": ("",),
    "cablebot_gym.trajectories": ("",),
    "cablebot_gym.uncertainty": ("",),
    "cablebot_gym.task": ("",),
    "cablebot_gym.policies": ("",),
    "cablebot_gym.rollout": ("",),
    "cablebot_gym.dlcc": (
        *("", "evaluator", "result", "monitor", "comparison", "exact", "optimum", "certificate"),
        *("paper_algorithm", "probability", "batch"),
    ),
    "cablebot_gym.benchmark": ("", "suites", "cells", "run", "store", "score", "maps", "leaderboard", "ray_backend"),
    "cablebot_gym.planning": ("", "program", "motion", "following", "library"),
    "cablebot_gym.kinematics": ("",),
    "cablebot_gym.physics": ("textbook", "inverse"),
    "cablebot_gym.rendering": ("", "moment", "painter", "camera", "window"),
    "cablebot_gym.films": ("", "film"),
    "cablebot_gym.report": ("", "page", "replay", "recording"),
    "baselines.classical": (
        *("", "law", "outer_loop", "feedback_linearization", "robust", "adaptive", "allocation"),
        *("flexible", "flex_eq22"),
    ),
    "baselines.optimal": ("", "tube", "nmpc", "horizon"),
    "baselines.learned": ("", "shipped", "policy", "bundle", "network", "features", "steering", "base", "vec_env"),
    "baselines.learned.wrappers": ("", "limits", "curriculum", "steered", "batch", "layers"),
}
"""Pages, and what stands on each: the package itself ("") and its modules."""


def write(folder: Folder) -> None:
    """All pages."""
    for name, parts in MODULES.items():
        folder.write(f"api/{name}.rst", page(name, parts))


def page(name: str, parts: tuple[str, ...]) -> str:
    """The directives of a page."""
    text = f"{_title(name, '=')}\n"
    for part in parts:
        module = f"{name}.{part}" if part else name
        if part:
            text += f"\n{_title(module, '-')}\n"
        options = "" if part == "" and len(parts) > 1 else "   :members:\n   :show-inheritance:\n"
        text += f".. automodule:: {module}\n{options}"
        if module == "cablebot_gym":
            text += f"\n.. autodata:: {module}.ENV_IDS\n"
        if not options:
            text += _exported(importlib.import_module(module))
    return text


def _exported(package: ModuleType) -> str:
    """Names that a package gives away itself."""
    names = getattr(package, "__all__", ())
    listed = ", ".join(f"``{name}``" for name in names)
    return f"\nTo import from ``{package.__name__}``: {listed}.\n" if names else ""


def _title(text: str, line: str) -> str:
    return f"{text}\n{line * len(text)}\n"
