"""Policies in processes of their own, with a deadline."""

from cablebot_gym.isolation.isolated import IsolatedPolicy

__all__ = ["IsolatedPolicy"]
