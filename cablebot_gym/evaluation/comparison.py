"""Comparison of policies over the same draws, with one or more payloads: tracking errors, torques
and tensions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs import described
from cablebot_gym.evaluation.batch import (
    Batch,
    EpisodeSpec,
    StepCount,
    versions,
)
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.rollout import Rollout, record
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import LoadedPolicy, Wrapper, name_of
from cablebot_gym.task import Task
from cablebot_gym.utils.checks import number, numbers
from cablebot_gym.utils.console import Progress, chosen_progress
from cablebot_gym.utils.files import write_csv
from cablebot_gym.utils.results import Result

CONFIDENCE = 0.95
"""Confidence of every interval."""

RESAMPLES = 2000
"""Number of bootstrap resamples for the interval of a reduction."""

_RECORDED = (
    *("tracking_error", "rotation_error", "tracking_error_peak", "rotation_error_peak"),
    *("torques", "commanded_action", "least_tensions", "largest_tensions", "time"),
)
"""Recorded arrays of every draw."""

REDUCTION_QUANTITIES = ("mean_error", "rms_error", "max_error")
"""Quantities with a reported reduction relative to the first policy."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Mean over the draws with its confidence interval, see :data:`CONFIDENCE`."""

    mean: float
    """Mean over the draws."""
    low: float
    """Lower end of the interval; the mean itself for one draw."""
    high: float
    """Upper end of the interval; the mean itself for one draw."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyMetrics:
    """Metrics of one policy. Arrays have one entry for each draw.

    After an early termination, the position error counts as constant for the rest of the motion: at
    its last value, or at the termination radius if that is larger. The other quantities count until
    the termination.
    """

    policy: str
    """Name of the policy."""
    isolated: bool
    """Whether it ran in a process of its own."""
    shipped: bool
    """Whether it has only code of this project."""
    mean_error: Array
    """Position error, mean over time [m]."""
    rms_error: Array
    """Position error, root mean square over time [m]."""
    max_error: Array
    """Largest position error at any physics step [m]."""
    max_rotation: Array
    """Largest rotation error at any physics step [rad]; 0 for a planar robot."""
    rms_torque: Array
    """Torque, root mean square over time and motors [N·m]."""
    peak_torque: Array
    """Largest |τ| at any control instant [N·m]."""
    torque_margin: Array
    """1 − max |a|: least remaining fraction of the torque-speed line; negative if a policy requests
    more torque."""
    least_tension: Array
    """Least tension of any cable at a physics step [N]."""
    largest_tension: Array
    """Largest tension of any cable at a physics step [N]."""
    carried: NDArray[np.bool_]
    """Whether the payload was carried under the task criterion."""
    ended: NDArray[np.bool_]
    """Whether the environment terminated the episode early."""
    error: Array = field(repr=False)
    """Position error at the end of each control step, (steps, draws) [m]; NaN after an early
    termination."""
    rotation: Array = field(repr=False)
    """Rotation error at the end of each control step, (steps, draws) [rad]; NaN after an early
    termination."""

    def estimate(self, quantity: str) -> Estimate:
        """Mean of a quantity over the draws with the confidence interval of Student's
        t-distribution."""
        from scipy.special import stdtrit  # slow to import

        values: Array = getattr(self, quantity)
        mean = float(values.mean())
        width = 0.0
        if len(values) > 1:
            error = float(values.std(ddof=1)) / math.sqrt(len(values))
            width = float(stdtrit(len(values) - 1, (1 + CONFIDENCE) / 2)) * error
        return Estimate(mean=mean, low=mean - width, high=mean + width)

    @property
    def success(self) -> Estimate:
        """Fraction of the draws that carry the payload, with the confidence interval of Clopper and
        Pearson."""
        from scipy.stats import binomtest  # slow to import

        fraction = float(self.carried.mean())
        draws = len(self.carried)
        if draws == 1:
            return Estimate(mean=fraction, low=fraction, high=fraction)
        ends = binomtest(int(self.carried.sum()), draws).proportion_ci(CONFIDENCE)
        return Estimate(mean=fraction, low=float(ends.low), high=float(ends.high))


QUANTITIES = {
    "mean_error": "m",
    "rms_error": "m",
    "max_error": "m",
    "max_rotation": "rad",
    "rms_torque": "N·m",
    "peak_torque": "N·m",
    "torque_margin": "1",
    "least_tension": "N",
    "largest_tension": "N",
}
"""Quantities of :class:`PolicyMetrics` that have an estimate, and their units."""

_PER_DRAW = (*QUANTITIES, "carried", "ended")
"""Quantities of every draw in the data of a comparison."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Comparison(Result):
    """Comparison of policies over the same draws. ``print(comparison)`` shows a summary."""

    conditions: Conditions
    """Conditions of all episodes."""
    payload: float
    """Nominal payload [kg]."""
    draw_seeds: tuple[int, ...]
    """Seed of each draw. ``env.reset(seed=…)`` or ``cablebot rollout --seed`` repeats the draw."""
    metrics: tuple[PolicyMetrics, ...] = field(repr=False)
    """Metrics of the policies, in the order of the arguments."""
    environment: dict[str, Any]
    """Robot, trajectory, uncertainty, control frequency and further settings, as JSON-able data."""
    task: Task = field(repr=False)
    """Public task of the episodes."""

    @property
    def not_isolated(self) -> tuple[str, ...]:
        """Names of the policies that are neither isolated nor shipped, and could change the
        evaluation."""
        names = []
        for metrics in self.metrics:
            if not (metrics.isolated or metrics.shipped):
                names.append(metrics.policy)
        return tuple(names)

    @property
    def draws(self) -> int:
        """Number of episodes of each policy."""
        return len(self.draw_seeds)

    def reduction(self, index: int, quantity: str) -> Estimate:
        """Relative reduction of a quantity by policy ``index`` with respect to the first policy.

        The reduction is 1 − (mean of policy ``index``)/(mean of the first policy) over paired
        draws. The interval is a seeded percentile bootstrap over the draws.
        """
        base = getattr(self.metrics[0], quantity)
        values = getattr(self.metrics[index], quantity)
        fraction = float(1 - values.mean() / base.mean())
        if self.draws == 1 or index == 0:
            return Estimate(mean=fraction, low=fraction, high=fraction)
        resampled = np.random.default_rng(self.conditions.seed).integers(
            self.draws, size=(RESAMPLES, self.draws)
        )
        fractions = 1 - values[resampled].mean(axis=1) / base[resampled].mean(axis=1)
        low, high = np.quantile(fractions, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
        return Estimate(mean=fraction, low=float(low), high=float(high))

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data: estimates, reductions and the values of each draw, without the time
        series."""
        policies = []
        for index, metrics in enumerate(self.metrics):
            values = {name: getattr(metrics, name).tolist() for name in _PER_DRAW}
            reductions = {}
            if index > 0:
                for name in REDUCTION_QUANTITIES:
                    reductions[name] = vars(self.reduction(index, name))
            policies.append(
                {
                    "policy": metrics.policy,
                    "isolated": metrics.isolated,
                    "shipped": metrics.shipped,
                    "estimates": {name: vars(metrics.estimate(name)) for name in QUANTITIES},
                    "reductions": reductions,
                    "per_draw": values,
                }
            )
        conditions = self.conditions.summary()
        del conditions["criterion"]  # episodes run to the end of the motion
        return conditions | {
            "payload": self.payload,
            "draws": self.draws,
            "draw_seeds": list(self.draw_seeds),
            "isolated": all(metrics.isolated for metrics in self.metrics),
            "error_bounds": vars(self.conditions.bounds),
            "environment": self.environment,
            "versions": versions(),
            "confidence": CONFIDENCE,
            "policies": policies,
        }

    def describe(self, *words: str) -> str:
        """Robot, some words, payload model, and draws of the uncertainty."""
        conditions = self.conditions
        draws = conditions.uncertainty_name or "no uncertainty"
        if conditions.uncertainty_name or self.draws > 1:
            draws = f"{self.draws} draw{'' if self.draws == 1 else 's'} of {draws}"
        robot = described(conditions.env_id, conditions.nominal_robot.name)
        return ", ".join([robot, *words, conditions.payload_model, draws])

    def __str__(self) -> str:
        lines = [self.describe(f"payload {self.payload:g} kg")]
        for index, metrics in enumerate(self.metrics):
            mean = metrics.estimate("mean_error")
            largest = metrics.estimate("max_error")
            change = ""
            if index > 0:
                reduction = self.reduction(index, "mean_error").mean
                change = f" ({-reduction:+.0%} versus {self.metrics[0].policy})"
            lines.append(
                f"{metrics.policy}: error {1e3 * mean.mean:.3g} mm mean{change}, "
                f"{1e3 * largest.mean:.3g} mm max; carried in {metrics.carried.mean():.0%}"
            )
        if self.not_isolated:
            lines.append(f"not isolated: {', '.join(self.not_isolated)}")
        return "\n".join(lines)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PayloadComparison(Result):
    """Comparisons of the same policies with increasing payloads. ``print(comparison)`` shows a
    summary."""

    comparisons: tuple[Comparison, ...]
    """One comparison for each payload."""

    @property
    def payloads(self) -> Array:
        """Nominal payloads, (k,) [kg]."""
        return np.array([comparison.payload for comparison in self.comparisons])

    @property
    def policies(self) -> tuple[str, ...]:
        """Names of the policies."""
        return tuple(metrics.policy for metrics in self.comparisons[0].metrics)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data: the payloads and the comparison with each of them."""
        return {
            "payloads": self.payloads.tolist(),
            "comparisons": [comparison.to_dict() for comparison in self.comparisons],
        }

    def __str__(self) -> str:
        return "\n".join(map(str, self.comparisons))


def save_draws(comparison: Comparison | PayloadComparison, path: str | Path) -> None:
    """Writes a CSV file with a row for each payload, policy and draw. An interrupted call leaves no
    partial file."""
    head = [f"{name} [{unit}]" for name, unit in QUANTITIES.items()]
    rows: list[list[Any]] = [["payload [kg]", "policy", "seed", *head, "carried", "ended"]]
    if isinstance(comparison, PayloadComparison):
        compared = comparison.comparisons
    else:
        compared = (comparison,)
    for item in compared:
        for metrics in item.metrics:
            # 0 makes numbers of truth values, which all programs read
            columns = [(0 + getattr(metrics, name)).tolist() for name in _PER_DRAW]
            for seed, *values in zip(item.draw_seeds, *columns, strict=True):
                rows.append([item.payload, metrics.policy, seed, *values])
    write_csv(path, rows)


def compare_policies(
    policies: Sequence[Any],
    env_id: str,
    *,
    payload: float = 0.0,
    names: Sequence[str] | None = None,
    wrappers: Sequence[Sequence[Wrapper]] | None = None,
    progress: Progress | bool | None = None,
    **conditions: Any,
) -> Comparison:
    """Runs all policies with one payload over the same draws.

    Args:
        policies: names, objects with ``predict``, or callables. Reductions are relative to the
            first policy.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        payload: nominal payload [kg].
        names: names of the policies in the result; None for their own names.
        wrappers: wrappers of the training of each policy, the innermost first, see
            :data:`cablebot_gym.policies.wrappers.Wrapper`; None for no wrappers.
        progress: callback after every control step; True shows it on standard error.
        conditions: ``uncertainty``, ``draws``, ``seed``, ``error_bounds``, ``robot`` and keywords of
            the environment, such as ``trajectory``: see
            :class:`~cablebot_gym.evaluation.conditions.Conditions`.

    Raises:
        ValueError: if an argument is invalid, or if two policies have the same name.
        cablebot_gym.policies.protocol.PolicyError: if a policy raises or returns anything but
            finite actions.
    """
    labels = _labels(policies, names)
    wrappers_of = [()] * len(labels) if wrappers is None else list(wrappers)
    payload = number("payload", payload, least=0, unit="kg")
    shared = Conditions.of(env_id, compare_policies, **conditions)
    metrics = []
    with chosen_progress(progress, "comparing") as step:
        count = StepCount(step, 0)
        for policy, label, layers in zip(policies, labels, wrappers_of, strict=True):
            batch = Batch(policy, shared, name=label, wrappers=layers)
            count.expected = len(labels) * batch.task.steps
            rows = [EpisodeSpec(payload, seed) for seed in batch.seeds]
            rollouts = record(batch, rows, _RECORDED, count)
            radius = batch.settings.error_bounds.termination_radius
            metrics.append(_metrics(batch.policy, rollouts, radius))
    return Comparison(
        conditions=shared,
        payload=payload,
        draw_seeds=tuple(batch.seeds),
        metrics=tuple(metrics),
        environment=batch.environment(),
        task=batch.task,
    )


def _labels(policies: Sequence[Any], names: Sequence[str] | None) -> list[str]:
    """Distinct names of the policies.

    Raises:
        ValueError: if there is no policy, or if two have the same name.
    """
    if isinstance(policies, str) or not policies:
        raise ValueError(f"policies must be a list, such as ['fl', 'robust'], not {policies!r}")
    labels = list(names or map(name_of, policies))
    if len(set(labels)) < len(policies) or len(labels) != len(policies):
        raise ValueError(f"policies need distinct names, not {', '.join(labels)}")
    return labels


def compare_over_payloads(
    policies: Sequence[Any],
    env_id: str,
    *,
    payloads: Sequence[float],
    progress: Progress | bool | None = None,
    **keywords: Any,
) -> PayloadComparison:
    """Runs :func:`compare_policies` with each payload. All payloads share the draws.

    Args:
        policies: names, objects with ``predict``, or callables.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        payloads: nominal payloads, increasing [kg].
        progress: callback after every control step; True shows it on standard error.
        keywords: further keywords of :func:`compare_policies`.

    Raises:
        ValueError: if an argument is invalid.
        cablebot_gym.policies.protocol.PolicyError: if a policy raises or returns anything but
            finite actions.
    """
    grid = numbers("payloads", payloads, least=0, unit="kg")
    if grid.ndim != 1 or not len(grid) or np.any(np.diff(grid) <= 0):
        raise ValueError(
            f"payloads must be increasing numbers, such as [0, 1, 2], not {payloads!r}"
        )
    comparisons: list[Comparison] = []
    with chosen_progress(progress, "comparing") as step:

        def count(done: int, expected: int) -> None:
            if step is not None:
                step(done + len(comparisons) * expected, len(grid) * expected)

        for payload in grid.tolist():
            comparisons.append(
                compare_policies(policies, env_id, payload=payload, progress=count, **keywords)
            )
    return PayloadComparison(comparisons=tuple(comparisons))


def _metrics(
    policy: LoadedPolicy, rollouts: Sequence[Rollout], termination_radius: float
) -> PolicyMetrics:
    """Metrics of one policy from its draws. The errors at the start of the episodes come from the
    verdicts.

    Args:
        policy: the policy.
        rollouts: recording of every draw.
        termination_radius: least position error that counts after an early termination [m].
    """

    def largest(name: str) -> Array:
        return np.array([np.abs(rollout.arrays[name]).max() for rollout in rollouts])

    error, rotation = (_series(rollouts, name) for name in ("tracking_error", "rotation_error"))
    ended = np.array([rollout.reason != "" for rollout in rollouts])
    final = np.maximum(
        [rollout.arrays["tracking_error"][-1] for rollout in rollouts], termination_radius
    )
    missing = rollouts[0].task.steps - len(error)
    filled = np.pad(error, [(0, missing), (0, 0)], constant_values=np.nan)
    filled = np.where(np.isnan(filled), final, filled)
    peak = np.maximum(
        largest("tracking_error_peak"), [rollout.verdict.position_peak for rollout in rollouts]
    )
    return PolicyMetrics(
        policy=policy.name,
        isolated=policy.isolated,
        shipped=policy.shipped,
        mean_error=filled.mean(axis=0),
        rms_error=np.sqrt((filled**2).mean(axis=0)),
        max_error=np.where(ended, np.maximum(peak, final), peak),
        max_rotation=np.maximum(
            largest("rotation_error_peak"), [rollout.verdict.rotation_peak for rollout in rollouts]
        ),
        rms_torque=np.array(
            [math.sqrt(np.mean(rollout.arrays["torques"] ** 2)) for rollout in rollouts]
        ),
        peak_torque=largest("torques"),
        torque_margin=1 - largest("commanded_action"),
        least_tension=np.array([rollout.arrays["least_tensions"].min() for rollout in rollouts]),
        largest_tension=largest("largest_tensions"),
        carried=np.array([rollout.verdict.carried for rollout in rollouts]),
        ended=ended,
        error=error,
        rotation=rotation,
    )


def _series(rollouts: Sequence[Rollout], name: str) -> Array:
    """An array of every rollout, (steps, draws), with NaN after an early termination."""
    arrays = [rollout.arrays[name] for rollout in rollouts]
    longest = max(map(len, arrays))
    series = np.full((longest, len(arrays)), np.nan)
    for draw, values in enumerate(arrays):
        series[: len(values), draw] = values
    return series
