"""Episodes of policies, watched and filmed. Needs the extra ``render``."""

SPEED = 0.25
"""Of films, as a share of the episode's own: a circle of one second takes four."""
