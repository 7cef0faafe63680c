"""The algorithm of the paper (Eqs. 37–39), and its law for joint springs (Eq. 22)."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from cablebot_baselines.laws import PaperFlexible
from cablebot_baselines.laws.outer_loop import PAPER_GAINS
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR
from cablebot_reproduction.fourth_order import FourthOrder
from cablebot_reproduction.linearised import growth_rate, unsaturated_actions
from cablebot_reproduction.load_iteration import iterate_load
from cablebot_reproduction.outcome import Number, Numbers, Outcome, Table
from cablebot_reproduction.robots import (
    FLEXIBLE_OF_4,
    flexible_robot,
    paper_circle,
    spatial_robot,
)
from cablebot_reproduction.simulation import CONTROL_FREQUENCY

GUESSES = {"planar_": (2.0, 0.25, 4.0), "": (5.0, 0.5, 10.0)}
"""First guesses m_l of each robot [kg]: that of Table 7 or 8, and two others."""

STIFFNESSES = tuple(np.logspace(0, 5, 11).tolist())
"""Stiffnesses K of the growth curve of Eq. 22 [N·m/rad]."""

NEARLY_CONTINUOUS = 50_000.0
"""Sampling frequency of a nearly continuous loop [Hz]."""

FRICTIONS = tuple(np.linspace(0.0, 0.012, 13).tolist())
"""Motor frictions c′ of the growth curve of Eq. 22 [N·m·s/rad]."""


def eq37() -> Outcome:
    """Results of the algorithm relative to the true payload."""
    numbers: Numbers = {}
    rows: list[tuple[Number, ...]] = []
    for (prefix, guesses), robot in zip(GUESSES.items(), (PLANAR, spatial_robot()), strict=True):
        minimum = textbook.MINIMUM_TENSION if robot.planar else 0.0
        circle = paper_circle(robot)
        true = exact_payload(
            robot, circle, minimum_tension=minimum, frequency=CONTROL_FREQUENCY
        ).payload
        numbers[f"{prefix}exact_payload_kg"] = true
        for form, name in (("literal", "as printed"), ("corrected", "corrected")):
            runs = []
            for guess in guesses:
                run = iterate_load(
                    robot,
                    circle,
                    guess=guess,
                    corrected=form == "corrected",
                    minimum_tension=minimum,
                )
                runs.append(run)
                ratio = run.payload / true
                rows.append(
                    (robot.kind, name, guess, run.payload, ratio, len(run.loads), run.converged)
                )
            payloads = [run.payload for run in runs]
            numbers[f"{prefix}{form}_payload_kg"] = payloads[0]
            numbers[f"{prefix}{form}_motor"] = runs[0].motor
            numbers[f"{prefix}{form}_guesses"] = len(runs[0].loads)
            numbers[f"{prefix}{form}_converges"] = all(run.converged for run in runs)
            numbers[f"{prefix}{form}_spread_kg"] = np.ptp(payloads)
        numbers[f"{prefix}literal_over_true"] = numbers[f"{prefix}literal_payload_kg"] / true
    header = (
        "robot",
        "Eqs. 37–39",
        "first guess [kg]",
        "result [kg]",
        "result / true payload",
        "guesses",
        "converges",
    )
    title = "Results of the algorithm, exact tracking at 500 Hz"
    return Outcome(numbers=numbers, tables=(Table(title=title, header=header, rows=rows),))


def eq22_growth(
    *, stiffness: float, friction: float = 0.0, frequency: float = CONTROL_FREQUENCY
) -> float:
    """Growth rate of the loop with Eq. 22 [1/s]. The law knows the motor friction."""
    robot = flexible_robot(mass=11.0, stiffness=stiffness, motor_damping=friction)
    robot = unsaturated_actions(robot)
    return growth_rate(PaperFlexible(robot), robot, control_frequency=frequency)


def eq22() -> Outcome:
    """Growth rates of the law of the paper, required motor friction, controllability and Eq. 36."""
    continuous = [
        eq22_growth(stiffness=stiffness, frequency=NEARLY_CONTINUOUS) for stiffness in STIFFNESSES
    ]
    rows = []
    for stiffness, rate in zip(STIFFNESSES, continuous, strict=True):
        rows.append((stiffness, eq22_growth(stiffness=stiffness), rate))
    damped = [eq22_growth(stiffness=3.0, friction=friction) for friction in FRICTIONS]
    stiffness, damping = PAPER_GAINS["spatial"]
    printed = np.array([[0.0, 1.0], [stiffness, damping]])  # Eq. 36, with +k_p and +k_d
    solution = solve_continuous_lyapunov(printed.T, -np.eye(2))
    poles = [np.roots([1.0, kd, kp]).real.max() for kp, kd in PAPER_GAINS.values()]
    robot = FLEXIBLE_OF_4
    slope = FourthOrder(robot).torque_slope(np.asarray(robot.mass), robot.home)
    numbers: Numbers = {
        "slowest_pole": max(poles),
        "max_growth_K2": eq22_growth(stiffness=2.0),
        "max_growth_K3": damped[0],
        "least_growth_any_K": min(continuous),
        "friction_needed": np.interp(0.0, -np.array(damped), FRICTIONS),
        "friction_rule": damping * float(robot.motor_inertia[0]),
        "lyapunov_printed_definite": np.linalg.eigvalsh(solution).min() > 0,
        # The torques enter the fourth derivative of each coordinate through this matrix.
        "controllable_states": 4 * np.linalg.matrix_rank(slope),
        "states": 2 * (robot.coordinates + robot.cables),
        "free_coordinates": robot.coordinates + robot.cables,
    }
    table = Table(
        title="Growth rate of the loop with Eq. 22 [1/s], 11 kg, no friction; stable below 0",
        header=("K [N·m/rad]", "sampled at 500 Hz", "sampled at 50 kHz"),
        rows=rows,
    )
    return Outcome(numbers=numbers, tables=(table,))
