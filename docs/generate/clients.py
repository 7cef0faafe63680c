"""A page for each script of ``examples/clients/``, and a table of what ``.ci/clients`` saw of them."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import Any

from cablebot_gym.benchmark.tables import markdown_table
from generate.pages import Pages

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "clients.json"

RAN = ["package", "version", "Gymnasium", "constraints", "what it printed", "time [s]"]

_CONSTRAINTS = re.compile(r'^# constraints = "(.+)"$', re.MULTILINE)


def write(pages: Pages) -> None:
    """Writes the table, and a page for each script."""
    rows = [["script", "what it shows", *RAN]]
    for name, ran in json.loads(RESULTS.read_text(encoding="utf-8")).items():
        script = f"use_{name}.py"
        code = (ROOT / "examples" / "clients" / script).read_text(encoding="utf-8")
        about, *_ = (ast.get_docstring(ast.parse(code)) or "").split("\n\n")
        about = about.replace("\n", " ")
        rows.append([f"[`{script}`](/generated/clients/{name}.md)", about, *_cells(ran, code)])
        facts = zip(RAN, _cells(ran, code), strict=True)
        text = "".join(f"* {head}: {cell}\n" for head, cell in facts)
        pages.write(
            f"clients/{name}.md", f"# {script}\n\n{about}\n\n{text}\n```python\n{code}```\n"
        )
    pages.write("clients.inc", markdown_table(rows))


def _cells(ran: dict[str, Any], code: str) -> list[str]:
    """Package, versions, constraints, figure or error, and time of a script."""
    printed = ran["figure"]
    if ran["error"] is not None:
        printed = f"**error**: {ran['error']}"
    versions = [ran["version"] or "–", ran.get("gymnasium") or "–"]
    constraints = _CONSTRAINTS.search(code)
    file = "constraints.txt" if constraints is None else constraints[1]
    return [ran["client"], *versions, f"`{file}`", printed, str(ran["seconds"] or "–")]
