"""Every file in examples/ runs, and prints what its docstring says."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

from cablebot_gym.identification import identify, read_log
from cablebot_gym.robots import find_robot

EXAMPLES = Path(__file__).parents[1] / "examples"


PAYLOAD = r"payload (?:known|unknown)[^:]*: ([\d.]+) kg"
FRACTION = r": +(\d+)% of"
AFTER_COLON = r"(?m)^[^:]*: (-?[\d.]+)"


def numbers(pattern, text):
    return [float(number) for number in re.findall(pattern, text)]


def first_steps(printed, folder):
    assert printed.endswith("\ncarried\n")
    assert "reference_pose" in printed


def ten_lines(printed, folder):
    """A learned policy beats the laws."""
    assert printed.startswith("76 numbers observed, 6 motors\n")
    laws, adaptive, learned = (float(line.split()[2]) for line in printed.splitlines()[1:])
    assert laws < adaptive < learned


def your_controller(printed, folder):
    fl, controller = numbers(PAYLOAD, printed)
    assert controller > 1.04 * fl


def your_robot(printed, folder):
    """Stronger motors carry more."""
    assert printed.splitlines()[-1].startswith("refused: home_pose")
    carried = numbers(AFTER_COLON, printed)
    assert carried == sorted(carried)
    assert carried[0] < 0.5 * carried[-1]


def identify_winch(printed, folder):
    """The logs of the page give the values of the script."""
    robot = find_robot(EXAMPLES / "square.toml")
    logs = [read_log(folder / "lifts" / name, robot) for name in ("2kg.csv", "6kg.csv")]
    truth = (8e-4, 0.01, 0.05, 0.04)
    for item, value in zip(identify(robot, logs).estimates, truth, strict=True):
        assert item.is_determined
        assert abs(item.value - value) < 2 * item.half_width


def identify_platform(printed, folder):
    """The logs of the page give the stiffness of the script."""
    robot = find_robot("flex-gch-klaus")
    logs = [read_log(folder / "motions" / name, robot) for name in ("0.3kg.csv", "1kg.csv")]
    estimates = identify(robot, logs).estimates
    stiffnesses = [item.value for item in estimates if item.name == "axial_stiffness"]
    assert len(stiffnesses) == 4
    assert all(abs(value / 15e3 - 1) < 0.01 for value in stiffnesses)


def your_trajectory(printed, folder):
    """Faster motions carry less."""
    slow, middle, fast = numbers(PAYLOAD, printed)
    assert slow > 1.3 * middle > 1.3**2 * fast > 0


def your_reward(printed, folder):
    """Heavier payloads earn less."""
    light, middle, heavy = numbers(AFTER_COLON, printed)
    assert 800 > light > middle + 1 > heavy + 50


def many_at_once(printed, folder):
    fractions = numbers(FRACTION, printed)
    assert len(fractions) == 8
    assert fractions[0] == 100
    assert fractions[-1] == 0


def what_if_it_is_heavier(printed, folder):
    """An estimate of the payload helps."""
    fl, _, adaptive = numbers(FRACTION, printed)
    assert adaptive > fl
    assert numbers(PAYLOAD, printed)[0] > 2


def record_a_video(printed, folder):
    with Image.open(folder / "out.gif") as video:
        assert video.size == (800, 300)
        assert video.n_frames > 20


def train_in_a_minute(printed, folder):
    fl, learned = numbers(PAYLOAD, printed)
    assert learned > 1.4 * fl
    assert (folder / "out" / "best.zip").is_file()


def train_with_sb3(printed, folder):
    assert numbers(PAYLOAD, printed)[-1] > 1.9
    assert (folder / "out" / "mine.zip").is_file()


def paper_figure(printed, folder):
    assert "motor 2 reaches its torque limit at t = 0.500 s" in printed
    with Image.open(folder / "out.png") as figure:
        assert min(figure.size) > 600


def minari_dataset(printed, folder):
    """Actions replay bit for bit, without violation."""
    lines = printed.splitlines()
    returns = [float(line.split()[-1]) for line in lines[1:-1]]
    assert len(returns) == 8
    assert min(returns) > 800
    assert lines[-1].endswith("at most 0.0")
    dataset = folder / "out" / "cablebot-spatial" / "ppo-circle-v0"
    for name in ("data/main_data.hdf5", "DATASHEET.md", "croissant.json"):
        assert (dataset / name).is_file()


FAST = (first_steps, identify_winch)
SLOW = (
    identify_platform,
    ten_lines,
    your_controller,
    your_robot,
    your_trajectory,
    your_reward,
    many_at_once,
    what_if_it_is_heavier,
    record_a_video,
    train_in_a_minute,
    train_with_sb3,
    paper_figure,
    minari_dataset,
)
"""Checks of what the examples of the same names print."""


def run(command, folder):
    ran = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    assert ran.returncode == 0, ran.stderr
    assert "Traceback" not in ran.stderr
    return ran.stdout


@pytest.mark.parametrize(
    "check", [*FAST, *(pytest.param(check, marks=pytest.mark.slow) for check in SLOW)]
)
def test_example_prints_its_result(check, tmp_path):
    path = EXAMPLES / f"{check.__name__}.py"
    check(run([sys.executable, str(path), str(tmp_path / "out")], tmp_path), tmp_path)
    assert f"python examples/{path.name}" in path.read_text(encoding="utf-8")


def test_every_example_is_checked():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {
        check.__name__ for check in FAST + SLOW
    }


@pytest.mark.slow
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
