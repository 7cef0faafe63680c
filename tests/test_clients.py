"""Scripts for other libraries, which `.ci/clients` runs, and their page."""

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_every_client_has_a_script_a_section_and_a_result():
    """A script that the page does not show is not documented; one without result has not run."""
    scripts = {path.name for path in (ROOT / "examples/clients").glob("*.py")}
    page = (ROOT / "docs/use-with.md").read_text(encoding="utf-8")
    results = json.loads((ROOT / "docs/clients.json").read_text(encoding="utf-8"))
    assert set(re.findall(r"examples/clients/(\w+\.py)", page)) == scripts
    assert {f"use_{name}.py" for name in results} == scripts
    for ran in results.values():
        assert (ran["error"] is None) == (ran["figure"] is not None)
