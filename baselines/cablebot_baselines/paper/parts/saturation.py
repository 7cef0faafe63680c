"""Figs. 10 to 13: the rigid robots at the largest payload that saturates no motor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from cablebot_baselines.classical.feedback_linearization import FeedbackLinearization
from cablebot_baselines.paper.exact import exact_limit, exact_profile, paper_circle
from cablebot_baselines.paper.finding import sentence
from cablebot_baselines.paper.part import Cell, Found, Outcome, Part
from cablebot_baselines.paper.parts.profiles import (
    Carried,
    computed_profile,
    draw_panels,
    early_end,
    first_saturation,
    head,
    on_reference,
    payload_table,
    peaks,
    run_of,
    simulated_profile,
    stays_within,
    travelled,
)
from cablebot_baselines.paper.readings import Readings
from cablebot_baselines.paper.runs import Law, closed_loop, largest_payload
from cablebot_gym.plotting.figures import new_figure, path_panels, torques_height
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits
from cablebot_gym.utils.palette import GREY, VERMILLION

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PATH_HEIGHT = 4.9
"""Room for a legend of three lines [inch]."""


@dataclass(frozen=True, kw_only=True)
class Rigid:
    """One of the rigid robots."""

    kind: Literal["planar", "spatial"]
    """Which of the two."""

    @property
    def env_id(self) -> str:
        """Environment."""
        return f"CableBot-{self.kind.capitalize()}-v0"

    def robot(self, readings: Readings) -> Robot:
        """The robot of §5.2."""
        return readings.planar if self.kind == "planar" else readings.spatial("payload")

    def law(self, readings: Readings) -> Law:
        """The paper's law for it."""
        if self.kind == "spatial":
            return FeedbackLinearization
        return partial(FeedbackLinearization, minimum_tension=readings.minimum_tension)

    def plays(self, readings: Readings) -> bool:
        """Whether a closed loop can be run under the reading. One α for all times is no feedback law."""
        return readings.plays and not (self.kind == "planar" and readings.alpha == "constant")

    def cells(self, readings: Readings) -> dict[str, Cell]:
        """Largest payloads, and a run without payload, for the case that none is carried."""
        robot = self.robot(readings)
        cells: dict[str, Cell] = {"exact": partial(exact_limit, readings=readings, robot=robot)}
        if not self.plays(readings):
            return cells
        keywords: dict[str, Any] = {
            "env_id": self.env_id,
            "law": self.law(readings),
            "robot": readings.motors(robot),
        }
        payload = partial(largest_payload, **keywords, name="fl")
        return cells | {
            "paper": partial(payload, criterion="paper"),
            "task": partial(payload, criterion="task"),
            "untold": partial(payload, criterion="task", payload_known=False),
            "empty": partial(closed_loop, **keywords, payload=0.0),
        }

    def torques(self, readings: Readings, found: Found) -> Outcome:
        """Numbers of Figs. 10 and 12."""
        robot, exact = self.robot(readings), Carried.computed(found["exact"])
        simulated = self.plays(readings)
        shown = Carried.simulated(found["paper"]) if simulated else exact
        numbers = shown.numbers(readings, robot) | exact.numbers(readings, robot, "exact_") | {"simulated": simulated}
        rows = {"exact tracking": (robot, exact)}
        if simulated:
            task, untold = Carried.simulated(found["task"]), Carried.simulated(found["untold"])
            numbers |= task.numbers(readings, robot, "task_") | untold.numbers(readings, robot, "untold_")
            rows |= {
                "closed loop, paper criterion": (robot, shown),
                "closed loop, task criterion": (robot, task),
                "closed loop, task criterion, payload not told": (robot, untold),
            }
        return Outcome(numbers=numbers, tables=(payload_table(f"Largest payloads of the {self.kind} robot.", rows),))

    def draw_torques(self, readings: Readings, found: Found) -> Figure:
        """Figs. 10 and 12."""
        robot = self.robot(readings)
        figure, ended = new_figure(torques_height(robot.cables)), list[str]()
        if self.plays(readings):
            carried = Carried.simulated(found["paper"])
            profile = simulated_profile(readings.motors(robot), run_of(found["paper"], found["empty"]))
            ended = early_end(found["paper"], found["empty"])
            how = "in closed loop with fl, paper criterion: |a| ≤ 1 at every control instant"
        else:
            carried = Carried.computed(found["exact"])
            profile = computed_profile(exact_profile(readings, robot, carried.payload or 0.0))
            how = "exact tracking, no closed loop"
        draw_panels(figure, profile, first_saturation(profile, carried))
        head(figure, readings, sentence(f"{self.kind} robot, {how}"), carried.sentence(robot), *ended)
        return figure

    def path(self, readings: Readings, found: Found) -> Outcome:
        """Numbers of Figs. 11 and 13."""
        bounds = Limits()
        if not self.plays(readings):
            return Outcome(numbers={"peak_error_mm": None, "bound_mm": 1e3 * bounds.position, "within": None})
        position, rotation = peaks(found["paper"], found["empty"])
        numbers = {
            "payload_kg": found["paper"].payload,
            "peak_error_mm": 1e3 * position,
            "bound_mm": 1e3 * bounds.position,
            "within": stays_within(found["paper"], found["empty"]),
        }
        if self.kind == "spatial":
            numbers |= {"peak_rotation_mrad": 1e3 * rotation, "rotation_bound_mrad": 1e3 * bounds.rotation}
        return Outcome(numbers=numbers)

    def draw_path(self, readings: Readings, found: Found) -> Figure:
        """Figs. 11 and 13."""
        robot, bounds = self.robot(readings), Limits()
        curves = []
        if self.plays(readings):
            shown = Carried.simulated(found["paper"])
            ended = early_end(found["paper"], found["empty"])
            title = (sentence(f"{self.kind} robot in closed loop with fl"), f"blue: {shown.sentence(robot)}", *ended)
            name = f"{shown.payload or 0.0:.3f} kg, told, paper criterion"
            curves.append(travelled(run_of(found["paper"], found["empty"]), name=name))
            for cell, color, told in (("task", VERMILLION, "told"), ("untold", GREY, "not told")):
                other = Carried.simulated(found[cell])
                if other.payload is not None:
                    name = f"{other.payload:.3f} kg, {told}, motors clip; limit: {other.gives_way}"
                    curves.append(travelled(found[cell].history, name=name, color=color))
        else:
            title = (
                sentence(f"{self.kind} robot, exact tracking, no closed loop"),
                "the path is the reference by assumption",
            )
            curves.append(on_reference(paper_circle(robot), name="exact tracking"))
        figure = new_figure(_PATH_HEIGHT)
        rotation = bounds.rotation if self.kind == "spatial" else None
        path_panels(figure, paper_circle(robot), curves, position=bounds.position, rotation=rotation)
        head(figure, readings, *title)
        return figure


