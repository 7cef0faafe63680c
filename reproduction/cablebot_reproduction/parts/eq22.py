"""The law of the paper for joint springs, Eq. 22: growth rates, controllability and Eq. 36."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from cablebot_baselines.classical import PaperFlexible
from cablebot_baselines.classical.outer_loop import PAPER_GAINS
from cablebot_gym.plotting.figures import new_figure, set_title
from cablebot_gym.robots import Robot
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Judgement, Run, verdict
from cablebot_reproduction.linearised import (
    controllable_states,
    growth_rate,
    unsaturated_actions,
)
from cablebot_reproduction.part import Jobs, Outcome, Results, Table, job
from cablebot_reproduction.runs import CONTROL_FREQUENCY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STIFFNESSES = tuple(np.logspace(0, 5, 11).tolist())
"""Stiffnesses K of the growth curve of Eq. 22 [N·m/rad]."""

NEARLY_CONTINUOUS = 50_000.0
"""Sampling frequency of a nearly continuous loop [Hz]."""

FRICTIONS = tuple(np.linspace(0.0, 0.012, 13).tolist())
"""Motor frictions c′ of the growth curve of Eq. 22 [N·m·s/rad]. The first one is 0."""

_GAINS = PAPER_GAINS["spatial"]


def growth_curve(
    *,
    robot: Robot,
    stiffnesses: tuple[float, ...],
    frictions: tuple[float, ...] = (0.0,),
    control_frequency: float = CONTROL_FREQUENCY,
) -> list[float]:
    """Growth rate of the loop with Eq. 22 for each stiffness and each motor friction [1/s]. The law
    knows the motor friction."""
    rates = []
    for stiffness, friction in product(stiffnesses, frictions):
        springs = robot.transmission.replace(stiffness=stiffness, motor_damping=friction)
        variant = unsaturated_actions(robot.replace(transmission=springs))
        law = PaperFlexible(variant)
        rates.append(growth_rate(law, variant, control_frequency=control_frequency))
    return rates


def printed_lyapunov_is_definite(*, gains: tuple[float, float]) -> bool:
    """Whether AᵀP + PA = −I has a solution P > 0 for A of one coordinate as printed in Eq. 36, with
    +k_p and +k_d."""
    printed = np.array([[0.0, 1.0], [gains[0], gains[1]]])
    solution = solve_continuous_lyapunov(printed.T, -np.eye(2))
    return bool(np.linalg.eigvalsh((solution + solution.T) / 2)[0] > 0)


def jobs(interpretation: Interpretation) -> Jobs:
    """Growth rates of Eq. 22, and the solution of Eq. 36."""
    robot = interpretation.flexible("control")
    curve = partial(job, growth_curve, robot=robot)
    return {
        "sampled": curve(stiffnesses=STIFFNESSES),
        "continuous": curve(stiffnesses=STIFFNESSES, control_frequency=NEARLY_CONTINUOUS),
        "friction K2": curve(stiffnesses=(2.0,), frictions=FRICTIONS),
        "friction K3": curve(stiffnesses=(3.0,), frictions=FRICTIONS),
        "definite": job(printed_lyapunov_is_definite, gains=_GAINS),
        "controllable": job(controllable_states, robot=robot),
    }


def outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Growth rates and the required motor friction."""
    robot = interpretation.flexible("control")
    rates = np.array(results["friction K3"])
    friction = None
    if rates.min() <= 0:
        friction = float(np.interp(0.0, -rates, FRICTIONS))
    header = ("K [N·m/rad]", "sampled at 500 Hz", "sampled at 50 kHz")
    rows = zip(STIFFNESSES, results["sampled"], results["continuous"], strict=True)
    title = (
        f"Growth rate of the loop with Eq. 22 [1/s], {robot.mass:g} kg, no friction; stable below 0"
    )
    return Outcome(
        numbers={
            "max_growth_K2": results["friction K2"][0],
            "max_growth_K3": results["friction K3"][0],
            "least_growth_any_K": min(results["continuous"]),
            "friction_needed": friction,
            "friction_rule": _GAINS[1] * float(robot.motor_inertia[0]),
            "lyapunov_printed_definite": results["definite"],
            "controllable_states": results["controllable"],
            "states": 2 * (robot.coordinates + robot.cables),
        },
        tables=(Table(title=title, header=header, rows=tuple(rows)),),
    )


def draw(interpretation: Interpretation, results: Results) -> Figure:
    """Growth rate versus stiffness and versus motor friction."""
    figure = new_figure(4.2)
    springs, frictions = figure.subplots(1, 2)
    for name, style, colour, label in (
        ("continuous", "o-", BLUE, "nearly continuous, 50 kHz"),
        ("sampled", "s--", VERMILLION, "500 Hz"),
    ):
        springs.semilogx(STIFFNESSES, results[name], style, color=colour, markersize=4, label=label)
    springs.axhline(_GAINS[1] / 2, color=GREY, linestyle=":", label="K_D/2")
    springs.set(xlabel="K [N·m/rad]", ylabel="growth rate [1/s]", title="without friction")
    for stiffness, colour in ((2, BLUE), (3, VERMILLION)):
        rates = results[f"friction K{stiffness}"]
        label = f"K = {stiffness} N·m/rad"
        frictions.plot(FRICTIONS, rates, ".-", color=colour, label=label)
    rule = _GAINS[1] * float(interpretation.flexible("control").motor_inertia[0])
    frictions.axvline(rule, color=GREY, linestyle=":", label="c′ = K_D J′")
    frictions.set(xlabel="motor friction c′ [N·m·s/rad]", title="with friction known to the law")
    for axes, position in ((springs, "center left"), (frictions, "upper right")):
        axes.axhline(0.0, color="black", linewidth=1.0)
        axes.legend(fontsize=9, frameon=False, loc=position)
    set_title(
        figure,
        "Eq. 22 on the robot with joint springs: growth rate of small deviations; unstable above 0",
    )
    return figure


