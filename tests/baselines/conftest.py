"""Fixtures of the tests of training, and of the tests of cards and of the script that makes
them."""

from pathlib import Path

import pytest

import cablebot_gym.benchmark.engine
from cablebot_gym.benchmark.cells import BestKnownCell, SurveyCell
from cablebot_gym.benchmark.records import Record


@pytest.fixture(scope="module")
def one_thread():
    """Limits torch to one thread: several threads wait for each other on busy cores."""
    from cablebot_baselines.learned.runs import torch_threads

    with torch_threads(1):
        yield


@pytest.fixture
def runs(tmp_path):
    """Folder of finished runs of five seeds."""
    from shipping import PAYLOADS, save_run  # needs torch

    for seed in PAYLOADS:
        save_run(tmp_path / "runs" / f"planner-planar-{seed}", seed)
    return tmp_path / "runs"


@pytest.fixture
def computed(monkeypatch):
    """Replaces evaluations: seeds carry ``PAYLOADS``, the base law 1.5 kg and other laws 1.9 kg;
    searches find ``SEARCHED``. Returns the cells.

    The leaderboard has the best known payloads ``BEST_KNOWN``.
    """
    from shipping import BEST_KNOWN, PAYLOADS, SEARCHED, script

    monkeypatch.setattr(script, "read_best_known", lambda path: BEST_KNOWN)
    monkeypatch.setattr(script, "known_on_held_out", lambda cards: {})
    cells = []

    def compute(cell):
        cells.append(cell)
        common = {"cell": cell, "source": cell.source, "versions": {}, "seconds": 0.0}
        if isinstance(cell, BestKnownCell):
            payload, verified = SEARCHED[cell.trajectory["seed"]]
            result = {"payload": payload, "verified": verified, "found": True}
            return Record(result=result, final=True, **common)
        number = Path(cell.policy).parent.name.rpartition("-")[2]
        payload = (
            PAYLOADS[int(number)] if number.isdigit() else 1.5 if "base" in cell.policy else 1.9
        )
        if not cell.payload_known and payload is not None:
            payload -= 1.0
        result = {"payload": payload}
        if isinstance(cell, SurveyCell):
            payloads = []
            for seed in cell.trajectory["seed"]:
                if cell.policy == "fl":
                    payloads.append(2.0)
                elif payload is None:
                    payloads.append(None)
                elif seed % 2:
                    payloads.append(payload + 1.0)
                else:
                    payloads.append(payload - 1.0)
            unknown = [None] * len(payloads)
            result = {"payloads": payloads, "stochastic": False}
            result |= dict.fromkeys(("failed_payloads", "violations", "resolutions"), unknown)
        return Record(result=result, **common)

    monkeypatch.setattr(cablebot_gym.benchmark.engine, "compute", compute)
    return cells
