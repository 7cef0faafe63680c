"""Loading of numba, and a message while it compiles: once per machine and version, which takes up to a minute."""

from __future__ import annotations

import gc
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from cablebot_gym.utils.console import PREPARATION


@contextmanager
def collection_paused() -> Iterator[None]:
    """Pauses garbage collection while numba makes half a million objects that stay until the process ends."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


with collection_paused():
    from numba import njit
    from numba.core import event, registry

__all__ = ["announce_compilation", "load_numba", "njit"]

_LOGGER = logging.getLogger("cablebot_gym")


@cache
def load_numba() -> None:
    """Loads the parts of numba that its first call would load, in half of the time.

    Numba imports ``scipy.linalg`` only to find out whether SciPy is installed, on which this package depends. A
    function that uses BLAS still imports it when it is compiled.
    """
    from numba.np import linalg

    ensure_blas = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        with collection_paused():
            registry.cpu_target.target_context.refresh()
    finally:
        linalg.ensure_blas = ensure_blas


class _Announcer(event.Listener):
    """Logs the first compilation of a kernel of this package, at the level that Python shows by default.

    Compilation counts as a preparation: estimates of the time left exclude it.
    """

    def __init__(self) -> None:
        self._logged = False

    def on_start(self, event: event.Event) -> None:
        PREPARATION.start()
        module = event.data["dispatcher"].py_func.__module__
        if not self._logged and module.startswith("cablebot_gym."):
            self._logged = True
            _LOGGER.warning("compiling for this machine; this takes up to a minute, once per kind of robot and use …")

    def on_end(self, event: event.Event) -> None:
        PREPARATION.end()


@cache
def announce_compilation() -> None:
    """Installs the announcer, once. Each module with compiled functions calls it on import."""
    event.register("numba:compile", _Announcer())  # type: ignore[no-untyped-call]
