"""Assembly of the nonlinear program for IPOPT: the Jacobian and the Hessian from small dense ones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from cablebot_gym.kinematics import Array
from cablebot_gym.planning.blocks import Block
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
    "mu_strategy": "adaptive",
}


class Assembled(NamedTuple):
    """A program that IPOPT can solve."""

    solver: Any
    """Solver of CasADi."""
    low: Array
    """Lower bounds of all constraints."""
    high: Array
    """Upper bounds of all constraints."""


def assemble(
    blocks: Sequence[Block],
    variables: int,
    payload: int,
    interrupt: SolverInterrupt,
    start: dict[str, Any],
) -> Assembled:
    """The program that maximises the payload.

    Args:
        blocks: constraints.
        variables: number of variables.
        payload: index of the payload among the variables.
        interrupt: stops the solver after Ctrl-C.
        start: options of IPOPT for its start.
    """
    ca = import_casadi()
    z = ca.MX.sym("z", variables)
    values = []
    jacobians = []
    multipliers = []
    hessian = ca.MX(variables, variables)
    for block in blocks:
        matrix = ca.DM(block.matrix.tocsc())
        count = block.instants
        rows = block.low.shape[1]
        size = block.matrix.shape[0] // count
        numbers = ca.reshape(matrix @ z + ca.DM(block.offset), size, count)
        jacobian, curvature = derivatives(block.function)
        multipliers.append(ca.MX.sym("lam", rows * count))
        slopes = jacobian.map(count)(numbers)
        curvatures = curvature.map(count)(numbers, ca.reshape(multipliers[-1], rows, count))
        values.append(ca.vec(block.function.map(count)(numbers)))
        jacobians.append(ca.diagcat(*ca.horzsplit(slopes, size)) @ matrix)
        hessian += matrix.T @ ca.diagcat(*ca.horzsplit(curvatures, size)) @ matrix
    constraints = ca.vertcat(*values)
    lam = ca.MX.sym("lam_g", constraints.shape[0])
    ends = np.cumsum([0, *(item.shape[0] for item in multipliers)]).tolist()
    (hessian,) = ca.graph_substitute([ca.triu(hessian)], multipliers, ca.vertsplit(lam, ends))
    no_parameters = ca.MX.sym("p", 0)
    slopes = ca.Function(
        "slopes",
        [z, no_parameters],
        [constraints, ca.vertcat(*jacobians)],
        ["x", "p"],
        ["g", "jac_g_x"],
    )
    curvature = ca.Function(
        "curvature",
        [z, no_parameters, ca.MX.sym("sigma"), lam],
        [hessian],
        ["x", "p", "lam_f", "lam_g"],
        ["triu_hess_gamma_x_x"],
    )
    options = {
        "iteration_callback": interrupt.callback(ca, variables, constraints.shape[0]),
        "jac_g": slopes,
        "hess_lag": curvature,
        "print_time": False,
        "ipopt": {**_OPTIONS, **start},
    }
    program = {"x": z, "f": -z[payload], "g": constraints}
    return Assembled(
        solver=ca.nlpsol("motion", "ipopt", program, options),
        low=np.concatenate([block.low.ravel() for block in blocks]),
        high=np.concatenate([block.high.ravel() for block in blocks]),
    )
