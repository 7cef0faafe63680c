"""Figs. 10 to 13: the rigid robots at the largest payload that saturates no motor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.paper.exact import exact_limit, exact_profile, paper_circle
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Jobs, Number, Outcome, Results, job
from cablebot_baselines.paper.parts import profiles
from cablebot_baselines.paper.parts.plotting import add_title
from cablebot_baselines.paper.runs import closed_loop, largest_payload
from cablebot_gym.plotting.figures import new_figure, path_panels, torques_height
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import GREY, VERMILLION

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

    def robot(self, interpretation: Interpretation) -> Robot:
        """The robot of §5.2."""
        return interpretation.planar if self.kind == "planar" else interpretation.spatial("payload")

    def closed_loop_possible(self, interpretation: Interpretation) -> bool:
        """Whether the interpretation allows a closed loop. A constant α is not a feedback law."""
        return interpretation.closed_loop_possible and not (
            self.kind == "planar" and interpretation.alpha == "constant"
        )

    def jobs(self, interpretation: Interpretation) -> Jobs:
        """Largest payloads and an unloaded episode, which is drawn if the robot fails unloaded."""
        robot = self.robot(interpretation)
        jobs = {"exact": job(exact_limit, interpretation=interpretation, robot=robot)}
        if not self.closed_loop_possible(interpretation):
            return jobs
        law = partial(FeedbackLinearization, minimum_tension=interpretation.minimum_tension)
        loop = {
            "env_id": f"CableBot-{self.kind.capitalize()}-v0",
            "law": law if self.kind == "planar" else FeedbackLinearization,
            "robot": interpretation.motors(robot),
        }
        payload = partial(job, largest_payload, **loop, name="fl")
        return jobs | {
            "paper": payload(criterion="paper"),
            "task": payload(criterion="task"),
            "payload_unknown": payload(criterion="task", payload_known=False),
            "empty": job(closed_loop, **loop),
        }

    def torques(self, interpretation: Interpretation, results: Results) -> Outcome:
        """Numbers of Figs. 10 and 12."""
        robot, exact = self.robot(interpretation), profiles.PayloadSummary.computed(results["exact"])
        simulated = self.closed_loop_possible(interpretation)
        numbers = exact.numbers(interpretation, robot) | exact.numbers(interpretation, robot, "exact_")
        numbers |= {"simulated": simulated}
        rows = {"exact tracking": (robot, exact)}
        for prefix, (name, method) in _METHODS.items() if simulated else ():
            summary = profiles.PayloadSummary.simulated(results[name])
            numbers |= summary.numbers(interpretation, robot, prefix)
            rows[method] = robot, summary
        return Outcome(
            numbers=numbers, tables=(profiles.payload_table(f"Largest payloads of the {self.kind} robot.", rows),)
        )

    def draw_torques(self, interpretation: Interpretation, results: Results) -> Figure:
        """Figs. 10 and 12."""
        robot, ended = self.robot(interpretation), list[str]()
        figure = new_figure(torques_height(robot.cables))
        if self.closed_loop_possible(interpretation):
            summary, shown = profiles.PayloadSummary.simulated(results["paper"]), _shown(results)
            profile, ended = profiles.simulated_profile(interpretation.motors(robot), shown.arrays), shown.end_reason
            description = "in closed loop with fl, paper criterion: |a| ≤ 1 at every control instant"
        else:
            summary = profiles.PayloadSummary.computed(results["exact"])
            profile = profiles.computed_profile(exact_profile(interpretation, robot, summary.payload or 0.0))
            description = "exact tracking, no closed loop"
        profiles.draw_panels(figure, profile, profiles.first_saturation(profile, summary))
        title = f"{self.kind.capitalize()} robot, {description}"
        add_title(figure, interpretation, title, summary.sentence(robot), *ended)
        return figure

    def path(self, interpretation: Interpretation, results: Results) -> Outcome:
        """Numbers of Figs. 11 and 13."""
        bounds = ErrorBounds()
        numbers: dict[str, Number] = {"peak_error_mm": None, "bound_mm": 1e3 * bounds.position, "within": None}
        if self.closed_loop_possible(interpretation):
            shown = _shown(results)
            position, rotation = shown.peaks
            numbers = {"payload_kg": shown.result.payload, **numbers}
            numbers |= {"peak_error_mm": 1e3 * position, "within": shown.within}
            if self.kind == "spatial":
                numbers |= {"peak_rotation_mrad": 1e3 * rotation, "rotation_bound_mrad": 1e3 * bounds.rotation}
        return Outcome(numbers=numbers)

    def draw_path(self, interpretation: Interpretation, results: Results) -> Figure:
        """Figs. 11 and 13."""
        robot, bounds, name = self.robot(interpretation), ErrorBounds(), f"{self.kind.capitalize()} robot"
        if self.closed_loop_possible(interpretation):
            shown, summary = _shown(results), profiles.PayloadSummary.simulated(results["paper"])
            title = [f"{name} in closed loop with fl", f"blue: {summary.sentence(robot)}", *shown.end_reason]
            label = f"{summary.payload or 0.0:.3f} kg, payload known, paper criterion"
            paths = [profiles.travelled(shown.arrays, name=label)]
            for key, color, known in (("task", VERMILLION, "known"), ("payload_unknown", GREY, "unknown")):
                other = profiles.PayloadSummary.simulated(results[key])
                if other.payload is not None:
                    label = f"{other.payload:.3f} kg, payload {known}, task criterion: {other.violation}"
                    paths.append(profiles.travelled(results[key].rollout.arrays, name=label, color=color))
        else:
            title = [f"{name}, exact tracking, no closed loop", "the path equals the reference by assumption"]
            paths = [profiles.on_reference(paper_circle(robot), name="exact tracking")]
        figure = new_figure(_PATH_HEIGHT)
        rotation = bounds.rotation if self.kind == "spatial" else None
        path_panels(figure, paper_circle(robot), paths, position=bounds.position, rotation=rotation)
        add_title(figure, interpretation, *title)
        return figure


def _shown(results: Results) -> profiles.Shown:
    return profiles.Shown(result=results["paper"], empty=results["empty"])


PLANAR, SPATIAL = Rigid(kind="planar"), Rigid(kind="spatial")
