"""Linear algebra of many small quadratic programs, and their solver."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpotrf, dtrtri

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


def inverse_factors(matrices: Array) -> Array:
    """L⁻¹ with LLᵀ of symmetric matrices (N, size, size); NaN if one is not positive definite."""
    inverses = np.full_like(matrices, np.nan)
    for inverse, matrix in zip(inverses, matrices, strict=True):
        factor, failed = dpotrf(matrix, lower=1)
        if not failed:
            inverse[:], _ = dtrtri(factor, lower=1)
    return inverses


def inverse_and_null_space(forces: Array) -> tuple[Array, Array]:
    """Pseudoinverses (N, K, m, n) and null spaces (N, K, m, m − n) of matrices (N, K, n, m); NaN for a
    robot with a singular square matrix, or with a number that is not finite."""
    *_, n, m = forces.shape
    is_finite: NDArray[np.bool_] = np.asarray(np.isfinite(forces).all(axis=(1, 2, 3)))
    if n == m:
        is_finite &= (np.linalg.det(forces) != 0).all(axis=1)
    safe = np.where(is_finite[:, None, None, None], forces, np.eye(n, m))
    if n == m:
        inverse = np.linalg.inv(safe)
        null_space = np.zeros((*safe.shape[:2], m, 0))
    else:
        left, singular_values, right = np.linalg.svd(safe)
        right = np.swapaxes(right, -1, -2)
        left = np.swapaxes(left / singular_values[..., None, :], -1, -2)
        inverse = right[..., :n] @ left
        null_space = right[..., n:]
    inverse[~is_finite] = np.nan
    return inverse, null_space
