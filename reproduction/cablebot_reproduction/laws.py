"""Control laws that the paper mentions and that are of no practical use. They are not registered as
policies."""

from __future__ import annotations

from cablebot_baselines.classical.law import Array, ClassicalLaw


class FeedForward(ClassicalLaw):
    """Open loop: applies the torque of exact tracking, independent of the state of the robot."""

    def torques(self, blocks: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Torques of the reference motion [N·m] and current pulley speeds [rad/s]."""
        acceleration = blocks["reference_acceleration"]
        required = self._inverse_dynamics(
            mass, blocks["reference_pose"], blocks["reference_velocity"], acceleration
        )
        current = self._inverse_dynamics(mass, blocks["pose"], blocks["velocity"], acceleration)
        return required.torques, current.speeds
