"""Solver of quadratic programs that are solved one after the other, thousands of times."""

from __future__ import annotations

from typing import Any

import numpy as np

from cablebot_gym.kinematics import Array


class PlanningError(RuntimeError):
    """The quadratic program has no solution, or the solver failed."""


class BufferedSolver:
    """CasADi solver that reads and writes NumPy arrays in place. Matrix conversion would take
    longer than the solver.

    Args:
        solver: solver of a quadratic program with dense arguments.
    """

    def __init__(self, solver: Any) -> None:
        self._buffer, self._evaluate = solver.buffer()
        self.inputs: dict[str, Array] = {}
        """Input arrays by name, column-major. The caller writes to them."""
        for index in range(solver.n_in()):
            flat: Any = np.zeros(solver.numel_in(index))
            if flat.size:
                self._buffer.set_arg(index, memoryview(flat))
                name = solver.name_in(index)
                shape = solver.size_in(index)
                self.inputs[name] = flat.reshape(shape, order="F")
        variables: Any = np.zeros(solver.numel_out("x"))
        self._buffer.set_res(solver.index_out("x"), memoryview(variables))
        self._variables: Array = variables

    def __call__(self) -> Array:
        """Solves the program and returns its variables. The next call overwrites them.

        Raises:
            PlanningError: if CasADi rejects the inputs, or the solver fails.
        """
        try:
            self._evaluate()
        except RuntimeError as error:
            raise PlanningError(str(error)) from error
        if not (self._buffer.stats()["success"] and np.isfinite(self._variables).all()):
            raise PlanningError("the solver failed")
        return self._variables
