"""Loading of numba, and compilation for the cache on disk."""

from __future__ import annotations

import gc
from collections.abc import Iterator
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


def cached_njit(function: Any, **options: Any) -> Any:
    """:func:`numba.njit` that stores compiled code on disk, see
    :class:`~cablebot_gym.physics.compiling.code_cache.CodeCache`."""
    compiled = numba.njit(**options)(function)
    compiled._cache = CodeCache(function)
    return compiled
