"""The paper's algorithm and laws put to the test: Eqs. 37–39, Eq. 22, Eq. 36, and what its text claims of them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from cablebot_baselines.classical import Composite, FeedbackLinearization, FourthOrder, PaperFlexible
from cablebot_baselines.classical.outer_loop import PAPER_GAINS
from cablebot_baselines.paper.exact import paper_circle
from cablebot_baselines.paper.laws import FeedForward
from cablebot_baselines.paper.linearised import controllable_states, growth_rate, unclipped
from cablebot_baselines.paper.load_iteration import LoadIteration, iterate_load
from cablebot_baselines.paper.part import Cell, Found, Number, Outcome, Part, Table
from cablebot_baselines.paper.parts.profiles import first_limit
from cablebot_baselines.paper.published import published_value
from cablebot_baselines.paper.readings import Readings
from cablebot_baselines.paper.runs import Law, closed_loop, compared, largest_payload
from cablebot_gym.bounds import exact_payload
from cablebot_gym.evaluation import Comparison, DLCCResult
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.physics import textbook
from cablebot_gym.plotting.figures import add_legend, entitle, new_figure
from cablebot_gym.robots import Robot
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GUESSES = {
    "planar": (published_value("table7.guess"), 0.25, 4.0),
    "spatial": (published_value("table8.guess"), 0.5, 10.0),
}
"""First guesses m_l [kg]: that of Tables 7 and 8, and two others."""

CONTROL_FREQUENCY = 500.0
"""Instants of the path per second [Hz]."""

STIFFNESSES = tuple(float(value) for value in np.logspace(0, 5, 11))
"""K of the curve of Eq. 22 [N·m/rad]."""

NEARLY_CONTINUOUS = 50_000.0
"""Samples per second at which the loop is as good as continuous [Hz]."""

FAST = 10_000.0
"""Commands per second of a loop in which the poles of Eqs. 14 and 19 can be seen [Hz]."""

FRICTIONS = tuple(float(value) for value in np.linspace(0.0, 0.012, 13))
"""c′ of the curve of Eq. 22 [N·m·s/rad]."""

IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0", "flexible": "CableBot-FlexSpatial-v0"}


# --- Eqs. 37-39 -------------------------------------------------------------------------------------------------------


def iterations(*, readings: Readings, robot: Robot, guesses: tuple[float, ...], corrected: bool) -> list[LoadIteration]:
    """The paper's eight steps from several first guesses."""
    return [
        iterate_load(
            robot,
            paper_circle(robot),
            guess=guess,
            corrected=corrected,
            minimum_tension=readings.minimum_tension,
            frequency=CONTROL_FREQUENCY,
            line_speed=readings.line_speed(robot),
        )
        for guess in guesses
    ]


def true_payload(*, readings: Readings, robot: Robot) -> float:
    """The closed form at the same instants [kg]."""
    minimum = readings.minimum_tension if robot.planar else 0.0
    found = exact_payload(
        robot,
        paper_circle(robot),
        minimum_tension=minimum,
        frequency=CONTROL_FREQUENCY,
        line_speed=readings.line_speed(robot),
    )
    return found.payload


def _rigid(readings: Readings) -> dict[str, Robot]:
    return {"planar": readings.planar, "spatial": readings.spatial("payload")}


def _eq37_cells(readings: Readings) -> dict[str, Cell]:
    cells: dict[str, Cell] = {}
    for kind, robot in _rigid(readings).items():
        cells[f"{kind} true"] = partial(true_payload, readings=readings, robot=robot)
        for form in ("literal", "corrected"):
            cells[f"{kind} {form}"] = partial(
                iterations, readings=readings, robot=robot, guesses=GUESSES[kind], corrected=form == "corrected"
            )
    return cells


