"""Tests of the algorithm and the laws of the paper: Eqs. 37–39, Eq. 22, Eq. 36, and the claims of the text."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from cablebot_baselines.classical import Composite, FeedbackLinearization, FourthOrder, PaperFlexible
from cablebot_baselines.classical.outer_loop import PAPER_GAINS
from cablebot_baselines.paper.exact import paper_circle
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.laws import FeedForward
from cablebot_baselines.paper.linearised import controllable_states, growth_rate, unsaturated_actions
from cablebot_baselines.paper.load_iteration import LoadIteration, iterate_load
from cablebot_baselines.paper.part import Jobs, Number, Outcome, Results, Table, job
from cablebot_baselines.paper.parts.profiles import violation_text
from cablebot_baselines.paper.published import published_value
from cablebot_baselines.paper.runs import FLEX, PLANAR, SPATIAL, Law, closed_loop, compared, largest_payload
from cablebot_gym.bounds import exact_payload
from cablebot_gym.evaluation import Comparison, DLCCResult
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
from cablebot_gym.robots import Robot
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GUESSES = {
    "planar": (published_value("table7.guess"), 0.25, 4.0),
    "spatial": (published_value("table8.guess"), 0.5, 10.0),
}
"""First guesses m_l [kg]: the guess of Table 7 or 8 and two other guesses."""

CONTROL_FREQUENCY = 500.0
"""Number of control instants per second [Hz]."""

STIFFNESSES = tuple(float(value) for value in np.logspace(0, 5, 11))
"""Stiffnesses K of the growth curve of Eq. 22 [N·m/rad]."""

NEARLY_CONTINUOUS = 50_000.0
"""Sampling frequency of a nearly continuous loop [Hz]."""

FAST = 10_000.0
"""Control frequency that resolves the poles of Eqs. 14 and 19 [Hz]."""

FRICTIONS = tuple(float(value) for value in np.linspace(0.0, 0.012, 13))
"""Motor frictions c′ of the growth curve of Eq. 22 [N·m·s/rad]."""

_GAINS = PAPER_GAINS["spatial"]

_FORMS = {"literal": "as printed", "corrected": "corrected"}


# --- Eqs. 37-39 -------------------------------------------------------------------------------------------------------


def iterations(
    *, interpretation: Interpretation, robot: Robot, guesses: tuple[float, ...], corrected: bool
) -> list[LoadIteration]:
    """Iterations of the paper from several first guesses."""
    iterate = partial(iterate_load, robot, paper_circle(robot), frequency=CONTROL_FREQUENCY)
    minimum, speed = interpretation.minimum_tension, interpretation.line_speed(robot)
    return [iterate(guess=guess, corrected=corrected, minimum_tension=minimum, line_speed=speed) for guess in guesses]


def true_payload(*, interpretation: Interpretation, robot: Robot) -> float:
    """Payload of the closed form at the same instants [kg]."""
    bound = exact_payload(
        robot,
        paper_circle(robot),
        minimum_tension=interpretation.minimum_tension if robot.planar else 0.0,
        frequency=CONTROL_FREQUENCY,
        line_speed=interpretation.line_speed(robot),
    )
    return bound.payload


def eq37_jobs(interpretation: Interpretation) -> Jobs:
    """Iterations in both forms, and true payloads."""
    jobs = {}
    for kind, robot in (("planar", interpretation.planar), ("spatial", interpretation.spatial("payload"))):
        chosen: dict[str, Any] = {"interpretation": interpretation, "robot": robot}
        jobs[f"{kind} true"] = job(true_payload, **chosen)
        for form in _FORMS:
            iteration = job(iterations, **chosen, guesses=GUESSES[kind], corrected=form == "corrected")
            jobs[f"{kind} {form}"] = iteration
    return jobs


def eq37_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Results of the iterations relative to the true payload."""
    numbers: dict[str, Number] = {}
    rows: list[tuple[Number, ...]] = []
    for kind in GUESSES:
        true = results[f"{kind} true"]
        stem = "" if kind == "spatial" else "planar_"
        numbers[f"{stem}exact_payload_kg"] = true
        for form, name in _FORMS.items():
            runs: list[LoadIteration] = results[f"{kind} {form}"]
            values = {
                "payload_kg": runs[0].payload,
                "motor": runs[0].motor,
                "guesses": len(runs[0].loads),
                "converges": all(run.converged for run in runs),
                "spread_kg": float(np.ptp([run.payload for run in runs])),
            }
            numbers |= {f"{stem}{form}_{key}": value for key, value in values.items()}
            for run in runs:
                ratio = _ratio(run.payload, true)
                rows.append((kind, name, run.loads[0], run.payload, ratio, len(run.loads), run.converged))
        numbers[f"{stem}literal_over_true"] = _ratio(results[f"{kind} literal"][0].payload, true)
        numbers[f"{stem}chosen_payload_kg"] = numbers[f"{stem}{interpretation.eq37}_payload_kg"]
    header = ("robot", "Eqs. 37–39", "first guess [kg]", "result [kg]", "result / true payload", "guesses", "converges")
    title = "Results of the algorithm, exact tracking at 500 Hz"
    return Outcome(numbers=numbers, tables=(Table(title=title, header=header, rows=tuple(rows)),))


