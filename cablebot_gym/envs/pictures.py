"""Pictures of the environments of a simulation, for ``render()``."""

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
"""Pictures per second of episode time in ``human`` mode, and ``metadata["render_fps"]``."""

LONGEST_TRAIL = 1000
"""Largest number of poses in the trail; the oldest poses are dropped."""


def check_render_mode(mode: str | None, modes: list[str]) -> str | None:
    """The render mode, checked.

    Raises:
        ValueError: if it is not one of ``modes``.
        ImportError: if pygame is missing.
    """
    if mode is None:
        return None
    if mode not in modes:
        raise ValueError(f"unknown render_mode {mode!r}: choose one of {', '.join(modes)}, or None")
    import_pygame()
    return mode


def moment(simulation: Simulation, env_index: int) -> Moment:
    """Present state of an environment, as the painter needs it."""
    robot = simulation.settings.robot
    row = simulation.info[env_index : env_index + 1].copy()
    info = {name: values[0] for name, values in info_dict(row, robot.cables).items()}
    # Uncertain motor strength scales the torque-speed line: the free speed stays nominal.
    strength = simulation.stall_torque[env_index] / robot.stall_torque
    return Moment(
        time=float(info["time"]),
        payload=float(info["payload"]),
        pose=simulation.pose[env_index].copy(),
        tensions=info["tensions"],
        torques=info["torques"],
        torque_limits=strength * np.array(torque_limits(robot, info["motor_speeds"])),
        commanded_action=info["commanded_action"],
        slack=info["slack"],
        position_error=float(info["tracking_error"]),
        rotation_error=float(info["rotation_error"]),
    )


def scene(simulation: Simulation, env_index: int, title: str) -> Scene:
    """Constant content of the pictures of an environment's episode, with a title."""
    task = simulation.tasks[env_index]
    return Scene(robot=task.robot, trajectory=task.trajectory, error_bounds=task.error_bounds, title=title)


class Pictures:
    """Records the trails of the platforms and paints pictures on request.

    Args:
        simulation: the environments to paint.
        title: text above each picture.
    """

    def __init__(self, simulation: Simulation, title: str) -> None:
        self._simulation, self._title = simulation, title
        self._trails: list[deque[Array]] = [deque(maxlen=LONGEST_TRAIL) for _ in range(simulation.count)]
        self._painters: dict[int, Painter] = {}
        self._window: Window | None = None
        self._last_shown = -math.inf

    def __getstate__(self) -> dict[str, Any]:
        """State for copies and pickles: without painters, which are made again on demand, and without the window."""
        return {**self.__dict__, "_painters": {}, "_window": None}

    def on_reset(self, env_indices: Iterable[int]) -> None:
        """Starts new trails after a reset of the environments ``env_indices``."""
        for env_index in env_indices:
            self._trails[env_index].clear()
            self._painters.pop(env_index, None)
            self._trails[env_index].append(self._simulation.pose[env_index].copy())
        self._last_shown = -math.inf

    def on_step(self) -> None:
        """Appends the present poses to the trails, after a step of all environments."""
        for trail, pose in zip(self._trails, self._simulation.pose, strict=True):
            trail.append(pose.copy())

    def array(self, env_index: int) -> NDArray[np.uint8]:
        """Picture of an environment, (height, width, 3)."""
        return self._painter(env_index).array(
            moment(self._simulation, env_index), self._trails[env_index], self._note(env_index)
        )

    def show(self) -> None:
        """Shows the first environment in a window, every 1/:data:`RATE` s of episode time and no faster than real time.

        Without a display the pictures are painted but not shown, see :class:`~cablebot_gym.rendering.window.Window`.
        """
        present = moment(self._simulation, 0)
        if present.time < self._last_shown + 1 / RATE - 1e-9:
            return
        self._last_shown = present.time
        if self._window is None:
            self._window = Window(self._title, needs_display=False)
        if not self._window.closed:
            self._window.show(self._painter(0).paint(present, self._trails[0], self._note(0)), RATE)

    def close(self) -> None:
        """Closes the window, if it is open."""
        if self._window is not None:
            self._window.close()

    def _painter(self, env_index: int) -> Painter:
        if env_index not in self._painters:
            self._painters[env_index] = Painter(scene(self._simulation, env_index, self._title))
        return self._painters[env_index]

    def _note(self, env_index: int) -> str:
        reason = TERMINATION_REASONS[int(self._simulation.reason[env_index])]
        return f"terminated: {reason.replace('_', ' ')}" if reason else ""