# --- verdicts ---------------------------------------------------------------------------------------------------------

_GROWTH = "Growth rate of small deviations: {eq22.max_growth_K2:1/s} for K = 2, {eq22.max_growth_K3:1/s} for K = 3."


@verdict("abstract.stability", "eq22", unit="1/s")
def gains_place_the_poles(run: Run) -> Judgement:
    """Both sets of gains have stable poles."""
    slowest = -np.inf
    for stiffness, damping in PAPER_GAINS.values():
        slowest = max(slowest, np.roots([1.0, damping, stiffness]).real.max())
    evidence = (
        "Poles of both sets of gains for the rigid robots.",
        "With joint springs the law of the paper does not place the poles: growth rate {eq22.max_growth_K3:1/s}.",
    )
    return Judgement(float(slowest), bool(slowest < 0), evidence, "real parts ≤ {ours}")


@verdict("3.3.linear", "eq22", unit="1/s", choice="β̈′ computed from v")
def error_obeys_eq_19(run: Run) -> Judgement:
    """Small deviations decay under Eq. 22."""
    evidence = (
        _GROWTH,
        "Smallest growth rate for K from 1 to 10⁵ N·m/rad: {eq22.least_growth_any_K:1/s}.",
        "Motor friction that stability requires: {eq22.friction_needed:N·m·s/rad}.",
        "Error on the robot: {fig7.closed_loop_peak_error_mm} (Fig. 7).",
        "If β̈′ is computed from v, the loop has no s³ term. If β̈′ is measured, it cancels.",
    )
    return _judge_growth(run, evidence)


@verdict("3.3.bounded", "eq22", unit="1/s", options=("eq24",))
def motor_angles_stay_stable(run: Run) -> Judgement:
    """Small deviations of the motor angles decay under Eq. 22."""
    evidence = (
        "Eq. 25 alone is an undamped oscillator, so deviations do not decay.",
        "Its frequency is {fig7.ripple_Hz:Hz}.",
        "On the robot H depends on β′, because the springs move the platform.",
        _GROWTH,
    )
    return _judge_growth(run, evidence)


@verdict("5.2.3.stable", "eq22", unit="1/s")
def responses_are_stable(run: Run) -> Judgement:
    """The same for the responses of Fig. 14."""
    return _judge_growth(run, ("Closed loop with Eq. 22, see §3.3.",))


def _judge_growth(run: Run, evidence: Iterable[str]) -> Judgement:
    growth = max(run.number("eq22.max_growth_K2"), run.number("eq22.max_growth_K3"))
    return Judgement(growth, growth < 0, evidence, "growth rate {ours}")


@verdict("3.3.robust", "eq22", unit="1/s", choice="β̈′ computed from v")
def robust_term_stabilises(run: Run) -> Judgement:
    """Eq. 22 is stable for some stiffness."""
    growth = run.number("eq22.least_growth_any_K")
    evidence = (
        "Inside its boundary layer the robust term is a stiffer PD controller. No gains stabilise Eq. 22: the "
        "characteristic polynomial M J′s⁴ + K (M + J′)(s² + K_D s + K_P) has no s³ term, so the sum of its roots is "
        "zero.",
    )
    return Judgement(growth, growth < 0, evidence, "growth rate ≥ {ours}")


@verdict("3.4.uncontrollable", "eq22", options=("stiffness",))
def robot_is_uncontrollable(run: Run) -> Judgement:
    """The motors do not control all states."""
    controllable = run.number("eq22.controllable_states")
    states = run.number("eq22.states")
    evidence = (
        "Rank of the controllability matrix of the linearised robot. The torques act on the platform through the "
        "springs with relative degree 4, and `fl4` linearises the robot. A system with fewer inputs than degrees of "
        "freedom can be controllable.",
    )
    text = "{eq22.controllable_states} of {eq22.states} states controllable"
    return Judgement(controllable, controllable < states, evidence, text)


@verdict("3.4.lyapunov", "eq22", choice="signs as printed")
def lyapunov_equation_has_a_solution(run: Run) -> Judgement:
    """Eq. 35 has a positive definite solution for the printed A."""
    evidence = (
        "A must contain −k_p and −k_d. The printed A has plus signs and is unstable, so no such P exists.",
    )
    return Judgement(
        None,
        run.number("eq22.lyapunov_printed_definite"),
        evidence,
        "{eq22.lyapunov_printed_definite}",
    )
