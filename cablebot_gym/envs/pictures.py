"""Pictures of the environments of a simulation, for ``render()``."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cablebot_gym.envs import TERMINATION_REASONS
from cablebot_gym.envs.outcome import info_dict
from cablebot_gym.envs.simulation import Simulation
from cablebot_gym.kinematics import Array
from cablebot_gym.rendering.moment import Moment
from cablebot_gym.utils.checks import choice

if TYPE_CHECKING:
    from cablebot_gym.rendering.painter import Painter
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
    # here, because most environments have no pictures
    from cablebot_gym.rendering.painter import import_pygame

    import_pygame()
    return choice("render_mode", mode, modes, ", or None")


class Pictures:
    """Records the trails of the platforms and paints pictures on request.

    Args:
        simulation: the environments to paint.
        title: text above each picture.
    """

    def __init__(self, simulation: Simulation, title: str) -> None:
        self._simulation = simulation
        self._title = title
        self._trails: list[deque[Array]] = [
            deque(maxlen=LONGEST_TRAIL) for _ in range(simulation.count)
        ]
        self._painters: dict[int, Painter] = {}
        self._window: Window | None = None
        self._last_shown = -math.inf

    def __getstate__(self) -> dict[str, Any]:
        """State for copies and pickles: without the window, and without painters, which are made
        again on demand."""
        return {**self.__dict__, "_painters": {}, "_window": None}

    def on_reset(self, env_indices: Iterable[int]) -> None:
        """Starts new trails after a reset of the environments ``env_indices``."""
        for env_index in env_indices:
            self._trails[env_index].clear()
            self._painters.pop(env_index, None)  # the task may have changed
            self._trails[env_index].append(self._simulation.pose[env_index].copy())
        self._last_shown = -math.inf

    def on_step(self) -> None:
        """Appends the present poses to the trails, after a step of all environments."""
        for trail, pose in zip(self._trails, self._simulation.pose, strict=True):
            trail.append(pose.copy())

    def array(self, env_index: int) -> NDArray[np.uint8]:
        """Picture of an environment, (height, width, 3)."""
        return self._painter(env_index).array(*self._content(env_index))

    def show(self) -> None:
        """Shows the first environment in a window, every 1/:data:`RATE` s of episode time and no
        faster than real time.

        Without a display the pictures are painted but not shown, see
        :class:`~cablebot_gym.rendering.window.Window`.
        """
        moment, trail, note = self._content(0)
        if moment.time < self._last_shown + 1 / RATE - 1e-9:  # rounded times
            return
        self._last_shown = moment.time
        if self._window is None:
            from cablebot_gym.rendering.window import Window

            self._window = Window(self._title)
        if not self._window.closed:
            self._window.show(self._painter(0).paint(moment, trail, note), RATE)

    def close(self) -> None:
        """Closes the window, if it is open."""
        if self._window is not None:
            self._window.close()

    def _painter(self, env_index: int) -> Painter:
        if env_index not in self._painters:
            from cablebot_gym.rendering.painter import Painter

            self._painters[env_index] = Painter(self._simulation.tasks[env_index], self._title)
        return self._painters[env_index]

    def _content(self, env_index: int) -> tuple[Moment, deque[Array], str]:
        """Present state, trail and note of an environment."""
        simulation = self._simulation
        robot = simulation.settings.robot
        info = info_dict(simulation.info[env_index], simulation.cables[:, env_index])
        moment = Moment.from_info(
            robot, simulation.stall_torque[env_index], simulation.pose[env_index], info
        )
        reason = TERMINATION_REASONS[int(simulation.reason[env_index])]
        note = ""
        if reason:
            note = f"terminated: {reason.replace('_', ' ')}"
        return moment, self._trails[env_index], note
