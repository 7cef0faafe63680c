"""Every file in examples/ runs, and prints what its docstring says."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))
FAST = ("first_steps",)


def payloads(lines: list[str]) -> list[float]:
    """Printed payloads [kg]."""
    return [
        float(match[1]) for line in lines if (match := re.search(r"payload (?:known|unknown)[^:]*: ([\d.]+) kg", line))
    ]


def fractions(lines: list[str]) -> list[float]:
    """Percentages of lines such as `fl: 40% of the draws`."""
    return [float(match[1]) for line in lines if (match := re.search(r": +(\d+)% of", line))]


def learned_policy_carries_more(lines: list[str], folder: Path) -> bool:
    fl, learned = payloads(lines)
    return learned > 1.4 * fl and (folder / "out" / "best.zip").is_file()


def own_controller_carries_more(lines: list[str], folder: Path) -> bool:
    fl, your_own = payloads(lines)
    return your_own > 1.04 * fl


def stronger_motors_carry_more(lines: list[str], folder: Path) -> bool:
    carried = [float(line.split(": ")[1].split()[0]) for line in lines[:-1]]
    return carried == sorted(carried) and carried[0] < 0.5 * carried[-1] and lines[-1].startswith("refused: home_pose")


def faster_motions_carry_less(lines: list[str], folder: Path) -> bool:
    carried = payloads(lines)
    return len(carried) == 3 and carried[0] > 1.3 * carried[1] and carried[1] > 1.3 * carried[2] > 0


def heavier_payloads_earn_less(lines: list[str], folder: Path) -> bool:
    light, more, most = (float(line.split(": ")[1].split()[0]) for line in lines)
    return 800 > light > more + 1 > most + 50


def heavy_payloads_fail(lines: list[str], folder: Path) -> bool:
    held = fractions(lines)
    return len(held) == 8 and held[0] == 100 and held[-1] == 0


def estimating_the_payload_helps(lines: list[str], folder: Path) -> bool:
    fl, _, adaptive = fractions(lines)
    return adaptive > fl and payloads(lines)[0] > 2


def trained_policy_is_evaluated(lines: list[str], folder: Path) -> bool:
    return (folder / "out" / "mine.zip").is_file() and payloads(lines)[-1] > 1.9


def video_is_written(lines: list[str], folder: Path) -> bool:
    with Image.open(folder / "out.gif") as video:
        return video.size == (800, 300) and video.n_frames > 20


def figure_is_written(lines: list[str], folder: Path) -> bool:
    with Image.open(folder / "out.png") as figure:
        return min(figure.size) > 600 and "motor 2 reaches its torque limit at t = 0.500 s" in lines[0]


def actions_replay_bit_for_bit(lines: list[str], folder: Path) -> bool:
    returns = [float(line.split()[-1]) for line in lines[1:-1]]  # above 800 without violation
    folder_of_data = folder / "out" / "cablebot-spatial" / "apg-circle-v0"
    files = [folder_of_data / name for name in ("data/main_data.hdf5", "DATASHEET.md", "croissant.json")]
    return (
        all(file.is_file() for file in files)
        and len(returns) == 8
        and min(returns) > 800
        and lines[-1].endswith("at most 0.0")
    )


def learned_policy_beats_the_laws(lines: list[str], folder: Path) -> bool:
    carried = [float(line.split()[2]) for line in lines[1:]]
    return lines[0] == "76 numbers observed, 6 motors" and carried == sorted(carried) and len(carried) == 3


RESULTS: dict[str, Callable[[list[str], Path], bool]] = {
    "first_steps": lambda lines, folder: lines[-1] == "carried" and "reference_pose" in "".join(lines),
    "ten_lines": learned_policy_beats_the_laws,
    "your_controller": own_controller_carries_more,
    "your_robot": stronger_motors_carry_more,
    "your_trajectory": faster_motions_carry_less,
    "your_reward": heavier_payloads_earn_less,
    "many_at_once": heavy_payloads_fail,
    "what_if_it_is_heavier": estimating_the_payload_helps,
    "record_a_video": video_is_written,
    "train_in_a_minute": learned_policy_carries_more,
    "train_with_sb3": trained_policy_is_evaluated,
    "paper_figure": figure_is_written,
    "minari_dataset": actions_replay_bit_for_bit,
}


@pytest.mark.parametrize(
    "example",
    [pytest.param(path, id=path.stem, marks=[] if path.stem in FAST else pytest.mark.slow) for path in EXAMPLES],
)
def test_example_prints_its_result(example, tmp_path):
    ran = subprocess.run(
        [sys.executable, str(example), str(tmp_path / "out")],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    assert "Traceback" not in ran.stderr
    assert RESULTS[example.stem](ran.stdout.splitlines(), tmp_path), ran.stdout
    assert f"python examples/{example.name}" in example.read_text(encoding="utf-8")


@pytest.mark.slow
def test_notebook_prints_its_stored_output(tmp_path):
    """Its code runs as one script: tests need no Jupyter. `jupyter nbconvert --execute --inplace` stores outputs."""
    cells = json.loads((EXAMPLES[0].parent / "tour.ipynb").read_text(encoding="utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    script = "\n".join("".join(cell["source"]) for cell in code)
    command = [sys.executable, "-c", script]
    ran = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert ran.returncode == 0, ran.stderr
    outputs = [output for cell in code for output in cell["outputs"]]
    stored = "".join("".join(output["text"]) for output in outputs if "text" in output)
    assert payloads(ran.stdout.splitlines()) == pytest.approx(payloads(stored.splitlines()), abs=2e-3)
    assert len(ran.stdout.splitlines()) == len(stored.splitlines())
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 2
