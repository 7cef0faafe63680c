"""The same cells as tasks of a Ray cluster."""

from __future__ import annotations

import os
import pickle
import socket
import sys
from collections.abc import Iterator, Mapping
from typing import Any

from cablebot_gym.benchmark.cells import Record
from cablebot_gym.benchmark.engine import Backend, Say, Task
from cablebot_gym.utils.workers import WorkerDied, cores

RETRIES = 3
"""How often a cell is tried again after its worker or its node was lost."""

_MEMORY = 100 * 2**20
"""Of the object store of a local cluster [bytes]: results are small."""


def on_ray(address: str) -> Backend:
    """A backend on the cluster of an address, ``auto`` for the running one, ``local`` for a new one on this machine.

    Each node needs this package and the policies' packages installed in the same versions; a cell that other code
    computes is refused.

    Raises:
        ImportError: if Ray is missing; the message names the command that installs it.
        ValueError: if nothing answers at the address, or, when it is used, if that is no cluster.
    """
    _import_ray()
    _check_address(address)

    def run(tasks: Mapping[str, Task], say: Say) -> Iterator[tuple[str, Record | WorkerDied]]:
        ray = _import_ray()
        if not tasks:
            return
        joined, keys = not ray.is_initialized(), {}
        if joined:
            _connect(ray, address)
        try:
            remote = ray.remote(num_cpus=1, max_retries=RETRIES)(_computed)
            keys = {remote.remote(pickle.dumps(task), sys.path): key for key, task in tasks.items()}
            while keys:
                (ready,), _ = ray.wait(list(keys), num_returns=1)
                key = keys.pop(ready)
                try:
                    outcome = ray.get(ready)
                except ray.exceptions.RayError as error:
                    outcome = WorkerDied(_why(error))
                yield key, outcome
        finally:
            for reference in keys:
                ray.cancel(reference, force=True)
            if joined:
                ray.shutdown()

    return run


def _computed(pickled: bytes, path: list[str]) -> Record:
    """Runs on a worker. It finds the modules that this process finds, where they are there too."""
    sys.path += [entry for entry in path if entry not in sys.path and os.path.isdir(entry or ".")]
    task: Task = pickle.loads(pickled)
    return task()


def _why(error: Any) -> str:
    """One line of Ray's many: what was raised on the worker, or what became of it."""
    cause = getattr(error, "cause", None)
    return str(error).strip().partition("\n")[0] if cause is None else f"{type(cause).__name__}: {cause}"


def _connect(ray: Any, address: str) -> None:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nobody is told without being asked
    new = {"num_cpus": cores(), "object_store_memory": _MEMORY, "include_dashboard": False}
    try:
        ray.init(address=address, log_to_driver=False, logging_level="ERROR", **(new if address == "local" else {}))
    except (ConnectionError, ValueError, RuntimeError, TimeoutError) as error:
        raise ValueError(f"no Ray cluster at {address!r}: {' '.join(str(error).split())}") from error


def _check_address(address: str) -> None:
    """Refuses at once what Ray would try for minutes."""
    if address in ("auto", "local"):
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise ValueError(f"{address!r} is no address of a Ray cluster: give auto, local, host:port or ray://host:port")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=5.0).close()
    except (OSError, OverflowError) as error:
        raise ValueError(f"no Ray cluster at {address!r}: {error}") from error


def _import_ray() -> Any:
    try:
        import ray
    except ImportError:
        raise ImportError("--ray needs the extra: pip install 'cablebot-gym[ray]'") from None
    return ray
