"""``cablebot best-known``: output, exit status, cache and interrupts."""

import json
import os
from types import SimpleNamespace

import pytest

from cablebot_gym.bounds import best_known

pytest.importorskip("casadi")

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"
LINE = ("--trajectory", '{"name": "line-planar", "duration": 0.4, "dwell": 0.0}')


@pytest.fixture(autouse=True)
def quick(cache, monkeypatch):
    """A cache of the test's own; two meshes and no certificate."""
    monkeypatch.setattr(best_known, "MESH_TOLERANCE", 1.0)
    upper = {"payload": 98.5, "total_mass": 99.5, "conditions": "none"}
    monkeypatch.setattr(
        best_known, "upper_bound", lambda *_: SimpleNamespace(to_dict=lambda: upper)
    )


def test_options_reach_the_search(cablebot, monkeypatch):
    result = SimpleNamespace(verified=True, to_json=lambda: '{"payload": 1.0}')
    calls = []
    monkeypatch.setattr(
        best_known,
        "find_best_known",
        lambda *positional, **keywords: calls.append((positional, keywords)) or result,
    )
    options = (
        "--rotation-bound",
        "30",
        "--control-frequency",
        "250",
        "--trajectory",
        "line-spatial",
        "--no-cache",
    )
    options += ("--robot", "spatial")
    assert cablebot("best-known", SPATIAL, *options, "--json").data == {"payload": 1.0}
    result.verified = False
    assert cablebot("best-known", SPATIAL).status == 1
    (positional, keywords), _ = calls
    assert positional == (SPATIAL,)
    assert keywords.pop("progress") is not None
    expected = {
        "trajectory": "line-spatial",
        "error_bounds": {"rotation": 0.03},
        "control_frequency": 250.0,
    }
    assert keywords == expected | {"robot": "spatial", "cache": False}


@pytest.mark.slow
def test_result_is_printed_cached_and_verified(cablebot, cache, monkeypatch):
    options = ("best-known", PLANAR, *LINE, "--position-bound", "20", "--control-frequency", "250")
    text = cablebot(*options, "--no-cache").out
    for words in (
        "best known payload",
        "kg",
        "20 mm",
        "verified by replays",
        "least tension",
        "98.500 kg",
    ):
        assert words in text
    assert not cache.exists()
    computed = cablebot(*options, "--json")
    data = json.loads(computed.out, parse_constant=pytest.fail)
    assert data["verified"] is True
    assert data["total_mass"] == data["payload"] + 1.0
    assert data["error_bounds"] == {"position": 0.02, "rotation": None}
    assert len(list(cache.iterdir())) == 1
    monkeypatch.setattr(best_known._Case, "solve", lambda *_: pytest.fail("searched again"))
    assert cablebot(*options, "--json").out == computed.out


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupt_ends_the_solver(cablebot, cache, interrupted_solver):
    ended = cablebot("best-known", PLANAR, *LINE)
    assert ended.status == 130
    assert "interrupted" in ended.err
    assert not cache.exists()
