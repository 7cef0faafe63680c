"""Every file in examples/ runs as its first lines say."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_and_keeps_its_promise(example, tmp_path):
    ran = subprocess.run(
        [sys.executable, str(example), str(tmp_path / "out")], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert "Traceback" not in ran.stderr
    if example.stem == "train_in_a_minute":
        carried = [float(line.partition("payload told: ")[2].split()[0]) for line in ran.stdout.splitlines()[-2:]]
        assert carried[1] > 1.4 * carried[0], "half as much again as fl"
