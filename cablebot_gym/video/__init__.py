"""Videos of episodes, in files and in a window. Requires the extra ``render``."""

SPEED = 0.25
"""Default playback speed, as a fraction of real time: one second of an episode takes four
seconds."""
