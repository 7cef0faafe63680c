"""Fixtures of the tests of the benchmark."""

import importlib
import sys

import pytest

from cablebot_gym.benchmark import policy_source as policy_sources
from cablebot_gym.utils import code_hash


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Writes a module of policies and clears the caches of hashes."""

    def write(name, text):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        importlib.invalidate_caches()
        hashes = (code_hash.source_hash, code_hash.module_file)
        for cached in (*hashes, policy_sources.policy_source, policy_sources._data_files):
            cached.cache_clear()
        return path

    parsed = code_hash._parsed

    def fresh(path, name):
        return (parsed.__wrapped__ if "toy_" in name else parsed)(path, name)

    monkeypatch.setattr(code_hash, "_parsed", fresh)
    monkeypatch.syspath_prepend(tmp_path)
    yield write
    for name in [name for name in sys.modules if name.startswith("toy_")]:
        del sys.modules[name]
