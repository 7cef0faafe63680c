"""The whole reproduction takes minutes: it is made in a process of its own, while other tests run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from baselines.reproduction.engine import RESULTS

_CODE = "import os; getattr(os, 'nice', int)(10); from cablebot_gym.cli import main; main()"
"""Politely: the other tests come first where cores are few."""

_COMMAND = [sys.executable, "-c", _CODE, "reproduce"]


class Reproduction:
    """`cablebot reproduce`, under way."""

    def __init__(self, workers: int | None) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self.out = Path(self._folder.name) / "reproduction"
        self._said = (Path(self._folder.name) / "said").open("w+", encoding="utf-8")
        arguments = ["--out", str(self.out), *(() if workers is None else ("--workers", str(workers)))]
        own_cache = {"CABLEBOT_CACHE": str(Path(self._folder.name) / "cache")}
        self._process = subprocess.Popen(
            [*_COMMAND, *arguments], stdout=self._said, stderr=subprocess.STDOUT, env={**os.environ, **own_cache}
        )

    def results(self) -> dict[str, Any]:
        """What results.json holds, once the process has ended."""
        status = self._process.wait()
        self._said.seek(0)
        assert status == 0, self._said.read()
        results: dict[str, Any] = json.loads((self.out / RESULTS).read_text(encoding="utf-8"))
        return results

    def stop(self) -> None:
        """Leaves nothing behind."""
        self._process.terminate()
        self._process.wait()
        self._said.close()
        self._folder.cleanup()


_under_way = pytest.StashKey[Reproduction]()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Starts as soon as it is known that the results are asked for; beside other tests on one core only."""
    asked = [item for item in session.items if "reproduced" in getattr(item, "fixturenames", ())]
    if asked and not session.config.option.collectonly:
        alone = len(asked) > len(session.items) / 2
        session.config.stash[_under_way] = Reproduction(workers=None if alone else 1)


def pytest_unconfigure(config: pytest.Config) -> None:
    """Ends what nobody waited for."""
    if (reproduction := config.stash.get(_under_way, None)) is not None:
        reproduction.stop()


@pytest.fixture(scope="session")
def reproduced(request: pytest.FixtureRequest) -> dict[str, Any]:
    """What `cablebot reproduce` says under the readings that are its own."""
    return request.config.stash[_under_way].results()
