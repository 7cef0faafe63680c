"""Files that people bring: encodings, forms, and errors in their code."""

import json
import os
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from cablebot_gym.benchmark.store import read_all
from cablebot_gym.cli.options import _read_data
from cablebot_gym.measurement import find_measurement
from cablebot_gym.motions import find_trajectory
from cablebot_gym.policies import load_policy
from cablebot_gym.robots import PLANAR, find_robot
from cablebot_gym.uncertainty import find_uncertainty
from cablebot_gym.utils.user_code import sentence_of_user_code
from cablebot_gym.utils.workers import _portable

ROOT = Path(__file__).parents[2]

MOTION = """
from cablebot_gym.motions import Reference
class Lost:
    name, duration, coordinates = "lost", 1.0, 2
    def __call__(self, times):
        return {"zero": 1 / 0}
class Odd(Lost):
    def __call__(self, times):
        return {}
def ends():
    raise SystemExit(3)
"""


SQUARE = (ROOT / "examples" / "square.toml").read_text()
READERS = {
    "robot.toml": (find_robot, SQUARE),
    "robot.TOML": (find_robot, SQUARE),
    "robot.json": (find_robot, json.dumps(PLANAR.to_dict())),
    "way.csv": (lambda path: find_trajectory(str(path), "planar"), "t,x,y\n0,0,0\n1,0.1,0\n"),
    "smoke.jsonl": (read_all, "{}"),
}


def outcome(read, path):
    """What a reader returns, or its message."""
    try:
        return read(path)
    except ValueError as error:
        return str(error)


@pytest.mark.parametrize("name", READERS)
def test_reader_accepts_a_byte_order_mark_and_asks_for_utf_8(tmp_path, name):
    read, text = READERS[name]
    path = tmp_path / name
    results = []
    for encoding in ("utf-8", "utf-8-sig"):
        path.write_text(text, encoding=encoding)
        results.append(outcome(read, path))
    assert results[0] == results[1]
    for data in (text.encode("utf-16"), text.encode("utf-16-le"), text.encode() + b"\xe9"):
        path.write_bytes(data)
        assert "save it as UTF-8" in outcome(read, path)


def option(path):
    return _read_data(SimpleNamespace(name="trajectory"), str(path))


def test_data_of_a_file_must_be_an_object(tmp_path):
    path = tmp_path / "a.json"
    path.write_text("[1]")
    with pytest.raises(ValueError, match="must hold a JSON object"):
        option(path)


ALL_READERS = {name: read for name, (read, _) in READERS.items()} | {
    "motion.json": option,
    "statistics.pkl": lambda path: load_policy("fl", PLANAR, wrappers=[path]),
}
UNREADABLE = {
    "pipe": os.mkfifo,
    "large": lambda path: path.touch() or os.truncate(path, 200 << 30),  # takes no space
    "brackets": lambda path: path.write_text("[" * 100_000 + "]" * 100_000),
}


@pytest.mark.skipif(sys.platform == "win32", reason="pipes have names on POSIX")
@pytest.mark.parametrize("kind", UNREADABLE)
@pytest.mark.parametrize("name", ALL_READERS)
def test_reader_refuses_an_unreadable_file_in_one_sentence(tmp_path, name, kind):
    """A reader of a pipe would wait for ever."""
    path = tmp_path / "folder" / name
    path.parent.mkdir()
    UNREADABLE[kind](path)
    result = outcome(ALL_READERS[name], path)
    assert isinstance(result, str)
    assert len(result) <= 1000


@pytest.mark.parametrize(
    ("find", "name"),
    [
        (find_robot, "planar"),
        (lambda name: load_policy(name, PLANAR), "fl"),
        (lambda name: find_trajectory(name, "planar"), "circle-planar"),
        (lambda name: find_uncertainty(name, PLANAR), "hardware"),
        (lambda name: find_measurement(name, PLANAR), "winches"),
    ],
)
def test_valid_name_wins_over_a_folder_of_the_same_name(tmp_path, monkeypatch, find, name):
    monkeypatch.chdir(tmp_path)
    Path(name).mkdir()
    find(name)


LINE = r"\(motion_of_a_test\.py, line "


@pytest.mark.parametrize(
    ("name", "status", "message"),
    [
        ("Lost", 1, rf"your code raised ZeroDivisionError: division by zero {LINE}6\)"),
        ("Odd", 2, "trajectory 'lost' must return a Reference, not dict"),
        ("ends", 2, rf"trajectory '.*:ends': it raised SystemExit: 3 {LINE}11\)"),
    ],
)
@pytest.mark.parametrize(
    "line", ["robot check planar", "rollout CableBot-Planar-v0 --policy fl --out run.csv"]
)
def test_error_in_a_motion_file_is_one_sentence(
    cablebot, tmp_path, monkeypatch, line, name, status, message
):
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "motion_of_a_test", raising=False)
    path = tmp_path / "motion_of_a_test.py"
    path.write_text(MOTION)
    ended = cablebot(line, "--trajectory", f"{path}:{name}")
    assert ended.status == status, ended.err
    assert ended.err.count("\n") == 1, ended.err
    assert re.search(message, ended.err), ended.err


def test_error_of_user_code_in_a_worker_keeps_its_line():
    try:
        raise KeyError("mass")
    except KeyError as error:
        portable = _portable(error)
    portable.__traceback__ = None
    start = "your code raised KeyError: 'mass' (test_files_of_users.py, line"
    assert sentence_of_user_code(portable).startswith(start)


def test_error_of_this_package_is_no_error_of_user_code():
    with pytest.raises(ValueError, match="unknown robot") as caught:
        find_robot(3.0)
    caught.value.__traceback__ = caught.tb.tb_next
    assert sentence_of_user_code(caught.value) == ""