def _eq37_outcome(readings: Readings, found: Found) -> Outcome:
    numbers: dict[str, Number] = {}
    rows: list[tuple[Number, ...]] = []
    for kind in GUESSES:
        true = found[f"{kind} true"]
        stem = "" if kind == "spatial" else "planar_"
        numbers[f"{stem}exact_payload_kg"] = true
        for form in ("literal", "corrected"):
            runs: list[LoadIteration] = found[f"{kind} {form}"]
            ends = [run.payload for run in runs]
            numbers[f"{stem}{form}_payload_kg"] = ends[0]
            numbers[f"{stem}{form}_motor"] = runs[0].motor
            numbers[f"{stem}{form}_guesses"] = len(runs[0].loads)
            numbers[f"{stem}{form}_converges"] = all(run.converged for run in runs)
            numbers[f"{stem}{form}_spread_kg"] = float(np.ptp(ends))
            rows += [
                (
                    kind,
                    "as printed" if form == "literal" else form,
                    run.loads[0],
                    run.payload,
                    _share(run.payload, true),
                    len(run.loads),
                    run.converged,
                )
                for run in runs
            ]
        numbers[f"{stem}literal_over_true"] = _share(found[f"{kind} literal"][0].payload, true)
        numbers[f"{stem}chosen_payload_kg"] = numbers[f"{stem}{readings.eq37}_payload_kg"]
    header = ("robot", "Eqs. 37–39", "first guess [kg]", "answer [kg]", "answer / true", "guesses", "converges")
    title = "The algorithm's answers, exact tracking at 500 Hz"
    return Outcome(numbers=numbers, tables=(Table(title=title, header=header, rows=tuple(rows)),))


def _share(payload: float, true: float) -> float | None:
    """Of the true payload; None if the platform alone is too heavy."""
    return payload / true if 0 < true < np.inf else None


def _eq37_draw(readings: Readings, found: Found) -> Figure:
    figure = new_figure(4.2)
    panels = figure.subplots(1, len(GUESSES))
    for axes, kind in zip(panels, GUESSES, strict=True):
        for form, colour, style in (("corrected", BLUE, "-"), ("literal", VERMILLION, "--")):
            for place, run in enumerate(found[f"{kind} {form}"]):
                name = "as printed" if form == "literal" else form
                label = f"{name}{', as chosen' if form == readings.eq37 else ''}" if place == 0 else None
                axes.plot(range(1, len(run.loads) + 1), run.loads, style, color=colour, marker=".", label=label)
        true = found[f"{kind} true"]
        axes.axhline(true, color="black", linewidth=1.0, label="true payload, closed form")
        axes.axhline(true / 2, color=GREY, linewidth=1.0, linestyle=":", label="half of it")
        axes.set(xlabel="guess number", ylabel="load mₑ [kg]", title=f"{kind} robot", ylim=(0, None), xlim=(0.5, 16.5))
    add_legend(figure, panels[0])
    entitle(figure, "Guesses of the paper's algorithm (steps 4 to 8), from three first guesses each")
    return figure


# --- Eq. 22 and Eq. 36 ------------------------------------------------------------------------------------------------


def growth(*, robot: Robot, stiffness: float, friction: float, control_frequency: float) -> float:
    """Growth rate of Eq. 22's loop at 1/s, the motors' friction told to the law."""
    springs = robot.transmission.replace(stiffness=stiffness, motor_damping=friction)
    robot = unclipped(robot.replace(transmission=springs))
    return growth_rate(PaperFlexible(robot), robot, control_frequency=control_frequency)


def growth_curve(*, robot: Robot, control_frequency: float) -> list[float]:
    """Growth rate for each of :data:`STIFFNESSES` [1/s]."""
    return [
        growth(robot=robot, stiffness=stiffness, friction=0.0, control_frequency=control_frequency)
        for stiffness in STIFFNESSES
    ]


def friction_curve(*, robot: Robot, stiffness: float) -> list[float]:
    """Growth rate for each of :data:`FRICTIONS` [1/s]."""
    return [
        growth(robot=robot, stiffness=stiffness, friction=friction, control_frequency=CONTROL_FREQUENCY)
        for friction in FRICTIONS
    ]


def printed_lyapunov_is_definite(*, gains: tuple[float, float]) -> bool:
    """Whether AᵀP + PA = −I has a P > 0 for one coordinate's A as Eq. 36 prints it, with + k_p and + k_d."""
    printed = np.array([[0.0, 1.0], [gains[0], gains[1]]])
    solution = solve_continuous_lyapunov(printed.T, -np.eye(2))
    return bool(np.linalg.eigvalsh((solution + solution.T) / 2)[0] > 0)


