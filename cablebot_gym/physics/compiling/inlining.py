"""Decorators of compiled functions, which keep the time of the first call short.

Numba optimises each function, translates it into machine code and wraps it for Python, also a
helper that is only inlined into others. It compiles a helper again for each literal argument, and
it compiles branches on the kind of robot that are never taken. Functions of :func:`inline` and
:func:`helper` are translated into LLVM's language once for each type of their arguments. LLVM
optimises them as parts of the entry points only. With a numba whose compiler has changed, they are
ordinary functions of numba: slower to compile, with the same results.
"""

from __future__ import annotations

import logging
from functools import partial

import numba

from cablebot_gym.physics.compiling.loading import collection_paused

_LOGGER = logging.getLogger("cablebot_gym")

try:
    with collection_paused():
        from cablebot_gym.physics.compiling.lean import lean_helper
except (ImportError, AttributeError) as error:
    _LOGGER.warning(
        "compilation takes several times longer, with the same results: this package does not know the compiler of "
        "numba %s (%s)",
        numba.__version__,
        error,
    )
    lean_helper = partial(numba.njit, error_model="numpy")

inline = partial(lean_helper, forceinline=True)
"""Decorator of functions that are inlined into all compiled functions that call them. They use
arrays of their callers only: they neither make nor return any. Python cannot call them."""

helper = partial(lean_helper, forceinline=False)
"""Decorator of functions that only compiled functions call, and that LLVM inlines where it pays."""
