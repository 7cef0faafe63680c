"""Entry points of compiled code that Python computes at first, to the same bits.

Compilation of one takes seconds. A program that makes few calls runs the Python functions and does
not wait; one that makes many spends little on Python before it has compiled code.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, update_wrapper
from types import CellType, FunctionType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from cablebot_gym.physics.compiling.fused import fma, python_fma
from cablebot_gym.physics.compiling.loading import cached_njit, load_numba

BUDGET = 2.0
"""Estimated time of Python before an entry point is compiled [s]. With about the time of its
compilation, no program takes much more than twice the time of the better choice."""

LONGEST_CALL = 0.1
"""Estimated time of a call that compiles at once [s]: a large batch is seldom stepped only once."""

AT_ONCE = "CABLEBOT_COMPILE_AT_ONCE"
"""Environment variable: with any text, entry points are compiled at their first call."""


@contextmanager
def compiled_at_once() -> Iterator[None]:
    """Compiles entry points at their first call, also in processes that are started meanwhile: where
    no later call may take long."""
    before = os.environ.get(AT_ONCE, "")
    os.environ[AT_ONCE] = "1"
    try:
        yield
    finally:
        os.environ[AT_ONCE] = before


class EntryPoint:
    """A function that Python calls: in Python until :data:`BUDGET` is spent, then compiled.

    Stored machine code is used at once. :attr:`present` is what a call runs now.

    Args:
        function: the function, with helpers of :mod:`~cablebot_gym.physics.compiling.inlining`.
        seconds: estimated time of Python for the arguments of a call [s].
        flat: whether all its arrays are indexed by numbers only, without slices. Python reads them
            faster then.
        in_python: other values in Python for variables that the function closes over.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        seconds: Callable[..., float],
        *,
        flat: bool = False,
        in_python: Mapping[str, Any] | None = None,
    ) -> None:
        self.compiled = cached_njit(
            function, nogil=True, error_model="numpy", no_cfunc_wrapper=True
        )
        self.left = BUDGET
        """Estimated time of Python that may still be spent [s]."""
        self._seconds = seconds
        self._flat = flat
        self._in_python = in_python or {}
        self._not_stored: set[Any] = set()
        self.present: Callable[..., Any] = self._choose
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        """Computes the function."""
        return self.present(*arguments)

    @cached_property
    def _function(self) -> Callable[..., Any]:
        """The function and all that it calls in Python."""
        return _copy_of(self.compiled.py_func, {}, self._in_python)

    def in_python(self, *arguments: Any) -> Any:
        """Computes a call in Python.

        Raises:
            ArithmeticError, ValueError: where compiled code computes NaN or infinity and Python's
                numbers do not, or where Python cannot round as compiled code does. The arrays are
                then as before.
        """
        with _undone_by_exceptions(arguments), np.errstate(all="ignore"):
            if self._flat:
                return self._function(*map(_without_numpy, arguments))
            return self._function(*arguments)

    def _choose(self, *arguments: Any) -> Any:
        """Computes a call in one of both ways."""
        if self.present is self.compiled:  # a caller has kept this method
            return self.compiled(*arguments)
        price = self._seconds(*arguments)
        too_long = price > min(self.left, LONGEST_CALL)
        if too_long or os.environ.get(AT_ONCE) or self._is_stored(arguments):
            return self._compile(*arguments)
        self.left -= price
        try:
            return self.in_python(*arguments)
        except (ArithmeticError, ValueError):
            return self._compile(*arguments)

    def _is_stored(self, arguments: tuple[Any, ...]) -> bool:
        kind = _kind_of(arguments)
        if kind not in self._not_stored:
            signature = tuple(map(self.compiled.typeof_pyval, arguments))
            if self.compiled._cache.is_stored(signature, self.compiled.targetctx):
                return True
            self._not_stored.add(kind)
        return False

    def _compile(self, *arguments: Any) -> Any:
        load_numba()
        self.present = self.compiled
        return self.compiled(*arguments)


def entry_point(**options: Any) -> Callable[[Callable[..., Any]], EntryPoint]:
    """Decorator that makes an :class:`EntryPoint` with its arguments."""
    return lambda function: EntryPoint(function, **options)


def _copy_of(function: Any, copies: dict[Any, Any], variables: Mapping[str, Any]) -> Any:
    """Copy of a Python function that calls the Python functions of compiled functions, directly or
    not.

    Args:
        function: the function.
        copies: copies that have been made.
        variables: values for variables that the function closes over.

    Raises:
        ArithmeticError: see :func:`python_fma`.
    """

    def in_python(value: Any) -> Any:
        if value is fma:
            return python_fma()
        if isinstance(value, Dispatcher):
            return _copy_of(value.py_func, copies, {})
        return value

    if function not in copies:
        code = function.__code__
        scope = dict(function.__globals__)
        cells = [
            CellType(in_python(variables.get(name, cell.cell_contents)))
            for name, cell in zip(code.co_freevars, function.__closure__ or (), strict=True)
        ]
        copies[function] = FunctionType(
            code, scope, function.__name__, function.__defaults__, tuple(cells)
        )
        for name in code.co_names:
            if name in scope:
                scope[name] = in_python(scope[name])
    return copies[function]


def _kind_of(value: Any) -> Any:
    """What numba's type of an argument depends on, in a tenth of the time that numba takes."""
    if isinstance(value, tuple):
        return type(value), *map(_kind_of, value)
    if isinstance(value, np.ndarray):
        return value.dtype.char, value.ndim, value.flags.num
    return type(value)


@contextmanager
def _undone_by_exceptions(arguments: Iterable[Any]) -> Iterator[None]:
    """Restores the arrays of a call that ends with an exception, also with Ctrl-C."""
    arrays = list(_writable_arrays(arguments))
    before = [array.copy() for array in arrays]
    try:
        yield
    except BaseException:
        for array, values in zip(arrays, before, strict=True):
            array[...] = values
        raise


def _writable_arrays(values: Iterable[Any]) -> Iterator[np.ndarray[Any, Any]]:
    for value in values:
        if isinstance(value, tuple):
            yield from _writable_arrays(value)
        elif isinstance(value, np.ndarray) and value.flags.writeable:
            yield value


class _Rows:
    """A matrix whose rows and entries Python reads and writes without NumPy."""

    def __init__(self, array: np.ndarray[Any, Any]) -> None:
        self.shape = array.shape
        self._rows: list[Any] = [row.data for row in array]

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, tuple):
            row, column = index
            return self._rows[row][column]
        return self._rows[index]

    def __setitem__(self, index: tuple[int, int], value: float) -> None:
        row, column = index
        self._rows[row][column] = value


def _without_numpy(value: Any) -> Any:
    """An argument as Python reads it fastest: numbers of memory views are Python's own."""
    if not isinstance(value, np.ndarray):
        return value
    if value.ndim == 2:
        return _Rows(value)
    return value.data
