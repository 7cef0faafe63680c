"""Cells on a Ray cluster of two nodes on this machine: the same numbers, and no cell lost with its worker."""

from __future__ import annotations

import os
import signal
import sys
import warnings
from functools import partial
from pathlib import Path

import pytest

from cablebot_gym.benchmark import ray_backend
from cablebot_gym.benchmark.cells import PolicyCell, compute
from cablebot_gym.benchmark.engine import run_cells
from cablebot_gym.benchmark.ray_backend import on_ray
from cablebot_gym.benchmark.store import Store
from cablebot_gym.utils.workers import WorkerDied

CIRCLE = {"name": "paper-planar", "duration": 0.8}
CELLS = [
    PolicyCell(env_id="CableBot-Planar-v0", trajectory=CIRCLE, policy=policy, **model)
    for policy in ("fl", "fl-tuned")
    for model in ({}, {"payload_known": False}, {"model_payload_factor": 0.9})
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


def killed_at_first(cell, marker):
    if not Path(marker).exists():
        Path(marker).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return compute(cell)


def always_killed():
    os.kill(os.getpid(), signal.SIGKILL)


def where(seconds):
    import time

    import ray

    time.sleep(seconds)
    return ray.get_runtime_context().get_node_id()


def test_cells_on_two_nodes_do_not_have_other_numbers_than_one_after_the_other(address, tmp_path):
    cells = {cell.key: cell for cell in CELLS}
    seen = []
    store = Store(tmp_path, say=seen.append)
    records = run_cells(cells, store, on_ray(address), progress=lambda *step: None, say=seen.append)
    assert [record.result for record in records] == [compute(cell).result for cell in CELLS]
    assert len({record.result["payload"] for record in records}) > 2
    assert seen == []
    assert len(list((tmp_path / "cells").iterdir())) == len(CELLS)


def test_both_nodes_are_used(address):
    tasks = {str(number): partial(where, 0.5) for number in range(4)}
    assert len({node for _, node in on_ray(address)(tasks, print)}) == 2


def test_cell_of_a_killed_worker_is_not_lost(address, tmp_path):
    tasks = {
        "killed": partial(killed_at_first, CELLS[0], str(tmp_path / "marker")),
        "other": partial(compute, CELLS[1]),
    }
    records = dict(on_ray(address)(tasks, print))
    assert (tmp_path / "marker").exists()
    assert {key: record.result for key, record in records.items()} == {
        "killed": compute(CELLS[0]).result,
        "other": compute(CELLS[1]).result,
    }


def test_cell_that_kills_every_worker_does_not_end_the_others(address, monkeypatch):
    monkeypatch.setattr(ray_backend, "RETRIES", 1)
    outcomes = dict(on_ray(address)({"deadly": always_killed, "other": partial(compute, CELLS[1])}, print))
    assert isinstance(outcomes["deadly"], WorkerDied)
    assert "died" in str(outcomes["deadly"])
    assert outcomes["other"].result == compute(CELLS[1]).result


def test_what_a_worker_cannot_import_is_named(address, monkeypatch):
    module = type(os)("only_here")
    module.task = type("task", (), {"__module__": "only_here", "__qualname__": "task"})
    monkeypatch.setitem(sys.modules, "only_here", module)
    outcome = dict(on_ray(address)({"one": module.task()}, print))["one"]
    assert "No module named 'only_here'" in str(outcome)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1", "nonsense", "host:port"])
def test_address_without_a_cluster_is_one_sentence_at_once(address):
    with pytest.raises(ValueError, match=rf"{address}' is not an address|no Ray cluster at '{address}"):
        on_ray(address)


def test_missing_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[ray\]'"):
        on_ray("local")
