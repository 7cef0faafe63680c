"""Every file in examples/ runs as its first lines say, and keeps their promise."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from PIL import Image

EXAMPLES = sorted((Path(__file__).parents[1] / "examples").glob("*.py"))


def payloads(lines: list[str]) -> list[float]:
    """Of results as they are printed [kg]."""
    return [
        float(found[1]) for line in lines if (found := re.search(r"payload (?:known|unknown)[^:]*: ([\d.]+) kg", line))
    ]


def fractions(lines: list[str]) -> list[float]:
    """Of lines such as `fl: 40% of the draws`."""
    return [float(found[1]) for line in lines if (found := re.search(r": +(\d+)% of", line))]


def gains_half(lines: list[str], folder: Path) -> bool:
    fl, learned = payloads(lines)
    return learned > 1.4 * fl and (folder / "out" / "best.zip").is_file()


def gains_a_tenth(lines: list[str], folder: Path) -> bool:
    fl, own = payloads(lines)
    return own > 1.1 * fl


def stronger_motors_carry_more(lines: list[str], folder: Path) -> bool:
    carried = [float(line.split(": ")[1].split()[0]) for line in lines[:-1]]
    return carried == sorted(carried) and carried[0] < 0.5 * carried[-1] and lines[-1].startswith("refused: home_pose")


def quicker_motions_leave_less(lines: list[str], folder: Path) -> bool:
    carried = payloads(lines)
    return len(carried) == 3 and carried[0] > 1.3 * carried[1] and carried[1] > 1.3 * carried[2] > 0


def heat_and_errors_cost(lines: list[str], folder: Path) -> bool:
    """The environment's own reward, 1 on the reference whatever the motors give, would hardly tell 0 from 1 kg."""
    light, more, most = (float(line.split(": ")[1].split()[0]) for line in lines)
    return 500 > light > more + 1 > most + 50


def heavy_ones_fail(lines: list[str], folder: Path) -> bool:
    held = fractions(lines)
    return len(held) == 8 and held[0] == 100 and held[-1] == 0


def weighing_helps(lines: list[str], folder: Path) -> bool:
    fl, _, adaptive = fractions(lines)
    return adaptive > fl and payloads(lines)[0] > 2


def judged_though_nothing_is_carried(lines: list[str], folder: Path) -> bool:
    return (folder / "out" / "mine.zip").is_file() and "fails unloaded" in lines[-1]


def video_is_there(lines: list[str], folder: Path) -> bool:
    with Image.open(folder / "out.gif") as video:
        return video.size == (800, 300) and video.n_frames > 20


def figure_is_there(lines: list[str], folder: Path) -> bool:
    with Image.open(folder / "out.png") as figure:
        return min(figure.size) > 600 and "motor 2 at t = 0.500 s" in lines[0]


def actions_replay_to_the_bit(lines: list[str], folder: Path) -> bool:
    demands = [float(line.split()[-1]) for line in lines[1:-1]]
    kept = folder / "out" / "cablebot-spatial" / "apg-circle-v0" / "data" / "main_data.hdf5"
    return (
        kept.is_file() and demands == sorted(set(demands)) and len(demands) == 8 and lines[-1].endswith("at most 0.0")
    )


PROMISES: dict[str, Callable[[list[str], Path], bool]] = {
    "first_steps": lambda lines, folder: lines[-1] == "carried" and "reference_pose" in "".join(lines),
    "your_controller": gains_a_tenth,
    "your_robot": stronger_motors_carry_more,
    "your_trajectory": quicker_motions_leave_less,
    "your_reward": heat_and_errors_cost,
    "many_at_once": heavy_ones_fail,
    "what_if_it_is_heavier": weighing_helps,
    "record_a_video": video_is_there,
    "train_in_a_minute": gains_half,
    "train_with_sb3": judged_though_nothing_is_carried,
    "paper_figure": figure_is_there,
    "minari_dataset": actions_replay_to_the_bit,
}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs_and_keeps_its_promise(example, tmp_path):
    ran = subprocess.run(
        [sys.executable, str(example), str(tmp_path / "out")], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert "Traceback" not in ran.stderr
    assert PROMISES[example.stem](ran.stdout.splitlines(), tmp_path), ran.stdout
    assert f"python examples/{example.name}" in example.read_text(encoding="utf-8")


def test_your_own_robot_trajectory_controller_or_reward_takes_less_than_30_lines():
    own = {path.stem: len(path.read_text(encoding="utf-8").splitlines()) for path in EXAMPLES if "your_" in path.name}
    assert own.keys() >= {"your_robot", "your_trajectory", "your_controller", "your_reward"}
    assert max(own.values()) < 30, own
