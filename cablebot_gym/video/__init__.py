"""Videos and pictures of episodes. Requires the extra ``render``."""

SPEED = 0.25
"""Default playback speed, as a fraction of real time: one second of an episode takes four
seconds."""
