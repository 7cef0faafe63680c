"""``cablebot best-known``: output, exit status, cache and interrupts."""

import os
from types import SimpleNamespace
from unittest.mock import ANY, Mock

import pytest

from cablebot_gym.bounds import best_known

pytest.importorskip("casadi")

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"
LINE = f"""best-known {PLANAR} --trajectory '{{"name": "line-planar", "duration": 0.4, "dwell": 0}}' """


@pytest.fixture(autouse=True)
def quick(cache, monkeypatch):
    """A cache of the test's own, and two meshes."""
    monkeypatch.setattr(best_known, "MESH_TOLERANCE", 1.0)


def test_options_reach_the_search(cablebot, monkeypatch):
    result = SimpleNamespace(verified=True, to_json=lambda: '{"payload": 1.0}')
    find = Mock(return_value=result)
    monkeypatch.setattr(best_known, "find_best_known", find)
    options = "--rotation-bound 30 --control-frequency 250 --trajectory line-spatial"
    line = f"best-known {SPATIAL} --robot spatial --json {options}"
    assert cablebot(line).data == {"payload": 1.0}
    keywords = {"trajectory": "line-spatial", "error_bounds": {"rotation": 0.03}}
    keywords |= {"control_frequency": 250.0, "robot": "spatial"}
    find.assert_called_once_with(SPATIAL, progress=ANY, **keywords)
    result.verified = False
    assert cablebot(f"best-known {SPATIAL}").status == 1


@pytest.mark.landing
def test_result_is_printed_and_verified(cablebot):
    line = f"{LINE} --position-bound 20 --control-frequency 250"
    text = cablebot(line).out
    for words in ("best known payload", "kg", "20 mm", "verified by replays"):
        assert words in text
    computed = cablebot(line, "--json").data
    assert computed["verified"] is True
    assert computed["total_mass"] == computed["payload"] + 1.0
    assert computed["error_bounds"] == {"position": 0.02, "rotation": None}


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupt_ends_the_solver(cablebot, cache, interrupted_solver):
    ended = cablebot(LINE)
    assert ended.status == 130
    assert "interrupted" in ended.err
    assert not cache.exists()
