"""Payload bounds independent of a policy: closed form, best known payload, and certificate of an
upper bound."""

from cablebot_gym.bounds.closed_form import ExactPayload, exact_payload

__all__ = ["ExactPayload", "exact_payload"]