_KS = {"K2": 2.0, "K3": 3.0}


def _eq22_cells(readings: Readings) -> dict[str, Cell]:
    robot = readings.flexible("control")
    cells: dict[str, Cell] = {
        "sampled": partial(growth_curve, robot=robot, control_frequency=CONTROL_FREQUENCY),
        "continuous": partial(growth_curve, robot=robot, control_frequency=NEARLY_CONTINUOUS),
        "definite": partial(printed_lyapunov_is_definite, gains=PAPER_GAINS["spatial"]),
        "controllable": partial(controllable_states, robot=robot),
    }
    for name, stiffness in _KS.items():
        cells[name] = partial(
            growth, robot=robot, stiffness=stiffness, friction=0.0, control_frequency=CONTROL_FREQUENCY
        )
        cells[f"friction {name}"] = partial(friction_curve, robot=robot, stiffness=stiffness)
    return cells


def _eq22_outcome(readings: Readings, found: Found) -> Outcome:
    robot = readings.flexible("control")
    rates = np.array(found["friction K3"])
    friction = float(np.interp(0.0, -rates, FRICTIONS)) if rates.min() <= 0 else None
    rows = zip(STIFFNESSES, found["sampled"], found["continuous"], strict=True)
    return Outcome(
        numbers={
            "max_growth_K2": found["K2"],
            "max_growth_K3": found["K3"],
            "least_growth_any_K": min(found["continuous"]),
            "friction_needed": friction,
            "friction_rule": PAPER_GAINS["spatial"][1] * float(robot.motor_inertia[0]),
            "lyapunov_printed_definite": found["definite"],
            "controllable_states": found["controllable"],
            "states": 2 * (robot.coordinates + robot.cables),
        },
        tables=(
            Table(
                title=f"Growth rate of the loop with Eq. 22 [1/s], {robot.mass:g} kg, no friction; stable below 0",
                header=("K [N·m/rad]", "sampled at 500 Hz", "sampled at 50 kHz"),
                rows=tuple(rows),
            ),
        ),
    )


def _eq22_draw(readings: Readings, found: Found) -> Figure:
    figure = new_figure(4.2)
    left, right = figure.subplots(1, 2)
    left.semilogx(
        STIFFNESSES, found["continuous"], color=BLUE, marker="o", markersize=4, label="nearly continuous, 50 kHz"
    )
    left.semilogx(STIFFNESSES, found["sampled"], "--", color=VERMILLION, marker="s", markersize=4, label="500 Hz")
    half = PAPER_GAINS["spatial"][1] / 2
    left.axhline(half, color=GREY, linestyle=":", label="K_D/2")
    left.set(xlabel="K [N·m/rad]", ylabel="growth rate [1/s]", title="without friction")
    for name, colour in (("K2", BLUE), ("K3", VERMILLION)):
        right.plot(FRICTIONS, found[f"friction {name}"], color=colour, marker=".", label=f"K = {_KS[name]:g} N·m/rad")
    rule = PAPER_GAINS["spatial"][1] * float(readings.flexible("control").motor_inertia[0])
    right.axvline(rule, color=GREY, linestyle=":", label="c′ = K_D J′")
    right.set(
        xlabel="motor friction c′ [N·m·s/rad]", ylabel="growth rate [1/s]", title="with friction that the law knows"
    )
    for axes in (left, right):
        axes.axhline(0.0, color="black", linewidth=1.0)
        axes.legend(fontsize=9, frameon=False, loc="center left" if axes is left else "upper right")
    entitle(figure, "Eq. 22 on the robot with joint springs: growth rate of small deviations; above 0 is unstable")
    return figure


# --- what the text claims ---------------------------------------------------------------------------------------------

_OFFSET = 1e-3
"""Start beside the reference [m]."""

_DRAWS = 64
"""Of Table 6."""

