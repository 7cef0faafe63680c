"""Calls that Python and compiled code compute, bit by bit."""

from __future__ import annotations

import inspect
from copy import deepcopy

import numpy as np

SCRATCH = ("p", "w")
"""Arguments that hold no results."""


def assert_same_bits(python, compiled):
    """Compares values of arguments and results. All NaN are equal."""
    if isinstance(python, tuple):
        for pair in zip(python, compiled, strict=True):
            assert_same_bits(*pair)
        return
    python, compiled = map(np.asarray, (python, compiled))
    assert python.dtype == compiled.dtype
    if python.dtype == float:
        both_nan = np.isnan(python) & np.isnan(compiled)
        python = np.where(both_nan, 0.0, python).view(np.int64)
        compiled = np.where(both_nan, 0.0, compiled).view(np.int64)
    np.testing.assert_array_equal(python, compiled)


def compare_ways(monkeypatch, *entries):
    """Makes entry points compute each call in both ways, and compares them. Returns the names of
    those that have been called, a set that grows."""
    names = set()

    def compare(entry):
        def call(*arguments):
            copies = deepcopy(arguments)
            result = entry.in_python(*copies)
            assert_same_bits((result,), (entry.compiled(*arguments),))
            names_of_arguments = inspect.signature(entry).parameters
            for name, *pair in zip(names_of_arguments, copies, arguments, strict=True):
                if name not in SCRATCH:
                    assert_same_bits(*pair)
            names.add(entry.__name__)
            return result

        monkeypatch.setattr(entry, "present", call)

    for entry in entries:
        compare(entry)
    return names
