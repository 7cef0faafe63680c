"""Figs. 10 to 13: the rigid robots at the largest payload that saturates no motor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.paper.exact import exact_limit, exact_profile, paper_circle
from cablebot_baselines.paper.finding import capitalized
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import Cell, CellResults, Outcome, Part
from cablebot_baselines.paper.parts.profiles import (
    PayloadSummary,
    add_title,
    computed_profile,
    draw_panels,
    drawn_run,
    early_end,
    first_saturation,
    on_reference,
    payload_table,
    peaks,
    simulated_profile,
    stays_within,
    travelled,
)
from cablebot_baselines.paper.runs import Law, closed_loop, largest_payload
from cablebot_gym.plotting.figures import new_figure, path_panels, torques_height
from cablebot_gym.robots import Robot
from cablebot_gym.task import ErrorBounds
from cablebot_gym.utils.palette import GREY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PATH_HEIGHT = 4.9
"""Figure height with space for a legend of three lines [inch]."""


@dataclass(frozen=True, kw_only=True)
class Rigid:
    """One of the rigid robots."""

    kind: Literal["planar", "spatial"]
    """Planar or spatial."""

    @property
    def env_id(self) -> str:
        """Environment id."""
        return f"CableBot-{self.kind.capitalize()}-v0"

    def robot(self, interpretation: Interpretation) -> Robot:
        """The robot of §5.2."""
        return interpretation.planar if self.kind == "planar" else interpretation.spatial("payload")

    def law(self, interpretation: Interpretation) -> Law:
        """Control law of the paper for this robot."""
        if self.kind == "spatial":
            return FeedbackLinearization
        return partial(FeedbackLinearization, minimum_tension=interpretation.minimum_tension)

    def closed_loop_possible(self, interpretation: Interpretation) -> bool:
        """Whether the interpretation allows a closed loop. A constant α is not a feedback law."""
        return interpretation.closed_loop_possible and not (
            self.kind == "planar" and interpretation.alpha == "constant"
        )

    def cells(self, interpretation: Interpretation) -> dict[str, Cell]:
        """Cells of the largest payloads and of an unloaded episode, which is drawn if the robot fails unloaded."""
        robot = self.robot(interpretation)
        cells: dict[str, Cell] = {"exact": partial(exact_limit, interpretation=interpretation, robot=robot)}
        if not self.closed_loop_possible(interpretation):
            return cells
        keywords: dict[str, Any] = {
            "env_id": self.env_id,
            "law": self.law(interpretation),
            "robot": interpretation.motors(robot),
        }
        payload = partial(largest_payload, **keywords, name="fl")
        return cells | {
            "paper": partial(payload, criterion="paper"),
            "task": partial(payload, criterion="task"),
            "payload_unknown": partial(payload, criterion="task", payload_known=False),
            "empty": partial(closed_loop, **keywords, payload=0.0),
        }

    def torques(self, interpretation: Interpretation, results: CellResults) -> Outcome:
        """Numbers of Figs. 10 and 12."""
        robot, exact = self.robot(interpretation), PayloadSummary.computed(results["exact"])
        simulated = self.closed_loop_possible(interpretation)
        shown = PayloadSummary.simulated(results["paper"]) if simulated else exact
        numbers = (
            shown.numbers(interpretation, robot)
            | exact.numbers(interpretation, robot, "exact_")
            | {"simulated": simulated}
        )
        rows = {"exact tracking": (robot, exact)}
        if simulated:
            task, unknown = (
                PayloadSummary.simulated(results["task"]),
                PayloadSummary.simulated(results["payload_unknown"]),
            )
            numbers |= task.numbers(interpretation, robot, "task_") | unknown.numbers(
                interpretation, robot, "payload_unknown_"
            )
            rows |= {
                "closed loop, paper criterion": (robot, shown),
                "closed loop, task criterion": (robot, task),
                "closed loop, task criterion, payload unknown": (robot, unknown),
            }
        return Outcome(numbers=numbers, tables=(payload_table(f"Largest payloads of the {self.kind} robot.", rows),))

    def draw_torques(self, interpretation: Interpretation, results: CellResults) -> Figure:
        """Figs. 10 and 12."""
        robot = self.robot(interpretation)
        figure, ended = new_figure(torques_height(robot.cables)), list[str]()
        if self.closed_loop_possible(interpretation):
            summary = PayloadSummary.simulated(results["paper"])
            profile = simulated_profile(interpretation.motors(robot), drawn_run(results["paper"], results["empty"]))
            ended = early_end(results["paper"], results["empty"])
            description = "in closed loop with fl, paper criterion: |a| ≤ 1 at every control instant"
        else:
            summary = PayloadSummary.computed(results["exact"])
            profile = computed_profile(exact_profile(interpretation, robot, summary.payload or 0.0))
            description = "exact tracking, no closed loop"
        draw_panels(figure, profile, first_saturation(profile, summary))
        add_title(
            figure, interpretation, capitalized(f"{self.kind} robot, {description}"), summary.sentence(robot), *ended
        )
        return figure

    def path(self, interpretation: Interpretation, results: CellResults) -> Outcome:
        """Numbers of Figs. 11 and 13."""
        bounds = ErrorBounds()
        if not self.closed_loop_possible(interpretation):
            return Outcome(numbers={"peak_error_mm": None, "bound_mm": 1e3 * bounds.position, "within": None})
        position, rotation = peaks(results["paper"], results["empty"])
        numbers = {
            "payload_kg": results["paper"].payload,
            "peak_error_mm": 1e3 * position,
            "bound_mm": 1e3 * bounds.position,
            "within": stays_within(results["paper"], results["empty"]),
        }
        if self.kind == "spatial":
            numbers |= {"peak_rotation_mrad": 1e3 * rotation, "rotation_bound_mrad": 1e3 * bounds.rotation}
        return Outcome(numbers=numbers)

    def draw_path(self, interpretation: Interpretation, results: CellResults) -> Figure:
        """Figs. 11 and 13."""
        robot, bounds = self.robot(interpretation), ErrorBounds()
        curves = []
        if self.closed_loop_possible(interpretation):
            shown = PayloadSummary.simulated(results["paper"])
            ended = early_end(results["paper"], results["empty"])
            title = (capitalized(f"{self.kind} robot in closed loop with fl"), f"blue: {shown.sentence(robot)}", *ended)
            name = f"{shown.payload or 0.0:.3f} kg, payload known, paper criterion"
            curves.append(travelled(drawn_run(results["paper"], results["empty"]), name=name))
            for cell, color, known in (("task", VERMILLION, "known"), ("payload_unknown", GREY, "unknown")):
                other = PayloadSummary.simulated(results[cell])
                if other.payload is not None:
                    name = f"{other.payload:.3f} kg, payload {known}, task criterion: {other.violation}"
                    curves.append(travelled(results[cell].history, name=name, color=color))
        else:
            title = (
                capitalized(f"{self.kind} robot, exact tracking, no closed loop"),
                "the path equals the reference by assumption",
            )
            curves.append(on_reference(paper_circle(robot), name="exact tracking"))
        figure = new_figure(_PATH_HEIGHT)
        rotation = bounds.rotation if self.kind == "spatial" else None
        path_panels(figure, paper_circle(robot), curves, position=bounds.position, rotation=rotation)
        add_title(figure, interpretation, *title)
        return figure


PLANAR, SPATIAL = Rigid(kind="planar"), Rigid(kind="spatial")

_TORQUES = """\
The payload is increased until the torque of the first motor reaches its limit, as in §5.2 "by trial and error". Each
panel shows the torque of one motor and its limits U± = ±τ_s − (τ_s/ω_n) β̇ at its speed; the dot marks the first
saturation. The motion is simulated in closed loop with the feedback linearization of the paper at 500 Hz under the
paper criterion: |a| ≤ 1 at every control instant (U⁻ ≤ τ ≤ U⁺), position error ≤ R, no slack cable. The table also
contains the closed form of exact tracking, which requires no simulation. Under the task criterion the motors saturate
and only the errors and slack cables limit the payload. If the interpretation allows no closed loop, the figure shows
exact tracking and its title states this.
"""

_PLANAR_COMPARED = """\
The row of §5.2.1 contains the comparison with the published payload.
"""

_SPATIAL = """\
Same as Fig. 10 for the spatial robot, whose motors also support its weight. The row of §5.2.2 contains the comparison
with the published payload. The section *Interpretations* shows the effect of the interpretation on the payload, and the
scan shows the effect of the geometry.
"""

_PATHS = """\
Path at the payload of Fig. 10 with the tube of radius R around the reference, and errors at each instant. The other
curves show the largest payloads of the same law under the task criterion, with known and with unknown payload. Torques
beyond U± then saturate, and the limiting violation is an error or a slack cable. Accuracy can therefore be neglected
only if no motor saturates and the law knows the payload.
"""

_SPATIAL_PATHS = """\
Same as Fig. 11 at the payload of Fig. 12. The rotation bound is a choice of this project; the paper defines none.
"""


def _part(name: str, title: str, text: str, rigid: Rigid, content: Literal["torques", "path"]) -> Part:
    outcome: Callable[[Interpretation, CellResults], Outcome] = rigid.torques if content == "torques" else rigid.path
    draw = rigid.draw_torques if content == "torques" else rigid.draw_path
    return Part(name=name, title=title, text=text, cells=rigid.cells, outcome=outcome, draw=draw)


PARTS: tuple[Part, ...] = (
    _part(
        "fig10",
        "Fig. 10: torques of the planar robot at its largest payload",
        _TORQUES + _PLANAR_COMPARED,
        PLANAR,
        "torques",
    ),
    _part("fig11", "Fig. 11: path of the planar robot at its largest payload", _PATHS, PLANAR, "path"),
    _part(
        "fig12",
        "Fig. 12: torques of the spatial robot at its largest payload",
        _SPATIAL,
        SPATIAL,
        "torques",
    ),
    _part("fig13", "Fig. 13: path of the spatial robot at its largest payload", _SPATIAL_PATHS, SPATIAL, "path"),
)
