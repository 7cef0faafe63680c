"""Draws docs/imports.svg: which part of the two packages imports which. Arrows that follow from
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


def part_of(module: str) -> str:
    """Part of a module: its package in ``cablebot_gym`` or ``cablebot_baselines``, or a module at
    the root."""
    names = module.split(".")
    if names[0] not in PACKAGES or len(names) < 2 or names[1].startswith("_") or names[1].isupper():
        return ""
    return f"{names[0]}.{names[1]}"


def import_graph() -> dict[str, set[str]]:
    """Imported parts by part."""
    graph: dict[str, set[str]] = {}
    for package, folder in PACKAGES.items():
        for path in sorted(folder.rglob("*.py")):
            part = part_of(".".join([package, *path.relative_to(folder).with_suffix("").parts]))
            if not part:
                continue
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                if isinstance(node, ast.ImportFrom):
                    names = [f"{node.module}.{alias.name}" for alias in node.names]
                graph.setdefault(part, set()).update(part_of(name) for name in names)
    return {
        part: {other for other in others if other in graph and other != part}
        for part, others in graph.items()
    }


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """The graph without the imports that a chain of other imports implies."""
    below: dict[str, set[str]] = {}
    for part in graphlib.TopologicalSorter(graph).static_order():
        below[part] = set().union(*(below[other] | {other} for other in graph[part]))
    return {
        part: {other for other in others if not any(other in below[between] for between in others)}
        for part, others in graph.items()
    }


def levels(graph: dict[str, set[str]]) -> dict[str, int]:
    """Length of the longest chain of imports below each part."""
    level: dict[str, int] = {}
    for part in graphlib.TopologicalSorter(graph).static_order():
        level[part] = 1 + max((level[other] for other in graph[part]), default=-1)
    return level


def positions(graph: dict[str, set[str]]) -> dict[str, tuple[float, float]]:
    """Column and row of each part; a row is sorted by the mean column of the parts that it
    imports."""
    level = levels(graph)
    place = dict[str, tuple[float, float]]()
    for row in range(max(level.values()) + 1):
        parts = [part for part in graph if level[part] == row]

        def mean_column(part: str) -> tuple[float, str]:
            columns = [place[other][0] for other in graph[part]]
            return sum(columns) / len(columns) if columns else 0.0, part

        for index, part in enumerate(sorted(parts, key=mean_column)):
            place[part] = index - (len(parts) - 1) / 2, row
    return place


def draw(graph: dict[str, set[str]]) -> Figure:
    """The figure: parts as boxes above all that they import."""
    place = positions(graph)
    figure = Figure(
        figsize=(8, 0.6 * (1 + max(row for _, row in place.values()))), layout="constrained"
    )
    axes = figure.add_subplot()
    boxes = {}
    for part, (column, row) in place.items():
        package, name = part.split(".")
        box = {"boxstyle": "round,pad=0.35", "facecolor": COLOURS[package], "edgecolor": "none"}
        text = axes.text(
            column, row, name, color="white", ha="center", va="center", fontsize=9, bbox=box
        )
        boxes[part] = text.get_bbox_patch()
    for part, others in graph.items():
        for other in others:
            arrow = {
                "arrowstyle": "-|>",
                "color": "#8c8c8c",
                "linewidth": 0.9,
                "connectionstyle": "arc3,rad=0.08",
            }
            arrow |= {"patchA": boxes[part], "patchB": boxes[other], "shrinkA": 0, "shrinkB": 2}
            axes.annotate("", place[other], place[part], arrowprops=arrow, zorder=1)
    columns = [column for column, _ in place.values()]
    axes.set(
        xlim=(min(columns) - 0.6, max(columns) + 0.6),
        ylim=(-0.6, max(row for _, row in place.values()) + 0.6),
    )
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
