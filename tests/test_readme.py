"""The README is short and its code runs; for its table and links see ``test_pages.py``."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

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
