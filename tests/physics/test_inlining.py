"""Decorators of compiled functions: what they compile, and how often."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core import event

from cablebot_gym.physics.compiling import (
    compile_time_constant,
    fma,
    helper,
    inline,
    inlining,
)
from cablebot_gym.physics.kernel.arithmetic import sincos


class Compilations(event.Listener):
    """Names of the functions that numba compiles."""

    def __init__(self):
        self.names = []

    def on_start(self, event):
        self.names.append(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event):
        pass


@compile_time_constant
class Choice(NamedTuple):
    doubles: bool
    count: int


@inline
def doubled(value):
    return 2 * value


@inline
def tripled(value):
    return 3 * value


@inline
def times(choice, value):
    return doubled(value) if choice.doubles else tripled(value)


@helper
def summed(choice, value):
    total = 0
    for _ in range(choice.count):
        total += times(choice, value)
    return total


def caller(choice, value):
    """A function that Python can call, for a choice and a literal value."""
    return njit(lambda: summed(choice, value))


def test_branches_of_constants_are_not_compiled_and_literals_share_a_compilation():
    compilations = Compilations()
    doubles = Choice(doubles=True, count=11)
    with event.install_listener("numba:compile", compilations):
        assert [caller(doubles, value)() for value in (1, 2, 3)] == [22, 44, 66]
        assert compilations.names.count("summed") == 1
        assert "tripled" not in compilations.names
        assert caller(Choice(doubles=False, count=2), 5)() == 30
    assert "tripled" in compilations.names


def test_inlined_function_that_allocates_raises():
    @inline
    def fresh(size):
        return np.zeros(size)

    with pytest.raises(TypeError, match="decorate it with helper"):
        njit(lambda: fresh(3).sum())()


# --- another numba ------------------------------------------------------------------------------------------------


LEAN = "cablebot_gym.physics.compiling.lean"
"""The module that extends numba."""


def horner(inline, helper):
    """A compiled function of decorators: fused sums, and branches of a constant."""
    turn = inline(sincos.py_func)

    @inline
    def term(choice, value):
        sine, cosine = turn(value)
        return fma(sine, cosine, 0.1) if choice.doubles else sine

    @helper
    def total(choice, values):
        result = 0.0
        for i in range(choice.count):
            result = fma(result, 0.3, term(choice, values[i]))
        return result

    choice = Choice(doubles=True, count=7)
    return njit(lambda values: total(choice, values))


def test_ordinary_functions_of_numba_have_the_same_bits(monkeypatch, caplog):
    """Where numba has no longer what the fast compilation extends. A line says so."""
    monkeypatch.delattr("numba.core.codegen.JITCodeLibrary")
    monkeypatch.delitem(sys.modules, LEAN)
    specification = importlib.util.find_spec(inlining.__name__)
    ordinary = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(ordinary)
    (record,) = caplog.records
    assert "JITCodeLibrary" in record.message
    values = np.linspace(-3.0, 9.0, 7)
    expected = horner(inline, helper)(values)
    assert horner(ordinary.inline, ordinary.helper)(values) == expected
