"""``render()``: what a simulation's lanes look like."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs.outcome import TERMINATION_REASONS, info_dict
from cablebot_gym.envs.simulation import Simulation
from cablebot_gym.kinematics import Array
from cablebot_gym.physics.textbook import torque_limits
from cablebot_gym.rendering.moment import Moment, Scene
from cablebot_gym.rendering.painter import Painter, import_pygame
from cablebot_gym.rendering.window import Window

RATE = 50
"""Pictures a second of ``human``, and ``metadata["render_fps"]``."""

LONGEST_TRAIL = 1000
"""Poses of the trail; the oldest go first."""


def check_render_mode(mode: str | None, modes: list[str]) -> str | None:
    """A render mode that can be had here.

    Raises:
        ValueError: if it is not one of ``modes``.
        ImportError: without pygame.
    """
    if mode is None:
        return None
    if mode not in modes:
        raise ValueError(f"render_mode {mode!r} is not available: choose one of {', '.join(modes)}, or leave it out")
    import_pygame()
    return mode


def moment(simulation: Simulation, lane: int) -> Moment:
    """What there is to see of a lane now."""
    robot = simulation.settings.robot
    row = simulation.info[lane : lane + 1].copy()
    info = {name: values[0] for name, values in info_dict(row, robot.cables).items()}
    strength = simulation.stall_torque[lane] / robot.stall_torque  # a weaker motor's free speed stays: the line shrinks
    return Moment(
        time=float(info["time"]),
        payload=float(info["payload"]),
        pose=simulation.pose[lane].copy(),
        tensions=info["tensions"],
        torques=info["torques"],
        torque_limits=strength * np.array(torque_limits(robot, info["motor_speeds"])),
        drive_demand=info["drive_demand"],
        slack=info["slack"],
        position_error=float(info["tracking_error"]),
        rotation_error=float(info["rotation_error"]),
    )


def scene(simulation: Simulation, lane: int, title: str) -> Scene:
    """What stays the same in a lane's episode, under its title."""
    task = simulation.tasks[lane]
    return Scene(robot=task.robot, trajectory=task.trajectory, limits=task.limits, title=title)


class Pictures:
    """Remembers where the platforms have been, and paints what is asked for.

    Args:
        simulation: its lanes are looked at.
        title: words above each picture.
    """

    def __init__(self, simulation: Simulation, title: str) -> None:
        self._simulation, self._title = simulation, title
        self._trails: list[deque[Array]] = [deque(maxlen=LONGEST_TRAIL) for _ in range(simulation.count)]
        self._painters: dict[int, Painter] = {}
        self._window: Window | None = None
        self._shown = -math.inf

    def __getstate__(self) -> dict[str, Any]:
        """For copies and pickles: painters are made anew where they are needed, and the window stays here."""
        return {**self.__dict__, "_painters": {}, "_window": None}

    def begun(self, lanes: Iterable[int]) -> None:
        """Episodes have started in ``lanes``."""
        for lane in lanes:
            self._trails[lane].clear()
            self._painters.pop(lane, None)
            self._trails[lane].append(self._simulation.pose[lane].copy())
        self._shown = -math.inf

    def stepped(self) -> None:
        """All lanes have made a step."""
        for trail, pose in zip(self._trails, self._simulation.pose, strict=True):
            trail.append(pose.copy())

    def array(self, lane: int) -> NDArray[np.uint8]:
        """A lane's picture (height, width, 3)."""
        return self._painter(lane).array(moment(self._simulation, lane), self._trails[lane], self._note(lane))

    def show(self) -> None:
        """The first lane in a window: every 1/:data:`RATE` s of its own time, and no faster than it passes.

        Without a display the pictures are drawn all the same, see :class:`~cablebot_gym.rendering.window.Window`.
        """
        now = moment(self._simulation, 0)
        if now.time < self._shown + 1 / RATE - 1e-9:
            return
        self._shown = now.time
        if self._window is None:
            self._window = Window(self._title, needs_display=False)
        if not self._window.closed:
            self._window.show(self._painter(0).paint(now, self._trails[0], self._note(0)), RATE)

    def close(self) -> None:
        """Closes the window."""
        if self._window is not None:
            self._window.close()

    def _painter(self, lane: int) -> Painter:
        if lane not in self._painters:
            self._painters[lane] = Painter(scene(self._simulation, lane, self._title))
        return self._painters[lane]

    def _note(self, lane: int) -> str:
        reason = TERMINATION_REASONS[int(self._simulation.reason[lane])]
        return f"ended: {reason.replace('_', ' ')}" if reason else ""
