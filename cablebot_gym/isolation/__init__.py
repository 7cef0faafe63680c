"""Policies in processes of their own, and the sandbox of policies of others."""

from cablebot_gym.isolation.isolated import IsolatedPolicy

__all__ = ["IsolatedPolicy"]
