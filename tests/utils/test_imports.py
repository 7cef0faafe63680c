"""Objects named as package.module:name or file.py:name."""

import sys

import pytest

from cablebot_gym.utils.imports import import_object


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A file in a folder that Python does not know."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "toy_objects", raising=False)
    path = tmp_path / "toy_objects.py"
    path.write_text(
        "import math\nfrom toy_sibling import GAIN\ndef make(robot): return GAIN\nclass Law: ...\n"
    )
    (tmp_path / "toy_sibling.py").write_text("GAIN = 7\n")
    return path


def test_file_is_imported_with_its_siblings_from_any_folder(file):
    assert import_object(f"{file}:make")(None) == 7
    assert import_object("math:pi") > 3


@pytest.mark.parametrize(
    ("ending", "message"),
    [
        ("", r"needs the name of an object in this file: .*toy_objects\.py:NAME$"),
        (":mak", "module 'toy_objects' has no attribute 'mak'; it has make, Law$"),
    ],
)
def test_wrong_name_raises_with_valid_ones(file, ending, message):
    with pytest.raises(ValueError, match=message):
        import_object(f"{file}{ending}")


def test_missing_file_and_hidden_file_raise(file):
    with pytest.raises(ValueError, match=r"file 'none\.py' does not exist"):
        import_object("none.py:make")
    hidden = file.with_name("json.py")
    hidden.write_text("def make(robot): ...\n")
    with pytest.raises(ValueError, match="another module is named 'json': rename"):
        import_object(f"{hidden}:make")
