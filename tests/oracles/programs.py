"""Linear programs of redundant tensions."""

import numpy as np
from scipy.optimize import linprog


def least_largest_action(structure, load, lower, upper, slope, offset):
    """Least largest |slope T + offset| of tensions T within their bounds that hold a load; it is the
    last variable."""
    column = -np.ones((len(slope), 1))
    steep = np.diag(slope)
    return linprog(
        np.append(0 * slope, 1),
        A_ub=np.block([[steep, column], [-steep, column]]),
        b_ub=np.append(-offset, offset),
        A_eq=np.column_stack([-structure.T, 0 * load]),
        b_eq=load,
        bounds=[*zip(lower, upper, strict=True), (0, None)],
    ).fun
