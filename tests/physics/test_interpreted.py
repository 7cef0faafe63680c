"""Rarely called functions: Python computes their first items, and nothing is compiled for them."""

from dataclasses import astuple

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cablebot_gym.physics import central_tensions, distribution, tension_problems
from cablebot_gym.physics.inlining import FEW_ITEMS

CABLES, COORDINATES, ITEMS = 5, 3, 60


def problems():
    """Structures, loads and upper bounds; half of the loads push, which no tensions hold."""
    rng = np.random.default_rng(3)
    structure = rng.normal(size=(ITEMS, CABLES, COORDINATES))
    load = -np.einsum("kmn,km->kn", structure, rng.uniform(2.0, 10.0, (ITEMS, CABLES)))
    load[::2] = rng.normal(size=(ITEMS // 2, COORDINATES))
    structure[7] = 0.0
    return structure, load


STRUCTURE, LOAD = problems()
CALLS = {
    "solve_least_norm": lambda: distribution.least_norm(STRUCTURE, LOAD, 1.0, 20.0),
    "solve_least_largest": lambda: distribution.unchecked_least_largest_action(
        STRUCTURE, LOAD, 1.0, 0.5, 0.1, 20.0
    ),
    "solve_central": lambda: [distribution.central(STRUCTURE, LOAD, 1.0, 0.05, 0.1)],
    "solve_feasible": lambda: distribution.feasible(STRUCTURE, LOAD, 1.0, 20.0),
    "solve_interval": lambda: distribution.largest_scale(
        STRUCTURE, LOAD, LOAD[::-1], 1.0, 20.0, 10.0
    ),
}


def values_of(result):
    return result if isinstance(result, list) else astuple(result)


@pytest.mark.parametrize("name", CALLS)
def test_python_and_compiled_code_give_the_same_bits(name, monkeypatch):
    """Excludes a power or a sum that Python rounds in another way."""
    module = central_tensions if name == "solve_central" else tension_problems
    function = getattr(module, name)
    monkeypatch.setattr(function, "_items_left", ITEMS)
    interpreted = CALLS[name]()
    assert function._items_left == 0
    compiled = CALLS[name]()
    for python_values, compiled_values in zip(
        *map(values_of, (interpreted, compiled)), strict=True
    ):
        assert_array_equal(python_values, compiled_values)


def test_first_resets_do_not_compile_the_distribution(monkeypatch):
    """Excludes ten seconds of compilation before the first step of a robot with redundant
    cables."""
    monkeypatch.setattr(tension_problems.solve_least_largest, "_items_left", FEW_ITEMS)
    monkeypatch.setattr(tension_problems.solve_least_largest, "compiled", None)
    env = gym.make("CableBot-Point-v0")
    for payload in (0.0, 1.0, 2.0):
        env.reset(seed=0, options={"payload": payload})
