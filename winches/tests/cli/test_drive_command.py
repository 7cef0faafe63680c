"""``cablebot drive`` on the process of the simulated boards."""

import json

import pytest

from cablebot_gym.robots import find_robot
from cablebot_winches.hardware.loop import INTERRUPTED
from cablebot_winches.identification import read_log

MOTION = json.dumps({"name": "line-planar-platform", "duration": 0.2, "dwell": 0.1})
DRIVE = ("drive", "--robot", "ttk4900", "--policy", "fk+fl", "--trajectory", MOTION)


def test_simulated_drive_is_complete_and_writes_its_log(cablebot, tmp_path):
    """The commands to one board may come before those to another one: no reply may be older."""
    log = tmp_path / "run.csv"
    ended = cablebot(*DRIVE, "--simulate", "--log", log)
    assert ended.status == 0, ended.err
    assert "complete\n" in ended.out
    assert "lost replies    none" in ended.out
    assert "late periods    0 of 200" in ended.out
    assert len(read_log(log, find_robot("ttk4900")).columns["time"]) == 200


def test_stopped_drive_fails_and_keeps_its_log(cablebot, tmp_path):
    log = tmp_path / "run.csv"
    ended = cablebot(*DRIVE, "--simulate", "--fault", "error@0.05:2", "--log", log)
    assert ended.status == 1
    assert "stopped: axis error 0x40 of winch 2" in ended.out
    assert log.exists()


def test_interrupted_drive_ends_as_other_commands(cablebot, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("cablebot_winches.hardware.loop._Loop._advance", interrupt)
    ended = cablebot(*DRIVE, "--simulate")
    assert ended.status == 130
    assert INTERRUPTED in ended.out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("", "give --port or --wiring of real winches, or --simulate"),
        ("--simulate --port a", "--port excludes --simulate"),
        ("--port a --port b --fault drop@1", "need --simulate"),
        ("--simulate --fault lose@1", "unknown fault 'lose'"),
        ("--simulate --fault drop@1:9", "winch of a fault must be"),
        ("--simulate --fault drop@soon", "KIND@TIME:WINCH"),
        ("--simulate --torque-limit 2", "torque_limit must be"),
        ("--simulate --watchdog 0.001", "watchdog must be"),
        ("--port a", "give --port 2 times"),
    ],
)
def test_invalid_options_are_one_sentence(cablebot, options, message):
    assert message in cablebot(*DRIVE, *options.split()).message(2)
