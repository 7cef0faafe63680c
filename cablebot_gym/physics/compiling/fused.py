"""The fused multiply-add a b + c, rounded once: of compiled code, and of Python with the same bits."""

from __future__ import annotations

import ctypes
import math
import random
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from fractions import Fraction
from functools import cache
from typing import Any

from numba import types
from numba.extending import intrinsic

FusedMultiplyAdd = Callable[[float, float, float], float]


def _fused(context: Any, a: Any, b: Any, c: Any) -> Any:
    """Explicit fused a b + c. Otherwise the compiler rounds differently for one lane and for a
    tile."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), generate


fma: Any = intrinsic(_fused)


@cache
def python_fma() -> FusedMultiplyAdd:
    """:data:`fma` for Python's numbers.

    Raises:
        ArithmeticError: if this machine has none that rounds once.
    """
    for candidate in _candidates():
        if is_exact(candidate):
            return candidate
    raise ArithmeticError("no library rounds a b + c once")


def _candidates() -> Iterator[FusedMultiplyAdd]:
    """Python's own function, from Python 3.13 on, and those of the C libraries."""
    if hasattr(math, "fma"):
        yield math.fma
    # None: all that the process has loaded, which includes glibc, musl and macOS's libSystem
    for library in (None, "libm.so.6", "ucrtbase"):
        with suppress(AttributeError, OSError, TypeError):
            function = ctypes.PyDLL(library).fma  # PyDLL keeps the lock of the interpreter: faster
            function.restype = ctypes.c_double
            function.argtypes = [ctypes.c_double] * 3
            yield function


def is_exact(candidate: FusedMultiplyAdd) -> bool:
    """Whether a function rounds a b + c once, compared with fractions.

    Some sums cancel all but the rounding error of the product. Some products are beyond the largest
    number, and some results below the smallest normal one.
    """
    draw = random.Random(0)
    for exponent in (0, 511, -505):
        for _ in range(16):
            a = math.ldexp(draw.uniform(1.0, 2.0), exponent)
            b = math.ldexp(draw.uniform(1.0, 2.0), exponent + 1)
            for c in (-a * b, -a * (b / 2), math.ldexp(draw.uniform(-1.0, 1.0), 2 * exponent)):
                if not math.isfinite(c):
                    continue
                exact = Fraction(a) * Fraction(b) + Fraction(c)
                if abs(exact) <= sys.float_info.max and candidate(a, b, c) != float(exact):
                    return False
    return True
