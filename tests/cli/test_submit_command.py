"""``cablebot submit`` and ``cablebot verify``: an outside package from its pull request to a board,
and cheats."""

import json
import os
import subprocess
import sys
import zipfile
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cli.conftest import names, read_json

from cablebot_gym.benchmark import suites
from cablebot_gym.benchmark.entries import make_entry
from cablebot_gym.benchmark.suites import Block, Suite
from cablebot_gym.isolation import sandbox
from cablebot_gym.isolation.installed import public_entry
from cablebot_gym.utils.code_hash import module_file

PLANAR = "CableBot-Planar-v0"
CHANGES = {"payload_max": 4.0, "control_frequency": 125.0}
TINY = Suite(
    name="tiny",
    summary="circle",
    env_ids=(PLANAR,),
    blocks=(Block(conditions=CHANGES),),
    best_known=False,
)
HIDDEN = replace(
    TINY, name="hidden", blocks=(Block(motion="hidden", conditions=CHANGES), *TINY.blocks)
)
CARD = {
    "authors": "A. Author",
    "licence": "BSD-3-Clause",
    "compute": "1 h",
    "data": "none",
    "seeds": "0",
}
SUBMIT = f"--id {PLANAR} --suite tiny " + " ".join(
    f"--{name} '{text}'" for name, text in CARD.items()
)
LAW = """
from pathlib import Path
import numpy as np
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.physics.inverse import inverse_dynamics
from cablebot_gym.physics.textbook import normalised_action
from cablebot_gym.policies import PolicyEntry

GAINS = np.loadtxt(Path(__file__).with_name("gains.txt"))

class Law:
    def __init__(self, robot): self.robot, self.layout = robot, observation_layout(robot)
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        now = self.layout.split(observation)
        error, rate = now["reference_pose"] - now["pose"], now["reference_velocity"] - now["velocity"]
        acceleration = now["reference_acceleration"] + GAINS[0] * error + GAINS[1] * rate
        mass = self.robot.mass + now["model_payload"][..., 0]
        needed = inverse_dynamics(self.robot, mass, now["pose"], now["velocity"], acceleration, minimum=5.0)
        return normalised_action(self.robot, needed.torques, needed.speeds), state

PENDANT = PolicyEntry(name="pendant", kind="classical", env_ids=("CableBot-Planar-v0",), factory=Law, summary="")
"""
WHEEL = {
    "pendant_law/__init__.py": "",
    "pendant_law/laws.py": LAW,
    "pendant_law/gains.txt": "400 40",
    "pendant_law-1.2.dist-info/METADATA": "Metadata-Version: 2.1\nName: pendant-law\nVersion: 1.2\n",
    "pendant_law-1.2.dist-info/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    "pendant_law-1.2.dist-info/entry_points.txt": "[cablebot_gym.policies]\npendant = pendant_law.laws:PENDANT\n",
    "pendant_law-1.2.dist-info/RECORD": "",
}
"""Files of a package of others."""

in_a_sandbox = pytest.mark.skipif(sandbox.sandbox_problem() != "", reason=sandbox.sandbox_problem())


@pytest.fixture
def command(cablebot, monkeypatch):
    """Runs a command on tiny suites with one worker, which is this process."""
    monkeypatch.setattr(suites, "SUITES", {"tiny": TINY, "hidden": HIDDEN} | suites.SUITES)
    monkeypatch.setenv("CABLEBOT_SANDBOX", "on")
    return lambda line, *arguments: cablebot(f"{line} --workers 1", *arguments)


@pytest.fixture
def install(tmp_path):
    """Installs the package of others into a folder, as pip does from a registry."""
    wheel = tmp_path / "pendant_law-1.2-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as file:
        for name, text in WHEEL.items():
            file.writestr(name, text)

    def run(target):
        typed = f"-m pip install --no-deps --no-index -q --target {target} {wheel}"
        subprocess.run([sys.executable, *typed.split()], check=True, capture_output=True)

    return run


@pytest.fixture
def source(tmp_path):
    """Folder of the sources of a policy of others: the module ``mine.py`` and a file that it
    reads."""
    folder = tmp_path / "work"
    folder.mkdir(exist_ok=True)
    (folder / "mine.py").write_text(LAW)
    (folder / "gains.txt").write_text("400 40")
    return folder


def record(entry):
    return read_json(Path(entry, "verification.json"))


