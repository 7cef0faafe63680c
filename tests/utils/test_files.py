"""Result files are written completely or not at all, and folders are checked before the work."""

import pytest

from cablebot_gym.utils.files import atomic_write, check_writable_dir


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device")])
@pytest.mark.parametrize("existing", [True, False])
def test_failed_write_leaves_the_previous_file_only(tmp_path, error, existing):
    def write_half(temporary):
        temporary.write_text("half")
        raise error

    path = tmp_path / "result.json"
    if existing:
        path.write_text("old")
    with pytest.raises(type(error)) as caught:
        atomic_write(path, write_half)
    assert caught.value is error
    assert [item.read_text() for item in tmp_path.iterdir()] == ["old"] * existing


def test_previous_file_exists_until_the_new_one_is_complete(tmp_path):
    """The temporary file is in the same folder, because a rename is atomic within one file system
    only."""
    path = tmp_path / "folder" / "a.b.png"
    atomic_write(path, lambda temporary: temporary.write_text("old"))

    def write(temporary):
        assert temporary.parent == path.parent
        assert temporary.suffix == ".png"
        temporary.write_text("new")
        assert path.read_text() == "old"

    atomic_write(path, write)
    assert path.read_text() == "new"
    assert list(path.parent.iterdir()) == [path]
    assert path.stat().st_mode & 0o777 == 0o644


def test_file_in_place_of_a_folder_raises(tmp_path):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(ValueError, match=r"cannot write to folder '.*file.*': .*; choose another"):
        check_writable_dir(tmp_path / "file" / "sub" / "deeper")
