"""Evaluation of the DLCC: the largest payload that a policy carries."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cablebot_gym.evaluation.batch import Batch, Progress, Trial
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.result import Details, DLCCResult
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
    payload_max: float | None = None,
    resolution: float | None = None,
    probability: float = 0.95,
    confidence: float = 0.95,
    search: str = "scan",
    name: str | None = None,
    wrappers: Sequence[Wrapper] = (),
    progress: Progress | bool | None = None,
    **conditions: Any,
) -> DLCCResult:
    """Evaluates the DLCC of a policy: the largest payload in the feasible interval that contains
    zero.

    A scan tries :data:`~cablebot_gym.evaluation.search.SCAN_POINTS` payloads; the gap below the
    first failed one is subdivided to ``resolution``. Episodes are repeated in another order, random
    payloads below the result and finer physics steps are tried. Under a random ``uncertainty`` the
    scan has :data:`~cablebot_gym.evaluation.search.SEARCH_DRAWS` draws; ``draws`` other ones, which
    all payloads share, confirm the payload.

    Args:
        policy: a loaded policy, an object with ``predict``, a callable ``observation -> action``, a
            class that makes one of them, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        payload_max: end of the scan [kg]; None for that of :func:`default_payload_max`.
        resolution: largest gap to the least failed payload [kg]; None for
            :data:`DEFAULT_RESOLUTION`, or :data:`DRAWN_RESOLUTION` with several draws.
        probability: required success probability; no effect with one draw.
        confidence: confidence of the payload as a one-sided lower tolerance bound; no effect with
            one draw.
        search: ``scan``, or ``bisection`` for policies that take seconds for an episode: it bisects
            the lowest gap between :data:`~cablebot_gym.evaluation.search.BISECTION_POINTS` payloads
            and can miss a failure, so its result is marked as unranked.
        name: name of the policy in the result; None for its own name.
        wrappers: wrappers of the training of the policy, the innermost first: classes or functions,
            their names, or the file of a ``VecNormalize``. They wrap a stand-in of the environment,
            see :data:`cablebot_gym.policies.wrappers.Wrapper`.
        progress: callback after every control step; True shows it on standard error.
        conditions: ``criterion``, ``uncertainty``, ``draws``, ``seed``, ``error_bounds``, ``robot``
            and keywords of the environment, such as ``payload_known`` and ``trajectory``: see
            :class:`~cablebot_gym.evaluation.conditions.Conditions`.

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
    batch = Batch(policy, Conditions.of(env_id, **conditions), name=name, wrappers=wrappers)
    if payload_max is None:
        payload_max = default_payload_max(
            batch.conditions.robot, batch.task.trajectory, batch.conditions.error_bounds
        )
    payload_max = number("payload_max", payload_max, above=0, unit="kg")
    is_scan = search == "scan"
    if resolution is None:
        resolution = DRAWN_RESOLUTION
        if is_scan and batch.draws == 1:
            resolution = DEFAULT_RESOLUTION
    resolution = number("resolution", resolution, above=0, unit="kg")
    title = f"{batch.policy.name}, {batch.conditions.criterion} criterion"
    with chosen_progress(progress, title) as step:
        outcome = Search(
            batch, payload_max, resolution, probability, confidence, step, thorough=is_scan
        ).run()
    details = _details(batch, outcome, payload_max, probability, confidence)
    return _result(batch, outcome, details, ranked=is_scan)


def default_payload_max(robot: Robot, trajectory: Trajectory, error_bounds: ErrorBounds) -> float:
    """Default end of the scan of a robot [kg]: the end of its payload range, or slightly more than
    its motors hold.

    For the paper's robots it is :data:`~cablebot_gym.robots.PAPER_PAYLOAD_MAX`.
    """
    if robot.defaults.payload_range is not None:
        return robot.defaults.payload_range[1]
    if has_paper_capacity(robot):
        return PAPER_PAYLOAD_MAX[robot.kind]
    ceiling = payload_ceiling(robot, trajectory, error_bounds)
    if ceiling <= 0:  # the motors do not even hold the platform
        ceiling = robot.mass
    return float(f"{SCAN_MARGIN * ceiling:.2g}")


def _result(batch: Batch, outcome: SearchOutcome, details: Details, ranked: bool) -> DLCCResult:
    """The score of a search."""
    below, above = outcome.below, outcome.above
    gap = 0.0
    if below is not None and above is not None:
        gap = above.payload - below.payload
    return DLCCResult(
        policy=batch.policy.name,
        conditions=batch.conditions,
        payload=None if below is None else below.payload,
        failed_payload=None if above is None else above.payload,
        resolution=max(gap, outcome.discretisation or 0.0),
        violation=None if above is None else above.violation,
        ranked=ranked,
        draw_seeds=tuple(batch.seeds),
        assured=outcome.assured if batch.random else None,
        rollout=outcome.rollout,
        details=details,
    )


def _details(
    batch: Batch, outcome: SearchOutcome, payload_max: float, probability: float, confidence: float
) -> Details:
    conditions, below, above = batch.conditions, outcome.below, outcome.above
    is_drawn = batch.draws > 1
    bounds: dict[str, float | None] = {
        "position": conditions.error_bounds.position,
        "rotation": None,
    }
    if conditions.criterion == "task" and not conditions.robot.point_mass:
        bounds["rotation"] = conditions.error_bounds.rotation
    failures: dict[str, int] = {}
    violation_seed = None
    if above is not None:
        violation_seed = above.seeds[above.violation_draw or 0]
        if len(above.verdicts) > 1:
            failures = above.failures
    return Details(
        payload_max=payload_max,
        feasible=outcome.feasible,
        success=outcome.success,
        discretisation=outcome.discretisation,
        margins={} if below is None else _margins(below, bounds),
        error_bounds=bounds,
        probability=probability if is_drawn else None,
        confidence=confidence if is_drawn else None,
        failures=failures,
        violation_seed=violation_seed,
        stochastic=batch.policy.declarations.stochastic,
        declared=conditions.criterion == "paper" and not batch.policy.held,
        wrappers=batch.policy.wrappers,
        environment=batch.environment(),
        fallbacks=batch.fallbacks,
    )


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
