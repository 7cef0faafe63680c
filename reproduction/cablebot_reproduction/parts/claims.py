"""Claims of the text about the controller: payloads and errors with and without feedback, poles,
affine torques."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np

from cablebot_baselines.classical import Composite, FeedbackLinearization, FourthOrder
from cablebot_baselines.classical.outer_loop import PAPER_GAINS
from cablebot_gym.evaluation import Comparison, DLCCResult
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_reproduction.exact import paper_circle
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Judgement, Run, verdict
from cablebot_reproduction.laws import FeedForward
from cablebot_reproduction.part import Jobs, Number, Outcome, Results, Table, job
from cablebot_reproduction.parts.profiles import violation_text
from cablebot_reproduction.published import ABOUT
from cablebot_reproduction.runs import (
    CONTROL_FREQUENCY,
    FLEX,
    PLANAR,
    SPATIAL,
    Law,
    closed_loop,
    compared,
    largest_payload,
)

FAST = 10_000.0
"""Control frequency that resolves the poles of Eqs. 14 and 19 [Hz]."""

_OFFSET = 1e-3
"""Initial position error [m]."""

_DRAWS = 64
"""Number of draws of Table 6."""

_CRITERIA = {"task": "", "paper": "_paper"}
"""Suffix of the names of the numbers by criterion."""


class _Loop(NamedTuple):
    law: str
    payload_known: bool
    numbers: dict[str, str]
    """Name of the number of each robot."""


_LOOPS = {
    "fl": _Loop("fl", True, {"planar": "planar_fl_payload_known", "spatial": "fl_payload_known"}),
    "payload_unknown": _Loop(
        "fl", False, {"planar": "planar_fl_payload_unknown", "spatial": "fl_payload_unknown"}
    ),
    "open loop": _Loop(
        "open loop", True, {"planar": "open_loop_planar", "spatial": "open_loop_spatial"}
    ),
}
"""Evaluated loops by the name of the job."""


def affinity(*, robot: Robot, minimum_tension: float) -> float:
    """Largest ratio of the second to the first difference of τ in the mass for exact tracking; 0 if
    τ is affine."""
    motion = paper_circle(robot)(np.arange(500) / 500)
    state = (motion.position, motion.velocity, motion.acceleration)
    torques = []
    for count in (1, 2, 3):
        tensions = textbook.required_tensions(
            robot, count * robot.mass, *state, minimum=minimum_tension
        )
        torques.append(textbook.required_torques(robot, tensions, *state))
    second = torques[2] - 2 * torques[1] + torques[0]
    return float(np.abs(second).max() / np.abs(torques[1] - torques[0]).max())


def decay_error(rollout: Rollout, gains: tuple[float, float]) -> float:
    """Largest deviation from ë + K_D ė + K_P e = 0 after an initial error, as a fraction of this
    error."""
    stiffness, damping = gains
    time = rollout.arrays["time"]
    poles = np.roots([1.0, damping, stiffness])
    weights = np.linalg.solve(np.stack([np.ones(2), poles]), [1.0, 0.0])
    expected = _OFFSET * np.real(np.exp(np.outer(time, poles)) @ weights)
    actual = rollout.arrays["pose"][:, 0] - rollout.arrays["reference_pose"][:, 0]
    return float(np.abs(actual - expected).max() / _OFFSET)


def jobs(interpretation: Interpretation) -> Jobs:
    """Payloads with and without feedback, episodes for the poles, and errors over draws."""
    planar_law = partial(FeedbackLinearization, minimum_tension=interpretation.minimum_tension)
    planar = interpretation.planar
    spatial = interpretation.spatial("payload")
    jobs = _rigid_jobs(interpretation, "planar", PLANAR, planar, planar_law)
    jobs |= _rigid_jobs(interpretation, "spatial", SPATIAL, spatial, FeedbackLinearization)
    flexible = interpretation.closed_loop_robot(interpretation.flexible("payload"))
    laws = (("fl4", FourthOrder), ("composite", Composite))
    errors = partial(job, compared, env_id=FLEX, robot=flexible, laws=laws, payload=1.0)
    jobs["flexible None"] = errors(uncertainty=None, draws=None)
    jobs["flexible table6"] = errors(uncertainty="table6", draws=_DRAWS)
    return jobs


def _rigid_jobs(
    interpretation: Interpretation, kind: str, env_id: str, robot: Robot, law: Law
) -> Jobs:
    """Jobs of one rigid robot."""
    jobs = {}
    robot = interpretation.closed_loop_robot(robot)
    laws: dict[str, Law] = {"fl": law, "open loop": FeedForward}
    for criterion in _CRITERIA:
        for name, loop in _LOOPS.items():
            payload = partial(job, largest_payload, law=laws[loop.law], name=loop.law)
            if not loop.payload_known:
                payload = partial(payload, payload_known=False)
            jobs[f"{kind} {name} {criterion}"] = payload(
                env_id=env_id, robot=robot, criterion=criterion
            )
    jobs[f"{kind} errors"] = job(
        compared,
        env_id=env_id,
        robot=robot,
        laws=tuple(laws.items()),
        payload=robot.mass / 10,
        uncertainty="table6",
        draws=_DRAWS,
    )
    decay = partial(
        job,
        closed_loop,
        env_id=env_id,
        robot=robot,
        law=law,
        trajectory={"name": f"dwell-{kind}", "duration": 0.5},
        initial_error=(_OFFSET,) + (0.0,) * (robot.coordinates - 1),
    )
    jobs[f"{kind} decay"] = decay(control_frequency=FAST)
    jobs[f"{kind} sampled decay"] = decay(control_frequency=CONTROL_FREQUENCY)
    jobs[f"{kind} affine"] = job(
        affinity, robot=robot, minimum_tension=interpretation.minimum_tension
    )
    return jobs


def outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Payloads, errors, poles and affinity."""
    numbers: dict[str, Number] = {}
    rows: list[tuple[Number, ...]] = []
    for kind in ("planar", "spatial"):
        for criterion, suffix in _CRITERIA.items():
            for name, loop in _LOOPS.items():
                result: DLCCResult = results[f"{kind} {name} {criterion}"]
                number = loop.numbers[kind]
                numbers[f"{number}{suffix}_kg"] = result.payload
                violation = violation_text(result.violation)
                rows.append(
                    (kind, loop.law, loop.payload_known, criterion, result.payload, violation)
                )
            numbers[f"closed_loop_{kind}{suffix}_kg"] = results[f"{kind} fl {criterion}"].payload
        numbers[f"closed_loop_{kind}_error_mm"] = _mean_error(results[f"{kind} errors"], 0)
        numbers[f"open_loop_{kind}_error_mm"] = _mean_error(results[f"{kind} errors"], 1)
        gains = PAPER_GAINS[kind]
        numbers[f"pole_error_{kind}"] = decay_error(results[f"{kind} decay"], gains)
        numbers[f"sampled_pole_error_{kind}"] = decay_error(results[f"{kind} sampled decay"], gains)
        numbers[f"poles_{kind}"] = _poles_text(gains)
        numbers[f"affine_{kind}"] = results[f"{kind} affine"]
    for index, name in enumerate(("fl4", "composite")):
        numbers[f"flex_{name}_error_nominal_mm"] = _mean_error(results["flexible None"], index)
        numbers[f"flex_{name}_error_table6_mm"] = _mean_error(results["flexible table6"], index)
    table = Table(
        title="Payloads with feedback, without feedback, and with feedback and unknown payload",
        header=("robot", "law", "payload known", "criterion", "payload [kg]", "limiting violation"),
        rows=tuple(rows),
    )
    return Outcome(numbers=numbers, tables=(table,))


