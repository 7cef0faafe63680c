"""The logs that the examples write give the values of the scripts."""

import runpy
from pathlib import Path

import pytest

from cablebot_gym.robots import find_robot
from cablebot_winches.identification import identify, read_log

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "winches" / "examples"


def test_logs_of_a_winch(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(EXAMPLES / "identify_winch.py"))
    robot = find_robot(ROOT / "examples" / "square.toml")
    logs = [read_log(Path("lifts") / name, robot) for name in ("2kg.csv", "6kg.csv")]
    truth = (8e-4, 0.01, 0.05, 0.04)
    for item, value in zip(identify(robot, logs).estimates, truth, strict=True):
        assert item.is_determined
        assert abs(item.value - value) < 2 * item.half_width


@pytest.mark.nightly
def test_logs_of_a_platform(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(EXAMPLES / "identify_platform.py"))
    robot = find_robot("flex-gch-klaus")
    logs = [read_log(Path("motions") / name, robot) for name in ("0.3kg.csv", "1kg.csv")]
    estimates = identify(robot, logs).estimates
    stiffnesses = [item.value for item in estimates if item.name == "axial_stiffness"]
    assert len(stiffnesses) == 4
    assert all(abs(value / 15e3 - 1) < 0.01 for value in stiffnesses)
