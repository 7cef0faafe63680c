"""Robots with elastic cables."""

from __future__ import annotations

from oracles.plants import with_transmission
from oracles.platforms import CAMERA, CRANE, HANGING, TURNING

JOINTS = {"stiffness": 400.0, "motor_inertia": 3e-3, "motor_damping": 0.01}
SWIVELLED_CAMERA = CAMERA.replace(swivel_radius=(0.1, 0.05, 0.0, 0.1))
SWIVELLED_CRANE = CRANE.replace(swivel_radius=0.05)
ELASTIC = (
    with_transmission(HANGING, axial_stiffness=2e4, axial_damping=40.0, extra_length=0.5),
    with_transmission(TURNING, axial_stiffness=(2e4, 3e4, 1e4, 2e4, 5e4), **JOINTS),
    with_transmission(
        SWIVELLED_CAMERA, axial_stiffness=2e4, coulomb_friction=0.3, load_friction=0.1
    ),
    with_transmission(
        SWIVELLED_CRANE, axial_stiffness=1e5, axial_damping=20.0, load_friction=0.05, **JOINTS
    ),
)
"""The last one has everything: swivel pulleys, springs, elastic cables, load friction, an inertia and a
centre of mass without symmetry."""
