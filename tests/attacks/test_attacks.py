"""Twelve attacks, each in a process of its own beside the honest law: they are refused, or gain
nothing. docs/leaderboard.md has the same table."""

import re
import shutil
import sys
from functools import cache
from pathlib import Path

import pytest
from attacks import cheats
from numba.core import config

from cablebot_gym.evaluation import PolicyError, evaluate_dlcc
from cablebot_gym.isolation import IsolatedPolicy
from cablebot_gym.isolation.process import has_bubblewrap
from cablebot_gym.physics.compiling.code_cache import code_folders
from cablebot_gym.robots import SPATIAL

pytestmark = [
    pytest.mark.landing,
    pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc"),
]

FOLDER = Path(__file__).parent
PAGE = FOLDER.parents[1] / "docs" / "leaderboard.md"
RESOLUTION = 0.01
SEED = 7
"""Evaluation seed. A policy does not know it, and tries the default, 0."""

HONEST = "payload of the honest law"
AT_MOST = "at most the payload of the honest law"
ROWS = "depends on the other episodes of its batch"


OUTCOMES = {
    "batch_mean": ROWS,
    "known_seed": HONEST,
    "module_memory": HONEST,
    "file_memory": HONEST,
    "wide_bounds": HONEST,
    "bribed_judge": HONEST,
    "replaced_code": HONEST,
    "islands": AT_MOST,
    "noisy": "is not reproducible",
    "hangs": "it used more than 2 s of processor time",
    "daemon": HONEST,
    "ends": "its process ended with exit status 0",
}
"""What the payload of a policy of cheats.py is, or words of the error."""
DRAWS = {"batch_mean": 64, "known_seed": 1}
"""Numbers of draws of the attacks on sensor noise."""


def is_refused(name):
    return OUTCOMES[name] not in (HONEST, AT_MOST)


@pytest.fixture(autouse=True)
def _search_path(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)


@cache
def payload_of(name, draws, deadline=60.0):
    """Payload of a policy [kg]; 0 if it fails unloaded."""
    with IsolatedPolicy(f"cheats:{name}", SPATIAL, deadline=deadline) as policy:
        result = evaluate_dlcc(
            policy,
            "CableBot-Spatial-v0",
            payload_max=10.0,
            resolution=RESOLUTION,
            seed=SEED,
            uncertainty=draws and cheats.NOISE,
            draws=draws,
        )
    return result.score


def left_behind():
    """Processes of the policy ``daemon``."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if f"time.sleep({cheats.SLEEP})".encode() in path.read_bytes():
                found.add(path.parent.name)
        except OSError:
            continue
    return found


@pytest.fixture
def compiled(tmp_path, monkeypatch):
    """A copy of the folder of compiled code, which is the one that this process uses."""
    folder = tmp_path / "cablebot_gym"
    shutil.copytree(code_folders()[-1], folder)
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    assert code_folders()[-1] == folder
    return folder


@pytest.mark.parametrize("name", OUTCOMES)
def test_attack_is_refused_or_gets_at_most_the_honest_payload(name, compiled):
    if name == "replaced_code" and not has_bubblewrap():
        pytest.skip("a bare process can replace the files of its user")
    draws = DRAWS.get(name)
    before = {path.name: path.read_bytes() for path in compiled.iterdir()}
    if is_refused(name):
        pattern = rf"^policy 'cheats:{name}'.*{re.escape(OUTCOMES[name])}"
        with pytest.raises(PolicyError, match=pattern):
            payload_of(name, draws, deadline=2.0)
    else:
        payload = payload_of(name, draws)
        expected = payload_of("Honest", draws)
        assert payload <= expected + 3 * RESOLUTION
        if OUTCOMES[name] == HONEST:
            assert payload >= expected - 3 * RESOLUTION
    assert left_behind() == set()
    for file, content in before.items():
        assert (compiled / file).read_bytes() == content


def test_page_has_the_attacks():
    text = PAGE.read_text(encoding="utf-8")
    for name, outcome in OUTCOMES.items():
        what = " ".join(getattr(cheats, name).__doc__.split())
        stated = f"error: {outcome}" if is_refused(name) else outcome
        assert re.search(rf"\| {re.escape(what)} \| .+ \| {re.escape(stated)} \|", text), what
