"""Loading of numba, compilation for the cache on disk, and one message for each robot that is
compiled."""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any


@contextmanager
def collection_paused() -> Iterator[None]:
    """Pauses garbage collection while numba makes half a million objects that stay until the
    process ends."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


with collection_paused():
    import numba
    from numba.core import registry

    from cablebot_gym.physics.compiling.code_cache import CodeCache

_LOGGER = logging.getLogger("cablebot_gym")


@cache
def load_numba() -> None:
    """Loads the parts of numba that its first call would load, in half of the time.

    Numba imports ``scipy.linalg`` only to find out whether SciPy is installed, on which this
    package depends. A function that uses BLAS still imports it when it is compiled.
    """
    from numba.np import linalg

    ensure_blas = linalg.ensure_blas
    linalg.ensure_blas = lambda: None
    try:
        with collection_paused():
            registry.cpu_target.target_context.refresh()
    finally:
        linalg.ensure_blas = ensure_blas


def cached_njit(function: Any, robot: str = "", **options: Any) -> Any:
    """:func:`numba.njit` that stores compiled code on disk, see
    :class:`~cablebot_gym.physics.compiling.code_cache.CodeCache`.

    Args:
        function: function to compile.
        robot: the robot for which code is compiled, in words; empty for functions of all robots.
        options: options of :func:`numba.njit`.
    """
    compiled = numba.njit(**options)(function)
    compiled._cache = CodeCache(function, _ANNOUNCEMENTS.announcer(robot))
    return compiled


class _Announcements:
    """Logs one line for each robot before its first function is compiled, at the level that Python
    shows by default."""

    def __init__(self) -> None:
        self._announced: set[str] = set()
        self._latest = "functions of all robots"

    def announcer(self, robot: str) -> Callable[[], None]:
        """Function to call before the compilation of code for a robot; empty for the robot that was
        named last."""
        if robot:
            self._latest = robot
        return lambda: self._announce(robot or self._latest)

    def _announce(self, robot: str) -> None:
        if robot not in self._announced:
            self._announced.add(robot)
            _LOGGER.warning(
                "compiling for this machine, once: %s, in at most 2 forms (one robot, batches), usually a few seconds "
                "each …",
                robot,
            )


_ANNOUNCEMENTS = _Announcements()
