"""The README: short, its code runs, and its table is that of the stored results."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from readme_table import readme_table, with_table

from cablebot_gym.benchmark.leaderboard import Results

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_readme_is_short_and_has_python_near_its_top():
    lines = README.splitlines()
    assert len(README.split()) <= 1200
    assert lines.index("```python") < 40


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 1])
def test_python_of_the_readme_runs(index, tmp_path):
    code = re.findall(r"```python\n(.*?)```", README, re.DOTALL)[index]
    ran = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert re.search(r"payload known: \d\.\d+ kg", ran.stdout)


def test_table_of_the_readme_has_the_stored_results():
    results = Results.from_json((ROOT / "docs" / "leaderboard" / "results.json").read_text(encoding="utf-8"))
    assert with_table(README, readme_table(results)) == README, "make it anew: python scripts/readme_table.py"


def test_every_link_of_the_readme_leads_to_a_file():
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", README)
    assert links
    assert [link for link in links if not link.startswith("https://") and not (ROOT / link).exists()] == []
