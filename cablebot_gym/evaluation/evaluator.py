"""Evaluation of the DLCC: the largest payload that a policy carries."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from cablebot_gym.evaluation.batch import Batch, Trial
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.result import Details, DLCCResult
from cablebot_gym.evaluation.search import Search, SearchOutcome
from cablebot_gym.motions import Trajectory
from cablebot_gym.physics.statics import payload_ceiling
from cablebot_gym.policies import Wrapper
from cablebot_gym.robots import PAPER_PAYLOAD_MAX, Robot, has_paper_capacity
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.checks import choice, number
from cablebot_gym.utils.console import Progress, chosen_progress

SEARCHES = ("scan", "bisection")
"""Kinds of search. Only a scan gives a ranked result."""

SCAN_MARGIN = 1.25
"""Ratio of the end of the scan to the payload that the motors can hold, for a robot without a payload
range."""

FINE_RESOLUTION = 1e-3
"""Default resolution of a scan with one draw: gap between the DLCC and the least failed payload
[kg]."""

COARSE_RESOLUTION = 1e-2
"""Default resolution of every other search [kg]: the number of draws limits the accuracy, or it is a
bisection."""

FEWEST_GAPS = 200
"""Least ratio of the end of the scan to the default resolution, which is finer for light robots."""


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

    A scan tries :data:`~cablebot_gym.evaluation.motion_search.SCAN_POINTS` payloads. The gap below the first
    failed one is subdivided to ``resolution``. The search then repeats episodes in another order and
    tries random payloads below the result. With one draw, it also tries finer physics steps. With
    several draws, the scan has :data:`~cablebot_gym.evaluation.search.SEARCH_DRAWS` draws of each
    payload, and ``draws`` other draws confirm the result. All payloads share these draws.

    Args:
        policy: a loaded policy, an object with ``predict``, a callable ``observation -> action``, a
            class that makes one of them, or a name as on the command line.
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        payload_max: end of the scan [kg]; None for that of :func:`default_payload_max`.
        resolution: largest gap to the least failed payload [kg]; None for :data:`FINE_RESOLUTION` in
            a scan with one draw, else :data:`COARSE_RESOLUTION`; finer for light robots.
        probability: required success probability; no effect with one draw.
        confidence: confidence of the payload as a one-sided lower tolerance bound; no effect with
            one draw.
        search: ``scan``, or ``bisection`` for policies that take seconds for an episode. A bisection
            tries :data:`~cablebot_gym.evaluation.search.BISECTION_POINTS` payloads and bisects the
            gap below the first failed one. It can miss failures, so its result is unranked.
        name: name of the policy in the result; None for its own name.
        wrappers: wrappers of the training of the policy, the innermost first: classes or functions,
            their names, or the file of a ``VecNormalize``, see
            :data:`cablebot_gym.policies.wrappers.Wrapper`.
        progress: callback after every control step; True shows a bar on standard error.
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
    checked = Conditions.of(env_id, evaluate_dlcc, **conditions)
    batch = Batch(policy, checked, name=name, wrappers=wrappers)
    if payload_max is None:
        trajectory = batch.task.trajectory
        payload_max = default_payload_max(checked.nominal_robot, trajectory, checked.bounds)
    payload_max = number("payload_max", payload_max, above=0, unit="kg")
    is_scan = search == "scan"
    if resolution is None:
        resolution = COARSE_RESOLUTION
        if is_scan and batch.draws == 1:
            resolution = FINE_RESOLUTION
        resolution = min(resolution, payload_max / FEWEST_GAPS)
    resolution = number("resolution", resolution, above=0, unit="kg")
    title = f"{batch.policy.name}, {checked.criterion} criterion"
    with chosen_progress(progress, title) as on_step:
        outcome = Search(
            batch, payload_max, resolution, probability, confidence, on_step, is_scan=is_scan
        ).run()
    details = _details(batch, outcome, payload_max, probability, confidence)
    return _result(batch, outcome, details, ranked=is_scan)


def default_payload_max(robot: Robot, trajectory: Trajectory, error_bounds: ErrorBounds) -> float:
    """Default end of the scan [kg]: the end of the robot's payload range; without one,
    :data:`~cablebot_gym.robots.paper.PAPER_PAYLOAD_MAX` for the paper's robots, and :data:`SCAN_MARGIN`
    times the payload that the motors can hold for others."""
    if robot.defaults.payload_range is not None:
        return robot.defaults.payload_range[1]
    if has_paper_capacity(robot):
        return PAPER_PAYLOAD_MAX[robot.kind]
    ceiling = payload_ceiling(robot, trajectory, error_bounds)
    if ceiling <= 0:  # the motors do not even hold the platform
        ceiling = robot.mass
    return float(f"{SCAN_MARGIN * ceiling:.2g}")  # two digits are enough


def _result(batch: Batch, outcome: SearchOutcome, details: Details, *, ranked: bool) -> DLCCResult:
    """The result of a search."""
    payload = failed_payload = violation = None
    gap = 0.0
    if outcome.below is not None:
        payload = outcome.below.payload
    if outcome.above is not None:
        failed_payload = outcome.above.payload
        violation = outcome.above.violation
    if payload is not None and failed_payload is not None:
        gap = failed_payload - payload
    return DLCCResult(
        policy=batch.policy.name,
        conditions=batch.conditions,
        payload=payload,
        failed_payload=failed_payload,
        resolution=max(gap, outcome.discretisation or 0.0),
        violation=violation,
        ranked=ranked,
        draw_seeds=tuple(batch.seeds),
        assured=outcome.assured if batch.random else None,
        isolated=batch.policy.isolated,
        rollout=outcome.rollout,
        details=details,
    )


def _details(
    batch: Batch, outcome: SearchOutcome, payload_max: float, probability: float, confidence: float
) -> Details:
    conditions = batch.conditions
    below = outcome.below
    above = outcome.above
    is_drawn = batch.draws > 1
    bounds: dict[str, float | None] = {
        "position": conditions.bounds.position,
        "rotation": None,
    }
    if conditions.criterion == "task" and not conditions.nominal_robot.point_mass:
        bounds["rotation"] = conditions.bounds.rotation
    maximum_tension = math.inf
    if conditions.criterion == "task":
        maximum_tension = conditions.nominal_robot.maximum_tension
    failures: dict[str, int] = {}
    violation_seed = None
    if above is not None:
        # A failed trial has a violation; 0 is for the type checker only.
        violation_seed = above.seeds[above.violation_draw or 0]
        if len(above.verdicts) > 1:
            failures = above.failures
    return Details(
        payload_max=payload_max,
        feasible=outcome.feasible,
        discretisation=outcome.discretisation,
        margins={} if below is None else _margins(below, bounds, maximum_tension),
        error_bounds=bounds,
        probability=probability if is_drawn else None,
        confidence=confidence if is_drawn else None,
        failures=failures,
        violation_seed=violation_seed,
        stochastic=batch.policy.declarations.stochastic,
        shipped=batch.policy.shipped,
        bubblewrap=batch.policy.bubblewrap,
        declared=conditions.criterion == "paper" and not batch.policy.shipped,
        wrappers=batch.policy.wrappers,
        environment=batch.environment(),
        fallbacks=batch.fallbacks,
    )


def _margins(
    trial: Trial, bounds: dict[str, float | None], maximum_tension: float
) -> dict[str, float]:
    """Least margins over the draws that carry the payload, as fractions of the limits, also of the
    maximum tension (``overload``) if there is one; the least tension in N."""
    carried = [verdict for verdict in trial.verdicts if verdict.carried]
    margins = {
        "torque": 1 - max(max(verdict.peak_action) for verdict in carried),
        "tension": min(verdict.least_tension for verdict in carried),
    }
    for name in ("position", "rotation"):
        bound = bounds[name]
        if bound is not None:
            margins[name] = 1 - max(getattr(verdict, f"{name}_peak") for verdict in carried) / bound
    if maximum_tension != math.inf:
        largest = max(verdict.largest_tension for verdict in carried)
        margins["overload"] = 1 - largest / maximum_tension
    return margins
