"""Kinematics and dynamics of a tile in one stage of the integration."""

from __future__ import annotations

from cablebot_gym.physics.compiling import inline
from cablebot_gym.physics.kernel.motors import grip_cables, stretch_cables, twist_springs
from cablebot_gym.physics.kernel.plane import (
    planar_cable,
    plane_acceleration,
    plane_cable,
    plane_platform,
)
from cablebot_gym.physics.kernel.rows import RATE, UNKNOWNS
from cablebot_gym.physics.kernel.space import (
    point_cable,
    point_load,
    spatial_acceleration,
    spatial_cable,
    spatial_platform,
)
from cablebot_gym.physics.kernel.taut import pulled_lane, taut_sets


@inline
def copy_parameters(parameters, p, lanes):
    """Copies the parameters of one robot to all lanes of a tile."""
    for row in range(parameters.shape[0]):
        for at in range(lanes):
            p[row * lanes + at] = parameters[row]


@inline
def stage_kinematics(form, lengths, p, w, lanes):
    """Directions, rates and biases of all cables, and lengths where ``lengths`` is True."""
    if form.coordinates == 6:
        for at in range(lanes):
            spatial_platform(form, p, w, at, lanes)
    elif form.coordinates == 3:
        for at in range(lanes):
            if form.dimensions == 2:
                plane_platform(form, p, w, at, lanes)
            else:
                point_load(p, w, at, lanes)
    for i in range(form.cables):
        for at in range(lanes):
            if form.coordinates == 6:
                spatial_cable(form, lengths, p, w, at, lanes, i)
            elif form.dimensions == 3:
                point_cable(form, lengths, p, w, at, lanes, i)
            elif form.coordinates == 3:
                plane_cable(p, w, at, lanes, i)
            else:
                planar_cable(p, w, at, lanes, i)


@inline
def stage_dynamics(form, unilateral, p, w, lanes):
    """Spring torques and accelerations of the stage, with the taut sets of all lanes."""
    if form.elastic:
        stretch_cables(form, unilateral, p, w, lanes)
        for at in range(lanes):
            pulled_lane(form, p, w, at, lanes)
    else:
        if form.jointed:
            twist_springs(form, unilateral, p, w, lanes)
        elif form.grips:
            grip_cables(form, p, w, lanes)
        taut_sets(form, unilateral, p, w, lanes)
    stage_accelerations(form, p, w, lanes)


@inline
def stage_accelerations(form, p, w, lanes):
    """Ẍ from y, in the rows from :func:`acceleration_row` on."""
    for at in range(lanes):
        if form.coordinates == 6:
            spatial_acceleration(form, p, w, at, lanes)
        elif form.coordinates == 3 and form.dimensions == 2:
            plane_acceleration(1.0, UNKNOWNS, RATE, w, at, lanes)


@inline
def acceleration_row(form):
    """Row of Ẍ after :func:`stage_dynamics`: y itself of point masses."""
    if form.dimensions == form.coordinates:
        return UNKNOWNS
    return RATE