def _mean_error(comparison: Comparison, index: int) -> float:
    """Mean position error over time and draws [mm]."""
    return 1e3 * comparison.metrics[index].estimate("mean_error").mean


def _poles_text(gains: tuple[float, float]) -> str:
    stiffness, damping = gains
    texts = []
    for pole in np.roots([1.0, damping, stiffness]):
        text = f"{pole.real:.2f}"
        if pole.imag != 0:
            text = f"{text} {pole.imag:+.2f}i".replace(" +", " + ").replace(" -", " − ")
        texts.append(text)
    return ", ".join(texts)


# --- verdicts ---------------------------------------------------------------------------------------------------------


@verdict("1.controller", "claims", unit="kg", choice="task criterion")
def controller_improves_accuracy_and_payload(run: Run) -> Judgement:
    """With feedback the errors are smaller and the payloads larger, under the task criterion."""
    is_improved = _error_is_smaller(run) and _payload_is_larger(run, "")
    evidence = (
        "Mean errors: see §6. Payloads under the task criterion, where the errors are the limit: planar "
        "{claims.closed_loop_planar_kg} with and {claims.open_loop_planar_kg} without feedback, spatial "
        "{claims.closed_loop_spatial_kg} with and {claims.open_loop_spatial_kg} without feedback.",
        'The verdict uses the task criterion, because the paper argues with accuracy ("and so"); §6 uses the paper '
        "criterion.",
    )
    text = "{claims.closed_loop_spatial_error_mm}, {claims.closed_loop_spatial_kg}"
    return Judgement(run.payload("claims.closed_loop_spatial_kg"), is_improved, evidence, text)


@verdict("6.open-tracking", "claims", unit="mm")
def feedback_improves_tracking(run: Run) -> Judgement:
    """With feedback the mean errors are smaller."""
    error = run.number("claims.closed_loop_spatial_error_mm")
    evidence = (
        "Mean errors with the uncertainty of Table 6; the open loop applies the torques of exact tracking: planar "
        "{claims.closed_loop_planar_error_mm} with and {claims.open_loop_planar_error_mm} without feedback, spatial "
        "{claims.closed_loop_spatial_error_mm} with and {claims.open_loop_spatial_error_mm} without feedback.",
    )
    return Judgement(error, _error_is_smaller(run), evidence)


