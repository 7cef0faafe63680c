"""Decorators of compiled functions: what they compile, and how often."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core import event

from cablebot_gym.physics.compiling.inlining import compile_time_constant, helper, inline


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


def test_branches_of_constants_are_not_compiled():
    compilations = Compilations()
    with event.install_listener("numba:compile", compilations):
        assert caller(Choice(doubles=True, count=3), 5)() == 30
        assert "tripled" not in compilations.names
        assert caller(Choice(doubles=False, count=2), 5)() == 30
    assert "tripled" in compilations.names


def test_literals_share_one_compilation():
    choice = Choice(doubles=True, count=11)
    compilations = Compilations()
    with event.install_listener("numba:compile", compilations):
        assert [caller(choice, value)() for value in (1, 2, 3)] == [22, 44, 66]
    assert compilations.names.count("summed") == 1


def test_inlined_function_that_allocates_raises():
    @inline
    def fresh(size):
        return np.zeros(size)

    with pytest.raises(TypeError, match="decorate it with helper"):
        njit(lambda: fresh(3).sum())()
