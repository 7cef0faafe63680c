"""Payload bounds independent of a policy: closed form and best known payload."""

from cablebot_gym.bounds.closed_form import ExactPayload, exact_payload

__all__ = ["ExactPayload", "exact_payload"]
