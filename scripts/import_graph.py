"""Draws docs/imports.svg: which room of the two packages imports which. Arrows that follow from
others are left out."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import matplotlib as mpl
import networkx as nx  # comes with torch
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


def import_graph() -> nx.DiGraph:
    """Rooms with an edge to each room that they import."""
    graph = nx.DiGraph()
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            room = room_of(".".join([package, *path.relative_to(folder).with_suffix("").parts]))
            imported = map(room_of, imported_names(path))
            graph.add_edges_from((room, name) for name in imported if name != room)
    graph.remove_node("")  # other modules
    return graph


def positions(graph: nx.DiGraph) -> dict[str, tuple[float, float]]:
    """Column and row of each room; a row is sorted by the mean column of the rooms that it
    imports."""
    position = dict[str, tuple[float, float]]()
    for row, rooms in enumerate(nx.topological_generations(graph.reverse())):
        ranked = []
        for room in rooms:
            columns = [position[imported][0] for imported in graph[room]]
            ranked.append((sum(columns) / max(len(columns), 1), room))
        for index, (_, room) in enumerate(sorted(ranked)):
            position[room] = index - (len(ranked) - 1) / 2, row
    return position


def draw(graph: nx.DiGraph) -> Figure:
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
    for room, imported in sorted(graph.edges):
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
    draw(nx.transitive_reduction(import_graph())).savefig(
        path, transparent=True, metadata={"Date": None}
    )
    path.write_text(
        re.sub(r" +$", "", path.read_text(encoding="utf-8"), flags=re.M), encoding="utf-8"
    )
    print(f"wrote {path.relative_to(ROOT)}")