@verdict("6.open-payload", "claims", unit="kg", choice="paper criterion")
def feedback_increases_the_payload(run: Run) -> Judgement:
    """With feedback the payloads are larger, under the paper criterion."""
    payload = run.payload("claims.closed_loop_spatial_paper_kg")
    evidence = (
        "Payloads without uncertainty, where the motors are the limit: planar {claims.closed_loop_planar_paper_kg} "
        "with and {claims.open_loop_planar_paper_kg} without feedback, spatial {claims.closed_loop_spatial_paper_kg} "
        "with and {claims.open_loop_spatial_paper_kg} without feedback.",
        "Task criterion: see §1.",
    )
    return Judgement(payload, _payload_is_larger(run, "_paper"), evidence)


def _error_is_smaller(run: Run) -> bool:
    """Whether feedback reduces the mean errors of both robots."""
    return all(
        run.number(f"claims.closed_loop_{kind}_error_mm")
        < run.number(f"claims.open_loop_{kind}_error_mm")
        for kind in PAPER_GAINS
    )


def _payload_is_larger(run: Run, suffix: str) -> bool:
    """Whether feedback increases the payloads of both robots under a criterion."""
    return all(
        run.payload(f"claims.closed_loop_{kind}{suffix}_kg")
        > run.payload(f"claims.open_loop_{kind}{suffix}_kg")
        for kind in PAPER_GAINS
    )


@verdict("3.1.poles", "claims")
def planar_error_has_the_poles(run: Run) -> Judgement:
    """The planar robot follows Eq. 14 within 5 % of an initial error."""
    return _judge_poles(run, "planar", equation=14, period="10 ms")


@verdict("3.2.poles", "claims")
def spatial_error_has_the_poles(run: Run) -> Judgement:
    """The spatial robot follows Eq. 19 within 5 % of an initial error."""
    return _judge_poles(run, "spatial", equation=19, period="100 ms")


def _judge_poles(run: Run, kind: str, *, equation: int, period: str) -> Judgement:
    errors = f"{{claims.pole_error_{kind}:%}} of this error at 10 kHz and within {{claims.sampled_pole_error_{kind}:%}}"
    evidence = (
        f"Starting with an initial error, the robot follows Eq. {equation} within {errors} at 500 Hz.",
        f"A zero-order hold of duration h reduces K_D by K_P h/2, so these gains are stable only for h below {period}.",
    )
    is_followed = run.number(f"claims.pole_error_{kind}") <= ABOUT
    return Judgement(None, is_followed, evidence, f"{{claims.poles_{kind}}}")


_RATIO = (
    "Ratio of the second to the first difference of the torques for one, two and three platform masses; at most 10⁻⁶ "
    "counts as linear."
)


@verdict("5.1.linear-spatial", "claims")
def spatial_torques_are_linear(run: Run) -> Judgement:
    """The torques of the spatial robot are affine in the load."""
    residual = run.number("claims.affine_spatial")
    evidence = (_RATIO, "The line does not pass through zero (B of Eq. 41).")
    return Judgement(residual, residual <= 1e-6, evidence, "residual {claims.affine_spatial:%}")


@verdict("5.1.linear-planar", "claims", options=("minimum_tension",), choice="smallest α")
def planar_torques_are_linear(run: Run) -> Judgement:
    """The torques of the planar robot are affine in the load."""
    residual = run.number("claims.affine_planar")
    evidence = (
        _RATIO,
        "S τ is affine, as Eq. 41 states. τ is not affine if a different pair of cables carries the minimum tension.",
    )
    return Judgement(residual, residual <= 1e-6, evidence, "residual {claims.affine_planar:%}")


@verdict("5.1.accuracy", "claims", unit="kg", choice="payload unknown")
def accuracy_can_be_neglected(run: Run) -> Judgement:
    """A law that does not know the payload carries as much, within 5 %."""
    unknown = run.payload("claims.fl_payload_unknown_paper_kg")
    known = run.payload("claims.fl_payload_known_paper_kg")
    evidence = (
        "Spatial robot, paper criterion: {claims.fl_payload_known_paper_kg} with known and "
        "{claims.fl_payload_unknown_paper_kg} with unknown payload.",
        "Task criterion: {claims.fl_payload_known_kg} with known and {claims.fl_payload_unknown_kg} with unknown "
        "payload.",
        "The claim holds if the law knows the payload and no motor saturates.",
    )
    text = "{claims.fl_payload_unknown_paper_kg} instead of {claims.fl_payload_known_paper_kg}"
    return Judgement(unknown, unknown >= 0.95 * known, evidence, text)


@verdict("6.uncertainty", "claims", unit="mm")
def uncertainty_affects_tracking(run: Run) -> Judgement:
    """The uncertainty of Table 6 increases the mean error of the robot with joint springs by more
    than 5 %."""
    uncertain = run.number("claims.flex_composite_error_table6_mm")
    nominal = run.number("claims.flex_composite_error_nominal_mm")
    evidence = (
        "Mean error of `composite`: {claims.flex_composite_error_table6_mm} with the uncertainty of Table 6, "
        "{claims.flex_composite_error_nominal_mm} without uncertainty.",
        "`fl4`: {claims.flex_fl4_error_table6_mm} with and {claims.flex_fl4_error_nominal_mm} without uncertainty.",
    )
    return Judgement(uncertain, uncertain > (1 + ABOUT) * nominal, evidence)
