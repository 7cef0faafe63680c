"""Several policies with one payload over the same draws: how well they track, and what it costs their motors."""

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
from cablebot_gym.task import Limits, Task, find_limits

CONFIDENCE = 0.95
"""Of every interval."""

RESAMPLES = 2000
"""Of the bootstrap that gives a reduction's interval."""

REDUCED = ("mean_error", "rms_error", "max_error")
"""Quantities whose reduction against the first policy is given."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A mean over draws with its interval of confidence :data:`CONFIDENCE`."""

    mean: float
    """The estimate."""
    low: float
    """Lower end; the estimate itself for one draw."""
    high: float
    """Upper end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """What one policy did; arrays have one entry for each draw.

    An episode that ended early is lost from then on: its position error is taken to stay at what it was, or at the
    termination radius if that is larger. Its other quantities count up to its end.
    """

    policy: str
    """Name."""
    mean_error: Array
    """Position error, mean over time [m]."""
    rms_error: Array
    """Position error, root mean square over time [m]."""
    max_error: Array
    """Largest position error at any physics step [m]."""
    max_rotation: Array
    """Largest rotation error at any physics step [rad]; 0 for a planar robot."""
    rms_torque: Array
    """Root mean square over time and motors [N·m]."""
    peak_torque: Array
    """Largest |τ| at any control instant [N·m]."""
    torque_margin: Array
    """1 − max |a|: share of the torque-speed line that was left; negative where more was asked for than there is."""
    least_tension: Array
    """Least tension of any cable at a control instant [N]."""
    carried: NDArray[np.bool_]
    """Whether the payload was carried, task criterion."""
    ended: NDArray[np.bool_]
    """Whether the environment ended the episode early."""
    error: Array = field(repr=False)
    """Position error at the end of each control step (steps, draws) [m]; NaN after an early end."""
    rotation: Array = field(repr=False)
    """Rotation error likewise [rad]."""

    def estimate(self, quantity: str) -> Estimate:
        """Mean of a quantity over the draws, with Student's interval."""
        values: Array = getattr(self, quantity)
        mean, width = float(values.mean()), 0.0
        if len(values) > 1:
            spread = float(values.std(ddof=1)) / math.sqrt(len(values))
            width = float(stats.t.ppf((1 + CONFIDENCE) / 2, len(values) - 1)) * spread
        return Estimate(mean=mean, low=mean - width, high=mean + width)


