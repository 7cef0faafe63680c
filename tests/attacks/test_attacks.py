"""Twelve attacks, each in a process of its own beside the honest law: they are refused, or gain
nothing. docs/validation.md has the same table."""

import re
import shutil
import sys
from dataclasses import dataclass
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
PAGE = FOLDER.parents[1] / "docs" / "validation.md"
RESOLUTION = 0.01
SEED = 7
"""Evaluation seed. A policy does not know it, and tries the default, 0."""

HONEST = "payload of the honest law"
AT_MOST = "at most the payload of the honest law"
ROWS = "depends on the other episodes of its batch"


@dataclass(frozen=True)
class Attack:
    """A policy of cheats.py and its outcome."""

    name: str
    outcome: str
    """What the payload is, or words of the error."""
    uncertainty: str | None = None
    """Name of an uncertainty of cheats.py."""
    draws: int | None = None

    @property
    def is_refused(self):
        return self.outcome not in (HONEST, AT_MOST)


ATTACKS = (
    Attack("batch_mean", ROWS, "NOISE", draws=64),
    Attack("known_seed", HONEST, "NOISE", draws=1),
    Attack("module_memory", HONEST),
    Attack("file_memory", HONEST),
    Attack("wide_bounds", HONEST),
    Attack("bribed_judge", HONEST),
    Attack("replaced_code", HONEST),
    Attack("islands", AT_MOST),
    Attack("noisy", "is not reproducible"),
    Attack("hangs", "it used more than 2 s of processor time"),
    Attack("daemon", HONEST),
    Attack("ends", "its process ended with exit status 0"),
)


@pytest.fixture(autouse=True)
def _search_path(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)


@cache
def payload_of(name, uncertainty, draws, deadline=60.0):
    """Payload of a policy [kg]; 0 if it fails unloaded."""
    with IsolatedPolicy(f"cheats:{name}", SPATIAL, deadline=deadline) as policy:
        result = evaluate_dlcc(
            policy,
            "CableBot-Spatial-v0",
            payload_max=10.0,
            resolution=RESOLUTION,
            seed=SEED,
            uncertainty=None if uncertainty is None else getattr(cheats, uncertainty),
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


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.name)
def test_attack_is_refused_or_gets_at_most_the_honest_payload(attack, compiled):
    if attack.name == "replaced_code" and not has_bubblewrap():
        pytest.skip("a bare process can replace the files of its user")
    conditions = attack.uncertainty, attack.draws
    before = {path.name: path.read_bytes() for path in compiled.iterdir()}
    if attack.is_refused:
        pattern = rf"^policy 'cheats:{attack.name}'.*{re.escape(attack.outcome)}"
        with pytest.raises(PolicyError, match=pattern):
            payload_of(attack.name, *conditions, deadline=2.0)
    else:
        payload = payload_of(attack.name, *conditions)
        expected = payload_of("Honest", *conditions)
        assert payload <= expected + 3 * RESOLUTION
        if attack.outcome == HONEST:
            assert payload >= expected - 3 * RESOLUTION
    assert left_behind() == set()
    for name, content in before.items():
        assert (compiled / name).read_bytes() == content


def test_page_has_the_attacks():
    text = PAGE.read_text(encoding="utf-8")
    for attack in ATTACKS:
        what = " ".join(getattr(cheats, attack.name).__doc__.split())
        outcome = f"error: {attack.outcome}" if attack.is_refused else attack.outcome
        assert re.search(rf"\| {re.escape(what)} \| .+ \| {re.escape(outcome)} \|", text), what