PLANAR, SPATIAL = Rigid(kind="planar"), Rigid(kind="spatial")

_TORQUES = """\
The payload is raised until the first motor's torque touches its limit, as §5.2 does "by trial and error". Each panel
has one motor's torque and its limits U± = ±τ_s − (τ_s/ω_n) β̇ at its own speed; the dot is the first saturation. The
motion is simulated in closed loop with the paper's feedback linearization at 500 Hz, under the paper's criterion:
|a| ≤ 1 at every control instant, which is U⁻ ≤ τ ≤ U⁺, position error ≤ R and no slack cable. The closed form of exact
tracking needs no simulation and stands beside it in the table. Under the task criterion the motors clip, and the
errors alone decide, here and in Fig. 11. A reading that no control loop can be run with is drawn for exact tracking,
and its title says so.
"""

_PLANAR_COMPARED = """\
The row of §5.2.1 compares with what is published.
"""

_SPATIAL = """\
As Fig. 10, for the spatial robot, whose motors hold its weight as well. The row of §5.2.2 compares with what is
published, *Readings* shows how far the payload moves with the reading, and the scan how far with the geometry.
"""

_PATHS = """\
The path at the payload of Fig. 10 inside the tube of radius R around its reference, and its errors at each instant.
The other curves are the largest payloads of the same law when torque beyond U± is clipped instead of forbidden, with
the payload told to the law and not told: there an error or a slack cable gives way, so that accuracy needs no
attention only while no motor saturates and the law knows the payload.
"""

_SPATIAL_PATHS = """\
As Fig. 11, at the payload of Fig. 12. The bound of rotation is ours; the paper has none.
"""


def _part(name: str, title: str, text: str, rigid: Rigid, what: Literal["torques", "path"]) -> Part:
    outcome: Callable[[Readings, Found], Outcome] = rigid.torques if what == "torques" else rigid.path
    draw = rigid.draw_torques if what == "torques" else rigid.draw_path
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