QUANTITIES = tuple(
    item.name for item in fields(Measured) if item.name not in ("policy", "carried", "ended", "error", "rotation")
)
"""The quantities of :class:`Measured` that have an estimate."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Policies over the same draws; ``print(comparison)`` gives the essentials."""

    env_id: str
    """Environment."""
    payload: float
    """Nominal [kg]."""
    payload_known: bool
    """Whether the policies were told the payload."""
    uncertainty: str | None
    """Name of what they did not know, ``custom`` for data; None for nothing."""
    draws: int
    """Episodes of each policy."""
    seed: int
    """From which the draws follow."""
    draw_seeds: tuple[int, ...]
    """Seed of each draw: ``env.reset(seed=…)``, or ``cablebot rollout --seed``, repeats it."""
    limits: Limits
    """Bounds of the errors."""
    measured: tuple[Measured, ...]
    """In the order asked for."""
    environment: dict[str, Any]
    """Robot, trajectory, uncertainty, control frequency, …, as plain data."""
    versions: dict[str, str]
    """Of Python and of the packages that make the numbers."""
    task: Task = field(repr=False)
    """The public task, for drawing."""

    def reduction(self, place: int, quantity: str) -> Estimate:
        """1 − (mean of a quantity over draws of policy ``place``)/(mean over draws of the first), draws paired.

        The interval is a seeded percentile bootstrap over draws.
        """
        base, other = getattr(self.measured[0], quantity), getattr(self.measured[place], quantity)
        share = float(1 - other.mean() / base.mean())
        if self.draws == 1 or place == 0:
            return Estimate(mean=share, low=share, high=share)
        chosen = np.random.default_rng(self.seed).integers(self.draws, size=(RESAMPLES, self.draws))
        shares = 1 - other[chosen].mean(axis=1) / base[chosen].mean(axis=1)
        low, high = np.quantile(shares, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
        return Estimate(mean=share, low=float(low), high=float(high))

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data: estimates, reductions and the draws' own values; without the time series."""
        policies = []
        for place, one in enumerate(self.measured):
            estimates = {name: vars(one.estimate(name)) for name in QUANTITIES}
            reductions = {name: vars(self.reduction(place, name)) for name in REDUCED} if place else {}
            values = {name: getattr(one, name).tolist() for name in (*QUANTITIES, "carried", "ended")}
            policies.append(
                {"policy": one.policy, "estimates": estimates, "reductions": reductions, "per_draw": values}
            )
        names = ("env_id", "payload", "payload_known", "uncertainty", "draws", "seed", "environment", "versions")
        head = {name: getattr(self, name) for name in names} | {"draw_seeds": list(self.draw_seeds)}
        return head | {"confidence": CONFIDENCE, "limits": vars(self.limits), "policies": policies}

    def to_json(self) -> str:
        """The comparison as JSON, indented."""
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)

    def __str__(self) -> str:
        draws = f"{self.draws} draw{'' if self.draws == 1 else 's'} of {self.uncertainty or 'no uncertainty'}"
        lines = [f"{described(self.env_id, self.task.robot.name)}, {self.payload:g} kg, {draws}"]
        for place, one in enumerate(self.measured):
            mean, most = one.estimate("mean_error"), one.estimate("max_error")
            text = f"{one.policy}: error {1e3 * mean.mean:.3g} mm mean, {1e3 * most.mean:.3g} mm max"
            if place:
                shares = [self.reduction(place, name).mean for name in ("mean_error", "max_error")]
                texts = [f"{abs(share):.0%} {'less' if share >= 0 else 'more'}" for share in shares]
                text += f" ({' and '.join(texts)} than {self.measured[0].policy})"
            ended = f", ended early in {one.ended.mean():.0%}" if one.ended.any() else ""
            lines.append(f"{text}; carried in {one.carried.mean():.0%}{ended}")
        return "\n".join(lines)


def compare_policies(
    policies: Sequence[Any],
    env_id: str,
    *,
    payload: float = 0.0,
    limits: Limits | dict[str, float] | None = None,
    uncertainty: Any = None,
    draws: int | None = None,
    seed: int = 0,
    names: Sequence[str] | None = None,
    progress: Progress | None = None,
    **keywords: Any,
) -> Comparison:
    """Runs every policy with one payload through the same draws.

    Args:
        policies: names, objects with ``predict``, or callables; the first one is what reductions are measured against.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        payload: nominal [kg].
        limits: bounds of the errors; None for 10 mm and 10 mrad.
        uncertainty: what the policies do not know, see :func:`cablebot_gym.uncertainty.find_uncertainty`.
        draws: episodes of each policy; None for the usual number if the uncertainty is random, else 1.
        seed: from which the draws follow.
        names: of the policies, in the result; None for their own.
        progress: called after every control step.
        keywords: for the environment: ``trajectory``, ``payload_known``, ``control_frequency``, ``robot``, …

    Raises:
        ValueError: if an argument is not valid, or two policies have the same name.
        cablebot_gym.policies.PolicyError: if a policy raises or returns anything but finite drive commands.
    """
    if isinstance(policies, str):
        raise ValueError(f"policies are a list, such as [{policies!r}], not one name")
    labels = [name_of(policy) for policy in policies] if names is None else list(names)
    if not labels:
        raise ValueError("there is nothing to compare: name at least one policy")
    if len(set(labels)) < len(labels) or len(labels) != len(policies):
        raise ValueError(f"policies need one name each, all different, not {', '.join(labels)}")
    if not isinstance(payload, Real) or isinstance(payload, bool) or not 0 <= payload < math.inf:
        raise ValueError(f"payload must be at least 0 kg, one finite number, not {payload!r}")
    bounds, measured = find_limits(limits), []
    for place, (policy, label) in enumerate(zip(policies, labels, strict=True)):
        batch = Batch(
            policy,
            env_id,
            name=label,
            criterion="task",
            limits=bounds,
            uncertainty=uncertainty,
            draws=draws,
            seed=seed,
            together=1,
            keywords=keywords,
        )
        with batch:
            watch, steps = _Watch(batch.draws, batch.task.robot.cables), batch.task.steps
            done = _Steps(progress, place * steps, len(labels) * steps)
            trial = batch.run([payload], observe=watch, progress=done, whole=True)[0]
            lost = batch.keywords["termination_radius"]
            measured.append(watch.measured(label, trial, steps, lost))
            task, description = batch.task, batch.description()
    return Comparison(
        env_id=env_id,
        payload=float(payload),
        payload_known=task.payload_known,
        uncertainty=uncertainty_name(uncertainty),
        draws=len(measured[0].carried),
        seed=int(seed),
        draw_seeds=tuple(batch.seeds),
        limits=bounds,
        measured=tuple(measured),
        environment=description,
        versions=versions(),
        task=task,
    )