def _ratio(payload: float, true: float) -> float | None:
    """Ratio to the true payload; None if the true payload is not positive and finite."""
    return payload / true if 0 < true < np.inf else None


def draw_eq37(interpretation: Interpretation, results: Results) -> Figure:
    """Guesses of the iterations."""
    figure = new_figure(4.2)
    panels = figure.subplots(1, len(GUESSES))
    for axes, kind in zip(panels, GUESSES, strict=True):
        for form, colour, style in (("corrected", BLUE, "-"), ("literal", VERMILLION, "--")):
            label = _FORMS[form] + (" (chosen)" if form == interpretation.eq37 else "")
            for run in results[f"{kind} {form}"]:
                axes.plot(range(1, len(run.loads) + 1), run.loads, style, color=colour, marker=".", label=label)
                label = "_"  # no further entry in the legend
        true = results[f"{kind} true"]
        axes.axhline(true, color="black", linewidth=1.0, label="true payload, closed form")
        axes.axhline(true / 2, color=GREY, linewidth=1.0, linestyle=":", label="half of the true payload")
        axes.set(xlabel="guess number", ylabel="load mₑ [kg]", title=f"{kind} robot", ylim=(0, None), xlim=(0.5, 16.5))
    add_legend(figure, panels[0])
    set_title(figure, "Guesses of the algorithm of the paper (steps 4 to 8) from three first guesses")
    return figure


# --- Eq. 22 and Eq. 36 ------------------------------------------------------------------------------------------------


def growth(
    *, robot: Robot, stiffness: float, friction: float = 0.0, control_frequency: float = CONTROL_FREQUENCY
) -> float:
    """Growth rate of the loop with Eq. 22 [1/s]. The law knows the motor friction."""
    springs = robot.transmission.replace(stiffness=stiffness, motor_damping=friction)
    robot = unsaturated_actions(robot.replace(transmission=springs))
    return growth_rate(PaperFlexible(robot), robot, control_frequency=control_frequency)


def growth_curve(*, robot: Robot, control_frequency: float) -> list[float]:
    """Growth rate for each of :data:`STIFFNESSES` [1/s]."""
    return [growth(robot=robot, stiffness=one, control_frequency=control_frequency) for one in STIFFNESSES]


def friction_curve(*, robot: Robot, stiffness: float) -> list[float]:
    """Growth rate for each of :data:`FRICTIONS` [1/s]."""
    return [growth(robot=robot, stiffness=stiffness, friction=friction) for friction in FRICTIONS]


def printed_lyapunov_is_definite(*, gains: tuple[float, float]) -> bool:
    """Whether AᵀP + PA = −I has a solution P > 0 for A of one coordinate as printed in Eq. 36, with +k_p and +k_d."""
    printed = np.array([[0.0, 1.0], [gains[0], gains[1]]])
    solution = solve_continuous_lyapunov(printed.T, -np.eye(2))
    return bool(np.linalg.eigvalsh((solution + solution.T) / 2)[0] > 0)


_KS = {"K2": 2.0, "K3": 3.0}


def eq22_jobs(interpretation: Interpretation) -> Jobs:
    """Growth rates of Eq. 22, and the solution of Eq. 36."""
    robot = interpretation.flexible("control")
    jobs = {
        "sampled": job(growth_curve, robot=robot, control_frequency=CONTROL_FREQUENCY),
        "continuous": job(growth_curve, robot=robot, control_frequency=NEARLY_CONTINUOUS),
        "definite": job(printed_lyapunov_is_definite, gains=_GAINS),
        "controllable": job(controllable_states, robot=robot),
    }
    for name, stiffness in _KS.items():
        jobs[name] = job(growth, robot=robot, stiffness=stiffness)
        jobs[f"friction {name}"] = job(friction_curve, robot=robot, stiffness=stiffness)
    return jobs


