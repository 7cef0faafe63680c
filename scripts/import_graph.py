"""Draws docs/imports.svg: which room of the two packages imports which. Arrows that follow from
others are left out."""

from __future__ import annotations

import ast
import graphlib
import re
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

ROOT = Path(__file__).parents[1]
PACKAGES = {
    "cablebot_gym": ROOT / "cablebot_gym",
    "cablebot_baselines": ROOT / "baselines" / "cablebot_baselines",
}
COLOURS = {"cablebot_gym": "#0072b2", "cablebot_baselines": "#d55e00"}


def room_of(module: str) -> str:
    """Room of a module: its package in ``cablebot_gym`` or ``cablebot_baselines``, or a module at
    the root; empty for other modules."""
    names = module.split(".")
    if names[0] not in PACKAGES or len(names) < 2 or names[1].startswith("_") or names[1].isupper():
        return ""
    return f"{names[0]}.{names[1]}"


def imported_names(path: Path) -> list[str]:
    """Full names that a file imports anywhere in its code."""
    names = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names += [f"{node.module}.{alias.name}" for alias in node.names]
    return names


def import_graph() -> dict[str, set[str]]:
    """Imported rooms by room."""
    graph: dict[str, set[str]] = {}
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            room = room_of(".".join([package, *path.relative_to(folder).with_suffix("").parts]))
            if room:
                graph.setdefault(room, set()).update(map(room_of, imported_names(path)))
    for room, imported in graph.items():
        imported &= graph.keys() - {room}
        graph[room] = imported
    return graph


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """The graph without the imports that a chain of other imports implies."""
    below: dict[str, set[str]] = {}
    direct: dict[str, set[str]] = {}
    for room in graphlib.TopologicalSorter(graph).static_order():
        implied = set().union(*(below[imported] for imported in graph[room]))
        below[room] = graph[room] | implied
        direct[room] = graph[room] - implied
    return {room: direct[room] for room in graph}


def levels(graph: dict[str, set[str]]) -> dict[str, int]:
    """Length of the longest chain of imports below each room."""
    level: dict[str, int] = {}
    for room in graphlib.TopologicalSorter(graph).static_order():
        level[room] = 1 + max((level[imported] for imported in graph[room]), default=-1)
    return level


def positions(graph: dict[str, set[str]]) -> dict[str, tuple[float, float]]:
    """Column and row of each room; a row is sorted by the mean column of the rooms that it
    imports."""
    level = levels(graph)
    position = dict[str, tuple[float, float]]()
    for row in range(max(level.values()) + 1):
        ranked = []
        for room in graph:
            if level[room] == row:
                columns = [position[imported][0] for imported in graph[room]]
                ranked.append((sum(columns) / max(len(columns), 1), room))
        for index, (_, room) in enumerate(sorted(ranked)):
            position[room] = index - (len(ranked) - 1) / 2, row
    return position


def draw(graph: dict[str, set[str]]) -> Figure:
    """The figure: rooms as boxes above all that they import."""
    position = positions(graph)
    columns, rows = zip(*position.values(), strict=True)
    figure = Figure(figsize=(8, 0.6 * (1 + max(rows))), layout="constrained")
    axes = figure.add_subplot()
    boxes = {}
    for room, (column, row) in position.items():
        package, name = room.split(".")
        box = {"boxstyle": "round,pad=0.35", "facecolor": COLOURS[package], "edgecolor": "none"}
        text = axes.text(
            column, row, name, color="white", ha="center", va="center", fontsize=9, bbox=box
        )
        boxes[room] = text.get_bbox_patch()
    for room, imported_rooms in graph.items():
        for imported in sorted(imported_rooms):
            arrow = {
                "arrowstyle": "-|>",
                "color": "#8c8c8c",
                "linewidth": 0.9,
                "connectionstyle": "arc3,rad=0.08",
                "patchA": boxes[room],
                "patchB": boxes[imported],
                "shrinkA": 0,
                "shrinkB": 2,
            }
            axes.annotate("", position[imported], position[room], arrowprops=arrow, zorder=1)
    axes.set(xlim=(min(columns) - 0.6, max(columns) + 0.6), ylim=(-0.6, max(rows) + 0.6))
    axes.axis("off")
    return figure


if __name__ == "__main__":
    mpl.rcParams |= {"svg.hashsalt": "imports", "svg.fonttype": "none"}
    path = ROOT / "docs" / "imports.svg"
    draw(reduced(import_graph())).savefig(path, transparent=True, metadata={"Date": None})
    path.write_text(
        re.sub(r" +$", "", path.read_text(encoding="utf-8"), flags=re.M), encoding="utf-8"
    )
    print(f"wrote {path.relative_to(ROOT)}")
