"""The stored results against the public logs, if the variable CABLEBOT_LOGS names their folder."""

import json
import os
from pathlib import Path

import pytest
import real_robots

from cablebot_winches.reality import STUDIES
from cablebot_winches.reality.sources import SOURCES, read_logs

STORED = json.loads(real_robots.RESULTS.read_text(encoding="utf-8"))


def test_stored_results_are_of_the_present_sources():
    assert STORED.keys() == STUDIES.keys()
    for name, source in SOURCES.items():
        assert (STORED[name]["commit"], STORED[name]["files"]) == (source.commit, source.files)


@pytest.mark.nightly
@pytest.mark.parametrize("name", STUDIES)
def test_stored_results_are_those_of_the_real_logs(name):
    folder = os.environ.get("CABLEBOT_LOGS")
    if not folder:
        pytest.skip("set CABLEBOT_LOGS to a folder with the logs of winches/docs/reality.md")
    source = SOURCES[name]
    anew = STUDIES[name](read_logs(source, Path(folder))).to_dict(name, source)
    again = "compute them anew: python winches/scripts/real_robots.py"
    assert anew["notes"] == STORED[name]["notes"], again
    for computed, stored in zip(anew["comparisons"], STORED[name]["comparisons"], strict=True):
        for field in ("quantity", "unit", "goal", "held"):
            assert computed[field] == stored[field], again
        assert computed["robot"] == pytest.approx(stored["robot"], rel=1e-3), again
        if stored["model"] is not None:
            assert computed["model"] == pytest.approx(stored["model"], rel=1e-3), again
