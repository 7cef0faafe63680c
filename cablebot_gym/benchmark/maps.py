"""Maps of the payload: what becomes of it when one number of the task is another than usual."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType

from cablebot_gym.benchmark.cells import DEFAULT_LIMITS, Cell
from cablebot_gym.envs import env_robot
from cablebot_gym.robots import find_robot
from cablebot_gym.trajectories import find_trajectory


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A number of the task that is varied."""

    name: str
    """Key of :data:`AXES`."""
    label: str
    """For people, with the unit."""
    scale: float
    """Of the unit, from SI."""
    values: tuple[float, ...]
    """What the suite asks for, SI."""

    def usual(self, cell: Cell) -> float:
        """What the number is where nothing else is asked for, SI; infinite for the springs of a rigid robot."""
        robot = find_robot(env_robot(cell.env_id))
        if self.name == "stiffness":
            return float(robot.stiffness[0]) if robot.flexible else float("inf")
        if self.name == "position":
            return DEFAULT_LIMITS["position"]
        fields = {name: value for name, value in cell.trajectory.items() if name != "duration"}
        return float(find_trajectory(fields, robot.coordinates).duration)

    def of(self, cell: Cell) -> float:
        """What the number is in a cell, SI."""
        asked = {
            "stiffness": cell.stiffness,
            "position": cell.limits["position"],
            "duration": cell.trajectory.get("duration"),
        }[self.name]
        return self.usual(cell) if asked is None else float(asked)

    def put(self, cell: Cell, value: float) -> Cell:
        """The cell with ``value`` for the number, SI; where that is the usual one, the cell as it is."""
        if value == self.usual(cell):
            return cell
        if self.name == "stiffness":
            return replace(cell, stiffness=value)
        if self.name == "position":
            return replace(cell, limits={**cell.limits, "position": value})
        return replace(cell, trajectory={**cell.trajectory, "duration": value})


AXES = MappingProxyType(
    {
        axis.name: axis
        for axis in (
            Axis(
                name="position",
                label="bound R of the position error [mm]",
                scale=1e3,
                values=(0.002, 0.005, 0.01, 0.02, 0.05),
            ),
            Axis(name="duration", label="duration of the motion [s]", scale=1.0, values=(0.8, 0.9, 1.0, 1.2, 1.5)),
            Axis(
                name="stiffness",
                label="stiffness K of the joints [N·m/rad]",
                scale=1.0,
                values=(1.0, 3.0, 10.0, 30.0, 100.0),
            ),
        )
    }
)
"""What is varied, by name."""


def unusual(cell: Cell) -> tuple[str, ...]:
    """Names of the axes along which a cell is away from the usual; none of most cells, one of a map's."""
    return tuple(axis.name for axis in AXES.values() if axis.of(cell) != axis.usual(cell))
