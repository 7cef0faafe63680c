"""Evaluation of the DLCC: the largest payload that a policy carries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cablebot_gym.evaluation.batch import Batch, Progress, Trial
from cablebot_gym.evaluation.result import DLCCResult
from cablebot_gym.evaluation.search import Search, SearchOutcome
from cablebot_gym.physics.statics import payload_ceiling
from cablebot_gym.policies import Wrapper
from cablebot_gym.robots import PAPER_PAYLOAD_MAX, Robot, has_paper_capacity
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.checks import choice, number
from cablebot_gym.utils.console import chosen_progress

SEARCHES = ("scan", "bisection")
"""Kinds of search. Only a scan gives a ranked result."""

SCAN_MARGIN = 1.25
"""End of the scan of a robot without a payload range, over the payload that no controller can be
expected to carry."""

DEFAULT_RESOLUTION = 1e-3
"""Default resolution for one draw: gap between the DLCC and the least failed payload [kg]."""

DRAWN_RESOLUTION = 1e-2
"""Default resolution for several draws, whose number limits the accuracy [kg]."""


def evaluate_dlcc(
    policy: Any,
    env_id: str,
    *,
    criterion: str = "task",
    error_bounds: ErrorBounds | dict[str, float] | None = None,
    payload_max: float | None = None,
    resolution: float | None = None,
    uncertainty: Any = None,
    draws: int | None = None,
    probability: float = 0.95,
    confidence: float = 0.95,
    seed: int = 0,
    search: str = "scan",
    name: str | None = None,
    wrappers: Sequence[Wrapper] = (),
    progress: Progress | bool | None = None,
    **keywords: Any,
) -> DLCCResult:
    """Evaluates the DLCC of a policy: the largest payload in the feasible interval that contains
    zero.

    The scan tries :data:`~cablebot_gym.evaluation.search.SCAN_POINTS` payloads from 0 to
    ``payload_max`` in one batch. The gap below the first failed payload is then subdivided until it
    is at most ``resolution`` wide. The episodes of the scan are repeated in another order, random
    payloads below the result are tried, and payloads around the result are tried with finer physics
    steps. Under a random ``uncertainty`` the scan has
    :data:`~cablebot_gym.evaluation.search.SEARCH_DRAWS` draws; the payload is then confirmed with
    ``draws`` other ones, which all payloads share.

    ``search="bisection"`` is for policies that take seconds for an episode. It tries
    :data:`~cablebot_gym.evaluation.search.BISECTION_POINTS` payloads and bisects the lowest gap
    below a failed one, without further checks except the repetition of the last two episodes. It
    can miss a failure between two payloads, so its result is marked as unranked.

    Args:
        policy: a loaded policy, an object with ``predict``, a callable ``observation -> action``, a
            class that makes one of them, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        criterion: ``task`` (saturated motors; position, rotation, tension) or ``paper`` (|a| ≤ 1,
            position, slack).
        error_bounds: bounds of the tracking errors; None for those of the robot.
        payload_max: end of the scan [kg]; None for that of :func:`default_payload_max`.
        resolution: largest gap to the least failed payload [kg]; None for
            :data:`DEFAULT_RESOLUTION`, or :data:`DRAWN_RESOLUTION` with several draws.
        uncertainty: model errors and disturbances that the policy does not know, see
            :func:`cablebot_gym.uncertainty.find_uncertainty`.
        draws: number of draws that confirm the payload; None for
            :data:`~cablebot_gym.evaluation.batch.DEFAULT_DRAWS` under a random uncertainty or with
            a policy that declares ``stochastic = True``, else 1.
        probability: required success probability; no effect with one draw.
        confidence: confidence of the payload as a one-sided lower tolerance bound; no effect with
            one draw.
        seed: seed that determines payloads and draws, so all policies share them.
        name: name of the policy in the result; None for its own name.
        wrappers: wrappers of the training of the policy, the innermost first: classes or functions,
            their names, or the file of a ``VecNormalize``. They wrap a stand-in of the environment,
            see :data:`cablebot_gym.policies.wrappers.Wrapper`.
        search: ``scan``, or ``bisection`` for slow policies.
        progress: callback after every control step; True shows it on standard error.
        keywords: keywords of the environment: ``trajectory``, ``payload_known``,
            ``control_frequency``, ``robot``, …

    Returns:
        The result. With several draws and the default ``probability`` and ``confidence``, the
        payload is a 95/95 lower tolerance bound: with 95 % confidence, at least 95 % of all draws
        carry it.

    Raises:
        ValueError: if an argument is invalid, or if the ``paper`` criterion is used for a policy
            that does not declare ``unsaturated_actions``.
        cablebot_gym.policies.protocol.PolicyError: if the policy raises, returns anything but
            finite actions, or does not act the same when its episodes are repeated.
    """
    choice("search", search, SEARCHES)
    number("probability", probability, above=0, below=1)
    number("confidence", confidence, above=0.5, below=1)
    batch = Batch(
        policy,
        env_id,
        name=name,
        wrappers=wrappers,
        criterion=criterion,
        error_bounds=error_bounds,
        uncertainty=uncertainty,
        draws=draws,
        seed=seed,
        keywords=keywords,
    )
    if payload_max is None:
        payload_max = default_payload_max(
            batch.task.robot, batch.task.trajectory, batch.error_bounds
        )
    payload_max = number("payload_max", payload_max, above=0, unit="kg")
    is_scan = search == "scan"
    if resolution is None:
        resolution = DRAWN_RESOLUTION
        if is_scan and batch.draws == 1:
            resolution = DEFAULT_RESOLUTION
    resolution = number("resolution", resolution, above=0, unit="kg")
    with chosen_progress(progress, f"{batch.policy.name}, {batch.criterion} criterion") as step:
        outcome = Search(
            batch, payload_max, resolution, probability, confidence, step, thorough=is_scan
        ).run()
    evidence: dict[str, Any] = dict.fromkeys(("assured", "probability", "confidence"))
    if batch.random:
        evidence["assured"] = outcome.assured
    if batch.draws > 1:
        evidence |= {"probability": probability, "confidence": confidence}
    return DLCCResult(
        payload_max=payload_max,
        ranked=is_scan,
        feasible=outcome.feasible,
        success=outcome.success,
        discretisation=outcome.discretisation,
        rollout=outcome.rollout,
        policy=batch.policy.name,
        criterion=batch.criterion,
        stochastic=batch.policy.declarations.stochastic,
        declared=batch.criterion == "paper" and not batch.policy.held,
        fallbacks=batch.fallbacks,
        wrappers=batch.policy.wrappers,
        **evidence,
        **_gap_fields(batch, outcome),
        **batch.description(),
    )


def default_payload_max(robot: Robot, trajectory: Trajectory, error_bounds: ErrorBounds) -> float:
    """Default end of the scan of a robot [kg]: the end of its payload range, or slightly more than
    its motors hold.

    For the paper's robots it is :data:`~cablebot_gym.robots.paper.PAPER_PAYLOAD_MAX`.
    """
    if robot.defaults.payload_range is not None:
        return robot.defaults.payload_range[1]
    if has_paper_capacity(robot):
        return PAPER_PAYLOAD_MAX[robot.kind]
    ceiling = payload_ceiling(robot, trajectory, error_bounds)
    if ceiling <= 0:  # the motors do not even hold the platform
        ceiling = robot.mass
    return float(f"{SCAN_MARGIN * ceiling:.2g}")


def _gap_fields(batch: Batch, outcome: SearchOutcome) -> dict[str, Any]:
    """Fields of the result about the payload and the failed one above it."""
    below = outcome.below
    above = outcome.above
    robot = batch.task.robot
    bounds: dict[str, float | None] = {"position": batch.error_bounds.position, "rotation": None}
    if batch.criterion == "task" and not robot.point_mass:
        bounds["rotation"] = batch.error_bounds.rotation
    data: dict[str, Any] = dict.fromkeys(
        ("payload", "total_mass", "failed_payload", "violation", "violation_seed")
    )
    data |= {"error_bounds": bounds, "scan_ended": above is None, "margins": {}, "failures": {}}
    gap = 0.0
    if below is not None:
        data |= {
            "payload": below.payload,
            "total_mass": below.payload + robot.mass,
            "margins": _margins(below, bounds),
        }
    if above is not None:
        data |= {"failed_payload": above.payload, "violation": above.violation}
        data["violation_seed"] = above.seeds[above.violation_draw or 0]
        if len(above.verdicts) > 1:
            data["failures"] = above.failures
        if below is not None:
            gap = above.payload - below.payload
    data["resolution"] = max(gap, outcome.discretisation or 0.0)
    return data


def _margins(trial: Trial, bounds: dict[str, float | None]) -> dict[str, float]:
    """Least margins over the draws that carry the payload, as fractions of the limits; tension in
    N."""
    carried = [verdict for verdict in trial.verdicts if verdict.carried]
    margins = {
        "torque": 1 - max(max(verdict.peak_action) for verdict in carried),
        "tension": min(verdict.least_tension for verdict in carried),
    }
    for name in ("position", "rotation"):
        bound = bounds[name]
        if bound is not None:
            margins[name] = 1 - max(getattr(verdict, f"{name}_peak") for verdict in carried) / bound
    return margins
