"""What the tests of the cards and of the script that makes them share, beside :mod:`shipping`."""

from __future__ import annotations

from pathlib import Path

import pytest

import cablebot_gym.benchmark.engine
from cablebot_gym.benchmark.cells import PolicyCell, Record


@pytest.fixture
def runs(tmp_path):
    from shipping import CARRIED, save_run  # needs torch, as most tests here do not

    for seed in CARRIED:
        save_run(tmp_path / "runs" / f"apg-circle-planar-{seed}", seed)
    return tmp_path / "runs"


@pytest.fixture
def computed(monkeypatch):
    """Payloads that cost nothing: seeds carry :data:`~shipping.CARRIED`, the base alone 1.5 kg and every law 1.9 kg."""
    from shipping import CARRIED

    cells = []

    def compute(cell):
        assert isinstance(cell, PolicyCell)
        cells.append(cell)
        number = Path(cell.policy).parent.name.rpartition("-")[2]
        payload = CARRIED[int(number)] if number.isdigit() else 1.5 if "base" in cell.policy else 1.9
        if not cell.payload_known and payload is not None:
            payload -= 1.0
        if "seed" in cell.trajectory:
            payload = 2.0 if cell.policy == "fl" else payload + (1.0 if cell.trajectory["seed"] % 2 else -1.0)
        return Record(cell=cell, source=cell.source, versions={}, result={"payload": payload}, seconds=0.0)

    monkeypatch.setattr(cablebot_gym.benchmark.engine, "compute", compute)
    return cells
