"""Rows of a tile's memory, and the form of a robot for which the kernel is compiled.

Robots are stored in tiles of ``lanes`` lanes, one robot a lane. Each tile is a flat array of rows,
``array[row * lanes + at]`` with the lane ``at``, so the innermost loops run over lanes and
vectorise. An array with two indices would be three times slower.
"""

from __future__ import annotations

from itertools import accumulate
from typing import NamedTuple

from cablebot_gym.physics.compiling import compile_time_constant, inline

LANES = 32
"""Robots per tile in a batch. The rows of a tile then fit into the first-level cache of a core."""


def _starts(*sizes: int) -> tuple[int, ...]:
    """First rows of blocks of these sizes one after the other, and the number of all rows."""
    return tuple(accumulate(sizes, initial=0))


# Rows of the parameters: platform, CABLE_PARAMETERS rows for each cable, and of lopsided robots,
# from body_parameter(m) on, I_xy, I_xz, I_yz and the centre of mass. Other robots do without these
# rows: they would be 4 % slower, since rows whose distance is a multiple of 4 KiB share a set of
# the first-level cache. From stretch_parameter(m, lopsided) on, robots with elastic cables, swivel
# pulleys or load friction have STRETCH_PARAMETERS further rows for each cable.
MASS, INERTIA, GRAVITY, FRICTION_SPEED, FORCE, MOMENT, FIRST_CABLE_PARAMETER = _starts(
    1, 3, 1, 1, 3, 3
)
(
    BASE,
    PLATFORM,
    PER_RADIUS,
    INERTIA_PER_RADIUS2,
    DAMPING_PER_RADIUS2,
    STALL,
    SLOPE,
    STIFFNESS,
    PER_MOTOR_INERTIA,
    MOTOR_DAMPING,
    HOME_LENGTH,
    LAG,
    COULOMB_FRICTION,
    CABLE_PARAMETERS,
) = _starts(3, 3, *[1] * 11)
PRODUCTS, CENTER, BODY_PARAMETERS = _starts(3, 3)
(
    RADIUS,
    PER_PULLEY_INERTIA,
    AXIAL_STIFFNESS,
    AXIAL_DAMPING,
    FULL_LENGTH,
    EXTRA_LENGTH,
    SWIVEL,
    LOAD_FRICTION,
    STRETCH_PARAMETERS,
) = range(9)

# Rows of the record, which persists between calls: state, action, and peaks and flags of the last
# control period.
POSE, VELOCITY, POSITION_PEAK, ROTATION_PEAK, FIRST_CABLE_RECORD = _starts(6, 6, 1, 1)
(
    DEMAND,
    TORQUE,
    TENSION,
    SPEED,
    SLACK,
    MOTOR_ANGLE,
    MOTOR_SPEED,
    LEAST_TENSION,
    LAGGED,
    LARGEST_TENSION,
    CABLE_RECORDS,
) = range(11)

# Rows of the scratch memory, which is not used between calls. Some serve two kinds of robots. TRIG
# of a platform in a plane: sine and cosine of φ.
(
    START,
    SUM,
    STAGE,
    RATE,
    ROTATION,
    BODY_VELOCITY,
    OMEGA,
    SPIN,
    LOAD,
    TRIG,
    UNKNOWNS,
    WRONG,
    LEAST_SUM,
    PAIR,
    FIRST_CABLE,
) = _starts(12, 12, 12, 6, 9, 3, 3, 3, 6, 4, 6, 1, 1, 4)
CENTRE = LEAST_SUM  # of platforms that turn
# Of each cable. Flexible robots use the rows from LENGTH on: MOTOR_START, MOTOR_SUM and MOTOR_STAGE
# have two rows each, angle β′ and speed β̇′. GAP: lagged minus requested torque. DECAY: of the gap in
# half a physics step. KNOWN: tension without the unknown acceleration.
(
    ROW,
    LENGTH_RATE,
    BIAS,
    REQUEST,
    DRIVE,
    TAUT,
    FREE_TENSION,
    LENGTH,
    MOTOR_START,
    MOTOR_SUM,
    MOTOR_STAGE,
    MOTOR_RATE,
    MOTOR_TORQUE,
    RESULTS,
    GAP,
    DECAY,
    KNOWN,
    CABLE_ROWS,
) = _starts(6, 1, 1, 1, 1, 1, 1, 1, 2, 2, 2, 1, 1, 4, 1, 1, 1)
GRIP = (
    MOTOR_START  # rigid robots with load friction: r T over the torque that it takes from the motor
)
# Forward kinematics: START and SUM have the best pose and the step from there; their last rows
# serve sums and flags.
SQUARES, TRIAL, ENDED = range(9, 12)

TENSIONS, TORQUES, SPEEDS, PULLEY_ACCELERATIONS = range(4)
"""Order of the results of the inverse dynamics."""


@compile_time_constant
class Form(NamedTuple):
    """Constants of the compiled code, which is compiled once for each form of robots."""

    dimensions: int
    """Number of coordinates of the position: 2 or 3."""
    coordinates: int
    """Number of coordinates n: with ``dimensions`` it determines the kind of the platform."""
    cables: int
    """Number of cables m."""
    jointed: bool
    """Whether there are springs between motors and pulleys."""
    elastic: bool
    """Whether the cables stretch."""
    swivel: bool
    """Whether the cables run over swivel pulleys."""
    lopsided: bool
    """Whether a platform in space has products of inertia or a centre of mass that is not the
    origin of its frame. True for every platform in a plane."""
    load_friction: bool
    """Whether the friction of some motor grows with its load."""

    @property
    def grips(self) -> bool:
        """Whether load friction takes a part of the torque that the cables feel: without springs."""
        return self.load_friction and not self.flexible

    @property
    def stretches(self) -> bool:
        """Whether the cables have the rows from :func:`stretch_parameter` on."""
        return self.elastic or self.swivel or self.load_friction

    @property
    def flexible(self) -> bool:
        """Whether the motors move independently of the platform."""
        return self.jointed or self.elastic


def body_parameter(cables: int) -> int:
    """Row of the first parameter that only lopsided robots have."""
    return FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * cables


def stretch_parameter(cables: int, lopsided: bool) -> int:
    """Row of the first parameter that only robots with elastic cables, swivel pulleys or load
    friction have."""
    return FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * cables + BODY_PARAMETERS * lopsided


def parameter_rows(form: Form) -> int:
    """Number of parameter rows of a tile."""
    stretch = STRETCH_PARAMETERS * form.cables * form.stretches
    return stretch_parameter(form.cables, form.lopsided) + stretch


def record_rows(form: Form) -> int:
    """Number of record rows of a tile."""
    return FIRST_CABLE_RECORD + CABLE_RECORDS * form.cables


def scratch_rows(form: Form) -> int:
    """Number of rows of the scratch memory."""
    return FIRST_CABLE + CABLE_ROWS * form.cables


body_row = inline(body_parameter)
stretch_row = inline(stretch_parameter)