_HOLD = {"planar": "hold-planar", "spatial": "hold-spatial"}


def affinity(*, robot: Robot, minimum_tension: float) -> float:
    """How far τ of exact tracking is from affine in the mass: its second difference over its first, the largest."""
    motion = paper_circle(robot)(np.arange(500) / 500)
    state = (motion.position, motion.velocity, motion.acceleration)
    masses = robot.mass * np.array([1.0, 2.0, 3.0])
    torques = [
        textbook.required_torques(
            robot, textbook.required_tensions(robot, mass, *state, minimum=minimum_tension), *state
        )
        for mass in masses
    ]
    second = torques[2] - 2 * torques[1] + torques[0]
    return float(np.abs(second).max() / np.abs(torques[1] - torques[0]).max())


def decay_error(rollout: Rollout, gains: tuple[float, float]) -> float:
    """How far a loop let go beside its reference is from ë + K_D ė + K_P e = 0, as a share of the first error."""
    stiffness, damping = gains
    time = rollout.arrays["time"]
    poles = np.roots([1.0, damping, stiffness])
    weights = np.linalg.solve(np.stack([np.ones(2), poles]), [1.0, 0.0])
    expected = _OFFSET * np.real(np.exp(np.outer(time, poles)) @ weights)
    actual = rollout.arrays["pose"][:, 0] - rollout.arrays["reference_pose"][:, 0]
    return float(np.abs(actual - expected).max() / _OFFSET)


def _claims_cells(readings: Readings) -> dict[str, Cell]:
    cells: dict[str, Cell] = {}
    planar_law = partial(FeedbackLinearization, minimum_tension=readings.minimum_tension)
    made: dict[str, tuple[Robot, Law]] = {
        "planar": (readings.moved(readings.planar), planar_law),
        "spatial": (readings.moved(readings.spatial("payload")), FeedbackLinearization),
    }
    for kind, (robot, law) in made.items():
        plan: dict[str, Law] = {"fl": law, "open loop": FeedForward}
        for criterion in ("task", "paper"):
            for name, one in plan.items():
                cells[f"{kind} {name} {criterion}"] = partial(
                    largest_payload, env_id=IDS[kind], law=one, robot=robot, name=name, criterion=criterion
                )
            cells[f"{kind} untold {criterion}"] = partial(
                largest_payload,
                env_id=IDS[kind],
                law=law,
                robot=robot,
                name="fl",
                criterion=criterion,
                payload_known=False,
            )
        cells[f"{kind} errors"] = partial(
            compared,
            env_id=IDS[kind],
            laws=tuple(plan.items()),
            robot=robot,
            payload=robot.mass / 10,
            uncertainty="table6",
            draws=_DRAWS,
        )
        start = (_OFFSET,) + (0.0,) * (robot.coordinates - 1)
        for name, frequency in (("decay", FAST), ("sampled decay", CONTROL_FREQUENCY)):
            cells[f"{kind} {name}"] = partial(
                closed_loop,
                env_id=IDS[kind],
                law=law,
                robot=robot,
                payload=0.0,
                trajectory={"name": _HOLD[kind], "duration": 0.5},
                initial_error=start,
                control_frequency=frequency,
            )
        cells[f"{kind} affine"] = partial(affinity, robot=robot, minimum_tension=readings.minimum_tension)
    flexible = readings.moved(readings.flexible("payload"))
    for unknown in (None, "table6"):
        cells[f"flexible {unknown}"] = partial(
            compared,
            env_id=IDS["flexible"],
            laws=(("fl4", FourthOrder), ("composite", Composite)),
            robot=flexible,
            payload=1.0,
            uncertainty=unknown,
            draws=_DRAWS if unknown else None,
        )
    return cells


