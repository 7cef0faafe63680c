"""The algorithm of the paper, Eqs. 37–39."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cablebot_gym.plotting.figures import add_legend, new_figure, set_title
from cablebot_gym.robots import Robot
from cablebot_gym.utils.palette import BLUE, GREY, VERMILLION
from cablebot_reproduction.exact import exact_bound, paper_circle
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Judgement, Run, verdict
from cablebot_reproduction.load_iteration import LoadIteration, iterate_load
from cablebot_reproduction.part import Jobs, Number, Outcome, Results, Table, job
from cablebot_reproduction.published import ABOUT, published_value, within
from cablebot_reproduction.runs import CONTROL_FREQUENCY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GUESSES = {
    "planar": (published_value("table7.guess"), 0.25, 4.0),
    "spatial": (published_value("table8.guess"), 0.5, 10.0),
}
"""First guesses m_l [kg]: the guess of Table 7 or 8 and two other guesses."""

_FORMS = {"literal": "as printed", "corrected": "corrected"}

_PREFIX = {"planar": "planar_", "spatial": ""}
"""Prefix of the names of the numbers of each robot."""


def iterations(
    *, interpretation: Interpretation, robot: Robot, guesses: tuple[float, ...], corrected: bool
) -> list[LoadIteration]:
    """Iterations of the paper from several first guesses."""
    iterate = partial(
        iterate_load,
        robot,
        paper_circle(robot),
        corrected=corrected,
        minimum_tension=interpretation.minimum_tension,
        line_speed=interpretation.line_speed(robot),
    )
    return [iterate(guess=guess) for guess in guesses]


def true_payload(*, interpretation: Interpretation, robot: Robot) -> float:
    """Payload of the closed form at the same instants [kg]."""
    return exact_bound(interpretation, robot, frequency=CONTROL_FREQUENCY).payload


def jobs(interpretation: Interpretation) -> Jobs:
    """Iterations in both forms, and true payloads."""
    jobs = {}
    for kind, robot in (
        ("planar", interpretation.planar),
        ("spatial", interpretation.spatial("payload")),
    ):
        jobs[f"{kind} true"] = job(true_payload, interpretation=interpretation, robot=robot)
        iterate = partial(
            job, iterations, interpretation=interpretation, robot=robot, guesses=GUESSES[kind]
        )
        jobs[f"{kind} literal"] = iterate(corrected=False)
        jobs[f"{kind} corrected"] = iterate(corrected=True)
    return jobs


def outcome(interpretation: Interpretation, results: Results) -> Outcome:
    """Results of the iterations relative to the true payload."""
    numbers: dict[str, Number] = {}
    rows: list[tuple[Number, ...]] = []
    for kind in GUESSES:
        true = results[f"{kind} true"]
        stem = _PREFIX[kind]
        numbers[f"{stem}exact_payload_kg"] = true
        for form, name in _FORMS.items():
            runs: list[LoadIteration] = results[f"{kind} {form}"]
            published = runs[0]
            numbers[f"{stem}{form}_payload_kg"] = published.payload
            numbers[f"{stem}{form}_motor"] = published.motor
            numbers[f"{stem}{form}_guesses"] = len(published.loads)
            numbers[f"{stem}{form}_converges"] = all(run.converged for run in runs)
            numbers[f"{stem}{form}_spread_kg"] = float(np.ptp([run.payload for run in runs]))
            for run in runs:
                ratio = _ratio(run.payload, true)
                rows.append(
                    (kind, name, run.loads[0], run.payload, ratio, len(run.loads), run.converged)
                )
        numbers[f"{stem}literal_over_true"] = _ratio(results[f"{kind} literal"][0].payload, true)
        numbers[f"{stem}chosen_payload_kg"] = numbers[f"{stem}{interpretation.eq37}_payload_kg"]
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
    return Outcome(numbers=numbers, tables=(Table(title=title, header=header, rows=tuple(rows)),))


def _ratio(payload: float, true: float) -> float | None:
    """Ratio to the true payload; None if the true payload is not positive and finite."""
    if 0 < true < np.inf:
        return payload / true
    return None


def draw(interpretation: Interpretation, results: Results) -> Figure:
    """Guesses of the iterations."""
    figure = new_figure(4.2)
    panels = figure.subplots(1, len(GUESSES))
    for axes, kind in zip(panels, GUESSES, strict=True):
        for form, colour, style in (("corrected", BLUE, "-"), ("literal", VERMILLION, "--")):
            label = _FORMS[form]
            if form == interpretation.eq37:
                label += " (chosen)"
            for run in results[f"{kind} {form}"]:
                guesses = range(1, len(run.loads) + 1)
                axes.plot(guesses, run.loads, style, color=colour, marker=".", label=label)
                label = "_"  # no further entry in the legend
        true = results[f"{kind} true"]
        axes.axhline(true, color="black", linewidth=1.0, label="true payload, closed form")
        axes.axhline(
            true / 2, color=GREY, linewidth=1.0, linestyle=":", label="half of the true payload"
        )
        axes.set(
            xlabel="guess number",
            ylabel="load mₑ [kg]",
            title=f"{kind} robot",
            ylim=(0, None),
            xlim=(0.5, 16.5),
        )
    add_legend(figure, panels[0])
    set_title(
        figure, "Guesses of the algorithm of the paper (steps 4 to 8) from three first guesses"
    )
    return figure


# --- verdicts ---------------------------------------------------------------------------------------------------------


@verdict("5.1.converges", "eq37", choice="as printed")
def guess_and_result_converge(run: Run) -> Judgement:
    """The printed form converges to the same value, within 5 %, from each first guess."""
    payload = run.payload("eq37.literal_payload_kg")
    spread = run.number("eq37.literal_spread_kg")
    evidence = (
        "Largest difference between the results of different first guesses: {eq37.literal_spread_kg}.",
        "The finding on the load coefficient (§5.1) compares the result with the payload.",
    )
    text = "{eq37.literal_payload_kg} from the first guess"
    is_unique = spread is not None and spread <= ABOUT * payload  # None if a result is infinite
    return Judgement(payload, run.number("eq37.literal_converges") and is_unique, evidence, text)


@verdict("5.1.answer", "eq37", choice="as printed")
def result_is_the_payload(run: Run) -> Judgement:
    """The printed form converges to the payload."""
    ratio = run.number("eq37.literal_over_true")
    evidence = (
        "Spatial robot: {eq37.literal_payload_kg} as printed, {eq37.corrected_payload_kg} corrected, "
        "{eq37.exact_payload_kg} in closed form.",
        "The printed τ± is the torque reserve with load; correct is the reserve without load.",
    )
    return Judgement(
        ratio, within(ratio, 1.0), evidence, "{eq37.literal_over_true} times the payload"
    )
