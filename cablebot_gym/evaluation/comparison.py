"""Comparison of policies with one payload over the same draws: tracking errors, torques and tensions."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from cablebot_gym.envs import described
from cablebot_gym.evaluation.batch import Batch, Progress, Trial, uncertainty_name, versions
from cablebot_gym.kinematics import Array
from cablebot_gym.policies import name_of
from cablebot_gym.task import ErrorBounds, Task, find_error_bounds

CONFIDENCE = 0.95
"""Confidence of every interval."""

RESAMPLES = 2000
"""Number of bootstrap resamples for the interval of a reduction."""

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

    After an early termination, the position error counts as constant for the rest of the motion: at its last value, or
    at the termination radius if that is larger. The other quantities count until the termination.
    """

    policy: str
    """Name of the policy."""
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
    """1 − max |a|: least remaining fraction of the torque-speed line; negative if a policy requests more torque."""
    least_tension: Array
    """Least tension of any cable at a control instant [N]."""
    carried: NDArray[np.bool_]
    """Whether the payload was carried under the task criterion."""
    ended: NDArray[np.bool_]
    """Whether the environment terminated the episode early."""
    error: Array = field(repr=False)
    """Position error at the end of each control step, (steps, draws) [m]; NaN after an early termination."""
    rotation: Array = field(repr=False)
    """Rotation error at the end of each control step, (steps, draws) [rad]; NaN after an early termination."""

    def estimate(self, quantity: str) -> Estimate:
        """Mean of a quantity over the draws with the confidence interval of Student's t-distribution."""
        values: Array = getattr(self, quantity)
        mean, width = float(values.mean()), 0.0
        if len(values) > 1:
            error = float(values.std(ddof=1)) / math.sqrt(len(values))
            width = float(stats.t.ppf((1 + CONFIDENCE) / 2, len(values) - 1)) * error
        return Estimate(mean=mean, low=mean - width, high=mean + width)


