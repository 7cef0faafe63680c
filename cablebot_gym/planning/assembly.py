"""Assembly of the nonlinear program for IPOPT: the Jacobian and the Hessian from small dense ones."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.planning.blocks import ConstraintBlock
from cablebot_gym.planning.signals import SolverInterrupt
from cablebot_gym.planning.stage_functions import derivatives, import_casadi

_TOLERANCE = 1e-5
"""Tolerance of IPOPT on the scaled program. Payloads are then accurate to 0.1 g."""


_OPTIONS = {
    "print_level": 0,
    "sb": "yes",
    "max_iter": 200,
    "tol": _TOLERANCE,
    "acceptable_tol": 10 * _TOLERANCE,
    "linear_solver": "mumps",
    # minimum degree: on these band matrices three times faster than automatic
    "mumps_pivot_order": 0,
}

_COLD_START = {"mu_strategy": "monotone"}
"""Options of IPOPT for a start far from the solution. The adaptive strategy takes half as many
iterations again."""


_WARM_START = {
    "mu_strategy": "adaptive",
    "warm_start_init_point": "yes",
    "mu_init": 1e-5,
    **{f"warm_start_{name}_push": 1e-8 for name in ("bound", "slack_bound", "mult_bound")},
}
"""Options of IPOPT for a start with multipliers close to the solution."""


_NEAR_START = {"mu_strategy": "monotone", "mu_init": 1e-4}
"""Options of IPOPT for a start without multipliers close to the solution."""


class Assembled:
    """A program that maximises the payload, and its solvers.

    Args:
        blocks: constraints.
        variables: number of variables.
        payload: index of the payload among the variables.
        interrupt: stops the solver after Ctrl-C.
    """

    def __init__(
        self,
        blocks: Sequence[ConstraintBlock],
        variables: int,
        payload: int,
        interrupt: SolverInterrupt,
    ) -> None:
        ca = import_casadi()
        self.blocks = blocks
        z = ca.MX.sym("z", variables)
        values = []
        jacobians = []
        multipliers = []
        hessian = ca.MX(variables, variables)
        for block in blocks:
            matrix = ca.DM(block.matrix.tocsc())
            count = len(block.times)
            size = block.matrix.shape[0] // count
            numbers = ca.reshape(matrix @ z + ca.DM(block.offset), size, count)
            jacobian, curvature = derivatives(block.function)
            multipliers.append(ca.MX.sym("lam", block.values * count))
            slopes = jacobian.map(count)(numbers)
            weights = ca.reshape(multipliers[-1], block.values, count)
            curvatures = curvature.map(count)(numbers, weights)
            values.append(ca.vec(block.function.map(count)(numbers)))
            jacobians.append(ca.diagcat(*ca.horzsplit(slopes, size)) @ matrix)
            hessian += matrix.T @ ca.diagcat(*ca.horzsplit(curvatures, size)) @ matrix
        constraints = ca.vertcat(*values)
        self.constraints = constraints.shape[0]
        lam = ca.MX.sym("lam_g", self.constraints)
        ends = np.cumsum([0, *(item.shape[0] for item in multipliers)]).tolist()
        (hessian,) = ca.graph_substitute([ca.triu(hessian)], multipliers, ca.vertsplit(lam, ends))
        no_parameters = ca.MX.sym("p", 0)
        self._program = {"x": z, "f": -z[payload], "g": constraints}
        self._options = {
            "iteration_callback": interrupt.callback(ca, variables, self.constraints),
            "jac_g": ca.Function(
                "slopes",
                [z, no_parameters],
                [constraints, ca.vertcat(*jacobians)],
                ["x", "p"],
                ["g", "jac_g_x"],
            ),
            "hess_lag": ca.Function(
                "curvature",
                [z, no_parameters, ca.MX.sym("sigma"), lam],
                [hessian],
                ["x", "p", "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            ),
            "print_time": False,
        }

    @cached_property
    def cold_solver(self) -> Any:
        """Solver for a start far from the solution."""
        return self._solver(_COLD_START)

    @cached_property
    def near_solver(self) -> Any:
        """Solver for a start close to the solution, without multipliers."""
        return self._solver(_NEAR_START)

    @cached_property
    def warm_solver(self) -> Any:
        """Solver for a start with multipliers close to the solution."""
        return self._solver(_WARM_START)

    def _solver(self, start: dict[str, Any]) -> Any:
        options = self._options | {"ipopt": {**_OPTIONS, **start}}
        return import_casadi().nlpsol("motion", "ipopt", self._program, options)

    def bounds(self, program: Any) -> tuple[Array, Array]:
        """Lower and upper bounds of all constraints for the program."""
        lows, highs = zip(*(block.bounds(program) for block in self.blocks), strict=True)
        return np.concatenate(lows), np.concatenate(highs)
