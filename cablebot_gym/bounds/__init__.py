"""Payload bounds without a policy: the closed form, the best known payload, a certificate of what is out of reach."""

from cablebot_gym.bounds.closed_form import ExactPayload, exact_payload

__all__ = ["ExactPayload", "exact_payload"]
