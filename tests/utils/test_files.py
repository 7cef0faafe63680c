"""A result file appears whole or not at all, and a folder is tried before the work."""

from __future__ import annotations

import os
import tempfile

import pytest

from cablebot_gym.utils.files import atomic_write, check_writable_dir

INTERRUPTS = [RuntimeError("half way"), KeyboardInterrupt(), SystemExit(3), OSError(28, "No space left on device")]


def half(error):
    """Writes half a file and fails."""

    def write(path):
        path.write_text("half", encoding="utf-8")
        raise error

    return write


@pytest.mark.parametrize("error", INTERRUPTS, ids=lambda error: type(error).__name__)
def test_failure_in_the_middle_does_not_leave_half_a_file(tmp_path, error):
    with pytest.raises(type(error)) as caught:
        atomic_write(tmp_path / "result.json", half(error))
    assert caught.value is error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("error", INTERRUPTS, ids=lambda error: type(error).__name__)
def test_failure_in_the_middle_does_not_touch_the_old_file(tmp_path, error):
    path = tmp_path / "result.json"
    path.write_text("old", encoding="utf-8")
    before = path.stat()
    with pytest.raises(type(error)):
        atomic_write(path, half(error))
    assert [item.name for item in tmp_path.iterdir()] == ["result.json"]
    assert path.read_text(encoding="utf-8") == "old"
    assert (path.stat().st_ino, path.stat().st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


def test_old_file_is_not_gone_while_the_new_one_is_written(tmp_path):
    path = tmp_path / "result.json"
    path.write_text("old", encoding="utf-8")
    seen = []

    def write(temporary):
        assert temporary != path
        assert temporary.parent == tmp_path, "a rename is whole within one file system only"
        temporary.write_text("new", encoding="utf-8")
        seen.append(path.read_text(encoding="utf-8"))

    atomic_write(path, write)
    assert seen == ["old"]
    assert path.read_text(encoding="utf-8") == "new"
    assert [item.name for item in tmp_path.iterdir()] == ["result.json"]


@pytest.mark.parametrize("name", ["run.npz", "run.csv", "a.b.png", "no suffix"])
def test_temporary_name_does_not_lose_the_suffix(tmp_path, name):
    path = tmp_path / name
    suffixes = []

    def write(temporary):
        suffixes.append(temporary.suffix)
        temporary.write_bytes(b"all")

    atomic_write(path, write)
    assert suffixes == [path.suffix]
    assert path.read_bytes() == b"all"


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_file_is_not_readable_by_its_owner_alone(tmp_path):
    atomic_write(tmp_path / "result.json", lambda path: path.write_text("x", encoding="utf-8"))
    assert (tmp_path / "result.json").stat().st_mode & 0o777 == 0o644


def test_failed_rename_does_not_leave_the_temporary_file(tmp_path):
    (tmp_path / "result.json").mkdir()
    with pytest.raises(OSError, match="directory"):
        atomic_write(tmp_path / "result.json", lambda path: path.write_text("x", encoding="utf-8"))
    assert [item.name for item in tmp_path.iterdir()] == ["result.json"]


def test_folder_that_does_not_exist_is_not_refused(tmp_path):
    folder = tmp_path / "a" / "b"
    check_writable_dir(folder)
    assert list(tmp_path.iterdir()) == []  # and it is not made before there is something to write


def test_trying_a_folder_does_not_change_what_is_in_it(tmp_path):
    (tmp_path / "result.json").write_text("old", encoding="utf-8")
    check_writable_dir(tmp_path)
    assert [item.read_text(encoding="utf-8") for item in tmp_path.iterdir()] == ["old"]


@pytest.mark.parametrize("below", ["", "sub", "sub/deeper"])
def test_file_in_the_place_of_a_folder_is_not_accepted(tmp_path, below):
    file = tmp_path / "file"
    file.write_text("kept", encoding="utf-8")
    with pytest.raises(ValueError, match=r"cannot write to folder '.*file.*': .*; choose another") as caught:
        check_writable_dir(file / below)
    assert "\n" not in str(caught.value)
    assert file.read_text(encoding="utf-8") == "kept"
    assert list(tmp_path.iterdir()) == [file]


def test_folder_that_only_seems_writable_is_not_accepted(tmp_path, monkeypatch):
    # Root may write anywhere, so a folder without permission is played.
    def refuse(**keywords):
        assert keywords["dir"] == tmp_path
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    with pytest.raises(ValueError, match=r"cannot write to folder .*: Permission denied; choose another"):
        check_writable_dir(tmp_path)