QUANTITIES = tuple(
    item.name for item in fields(PolicyMetrics) if item.name not in ("policy", "carried", "ended", "error", "rotation")
)
"""Quantities of :class:`PolicyMetrics` that have an estimate."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Comparison of policies over the same draws. ``print(comparison)`` shows a summary."""

    env_id: str
    """Id of the environment."""
    payload: float
    """Nominal payload [kg]."""
    payload_known: bool
    """Whether the payload is known to the policies."""
    model_payload_factor: float
    """Ratio of the payload in the policies' models to the nominal payload."""
    uncertainty: str | None
    """Name of the uncertainty, ``custom`` for data; None without uncertainty."""
    draws: int
    """Number of episodes of each policy."""
    seed: int
    """Seed that determines the draws."""
    draw_seeds: tuple[int, ...]
    """Seed of each draw. ``env.reset(seed=…)`` or ``cablebot rollout --seed`` repeats the draw."""
    error_bounds: ErrorBounds
    """Bounds of the tracking errors."""
    metrics: tuple[PolicyMetrics, ...]
    """Metrics of the policies, in the order of the arguments."""
    environment: dict[str, Any]
    """Robot, trajectory, uncertainty, control frequency and further settings, as JSON-able data."""
    versions: dict[str, str]
    """Versions of Python and of the packages that determine the results."""
    task: Task = field(repr=False)
    """Public task of the episodes."""

    def reduction(self, index: int, quantity: str) -> Estimate:
        """Relative reduction of a quantity by policy ``index`` with respect to the first policy.

        The reduction is 1 − (mean of policy ``index``)/(mean of the first policy) over paired draws. The interval is a
        seeded percentile bootstrap over the draws.
        """
        base, other = getattr(self.metrics[0], quantity), getattr(self.metrics[index], quantity)
        fraction = float(1 - other.mean() / base.mean())
        if self.draws == 1 or index == 0:
            return Estimate(mean=fraction, low=fraction, high=fraction)
        chosen = np.random.default_rng(self.seed).integers(self.draws, size=(RESAMPLES, self.draws))
        fractions = 1 - other[chosen].mean(axis=1) / base[chosen].mean(axis=1)
        low, high = np.quantile(fractions, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
        return Estimate(mean=fraction, low=float(low), high=float(high))

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data: estimates, reductions and the values of each draw, without the time series."""
        policies = []
        for index, metrics in enumerate(self.metrics):
            estimates = {name: vars(metrics.estimate(name)) for name in QUANTITIES}
            reductions = {name: vars(self.reduction(index, name)) for name in REDUCTION_QUANTITIES} if index else {}
            values = {name: getattr(metrics, name).tolist() for name in (*QUANTITIES, "carried", "ended")}
            policies.append(
                {"policy": metrics.policy, "estimates": estimates, "reductions": reductions, "per_draw": values}
            )
        names = (
            "env_id",
            "payload",
            "payload_known",
            "model_payload_factor",
            "uncertainty",
            "draws",
            "seed",
            "environment",
            "versions",
        )
        head = {name: getattr(self, name) for name in names} | {"draw_seeds": list(self.draw_seeds)}
        return head | {"confidence": CONFIDENCE, "error_bounds": vars(self.error_bounds), "policies": policies}

    def to_json(self) -> str:
        """The comparison as JSON, indented."""
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)

    def __str__(self) -> str:
        draws = f"{self.draws} draw{'' if self.draws == 1 else 's'} of {self.uncertainty or 'no uncertainty'}"
        lines = [f"{described(self.env_id, self.task.robot.name)}, {self.payload:g} kg, {draws}"]
        for index, metrics in enumerate(self.metrics):
            mean, largest = metrics.estimate("mean_error"), metrics.estimate("max_error")
            text = f"{metrics.policy}: error {1e3 * mean.mean:.3g} mm mean, {1e3 * largest.mean:.3g} mm max"
            if index:
                fractions = [self.reduction(index, name).mean for name in ("mean_error", "max_error")]
                texts = [f"{abs(fraction):.0%} {'less' if fraction >= 0 else 'more'}" for fraction in fractions]
                text += f" ({' and '.join(texts)} than {self.metrics[0].policy})"
            ended = f", ended early in {metrics.ended.mean():.0%}" if metrics.ended.any() else ""
            lines.append(f"{text}; carried in {metrics.carried.mean():.0%}{ended}")
        return "\n".join(lines)


def compare_policies(
    policies: Sequence[Any],
    env_id: str,
    *,
    payload: float = 0.0,
    error_bounds: ErrorBounds | dict[str, float] | None = None,
    uncertainty: Any = None,
    draws: int | None = None,
    seed: int = 0,
    names: Sequence[str] | None = None,
    progress: Progress | None = None,
    **keywords: Any,
) -> Comparison:
    """Runs all policies with one payload over the same draws.

    Args:
        policies: names, objects with ``predict``, or callables. Reductions are relative to the first policy.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        payload: nominal payload [kg].
        error_bounds: bounds of the tracking errors; None for 10 mm and 10 mrad.
        uncertainty: model errors and disturbances that the policies do not know, see
            :func:`cablebot_gym.uncertainty.find_uncertainty`.
        draws: number of episodes of each policy; None for the default number under a random uncertainty, else 1.
        seed: seed that determines the draws.
        names: names of the policies in the result; None for their own names.
        progress: callback after every control step.
        keywords: keywords of the environment: ``trajectory``, ``payload_known``, ``control_frequency``, ``robot``, …

    Raises:
        ValueError: if an argument is invalid, or if two policies have the same name.
        cablebot_gym.policies.protocol.PolicyError: if a policy raises or returns anything but finite actions.
    """
    if isinstance(policies, str):
        raise ValueError(f"policies must be a list, such as [{policies!r}], not one name")
    labels = [name_of(policy) for policy in policies] if names is None else list(names)
    if not labels:
        raise ValueError("there is no policy to compare: give at least one policy")
    if len(set(labels)) < len(labels) or len(labels) != len(policies):
        raise ValueError(f"every policy needs its own name, but the names are {', '.join(labels)}: give distinct names")
    if not isinstance(payload, Real) or isinstance(payload, bool) or not 0 <= payload < math.inf:
        raise ValueError(f"payload must be a finite number of at least 0 kg, not {payload!r}")
    bounds, metrics = find_error_bounds(error_bounds), []
    for index, (policy, label) in enumerate(zip(policies, labels, strict=True)):
        batch = Batch(
            policy,
            env_id,
            name=label,
            criterion="task",
            error_bounds=bounds,
            uncertainty=uncertainty,
            draws=draws,
            seed=seed,
            max_payloads=1,
            keywords=keywords,
        )
        with batch:
            recorder, steps = _Recorder(batch.draws, batch.task.robot.cables), batch.task.steps
            advance = _Steps(progress, index * steps, len(labels) * steps)
            trial = batch.run([payload], observe=recorder, progress=advance, full_motion=True)[0]
            radius = batch.keywords["termination_radius"]
            metrics.append(recorder.metrics(label, trial, steps, radius))
            task, description = batch.task, batch.description()
    return Comparison(
        env_id=env_id,
        payload=float(payload),
        payload_known=task.payload_known,
        model_payload_factor=float(keywords.get("model_payload_factor", 1.0)),
        uncertainty=uncertainty_name(uncertainty),
        draws=len(metrics[0].carried),
        seed=int(seed),
        draw_seeds=tuple(batch.seeds),
        error_bounds=bounds,
        metrics=tuple(metrics),
        environment=description,
        versions=versions(),
        task=task,
    )


class _Steps:
    """Progress callback that adds the steps of one policy to those of the previous policies."""

    def __init__(self, progress: Progress | None, done: int, expected: int) -> None:
        self._progress, self._done, self._expected = progress, done, expected

    def __call__(self, steps: int) -> None:
        self._done += steps
        if self._progress is not None:
            self._progress(self._done, self._expected)


class _Recorder:
    """Observer that accumulates the metrics of a batch during its steps."""

    def __init__(self, draws: int, cables: int) -> None:
        self._error: list[Array] = []
        self._rotation: list[Array] = []
        self._peak, self._rotation_peak, self._torque_squares = np.zeros(draws), np.zeros(draws), np.zeros(draws)
        self._torque, self._action, self._tension = np.zeros(draws), np.zeros(draws), np.full(draws, np.inf)
        self._steps, self._last_error, self._cables = np.zeros(draws), np.zeros(draws), cables
        self._ended = np.zeros(draws, np.bool_)

    def __call__(self, info: dict[str, Any], pose: Array, running: NDArray[np.bool_]) -> None:
        self._error.append(np.where(running, info["tracking_error"], np.nan))
        self._rotation.append(np.where(running, info["rotation_error"], np.nan))
        self._ended |= running & (info["termination_reason"] != "")
        torque, action = np.abs(info["torques"]), np.abs(info["commanded_action"])
        self._torque_squares += np.where(running, np.sum(torque**2, axis=1), 0.0)
        self._steps += running
        self._last_error[running] = info["tracking_error"][running]
        for largest, values in (
            (self._peak, info["tracking_error_peak"]),
            (self._rotation_peak, info["rotation_error_peak"]),
            (self._torque, torque.max(axis=1)),
            (self._action, action.max(axis=1)),
        ):
            np.maximum(largest, values, out=largest, where=running)
        np.minimum(self._tension, info["tensions"].min(axis=1), out=self._tension, where=running)

    def metrics(self, policy: str, trial: Trial, steps: int, termination_radius: float) -> PolicyMetrics:
        """Metrics of the finished batch. The errors at the start of the episodes come from the verdicts.

        Args:
            policy: name of the policy.
            trial: verdicts of the episodes.
            steps: number of control steps of the full motion.
            termination_radius: least position error that counts after an early termination [m].
        """
        verdicts = trial.verdicts
        error, rotation = np.array(self._error), np.array(self._rotation)
        rest = np.full((steps - len(error), error.shape[1]), np.nan)
        final = np.maximum(self._last_error, termination_radius)
        filled = np.concatenate([error, rest])
        filled = np.where(np.isnan(filled), final, filled)
        peak = np.maximum(self._peak, [verdict.position_peak for verdict in verdicts])
        return PolicyMetrics(
            policy=policy,
            mean_error=filled.mean(axis=0),
            rms_error=np.sqrt((filled**2).mean(axis=0)),
            max_error=np.where(self._ended, np.maximum(peak, final), peak),
            max_rotation=np.maximum(self._rotation_peak, [verdict.rotation_peak for verdict in verdicts]),
            rms_torque=np.sqrt(self._torque_squares / self._steps / self._cables),
            peak_torque=self._torque,
            torque_margin=1 - self._action,
            least_tension=self._tension,
            carried=np.array([verdict.carried for verdict in verdicts]),
            ended=self._ended,
            error=error,
            rotation=rotation,
        )