class _Steps:
    """Counts the steps of one policy after those of the policies before it."""

    def __init__(self, progress: Progress | None, done: int, expected: int) -> None:
        self._progress, self._done, self._expected = progress, done, expected

    def __call__(self, steps: int) -> None:
        self._done += steps
        if self._progress is not None:
            self._progress(self._done, self._expected)


class _Watch:
    """Sums up episodes as they go."""

    def __init__(self, draws: int, cables: int) -> None:
        self._error: list[Array] = []
        self._rotation: list[Array] = []
        self._peak, self._rotation_peak, self._squares = np.zeros(draws), np.zeros(draws), np.zeros(draws)
        self._torque, self._demand, self._tension = np.zeros(draws), np.zeros(draws), np.full(draws, np.inf)
        self._lasted, self._last, self._cables = np.zeros(draws), np.zeros(draws), cables
        self._ended = np.zeros(draws, np.bool_)

    def __call__(self, info: dict[str, Any], pose: Array, lasting: NDArray[np.bool_]) -> None:
        self._error.append(np.where(lasting, info["tracking_error"], np.nan))
        self._rotation.append(np.where(lasting, info["rotation_error"], np.nan))
        self._ended |= lasting & (info["termination_reason"] != "")
        torque, demand = np.abs(info["torques"]), np.abs(info["drive_demand"])
        self._squares += np.where(lasting, np.sum(torque**2, axis=1), 0.0)
        self._lasted += lasting
        self._last[lasting] = info["tracking_error"][lasting]
        for total, seen in (
            (self._peak, info["tracking_error_peak"]),
            (self._rotation_peak, info["rotation_error_peak"]),
            (self._torque, torque.max(axis=1)),
            (self._demand, demand.max(axis=1)),
        ):
            np.maximum(total, seen, out=total, where=lasting)
        np.minimum(self._tension, info["tensions"].min(axis=1), out=self._tension, where=lasting)

    def measured(self, policy: str, trial: Trial, steps: int, lost: float) -> Measured:
        """Everything seen, once the episodes are over; what was seen at their start stands in the verdicts.

        Args:
            policy: its name.
            trial: its verdicts.
            steps: control steps of the whole motion.
            lost: least position error that an episode counts with after an early end [m].
        """
        verdicts = trial.verdicts
        error, rotation = np.array(self._error), np.array(self._rotation)
        rest = np.full((steps - len(error), error.shape[1]), np.nan)
        stays = np.maximum(self._last, lost)
        whole = np.concatenate([error, rest])
        whole = np.where(np.isnan(whole), stays, whole)
        peak = np.maximum(self._peak, [verdict.position_peak for verdict in verdicts])
        return Measured(
            policy=policy,
            mean_error=whole.mean(axis=0),
            rms_error=np.sqrt((whole**2).mean(axis=0)),
            max_error=np.where(self._ended, np.maximum(peak, stays), peak),
            max_rotation=np.maximum(self._rotation_peak, [verdict.rotation_peak for verdict in verdicts]),
            rms_torque=np.sqrt(self._squares / self._lasted / self._cables),
            peak_torque=self._torque,
            torque_margin=1 - self._demand,
            least_tension=self._tension,
            carried=np.array([verdict.carried for verdict in verdicts]),
            ended=self._ended,
            error=error,
            rotation=rotation,
        )
