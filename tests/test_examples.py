"""Every file in examples/ runs, and prints what its docstring says."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

EXAMPLES = Path(__file__).parents[1] / "examples"


PAYLOAD = r"payload (?:known|unknown)[^:]*: ([\d.]+) kg"
FRACTION = r": +(\d+)% of"
AFTER_COLON = r"(?m)^[^:]*: (-?[\d.]+)"


def numbers(pattern, text):
    return [float(number) for number in re.findall(pattern, text)]


def first_steps(printed, folder):
    assert printed.endswith("\ncarried\n")


def ten_lines(printed, folder):
    """A learned policy beats the laws."""
    laws, observing, learned = (float(line.split()[2]) for line in printed.splitlines()[1:])
    assert laws < observing < learned


def your_controller(printed, folder):
    fl, controller = numbers(PAYLOAD, printed)
    assert controller > 1.04 * fl


def your_robot(printed, folder):
    """Stronger motors carry more."""
    assert printed.splitlines()[-1].startswith("refused: home_pose")
    carried = numbers(AFTER_COLON, printed)
    assert carried == sorted(carried)


def your_trajectory(printed, folder):
    """Faster motions carry less."""
    slow, middle, fast = numbers(PAYLOAD, printed)
    assert slow > 1.3 * middle > 1.3**2 * fast > 0


def your_reward(printed, folder):
    """Heavier payloads earn less."""
    light, middle, heavy = numbers(AFTER_COLON, printed)
    assert 800 > light > middle + 1 > heavy + 50


def tune_gains(printed, folder):
    """Gains that are too high fail unloaded."""
    *others, best, too_high, largest = numbers(r" ([\d.]+) kg", printed)
    assert max(others) < best == largest
    assert too_high == 0
    assert "payload None" in printed


def many_at_once(printed, folder):
    fractions = numbers(FRACTION, printed)
    assert (len(fractions), fractions[0], fractions[-1]) == (8, 100, 0)


def what_if_it_is_heavier(printed, folder):
    """An estimate of the payload helps."""
    fl, _, observing = numbers(FRACTION, printed)
    assert observing > fl


def record_a_video(printed, folder):
    with Image.open(folder / "out.gif") as video:
        assert video.n_frames > 20


def train_with_sb3(printed, folder):
    """Without its learner the law carries 1.77 kg."""
    assert numbers(PAYLOAD, printed)[-1] > 1.6


def paper_figure(printed, folder):
    assert "motor 2 reaches its torque limit at t = 0.500 s" in printed
    assert (folder / "out.png").is_file()


CHECKS = (
    first_steps,
    ten_lines,
    your_controller,
    your_robot,
    your_trajectory,
    your_reward,
    tune_gains,
    many_at_once,
    what_if_it_is_heavier,
    record_a_video,
    train_with_sb3,
    paper_figure,
)
"""Checks of what the examples of the same names print."""


def run(command, folder):
    ran = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    assert ran.returncode == 0, ran.stderr
    assert "Traceback" not in ran.stderr
    return ran.stdout


@pytest.mark.landing
@pytest.mark.parametrize("check", CHECKS)
def test_example_prints_its_result(check, tmp_path):
    path = EXAMPLES / f"{check.__name__}.py"
    check(run([sys.executable, str(path), str(tmp_path / "out")], tmp_path), tmp_path)
    assert f"python examples/{path.name}" in path.read_text(encoding="utf-8")


def test_every_example_is_checked():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {check.__name__ for check in CHECKS}


@pytest.mark.landing
def test_notebook_prints_its_stored_output(tmp_path):
    """Its code runs as one script: tests need no Jupyter. `jupyter nbconvert --execute --inplace`
    stores outputs."""
    cells = json.loads((EXAMPLES / "tour.ipynb").read_text(encoding="utf-8"))["cells"]
    scripts = []
    stored = ""
    pictures = 0
    for cell in cells:
        if cell["cell_type"] == "code":
            scripts.append("".join(cell["source"]))
            for output in cell["outputs"]:
                stored += "".join(output.get("text", ()))
                pictures += "image/png" in output.get("data", {})
    printed = run([sys.executable, "-c", "\n".join(scripts)], tmp_path)
    assert numbers(PAYLOAD, printed) == pytest.approx(numbers(PAYLOAD, stored), abs=2e-3)
    assert len(printed.splitlines()) == len(stored.splitlines())
    assert pictures == 2
