"""Rows on a Ray cluster of two nodes on this machine: equal numbers, and no row is lost with its
worker."""

import os
import signal
import warnings
from functools import partial
from pathlib import Path

import pytest
from benchmark.made_rows import asked

from cablebot_gym.benchmark import ray_backend
from cablebot_gym.benchmark.engine import run_rows
from cablebot_gym.benchmark.ray_backend import on_ray
from cablebot_gym.benchmark.rows import compute
from cablebot_gym.benchmark.store import Store
from cablebot_gym.utils.workers import WorkerDied

CIRCLE = {"name": "circle-planar", "duration": 0.8}
ROWS = [
    asked(policy=policy, motion=CIRCLE, search={"resolution": 0.1}, **model)
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


@pytest.mark.landing
def test_rows_on_two_nodes_have_the_numbers_of_one_process(address, tmp_path):
    head = {"suite": "smoke", "command": "", "seed_text": None}
    store = Store(tmp_path, **head, say=print)
    run_rows(ROWS, store, on_ray(address), progress=lambda *step: None)
    results = [store.find(row).result for row in ROWS]
    assert results == [row.result for asked_row in ROWS for row in compute([asked_row])]
    assert len({result["payload"] for result in results}) > 2


@pytest.mark.landing
def test_job_of_a_killed_worker_is_repeated(address, tmp_path, monkeypatch):
    monkeypatch.setattr(ray_backend, "RETRIES", 1)
    jobs = {"killed": partial(killed_at_first, str(tmp_path / "marker")), "deadly": always_killed}
    outcomes = dict(on_ray(address)(jobs))
    assert outcomes["killed"] == "computed"
    assert isinstance(outcomes["deadly"], WorkerDied)
    assert "died" in str(outcomes["deadly"])


@pytest.mark.parametrize("address", ["127.0.0.1:1", "nonsense", "host:port"])
def test_address_without_cluster_raises_at_once(address):
    pytest.importorskip("ray")
    with pytest.raises(ValueError, match=f"no Ray cluster at '{address}"):
        on_ray(address)
