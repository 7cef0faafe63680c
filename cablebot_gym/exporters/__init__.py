"""Robots as files of other programs: MJCF of MuJoCo."""

from cablebot_gym.exporters.mjcf import ExportedRobot, export_mjcf

__all__ = ["ExportedRobot", "export_mjcf"]
