"""Runs jobs as tasks of a Ray cluster."""

from __future__ import annotations

import os
import pickle
import socket
import sys
from collections.abc import Iterator, Mapping
from itertools import islice
from typing import Any

from cablebot_gym.benchmark.engine import Backend, Job
from cablebot_gym.utils.workers import WorkerDied, cores

RETRIES = 3
"""Maximum number of retries of a job whose worker or node was lost."""

_MEMORY = 100 * 2**20
"""Size of the object store of a local cluster [bytes]. Results are small."""


def on_ray(address: str) -> Backend:
    """A backend on a Ray cluster.

    Each node needs the same versions of this package and of the policies' packages. A result
    computed by different code is rejected.

    Args:
        address: ``auto`` for the running cluster, ``local`` for a new one on this machine, else
            ``host:port`` or ``ray://host:port``.

    Raises:
        ImportError: if Ray is missing. The message names the command that installs it.
        ValueError: if no server answers at the address. The backend raises it if the server is no
            Ray cluster.
    """
    _import_ray()
    _check_address(address)

    def run(jobs: Mapping[str, Job]) -> Iterator[Any]:
        ray = _import_ray()
        if not jobs:
            return
        connects = not ray.is_initialized()
        keys: dict[Any, str] = {}
        if connects:
            _connect(ray, address)
        try:
            remote = ray.remote(num_cpus=1, max_retries=RETRIES)(_computed)
            waiting = iter(jobs.items())
            while True:
                # few jobs in advance, because a job has the knowledge of the time when it is pickled
                room = max(2 * int(ray.cluster_resources().get("CPU", 0)), 1) - len(keys)
                for key, job in islice(waiting, max(room, 0)):
                    keys[remote.remote(pickle.dumps(job), sys.path)] = key
                if not keys:
                    return
                (ready,), _ = ray.wait(list(keys), num_returns=1)
                key = keys.pop(ready)
                try:
                    outcome = ray.get(ready)
                except ray.exceptions.RayError as error:
                    outcome = WorkerDied(_reason(error))
                yield key, outcome
        finally:
            for reference in keys:
                ray.cancel(reference, force=True)
            if connects:
                ray.shutdown()

    return run


def _computed(pickled: bytes, path: list[str]) -> Any:
    """Runs on a worker. Adds the caller's module path, as far as its folders exist on the worker's
    machine."""
    sys.path += [entry for entry in path if entry not in sys.path and os.path.isdir(entry or ".")]
    return pickle.loads(pickled)()


def _reason(error: Any) -> str:
    """One line of Ray's error: the exception on the worker, or the fate of the worker."""
    cause = getattr(error, "cause", None)
    return (
        str(error).strip().partition("\n")[0]
        if cause is None
        else f"{type(cause).__name__}: {cause}"
    )


def _connect(ray: Any, address: str) -> None:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    new = {"num_cpus": cores(), "object_store_memory": _MEMORY, "include_dashboard": False}
    try:
        ray.init(
            address=address,
            log_to_driver=False,
            logging_level="ERROR",
            **(new if address == "local" else {}),
        )
    except (ConnectionError, ValueError, RuntimeError, TimeoutError) as error:
        raise ValueError(
            f"no Ray cluster at {address!r}: {' '.join(str(error).split())}"
        ) from error


def _check_address(address: str) -> None:
    """Rejects an unreachable address at once; Ray itself retries for minutes."""
    if address in ("auto", "local"):
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=5.0).close()
    except (OSError, OverflowError, ValueError) as error:
        raise ValueError(
            f"no Ray cluster at {address!r} ({error}): use auto, local, host:port or ray://host:port"
        ) from error


def _import_ray() -> Any:
    try:
        import ray
    except ImportError:
        raise ImportError("--ray requires the extra ray: pip install 'cablebot-gym[ray]'") from None
    return ray
