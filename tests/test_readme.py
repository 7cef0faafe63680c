"""The README is short and its code runs; for its table and links see ``test_pages.py``."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("index", [0, 1, 2])
def test_python_of_the_readme_runs(index, tmp_path):
    # seconds
    code = re.findall(r"```python\n(.*?)```", README, re.DOTALL)[index].replace("400_000", "1_000")
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0
    assert ran.stderr == ""
    assert re.search(r"payload known(, not isolated)?: \d\.\d+ kg", ran.stdout)


def test_training_of_the_readme_is_that_of_the_example():
    """A test of the examples runs it in full: it carries at least 1.9 kg."""
    example = (
        (ROOT / "examples" / "train_with_sb3.py")
        .read_text(encoding="utf-8")
        .replace(" verbose=1,", "")
    )
    steps = re.search(r"model\.learn\((\S+)\)", README)[1]
    assert f"else {steps}\n" in example
    for line in re.findall(r"^(?:envs|model) = .*$", README, re.MULTILINE):
        assert line.replace('"CableBot-Planar-v0"', "ENV_ID") in example
