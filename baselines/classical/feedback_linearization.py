"""The paper's feedback linearization for rigid transmissions (Eqs. 10–13 planar, 16–18 spatial)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cablebot_gym.envs import RIGID_ENV_IDS
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.physics import textbook
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import Robot

Array = NDArray[np.float64]

PAPER_GAINS = {"planar": (2000.0, 10.0), "spatial": (30.0, 20.0)}
"""(K_P, K_D) of Tables 2 and 4 [1/s², 1/s]."""

MINIMUM_TENSION = 5.0
"""T_min of the planar law [N]. At 0 the cables slacken at once in closed loop; a few newtons keep them taut."""


class FeedbackLinearization:
    """``τ = r T + J β̈ + c β̇`` with ``−Sᵀ T = D v + h`` and ``v = Ẍ_d + K_D ė + K_P e``, e = X_d − X.

    Built from nominal parameters and the told payload. Planar: the least tensions that are all at least
    ``minimum_tension`` (Eq. 11 with the least α). The drive command is not clipped, so that |a| > 1 is the paper's
    torque violation.

    Args:
        robot: nominal robot.
        gains: (K_P, K_D), the same for each coordinate; None for the paper's. Sampling lowers K_D by about K_P h/2:
            the planar gains need a control frequency well above 100 Hz.
        minimum_tension: T_min of a planar robot [N]; ≥ 0. A spatial robot's tensions have no freedom.

    Raises:
        ValueError: if a gain is not positive, or ``minimum_tension`` is negative.
    """

    unclipped = True

    def __init__(
        self,
        robot: Robot,
        *,
        gains: tuple[float, float] | None = None,
        minimum_tension: float = MINIMUM_TENSION,
    ) -> None:
        self.robot = robot
        if gains is None:
            gains = PAPER_GAINS["planar" if robot.planar else "spatial"]
        checked = np.asarray(gains)
        if checked.shape != (2,) or checked.dtype.kind not in "iuf" or not np.all((checked > 0) & (checked < np.inf)):
            raise ValueError(f"gains must be two positive numbers (K_P, K_D), not {gains!r}")
        self.stiffness, self.damping = checked.tolist()
        if not 0 <= minimum_tension < math.inf:
            raise ValueError(f"minimum_tension must be at least 0 N, not {minimum_tension}")
        self.minimum_tension = minimum_tension
        self._layout = observation_layout(robot)

    def predict(
        self,
        observation: ArrayLike,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Array, Any]:
        """Drive commands (m,) for one observation or (N, m) for a batch; ``state`` is passed through.

        Raises:
            ValueError: if the observation is not of this robot's layout.
        """
        robot, part = self.robot, self._layout.split(self._layout.checked(observation, self.robot.name))
        pose, velocity = part["pose"], part["velocity"]
        outer = outer_loop(part, self.stiffness, self.damping)
        mass = robot.mass + part["told_payload"][..., 0]
        needed = textbook.inverse_dynamics(
            robot, mass, pose, velocity, outer, minimum=self.minimum_tension, strict=False
        )
        return (needed.torques + robot.speed_slope * needed.speeds) / robot.stall_torque, state


def outer_loop(part: dict[str, Array], stiffness: float, damping: float) -> Array:
    """``v = Ẍ_d + K_D ė + K_P e`` (Eqs. 13 and 18) from the blocks of an observation, (..., n)."""
    correction = damping * (part["reference_velocity"] - part["velocity"])
    correction = correction + stiffness * (part["reference_pose"] - part["pose"])
    return part["reference_acceleration"] + correction


FL = PolicyEntry(
    name="fl",
    kind="classical",
    env_ids=RIGID_ENV_IDS,
    factory=FeedbackLinearization,
    summary="the paper's feedback linearization, its gains",
)
