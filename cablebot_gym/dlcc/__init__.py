"""Dynamic load-carrying capacity: how much a robot can carry along a motion, and what limits it."""