def _claims_outcome(readings: Readings, found: Found) -> Outcome:
    numbers: dict[str, Number] = {}
    rows: list[tuple[Number, ...]] = []
    for kind in ("planar", "spatial"):
        prefix = "" if kind == "spatial" else "planar_"
        for criterion, suffix in (("task", ""), ("paper", "_paper")):
            for name, word in (("fl", "fl_told"), ("untold", "fl_untold"), ("open loop", "open_loop")):
                result: DLCCResult = found[f"{kind} {name} {criterion}"]
                key = f"open_loop_{kind}{suffix}_kg" if name == "open loop" else f"{prefix}{word}{suffix}_kg"
                numbers[key] = result.payload
                told = "not told" if name == "untold" else "told"
                law = "open loop" if name == "open loop" else "fl"
                rows.append((kind, law, told, criterion, result.payload, first_limit(result.limit)))
            numbers[f"closed_loop_{kind}{suffix}_kg"] = found[f"{kind} fl {criterion}"].payload
        for place, word in enumerate(("closed_loop", "open_loop")):
            numbers[f"{word}_{kind}_error_mm"] = _mean_error(found[f"{kind} errors"], place)
        gains = PAPER_GAINS[kind]
        numbers[f"pole_error_{kind}"] = decay_error(found[f"{kind} decay"], gains)
        numbers[f"sampled_pole_error_{kind}"] = decay_error(found[f"{kind} sampled decay"], gains)
        numbers[f"poles_{kind}"] = ", ".join(_pole(pole) for pole in np.roots([1.0, gains[1], gains[0]]))
        numbers[f"affine_{kind}"] = found[f"{kind} affine"]
    for place, name in enumerate(("fl4", "composite")):
        numbers[f"flex_{name}_error_nominal_mm"] = _mean_error(found["flexible None"], place)
        numbers[f"flex_{name}_error_table6_mm"] = _mean_error(found["flexible table6"], place)
    header = ("robot", "law", "payload", "criterion", "carries [kg]", "first limit")
    title = "Feedback, no feedback, and a payload that the law is not told"
    return Outcome(numbers=numbers, tables=(Table(title=title, header=header, rows=tuple(rows)),))


def _mean_error(comparison: Comparison, place: int) -> float:
    """Mean position error over time and draws [mm]."""
    return 1e3 * comparison.measured[place].estimate("mean_error").mean


def _pole(pole: complex) -> str:
    pole = complex(pole)
    return (
        f"{pole.real:.2f}"
        if pole.imag == 0
        else f"{pole.real:.2f} {'+' if pole.imag > 0 else '−'} {abs(pole.imag):.2f}i"
    )


PARTS: tuple[Part, ...] = (
    Part(
        name="eq37",
        title="The paper's algorithm, Eqs. 37–39",
        text=(
            "Steps 4 to 8 of §5.1 for exact tracking. As printed, τ± = U± − τ_e is what the *loaded* robot leaves of "
            "the torque, so that the guess which repeats itself is half the true payload. With what the *empty* robot "
            'leaves, the product C·m_e tends to the true payload from any guess. "True" is the closed form at the same '
            "500 instants per second; between them, at the jump itself, the limit is a little lower (Fig. 12)."
        ),
        cells=_eq37_cells,
        outcome=_eq37_outcome,
        draw=_eq37_draw,
    ),
    Part(
        name="eq22",
        title="The paper's law for joint springs, Eq. 22",
        text=(
            "With β̈′ taken from the commanded acceleration the loop is M J′ s⁴ + K (M + J′)(s² + K_D s + K_P) for each "
            "mode: it has no s³ term, so that its roots sum to zero and some grow, near K_D/2, for every K. "
            "(Commands that are held for 2 ms damp springs of some thousand N·m/rad by themselves.) Friction of the "
            "motors of about K_D J′ is what it takes. The rates are those of the sampled plant, linearised at rest."
        ),
        cells=_eq22_cells,
        outcome=_eq22_outcome,
        draw=_eq22_draw,
    ),
    Part(
        name="claims",
        title="What the text says of the controller",
        text=(
            "The payload of feedback linearization, told and not told, and of exact tracking's torques without "
            "feedback, both at 500 Hz. Findings above rest on more runs of this part: mean errors over 64 draws of "
            "Table 6; the robot let go 1 mm beside its reference, for the poles of Eqs. 14 and 19; torques with one, "
            "two and three platform masses."
        ),
        cells=_claims_cells,
        outcome=_claims_outcome,
    ),
)