def eq22_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Growth rates and the required motor friction."""
    robot = interpretation.flexible("control")
    rates = np.array(results["friction K3"])
    header = ("K [N·m/rad]", "sampled at 500 Hz", "sampled at 50 kHz")
    rows = zip(STIFFNESSES, results["sampled"], results["continuous"], strict=True)
    title = f"Growth rate of the loop with Eq. 22 [1/s], {robot.mass:g} kg, no friction; stable below 0"
    return Outcome(
        numbers={
            "max_growth_K2": results["K2"],
            "max_growth_K3": results["K3"],
            "least_growth_any_K": min(results["continuous"]),
            "friction_needed": float(np.interp(0.0, -rates, FRICTIONS)) if rates.min() <= 0 else None,
            "friction_rule": _GAINS[1] * float(robot.motor_inertia[0]),
            "lyapunov_printed_definite": results["definite"],
            "controllable_states": results["controllable"],
            "states": 2 * (robot.coordinates + robot.cables),
        },
        tables=(Table(title=title, header=header, rows=tuple(rows)),),
    )


def draw_eq22(interpretation: Interpretation, results: Results) -> Figure:
    """Growth rate versus stiffness and versus motor friction."""
    figure = new_figure(4.2)
    left, right = figure.subplots(1, 2)
    left.semilogx(STIFFNESSES, results["continuous"], "o-", color=BLUE, markersize=4, label="nearly continuous, 50 kHz")
    left.semilogx(STIFFNESSES, results["sampled"], "s--", color=VERMILLION, markersize=4, label="500 Hz")
    left.axhline(_GAINS[1] / 2, color=GREY, linestyle=":", label="K_D/2")
    left.set(xlabel="K [N·m/rad]", ylabel="growth rate [1/s]", title="without friction")
    for name, colour in (("K2", BLUE), ("K3", VERMILLION)):
        right.plot(FRICTIONS, results[f"friction {name}"], ".-", color=colour, label=f"K = {_KS[name]:g} N·m/rad")
    rule = _GAINS[1] * float(interpretation.flexible("control").motor_inertia[0])
    right.axvline(rule, color=GREY, linestyle=":", label="c′ = K_D J′")
    right.set(xlabel="motor friction c′ [N·m·s/rad]", title="with friction known to the law")
    for axes, place in ((left, "center left"), (right, "upper right")):
        axes.axhline(0.0, color="black", linewidth=1.0)
        axes.legend(fontsize=9, frameon=False, loc=place)
    set_title(figure, "Eq. 22 on the robot with joint springs: growth rate of small deviations; unstable above 0")
    return figure


# --- claims of the text -----------------------------------------------------------------------------------------------

_OFFSET = 1e-3
"""Initial position error [m]."""

_DRAWS = 64
"""Number of draws of Table 6."""

_LOOPS = {
    "fl": ("fl", True, "fl_payload_known"),
    "payload_unknown": ("fl", False, "fl_payload_unknown"),
    "open loop": ("open loop", True, "open_loop"),
}
"""Law, whether it knows the payload, and name of the number, by job."""


def affinity(*, robot: Robot, minimum_tension: float) -> float:
    """Largest ratio of the second to the first difference of τ in the mass for exact tracking; 0 if τ is affine."""
    motion = paper_circle(robot)(np.arange(500) / 500)
    state = (motion.position, motion.velocity, motion.acceleration)
    tensions = [
        textbook.required_tensions(robot, count * robot.mass, *state, minimum=minimum_tension) for count in (1, 2, 3)
    ]
    torques = [textbook.required_torques(robot, one, *state) for one in tensions]
    second = torques[2] - 2 * torques[1] + torques[0]
    return float(np.abs(second).max() / np.abs(torques[1] - torques[0]).max())


def decay_error(rollout: Rollout, gains: tuple[float, float]) -> float:
    """Largest deviation from ë + K_D ė + K_P e = 0 after an initial error, as a fraction of this error."""
    stiffness, damping = gains
    time = rollout.arrays["time"]
    poles = np.roots([1.0, damping, stiffness])
    weights = np.linalg.solve(np.stack([np.ones(2), poles]), [1.0, 0.0])
    expected = _OFFSET * np.real(np.exp(np.outer(time, poles)) @ weights)
    actual = rollout.arrays["pose"][:, 0] - rollout.arrays["reference_pose"][:, 0]
    return float(np.abs(actual - expected).max() / _OFFSET)


def claims_jobs(interpretation: Interpretation) -> Jobs:
    """Payloads with and without feedback, episodes for the poles, and errors over draws."""
    jobs = {}
    planar_law = partial(FeedbackLinearization, minimum_tension=interpretation.minimum_tension)
    setups: dict[str, tuple[str, Robot, Law]] = {
        "planar": (PLANAR, interpretation.planar, planar_law),
        "spatial": (SPATIAL, interpretation.spatial("payload"), FeedbackLinearization),
    }
    for kind, (env_id, nominal, law) in setups.items():
        robot = interpretation.closed_loop_robot(nominal)
        plant: dict[str, Any] = {"env_id": env_id, "robot": robot}
        laws: dict[str, Law] = {"fl": law, "open loop": FeedForward}
        for criterion in ("task", "paper"):
            for key, (name, known, _) in _LOOPS.items():
                told = {} if known else {"payload_known": False}
                jobs[f"{kind} {key} {criterion}"] = job(
                    largest_payload, **plant, law=laws[name], name=name, criterion=criterion, **told
                )
        draws = {"payload": robot.mass / 10, "uncertainty": "table6", "draws": _DRAWS}
        jobs[f"{kind} errors"] = job(compared, **plant, laws=tuple(laws.items()), **draws)
        dwell = {"name": f"dwell-{kind}", "duration": 0.5}
        start = (_OFFSET,) + (0.0,) * (robot.coordinates - 1)
        for name, frequency in (("decay", FAST), ("sampled decay", CONTROL_FREQUENCY)):
            jobs[f"{kind} {name}"] = job(
                closed_loop, **plant, law=law, trajectory=dwell, initial_error=start, control_frequency=frequency
            )
        jobs[f"{kind} affine"] = job(affinity, robot=robot, minimum_tension=interpretation.minimum_tension)
    plant = {"env_id": FLEX, "robot": interpretation.closed_loop_robot(interpretation.flexible("payload"))}
    flexible = partial(job, compared, **plant, laws=(("fl4", FourthOrder), ("composite", Composite)), payload=1.0)
    jobs["flexible None"] = flexible(uncertainty=None, draws=None)
    jobs["flexible table6"] = flexible(uncertainty="table6", draws=_DRAWS)
    return jobs


def claims_outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Payloads, errors, poles and affinity."""
    numbers: dict[str, Number] = {}
    rows: list[tuple[Number, ...]] = []
    for kind in ("planar", "spatial"):
        prefix = "" if kind == "spatial" else "planar_"
        for criterion, suffix in (("task", ""), ("paper", "_paper")):
            for key, (law, known, word) in _LOOPS.items():
                result: DLCCResult = results[f"{kind} {key} {criterion}"]
                name = f"open_loop_{kind}{suffix}_kg" if key == "open loop" else f"{prefix}{word}{suffix}_kg"
                numbers[name] = result.payload
                rows.append((kind, law, known, criterion, result.payload, violation_text(result.violation)))
            numbers[f"closed_loop_{kind}{suffix}_kg"] = results[f"{kind} fl {criterion}"].payload
        for index, word in enumerate(("closed_loop", "open_loop")):
            numbers[f"{word}_{kind}_error_mm"] = _mean_error(results[f"{kind} errors"], index)
        stiffness, damping = PAPER_GAINS[kind]
        poles = ", ".join(_pole(complex(pole)) for pole in np.roots([1.0, damping, stiffness]))
        numbers |= {
            f"pole_error_{kind}": decay_error(results[f"{kind} decay"], (stiffness, damping)),
            f"sampled_pole_error_{kind}": decay_error(results[f"{kind} sampled decay"], (stiffness, damping)),
            f"poles_{kind}": poles,
            f"affine_{kind}": results[f"{kind} affine"],
        }
    for index, name in enumerate(("fl4", "composite")):
        numbers[f"flex_{name}_error_nominal_mm"] = _mean_error(results["flexible None"], index)
        numbers[f"flex_{name}_error_table6_mm"] = _mean_error(results["flexible table6"], index)
    header = ("robot", "law", "payload known", "criterion", "payload [kg]", "limiting violation")
    title = "Payloads with feedback, without feedback, and with feedback and unknown payload"
    return Outcome(numbers=numbers, tables=(Table(title=title, header=header, rows=tuple(rows)),))


def _mean_error(comparison: Comparison, index: int) -> float:
    """Mean position error over time and draws [mm]."""
    return 1e3 * comparison.metrics[index].estimate("mean_error").mean


def _pole(pole: complex) -> str:
    if pole.imag == 0:
        return f"{pole.real:.2f}"
    return f"{pole.real:.2f} {'+' if pole.imag > 0 else '−'} {abs(pole.imag):.2f}i"
