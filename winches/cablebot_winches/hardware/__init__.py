"""Policies on real winches: the line protocol of ODrive, the control loop with its limits, and
simulated boards. ``cablebot drive``."""
