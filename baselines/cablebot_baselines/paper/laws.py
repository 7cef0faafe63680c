"""Laws that the paper speaks of and nobody would use: shown here, and not among the policies."""

from __future__ import annotations

from cablebot_baselines.classical.law import Array, ClassicalLaw


class FeedForward(ClassicalLaw):
    """Open loop: the torque that exact tracking asks for, whatever the robot does."""

    def torques(self, part: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Torques [N·m] of the motion that is asked for, and the speeds that the pulleys have [rad/s]."""
        motion = (part[f"reference_{name}"] for name in ("pose", "velocity", "acceleration"))
        needed = self._inverse_dynamics(mass, *motion)
        speeds = self._inverse_dynamics(mass, part["pose"], part["velocity"], part["reference_acceleration"]).speeds
        return needed.torques, speeds
