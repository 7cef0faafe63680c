"""Cells on a Ray cluster of two nodes on this machine: equal numbers, and no cell is lost with its
worker."""

import os
import signal
import warnings
from functools import partial
from pathlib import Path

import pytest

from cablebot_gym.benchmark import ray_backend
from cablebot_gym.benchmark.cells import PolicyCell
from cablebot_gym.benchmark.engine import run_cells
from cablebot_gym.benchmark.ray_backend import on_ray
from cablebot_gym.benchmark.records import compute
from cablebot_gym.benchmark.store import Store
from cablebot_gym.utils.workers import WorkerDied

CIRCLE = {"name": "circle-planar", "duration": 0.8}
CELLS = [
    PolicyCell(
        env_id="CableBot-Planar-v0", trajectory=CIRCLE, policy=policy, resolution=0.1, **model
    )
    for policy in ("fl", "fl:gains=tuned")
    for model in ({}, {"payload_known": False})
]


@pytest.fixture(scope="module")
def address():
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        node = {"num_cpus": 1, "object_store_memory": 80 * 2**20, "include_dashboard": False}
        cluster = Cluster(initialize_head=True, head_node_args=node)
        try:
            cluster.add_node(**node)
            yield cluster.address
        finally:
            ray.shutdown()
            cluster.shutdown()


def killed_at_first(marker):
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "computed"


def always_killed():
    os.kill(os.getpid(), signal.SIGKILL)


def run(address, jobs, returned=(WorkerDied,)):
    return dict(on_ray(address)(jobs, print, returned))


@pytest.mark.landing
def test_cells_on_two_nodes_have_the_numbers_of_one_process(address, tmp_path):
    messages = []
    store = Store(tmp_path, say=messages.append)
    cells = {cell.key: cell for cell in CELLS}
    records = run_cells(
        cells, store, on_ray(address), progress=lambda *step: None, say=messages.append
    )
    assert [record.result for record in records] == [compute(cell).result for cell in CELLS]
    assert len({record.result["payload"] for record in records}) > 2
    assert messages == []
    assert len(list((tmp_path / "cells").iterdir())) == len(CELLS)


@pytest.mark.landing
def test_job_of_a_killed_worker_is_repeated(address, tmp_path, monkeypatch):
    monkeypatch.setattr(ray_backend, "RETRIES", 1)
    jobs = {"killed": partial(killed_at_first, str(tmp_path / "marker")), "deadly": always_killed}
    outcomes = run(address, jobs)
    assert outcomes["killed"] == "computed"
    assert isinstance(outcomes["deadly"], WorkerDied)
    assert "died" in str(outcomes["deadly"])


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nonsense", "host:port"])
def test_address_without_cluster_raises_at_once(address):
    pytest.importorskip("ray")
    with pytest.raises(
        ValueError, match=rf"{address}' is not an address|no Ray cluster at '{address}"
    ):
        on_ray(address)
