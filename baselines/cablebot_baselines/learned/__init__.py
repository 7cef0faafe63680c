"""Learned policies: networks that plan, and reinforcement learning."""