@in_a_sandbox
@pytest.mark.slow
def test_package_of_others_is_submitted_verified_and_on_a_board(
    command, install, tmp_path, monkeypatch
):
    entry = Path("entries/pendant")
    install(tmp_path / "site")
    with pytest.MonkeyPatch.context() as author:
        author.syspath_prepend(tmp_path / "site")
        submitted = command(f"submit pendant --out {entry} {SUBMIT}")
        assert submitted.status == 0, submitted.err
        assert "pendant, unverified" in submitted.out
    public_entry.cache_clear()
    module_file.cache_clear()
    assert names(entry) == ["entry.json", "results.json"]
    target = "--only-binary :all: --target entries/pendant/packages pendant-law==1.2"
    message = command(f"verify {entry}").message(2)
    assert f"pip install --no-deps {target}" in message
    install(entry / "packages")
    verified = command(f"verify {entry}")
    assert verified.status == 0, verified.err
    verification = record(entry)
    assert verification["outcome"] == "verified"
    assert verification["network"] == "cut"
    assert verification["sandbox"].startswith("bubblewrap")
    assert str(verification["seed"]) not in (entry / "results.json").read_text()
    day = datetime(2027, 1, 1, tzinfo=UTC)
    monkeypatch.setattr("cablebot_gym.benchmark.board.utc_now", lambda: day)
    for options in ("--commit 1 --beacon lottery --beacon-date 2027-01-02", "--beacon-value 7"):
        board = "benchmark --suite hidden --policies fl --entries entries --out board "
        ended = command(board + options)
        day += timedelta(days=1)
        assert ended.status == 0, ended.err
    page = Path("board/leaderboard.md").read_text()
    card = "pendant-law==1.2 | A. Author | BSD-3-Clause | 1 h | none | 0"
    assert f"| `entries/pendant` | {card} | verified |" in page
    assert "unverified" not in page
    (entry / "packages/pendant_law/gains.txt").write_text("800 40")
    message = command(f"verify {entry}").message(1)
    assert "does not match its card in pendant_law/gains.txt" in message
    assert record(entry)["outcome"] == "refused"


READER = """
class Reader(Law):
    def reset(self, tasks):
        for name in ("entries/reader/results.json", "verification/reader/run.json"):
            if Path(name).exists(): self.layout = None
        if Path.cwd().joinpath("mine.py").exists(): return
        raise RuntimeError("where are my files?")
"""


@in_a_sandbox
@pytest.mark.slow
def test_policy_that_needs_files_of_its_author_is_refused(command, source):
    """On the machine of its author it reads a file, and is good; in the sandbox there is none."""
    (source / "mine.py").write_text(LAW + READER)
    sandbox.opt_out()
    assert command(f"submit mine.py:Reader --out entries/reader {SUBMIT}").status == 0
    os.environ["CABLEBOT_SANDBOX"] = "on"
    message = command("verify entries/reader").message(1)
    assert "rerun: policy 'entries/reader': it raised RuntimeError" in message


@pytest.mark.slow
def test_larger_claim_is_refused_and_its_folder_is_unverified(command, source):
    """Without a sandbox, so that it runs everywhere."""
    entry = Path("entries/mine")
    sandbox.opt_out()
    assert command(f"submit mine.py:Law --out {entry} {SUBMIT}").status == 0
    assert names(entry) == ["entry.json", "policy", "results.json"]
    good = command(f"verify {entry} --no-sandbox")
    assert good.status == 0
    assert record(entry)["outcome"] == "reproduced without a sandbox"
    assert "with network and all files" in good.out
    assert names(Path("verification/mine")) == []
    results = read_json(entry / "results.json")
    results["cells"][0]["result"]["payload"] += 0.5
    (entry / "results.json").write_text(json.dumps(results))
    message = command(f"verify {entry} --no-sandbox").message(1)
    assert message.startswith("cablebot: refused: CableBot-Planar-v0, circle-planar")
    assert "claimed; rerun: it carries" in message


def test_entry_needs_a_sandbox_or_consent_and_results(command, cablebot, source, monkeypatch):
    monkeypatch.setattr(sandbox, "sandbox_problem", lambda: "bubblewrap is not installed")
    for line in ("verify entries/mine", "benchmark --entries entries"):
        message = command(line).message(2)
        assert "there is no sandbox: bubblewrap is not installed. --no-sandbox runs" in message
    message = cablebot(f"dlcc {PLANAR} --policy fl --sandbox").message(2)
    assert "--sandbox needs --isolate" in message
    make_entry(Path("entries/mine"), "mine.py:Law", [PLANAR], CARD)
    message = command("verify entries/mine --no-sandbox").message(1)
    assert "refused: 'entries/mine/results.json' holds no results" in message
    assert record("entries/mine")["sandbox"] is None
