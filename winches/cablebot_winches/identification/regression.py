"""Least squares with confidence intervals, which refuses parameters that the samples do not
determine.

Smooth signals make neighbouring errors alike, so that the usual intervals would be too narrow. Here
the intervals are those of the jackknife over blocks in time: the scatter of the estimates without
one block each, with Student's t.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from cablebot_gym.kinematics import Array
from cablebot_winches.identification.samples import Samples

CONFIDENCE = 0.95
"""Confidence of the intervals."""

WIDEST = 0.5
"""Largest half width of the interval of a determined parameter, as a fraction of its value."""

TOO_WIDE = f"the interval is wider than ± {100 * WIDEST:g} % of the value"
"""Start of the reason why a parameter with a wide interval is not determined."""

LEAST_EFFECT = 0.1
"""Least effect of a parameter on another one, as a part of the torque of the first, that is named."""

LEAST_SINGULAR = 1e-6
"""Least singular value of the columns of the Jacobian, over the largest, that a step follows."""

LEAST_TOLERANCE = 0.01
"""Least part of the square of a regressor that the other regressors do not explain."""

CONSTANT = "torque_constant"
"""Name of the torque constant k_t."""

REMEDIES = {
    "load_friction": ("one load", "add a log with another load"),
    "damping": ("one speed", "add a log with another speed"),
    "motor_damping": ("one speed", "add a log with another speed"),
    "pulley_inertia": ("a constant speed", "add a log with accelerations"),
    "motor_inertia": ("a constant speed", "add a log with accelerations"),
    "coulomb_friction": ("one direction", "add a log in the other direction"),
    CONSTANT: ("one direction", "add a log in the other direction"),
    "axial_stiffness": (
        "one tension at each length",
        "add a log with another payload or pretension",
    ),
    "pulley_radius": ("one length", "add a longer motion"),
    "stiffness": ("one load", "add a log with another payload"),
}
"""What a log has that does not determine a parameter, and the remedy, in the order in which
parameters are left out."""


UNKNOWN_TENSIONS = "the tensions of redundant cables are unknown; add the columns tension_1, …"
"""Reason of a parameter that needs the tensions."""

_Groups = dict[str, tuple[tuple[int, ...], ...]]
"""Groups of motors that share a parameter, by its name."""


@dataclass(frozen=True, kw_only=True)
class ParameterEstimate:
    """Estimate of a parameter of one motor, or of several motors that share it."""

    name: str
    """Field of the transmission, or :data:`CONSTANT`."""
    motors: tuple[int, ...]
    """Indices of the motors."""
    value: float = np.nan
    """Value in SI units; NaN if the parameter is left out."""
    half_width: float = np.nan
    """Half width of the interval of :data:`CONFIDENCE`."""
    reason: str = ""
    """Why the parameter is not determined; empty if it is."""
    given: str = ""
    """Values of the robot that this one rests on, such as ``load_friction = 0.03``."""

    @property
    def is_determined(self) -> bool:
        """Whether the samples determine the parameter."""
        return not self.reason


@dataclass(frozen=True, kw_only=True, eq=False)
class WinchFit:
    """Result of the least squares."""

    estimates: tuple[ParameterEstimate, ...]
    """Estimates of all parameters."""
    residual: Array
    """Measured minus modelled response, (N,)."""


def fit(
    samples: Samples,
    names: Sequence[str],
    values: Mapping[str, Array],
    *,
    alternatives: Sequence[Samples] = (),
    same_winches: bool = False,
) -> WinchFit:
    """Parameters of each motor where the samples of each motor determine them, otherwise of all
    motors together, or of equal winches.

    Parameters that the samples cannot separate from others keep their values.

    Args:
        samples: samples.
        names: names of the regressors.
        values: present values by name, each (m,).
        alternatives: the samples under other assumptions. The intervals grow by the changes of the
            estimates with them.
        same_winches: whether all motors of the robot have the same parameters.

    Raises:
        ValueError: if torques or currents have the wrong sign, or the torque constant is not
            determined.
    """
    motors = tuple(np.unique(samples.motor).tolist())
    motors_are_joined = motors[0] < 0
    if motors_are_joined or same_winches:
        motors = tuple(range(samples.regressors.shape[1]))
    _check_sign(samples)
    equations = _Equations(samples, names, values)
    others = [_Equations(alternative, names, values) for alternative in alternatives]
    fitted = [*names]
    if samples.is_current:
        fitted.insert(0, CONSTANT)  # the equations expect it first
    separate = tuple((motor,) for motor in motors)
    if same_winches:
        separate = (motors,)
    groups: _Groups = dict.fromkeys(fitted, separate)
    left_out = []
    while True:
        name = equations.inseparable(groups)
        if not name:
            break
        if len(groups[name]) > 1:
            groups[name] = (motors,)
        elif name == CONSTANT:
            raise ValueError(f"the torque constant is not determined: {inseparable_text(name)}")
        else:
            del groups[name]
            reason = inseparable_text(name)
            if name == "load_friction" and motors_are_joined:
                reason = UNKNOWN_TENSIONS
            left_out.append(ParameterEstimate(name=name, motors=motors, reason=reason))
    estimates, residual = equations.solve(groups, others)
    for name in groups:
        is_wide = any(item.name == name and not item.is_determined for item in estimates)
        if is_wide and len(groups[name]) > 1:
            groups[name] = (motors,)
            estimates, residual = equations.solve(groups, others)
    estimates = equations.with_given(estimates, left_out)
    order = [CONSTANT, *names]
    estimates = sorted(
        [*estimates, *left_out], key=lambda item: (order.index(item.name), item.motors)
    )
    return WinchFit(estimates=tuple(estimates), residual=residual)


def inseparable_text(name: str) -> str:
    """Why the samples cannot separate a parameter from others, and the remedy."""
    state, remedy = REMEDIES[name]
    return f"the logs have {state}; {remedy}"


def given_text(name: str, values: Array) -> str:
    """A parameter with its values, one if they are equal."""
    shown = [f"{value:.3g}" for value in values.tolist()]
    if len(set(shown)) == 1:
        return f"{name} = {shown[0]}"
    return f"{name} = [{', '.join(shown)}]"


def _check_sign(samples: Samples) -> None:
    for motor in np.unique(samples.motor):
        chosen = samples.motor == motor
        if motor >= 0 and np.sum(samples.response[chosen] * samples.known[chosen]) < 0:
            quantity = "current" if samples.is_current else "torque"
            column = f"{quantity}_{motor + 1}"
            raise ValueError(
                f"{column} is negative while motor {motor + 1} pulls its cable: multiply {column} by "
                "−1. Speeds are positive while the cable winds up"
            )


class _Equations:
    """The equations ``response = (known + Σ regressor · parameter)/k_t``."""

    def __init__(self, samples: Samples, names: Sequence[str], values: Mapping[str, Array]) -> None:
        self.samples = samples
        self.names = names
        self.values = values

    def inseparable(self, groups: _Groups) -> str:
        """The first parameter of :data:`REMEDIES` whose column of the Jacobian the others explain;
        empty if there is none."""
        columns = _columns(groups)
        jacobian, _, _ = self._solution(columns)
        dependent = set()
        for column, part in zip(columns, unexplained(jacobian), strict=True):
            if part < LEAST_TOLERANCE:
                dependent.add(column.name)
        return next((name for name in REMEDIES if name in dependent), "")

    def solve(
        self, groups: _Groups, alternatives: Sequence[_Equations]
    ) -> tuple[list[ParameterEstimate], Array]:
        """Estimates, and the residual (N,)."""
        columns = _columns(groups)
        jacobian, residual, values = self._solution(columns)
        widths = half_widths(jacobian, residual, self.samples.block)
        for alternative in alternatives:
            _, _, others = alternative._solution(columns)
            widths = widths + np.abs(others - values)
        estimates = []
        for column, value, half_width in zip(columns, values, widths, strict=True):
            estimate = replace(column, value=float(value), half_width=float(half_width))
            estimates.append(replace(estimate, reason=doubt(estimate)))
        return estimates, residual

    def with_given(
        self, estimates: Sequence[ParameterEstimate], left_out: Sequence[ParameterEstimate]
    ) -> list[ParameterEstimate]:
        """The estimates with the values of the robot that they rest on: those of left-out parameters
        whose torque they would have to explain."""
        if not estimates:
            return []
        jacobian, _, _ = self._solution(estimates)
        norms = np.linalg.norm(jacobian, axis=0)
        given: list[list[str]] = [[] for _ in estimates]
        for item in left_out:
            torque = self.samples.regressors[:, :, self.names.index(item.name)].sum(axis=1)
            effects = np.linalg.lstsq(jacobian / norms, torque, rcond=None)[0]
            for index, estimate in enumerate(estimates):
                rows = jacobian[:, index] != 0
                size = np.linalg.norm(torque[rows])
                is_felt = abs(effects[index]) > LEAST_EFFECT * size
                # The torque of this friction scales the equations of the platform.
                if is_felt or item.reason == UNKNOWN_TENSIONS:
                    values = self.values[item.name][list(estimate.motors)]
                    given[index].append(given_text(item.name, values))
        return [
            replace(estimate, given=", ".join(texts))
            for estimate, texts in zip(estimates, given, strict=True)
        ]

    def _solution(self, columns: Sequence[ParameterEstimate]) -> tuple[Array, Array, Array]:
        """Jacobian (N, p), residual (N,) and values (p,) by the method of Gauss and Newton."""
        constants = [column for column in columns if column.name == CONSTANT]
        others = [column for column in columns if column.name != CONSTANT]
        regressors = np.zeros((len(self.samples.response), len(others)))
        known = self.samples.known.copy()
        for index, name in enumerate(self.names):
            known += self.samples.regressors[:, :, index] @ self.values[name]
        for position, item in enumerate(others):
            index, motors = self.names.index(item.name), list(item.motors)
            factors = self.samples.regressors[:, motors, index]
            regressors[:, position] = factors.sum(axis=1)
            known -= factors @ self.values[item.name][motors]
        response = self.samples.response
        values = np.zeros(len(columns))
        if not constants:
            if others:
                values = np.linalg.lstsq(regressors, response - known, rcond=None)[0]
            return regressors, response - known - regressors @ values, values
        members = np.zeros((len(response), len(constants)))
        for position, item in enumerate(constants):
            members[:, position] = np.isin(self.samples.motor, item.motors)
        count = len(constants)
        values[:count] = (known**2 @ members) / ((known * response) @ members)
        for _ in range(50):
            torque = known + regressors @ values[count:]
            constant = (members @ values[:count])[:, None]
            jacobian = np.hstack([-members * torque[:, None] / constant**2, regressors / constant])
            residual = response - torque / constant[:, 0]
            scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-12)
            # Columns that others explain would make the steps huge.
            step = np.linalg.lstsq(jacobian / scale, residual, rcond=LEAST_SINGULAR)[0]
            values = values + step / scale
            if np.linalg.norm(step) < 1e-9 * np.linalg.norm(response):
                break
        return jacobian, residual, values


def _columns(groups: _Groups) -> list[ParameterEstimate]:
    """One column of the Jacobian for each parameter and group of motors."""
    return [ParameterEstimate(name=name, motors=group) for name in groups for group in groups[name]]


def unexplained(jacobian: Array) -> Array:
    """Part of the square of each column that the other columns do not explain, (p,); 0 for a column
    of zeros."""
    norms = np.linalg.norm(jacobian, axis=0)
    triangle: Array = np.linalg.qr(jacobian / np.where(norms > 0, norms, 1.0)).R
    parts = np.empty(len(norms))
    for index in range(len(norms)):
        others = np.delete(triangle, index, axis=1)
        explained = others @ np.linalg.lstsq(others, triangle[:, index], rcond=None)[0]
        parts[index] = np.sum((triangle[:, index] - explained) ** 2)
    return parts


def half_widths(jacobian: Array, residual: Array, block: Array) -> Array:
    """Half widths of the intervals by the jackknife over blocks, (p,)."""
    size = jacobian.shape[1]
    if not size:
        return np.zeros(0)
    scale = np.linalg.norm(jacobian, axis=0)
    jacobian = jacobian / scale
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    changes, blocks = [], np.zeros(size)
    for number in np.unique(block):
        rows = jacobian[block == number]
        gram = rows.T @ rows
        # A block that alone determines a parameter makes the matrix singular: the small number gives
        # the parameter a huge change, and so a huge interval.
        reduced = (1 + 1e-9) * np.eye(size) - gram @ inverse
        changes.append(inverse @ np.linalg.solve(reduced, rows.T @ residual[block == number]))
        blocks += np.diag(gram) > 1e-9
    degrees = np.maximum(blocks - 1, 1e-3)
    variance = np.sum(np.square(changes), axis=0) * degrees / np.maximum(blocks, 1)
    quantile = student.ppf((1 + CONFIDENCE) / 2, np.maximum(degrees, 1))
    widths: Array = np.where(blocks > 1, quantile * np.sqrt(variance) / scale, np.inf)
    return widths


def jackknife_half_width(estimates: Sequence[float]) -> float:
    """Half width of the interval of an estimate from those without one block each."""
    count = len(estimates)
    if count < 2:
        return np.inf
    variance = np.var(estimates) * (count - 1)
    return float(student.ppf((1 + CONFIDENCE) / 2, count - 1) * np.sqrt(variance))


def doubt(estimate: ParameterEstimate) -> str:
    """Why an estimate does not determine its parameter; empty if it does."""
    _, remedy = REMEDIES[estimate.name]
    if estimate.half_width > WIDEST * abs(estimate.value):
        log = remedy.removeprefix("add ")
        return f"{TOO_WIDE}; add longer logs, or {log}"
    if estimate.value < 0:
        return "the value is negative; check the signs, the loads and the unit of the columns"
    return ""
