"""Fixtures of the tests of the command line."""

import json
import shlex
import sys
from dataclasses import dataclass

import pytest

from cablebot_gym.cli import app as cli

TOYS = """
import os
import signal
import sys
import numpy as np
from cablebot_baselines.laws import FeedbackLinearization

class Toy(FeedbackLinearization):
    steps = 0
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state)
        self.steps += 1
        return (self.eleventh(action) if self.steps == 11 else action), state

class raises(Toy):
    def eleventh(self, action):
        raise RuntimeError("lost")

class exits(Toy):
    def eleventh(self, action):
        sys.exit(0)

class nan(Toy):
    def eleventh(self, action):
        return action * np.nan

class interrupted(Toy):
    def eleventh(self, action):
        os.kill(os.getpid(), signal.SIGINT)
        return action

def clipped(robot):
    law = FeedbackLinearization(robot)
    return lambda observation: np.clip(law.predict(observation)[0], -1, 1)

def limp(robot):
    return lambda observation: np.zeros(robot.cables)

def declares(robot):
    return FeedbackLinearization(robot)
"""


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    status: int
    out: str
    err: str

    @property
    def data(self):
        """Standard output as JSON without NaN and infinity. Standard error may have progress, which
        depends on the time."""
        assert self.status == 0
        return json.loads(self.out, parse_constant=pytest.fail)

    def message(self, status):
        """The only line on standard error of a command that failed with a status."""
        assert self.status == status, self.err
        assert self.out == "", self.err
        assert self.err.count("\n") == 1, self.err
        assert self.err.startswith("cablebot: ")
        return self.err


@pytest.fixture
def cablebot(monkeypatch, capfd, tmp_path):
    """Runs a command in this process, in an empty folder: a line as in a shell, and further
    arguments."""
    folder = tmp_path / "work"
    folder.mkdir()
    monkeypatch.chdir(folder)
    # no lines of progress on a slow machine
    monkeypatch.setattr("cablebot_gym.utils.console.FIRST_LINE", 1e9)

    def run(line, *arguments):
        typed = [*shlex.split(line), *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", ["cablebot", *typed])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        return Ended(ended.value.code or 0, *capfd.readouterr())

    return run


@pytest.fixture
def toys(tmp_path, monkeypatch):
    """A module of policies by ``toys:name``, each FL except for what its name says."""
    folder = tmp_path / "modules"
    folder.mkdir()
    (folder / "cli_toys.py").write_text(TOYS)
    monkeypatch.syspath_prepend(folder)
    yield lambda name: f"cli_toys:{name}"
    sys.modules.pop("cli_toys", None)


def names(folder):
    """Names of the files in a folder."""
    return sorted(path.name for path in folder.iterdir())


def read_json(path):
    return json.loads(path.read_text())
