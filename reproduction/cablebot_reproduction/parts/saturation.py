"""Figs. 10 to 13: the rigid robots at the largest payload that saturates no motor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_gym.plotting.figures import new_figure, path_panels, torques_height
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import GREY, VERMILLION
from cablebot_reproduction.exact import exact_limit, exact_profile, paper_circle
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.judgement import Judgement, Run, verdict
from cablebot_reproduction.part import Jobs, Outcome, Results, job
from cablebot_reproduction.parts import profiles
from cablebot_reproduction.parts.interpretations import evidence_of_combinations
from cablebot_reproduction.parts.plotting import add_title
from cablebot_reproduction.parts.profiles import PayloadSummary
from cablebot_reproduction.published import LOADS, MOTORS, within
from cablebot_reproduction.runs import closed_loop, largest_payload

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PATH_HEIGHT = 4.9
"""Figure height with space for a legend of three lines [inch]."""

_METHODS = {
    "": ("paper", "closed loop, paper criterion"),
    "task_": ("task", "closed loop, task criterion"),
    "payload_unknown_": ("payload_unknown", "closed loop, task criterion, payload unknown"),
}
"""Job and text of each closed loop, by the prefix of its numbers."""


@dataclass(frozen=True, kw_only=True)
class Rigid:
    """One of the rigid robots."""

    kind: Literal["planar", "spatial"]
    """Planar or spatial."""

    @property
    def name(self) -> str:
        """Name for a title."""
        return f"{self.kind.capitalize()} robot"

    def robot(self, interpretation: Interpretation) -> Robot:
        """The robot of §5.2."""
        return interpretation.planar if self.kind == "planar" else interpretation.spatial("payload")

    def closed_loop_possible(self, interpretation: Interpretation) -> bool:
        """Whether the interpretation allows a closed loop. A constant α is not a feedback law."""
        if self.kind == "planar" and interpretation.alpha == "constant":
            return False
        return interpretation.closed_loop_possible

    def jobs(self, interpretation: Interpretation) -> Jobs:
        """Largest payloads and an unloaded episode, which is drawn if the robot fails unloaded."""
        robot = self.robot(interpretation)
        jobs = {"exact": job(exact_limit, interpretation=interpretation, robot=robot)}
        if not self.closed_loop_possible(interpretation):
            return jobs
        law: Any = FeedbackLinearization
        if self.kind == "planar":
            law = partial(FeedbackLinearization, minimum_tension=interpretation.minimum_tension)
        loop = {
            "env_id": f"CableBot-{self.kind.capitalize()}-v0",
            "law": law,
            "robot": interpretation.closed_loop_robot(robot),
        }
        payload = partial(job, largest_payload, **loop, name="fl")
        jobs["paper"] = payload(criterion="paper")
        jobs["task"] = payload(criterion="task")
        jobs["payload_unknown"] = payload(criterion="task", payload_known=False)
        jobs["empty"] = job(closed_loop, **loop)
        return jobs

    def torques(self, interpretation: Interpretation, results: Results) -> Outcome:
        """Numbers of Figs. 10 and 12."""
        robot = self.robot(interpretation)
        exact = PayloadSummary.computed(results["exact"])
        is_simulated = self.closed_loop_possible(interpretation)
        numbers = exact.numbers(interpretation, robot)
        numbers |= exact.numbers(interpretation, robot, "exact_")
        numbers["simulated"] = is_simulated
        rows = {"exact tracking": (robot, exact)}
        if is_simulated:
            for prefix, (name, method) in _METHODS.items():
                summary = PayloadSummary.simulated(results[name])
                numbers |= summary.numbers(interpretation, robot, prefix)
                rows[method] = robot, summary
        table = profiles.payload_table(f"Largest payloads of the {self.kind} robot.", rows)
        return Outcome(numbers=numbers, tables=(table,))

    def draw_torques(self, interpretation: Interpretation, results: Results) -> Figure:
        """Figs. 10 and 12."""
        robot = self.robot(interpretation)
        figure = new_figure(torques_height(robot.cables))
        end_reason: list[str] = []
        if self.closed_loop_possible(interpretation):
            summary = PayloadSummary.simulated(results["paper"])
            shown = _shown(results)
            profile = profiles.simulated_profile(
                interpretation.closed_loop_robot(robot), shown.arrays
            )
            end_reason = shown.end_reason
            description = (
                "in closed loop with fl, paper criterion: |a| ≤ 1 at every control instant"
            )
        else:
            summary = PayloadSummary.computed(results["exact"])
            profile = profiles.computed_profile(
                exact_profile(interpretation, robot, summary.payload or 0.0)
            )
            description = "exact tracking, no closed loop"
        profiles.draw_panels(figure, profile, profiles.first_saturation(profile, summary))
        add_title(
            figure,
            interpretation,
            f"{self.name}, {description}",
            summary.sentence(robot),
            *end_reason,
        )
        return figure

    def path(self, interpretation: Interpretation, results: Results) -> Outcome:
        """Numbers of Figs. 11 and 13."""
        if not self.closed_loop_possible(interpretation):
            return Outcome(numbers=profiles.NO_PATH)
        shown = _shown(results)
        numbers = profiles.path_numbers(shown)
        if self.kind == "spatial":
            _, rotation = shown.peaks
            numbers["peak_rotation_mrad"] = 1e3 * rotation
            numbers["rotation_bound_mrad"] = 1e3 * ErrorBounds().rotation
        return Outcome(numbers=numbers)

    def draw_path(self, interpretation: Interpretation, results: Results) -> Figure:
        """Figs. 11 and 13."""
        robot, bounds = self.robot(interpretation), ErrorBounds()
        if self.closed_loop_possible(interpretation):
            shown = _shown(results)
            summary = PayloadSummary.simulated(results["paper"])
            title = [
                f"{self.name} in closed loop with fl",
                f"blue: {summary.sentence(robot)}",
                *shown.end_reason,
            ]
            label = f"{summary.payload or 0.0:.3f} kg, payload known, paper criterion"
            paths = [profiles.travelled(shown.arrays, name=label)]
            for key, color, known in (
                ("task", VERMILLION, "known"),
                ("payload_unknown", GREY, "unknown"),
            ):
                task = PayloadSummary.simulated(results[key])
                if task.payload is not None:
                    label = (
                        f"{task.payload:.3f} kg, payload {known}, task criterion: {task.violation}"
                    )
                    paths.append(
                        profiles.travelled(results[key].rollout.arrays, name=label, color=color)
                    )
        else:
            title = [
                f"{self.name}, exact tracking, no closed loop",
                "the path equals the reference by assumption",
            ]
            paths = [profiles.on_reference(paper_circle(robot), name="exact tracking")]
        figure = new_figure(_PATH_HEIGHT)
        rotation = bounds.rotation if self.kind == "spatial" else None
        path_panels(figure, paper_circle(robot), paths, position=bounds.position, rotation=rotation)
        add_title(figure, interpretation, *title)
        return figure


def _shown(results: Results) -> profiles.Shown:
    return profiles.Shown(result=results["paper"], empty=results["empty"])


PLANAR = Rigid(kind="planar")
SPATIAL = Rigid(kind="spatial")


# --- verdicts ---------------------------------------------------------------------------------------------------------

_PLANAR_OPTIONS = ("line", "planar_apex", "minimum_tension", "alpha")
_SPATIAL_OPTIONS = ("line", "platform_mass", "triangles", "sides", "pulleys")


@verdict("5.2.1.payload", "fig10", options=("payload", *_PLANAR_OPTIONS))
def planar_payload(run: Run) -> Judgement:
    """The planar robot carries the published payload."""
    payload = run.payload("fig10.counted_kg")
    evidence = (
        run.sentence_if("fig10.simulated", "Added load in closed loop: {fig10.payload_kg}."),
        "Added load by exact tracking: {fig10.exact_payload_kg}.",
        "Total mass of platform and load by exact tracking: {fig10.exact_total_mass_kg:vs 5.2.1.payload}.",
        *evidence_of_combinations(run, "planar"),
        "Largest added load over all orientations of the triangle: {scan.planar_best_added_kg}.",
    )
    return Judgement(payload, within(payload, LOADS["planar"]), evidence)


@verdict("5.2.2.payload", "fig12", options=("payload", *_SPATIAL_OPTIONS))
def spatial_payload(run: Run) -> Judgement:
    """The spatial robot carries the published payload."""
    payload = run.payload("fig12.counted_kg")
    evidence = (
        run.sentence_if("fig12.simulated", "Added load in closed loop: {fig12.payload_kg}."),
        "Added load by exact tracking: {fig12.exact_payload_kg}.",
        *evidence_of_combinations(run, "spatial"),
        "The payload alone does not identify the geometry: {scan.hits} of {scan.geometries} tested geometries also "
        "give it, {scan.hits_second_motor} of them with motor 2 as the limiting motor. Payloads reach "
        "{scan.largest_kg}.",
    )
    return Judgement(payload, within(payload, LOADS["spatial"]), evidence)


@verdict("5.2.3.rigid", "fig12", options=("payload", *_SPATIAL_OPTIONS))
def repeated_spatial_payload(run: Run) -> Judgement:
    """The same, repeated in §5.2.3."""
    payload = run.payload("fig12.counted_kg")
    evidence = ("See §5.2.2: load capacity of the spatial robot.",)
    return Judgement(payload, within(payload, LOADS["spatial"]), evidence)


@verdict("5.2.1.motor", "fig10", options=_PLANAR_OPTIONS)
def planar_motor(run: Run) -> Judgement:
    """The published motor of the planar robot saturates first."""
    return _first_motor(run, "fig10", MOTORS["planar"])


@verdict("5.2.2.motor", "fig12", options=_SPATIAL_OPTIONS)
def spatial_motor(run: Run) -> Judgement:
    """The published motor of the spatial robot saturates first."""
    return _first_motor(run, "fig12", MOTORS["spatial"])


def _first_motor(run: Run, figure: str, published: float) -> Judgement:
    motor = run.number(f"{figure}.motor")
    evidence = (
        "Paper criterion.",
        f"Exact tracking: motor {{{figure}.exact_motor}} at {{{figure}.exact_time_s}}.",
    )
    if run.payload(f"{figure}.payload_kg") < 0:  # the robot fails unloaded
        return Judgement(None, False, evidence)
    text = f"motor {{{figure}.motor}} at {{{figure}.time_s}}"
    return Judgement(motor, motor == published, evidence, text)


@verdict("5.2.1.path", "fig11", unit="mm", options=_PLANAR_OPTIONS)
def planar_path(run: Run) -> Judgement:
    """The planar path stays within R."""
    evidence = ("Bound 10 mm.", "Largest payload of the law, which knows it: {fig11.payload_kg}.")
    return Judgement(run.number("fig11.peak_error_mm"), run.number("fig11.within"), evidence)


@verdict("5.2.2.path", "fig13", unit="mm", options=_SPATIAL_OPTIONS)
def spatial_path(run: Run) -> Judgement:
    """The spatial path stays within R."""
    evidence = (
        "Bound 10 mm.",
        "Largest payload of the law, which knows it: {fig13.payload_kg}.",
        "Largest rotation error: {fig13.peak_rotation_mrad}; the paper defines no bound for it.",
    )
    return Judgement(run.number("fig13.peak_error_mm"), run.number("fig13.within"), evidence)
