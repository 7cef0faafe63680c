"""Compiled code on disk: where it is stored, and when it is compiled again."""

import importlib

import pytest

from cablebot_gym.physics.compiling import code_cache
from cablebot_gym.physics.compiling.loading import cached_njit

HELPER = "cached_helper"
CALLER = "cached_caller"


def triple(number):
    return 3 * number


def hits(function=triple, argument=2, expected=6):
    """Calls a function as a new process would. Returns the number of signatures that were read from
    disk."""
    compiled = cached_njit(function)
    assert compiled(argument) == expected
    return sum(compiled.stats.cache_hits.values())


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Sets the folders of compiled code: existing ones are writable, files in their place are
    not."""

    def set_folders(*paths):
        monkeypatch.setattr(code_cache, "code_folders", lambda: list(paths))
        return paths

    return set_folders


def test_read_only_folder_is_read(folders, tmp_path):
    """Nobody can write into a folder below a file, not even root."""
    (tmp_path / "file").write_text("no folder", encoding="utf-8")
    folders(tmp_path)
    hits()
    folders(tmp_path, tmp_path / "file" / "folder")
    assert hits() == 1


def test_change_of_a_helper_in_another_file_compiles_again(folders, tmp_path, monkeypatch):
    folders(tmp_path / "cache")
    monkeypatch.syspath_prepend(tmp_path)
    helper = tmp_path / f"{HELPER}.py"
    caller = tmp_path / f"{CALLER}.py"
    caller.write_text(
        f"from {HELPER} import add, FACTOR\ndef call(number):\n    return FACTOR * add(number)\n",
        encoding="utf-8",
    )

    def run(addend, factor, expected):
        source = "from numba import njit\n"
        source += "@njit\ndef add(number):\n    return number + "
        helper.write_text(f"{source}{addend}\nFACTOR = {factor}\n", encoding="utf-8")
        for name in (HELPER, CALLER):
            monkeypatch.delitem(importlib.sys.modules, name, raising=False)
        importlib.invalidate_caches()
        code_cache._file_hash.cache_clear()
        return hits(importlib.import_module(CALLER).call, 1, expected)

    monkeypatch.setattr(importlib.sys, "dont_write_bytecode", True)
    assert [run(1, 5, 10), run(1, 5, 10)] == [0, 1]
    assert [run(2, 5, 15), run(2, 7, 21)] == [0, 0]
