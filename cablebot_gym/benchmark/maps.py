"""Payload maps: the DLCC as a function of one parameter of the task, all others at their defaults."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType

from cablebot_gym.benchmark.cells import DEFAULT_ERROR_BOUNDS, Cell
from cablebot_gym.envs import env_robot
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import find_trajectory


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A parameter of the task that a map varies."""

    name: str
    """Key of :data:`AXES`."""
    label: str
    """Axis label with the unit."""
    scale: float
    """Factor from SI to the unit of the label."""
    values: tuple[float, ...]
    """Values that the suite evaluates, SI."""

    def default_value(self, cell: Cell) -> float:
        """Default of the parameter, SI; infinite for the stiffness of a rigid robot."""
        robot = find_robot(env_robot(cell.env_id))
        if self.name == "stiffness":
            return float(robot.stiffness[0]) if robot.flexible else float("inf")
        if self.name == "position":
            return DEFAULT_ERROR_BOUNDS["position"]
        fields = {name: value for name, value in cell.trajectory.items() if name != "duration"}
        return float(find_trajectory(fields, robot.coordinates).duration)

    def value(self, cell: Cell) -> float:
        """Value of the parameter in a cell, SI."""
        given = {
            "stiffness": cell.stiffness,
            "position": cell.error_bounds["position"],
            "duration": cell.trajectory.get("duration"),
        }[self.name]
        return self.default_value(cell) if given is None else float(given)

    def with_value(self, cell: Cell, value: float) -> Cell:
        """The cell with the parameter set to ``value``, SI; the unchanged cell if ``value`` is the default."""
        if value == self.default_value(cell):
            return cell
        if self.name == "stiffness":
            return replace(cell, stiffness=value)
        if self.name == "position":
            return replace(cell, error_bounds={**cell.error_bounds, "position": value})
        return replace(cell, trajectory={**cell.trajectory, "duration": value})


AXES = MappingProxyType(
    {
        axis.name: axis
        for axis in (
            Axis(
                name="position",
                label="position error bound R [mm]",
                scale=1e3,
                values=(0.002, 0.005, 0.01, 0.02, 0.05),
            ),
            Axis(name="duration", label="motion duration [s]", scale=1.0, values=(0.8, 0.9, 1.0, 1.2, 1.5)),
            Axis(
                name="stiffness",
                label="joint stiffness K [N·m/rad]",
                scale=1.0,
                values=(1.0, 3.0, 10.0, 30.0, 100.0),
            ),
        )
    }
)
"""Axes by name."""


def varied_axes(cell: Cell) -> tuple[str, ...]:
    """Names of the axes whose value in a cell is not the default: none for most cells, one for a cell of a map."""
    return tuple(axis.name for axis in AXES.values() if axis.value(cell) != axis.default_value(cell))
