"""Control laws that the paper mentions and that are of no practical use. They are not registered as policies."""

from __future__ import annotations

from cablebot_baselines.classical.law import Array, ClassicalLaw


class FeedForward(ClassicalLaw):
    """Open loop: applies the torque of exact tracking, independent of the state of the robot."""

    def torques(self, blocks: dict[str, Array], mass: Array) -> tuple[Array, Array]:
        """Torques of the reference motion [N·m] and current pulley speeds [rad/s]."""
        motion = (blocks[f"reference_{name}"] for name in ("pose", "velocity", "acceleration"))
        needed = self._inverse_dynamics(mass, *motion)
        speeds = self._inverse_dynamics(
            mass, blocks["pose"], blocks["velocity"], blocks["reference_acceleration"]
        ).speeds
        return needed.torques, speeds
