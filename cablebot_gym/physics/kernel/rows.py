"""Rows of a tile's memory, and the form of a robot for which the kernel is compiled.

Robots are stored in tiles of ``lanes`` lanes, one robot a lane. Each tile is a flat array of rows,
``array[row * lanes + at]`` with the lane ``at``, so the innermost loops run over lanes and
vectorise. An array with two indices would be three times slower.
"""

from __future__ import annotations

from typing import NamedTuple

from cablebot_gym.physics.compiling import compile_time_constant, inline

LANES = 32
"""Robots per tile in a batch. The rows of a tile then fit into the first-level cache of a core."""

# Rows of the parameters: platform, CABLE_PARAMETERS rows for each cable, and of lopsided robots,
# from body_parameter(m) on, I_xy, I_xz, I_yz and the centre of mass. Other robots do without these
# rows: they would be 4 % slower, since rows whose distance is a multiple of 4 KiB share a set of
# the first-level cache. From stretch_parameter(m, lopsided) on, robots with elastic cables, swivel
# pulleys or load friction have STRETCH_PARAMETERS further rows for each cable.
MASS = 0
INERTIA = 1
GRAVITY = 4
FRICTION_SPEED = 5
FORCE = 6
MOMENT = 9
FIRST_CABLE_PARAMETER = 12
BASE = 0
PLATFORM = 3
PER_RADIUS = 6
INERTIA_PER_RADIUS2 = 7
DAMPING_PER_RADIUS2 = 8
STALL = 9
SLOPE = 10
STIFFNESS = 11
PER_MOTOR_INERTIA = 12
MOTOR_DAMPING = 13
HOME_LENGTH = 14
LAG = 15
COULOMB_FRICTION = 16
CABLE_PARAMETERS = 17
PRODUCTS, CENTER, BODY_PARAMETERS = 0, 3, 6
RADIUS = 0
PER_PULLEY_INERTIA = 1
AXIAL_STIFFNESS = 2
AXIAL_DAMPING = 3
FULL_LENGTH = 4
EXTRA_LENGTH = 5
SWIVEL = 6
LOAD_FRICTION = 7
STRETCH_PARAMETERS = 8

# Rows of the record, which persists between calls: state, action, and peaks and flags of the last
# control period. With joint springs and elastic cables, PULLEY_RECORDS rows for each pulley follow,
# angle and speed.
POSE = 0
VELOCITY = 6
POSITION_PEAK = 12
ROTATION_PEAK = 13
FIRST_CABLE_RECORD = 14
DEMAND = 0
TORQUE = 1
TENSION = 2
SPEED = 3
SLACK = 4
MOTOR_ANGLE = 5
MOTOR_SPEED = 6
LEAST_TENSION = 7
LAGGED = 8
LARGEST_TENSION = 9
CABLE_RECORDS, PULLEY_RECORDS = 10, 2

# Rows of the scratch memory, which is not used between calls. Some serve two kinds of robots. TRIG
# of a platform in a plane: sine and cosine of φ.
START, SUM, STAGE, RATE = 0, 12, 24, 36
ROTATION = 42
BODY_VELOCITY = 51
OMEGA = 54
SPIN = 57
LOAD = 60
TRIG = 66
UNKNOWNS = 70
WRONG = 76
LEAST_SUM = 77
PAIR = 78
FIRST_CABLE = 82
CENTRE = LEAST_SUM  # of platforms that turn
ROW = 0
LENGTH_RATE = 6
BIAS = 7
REQUEST = 8
DRIVE = 9
TAUT = 10
FREE_TENSION = 11
GRIP = 13  # rigid robots with load friction: r T over the torque that it takes from the motor
# Flexible robots: MOTOR_START, MOTOR_SUM and MOTOR_STAGE have two rows each, angle β′ and speed
# β̇′.
LENGTH = 12
MOTOR_START = 13
MOTOR_SUM = 15
MOTOR_STAGE = 17
MOTOR_RATE = 19
MOTOR_TORQUE = 20
RESULTS = 21
GAP = 25  # lagged minus requested torque
DECAY = 26  # of the gap in half a physics step
KNOWN = 27  # tension without the unknown acceleration
CABLE_ROWS = 28
# Forward kinematics: START and SUM have the best pose and the step from there; their last rows
# serve sums and flags.
SQUARES, TRIAL, ENDED = 9, 10, 11
# The pulleys between joint springs and elastic cables, after all cables.
PULLEY_START = 0
PULLEY_SUM = 2
PULLEY_STAGE = 4
PULLEY_RATE = 6
PULLEY_ROWS = 7

TENSIONS, TORQUES, SPEEDS, PULLEY_ACCELERATIONS = 0, 1, 2, 3
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

    @property
    def double(self) -> bool:
        """Whether there are pulleys between joint springs and elastic cables."""
        return self.jointed and self.elastic

    @property
    def robot_text(self) -> str:
        """The kind of robot in words, without the number of lanes."""
        point = self.coordinates == self.dimensions
        body = "point mass" if point else "platform"
        space = "in space" if self.dimensions == 3 else "in a plane"
        text = f"{body} {space} on {self.cables} cables"
        if self.double:
            return f"{text} with joint springs and elastic cables"
        if self.jointed:
            return f"{text} with joint springs"
        if self.elastic:
            return f"{text} with elastic cables"
        return text


def body_parameter(cables: int) -> int:
    """Row of the first parameter that only lopsided robots have."""
    return FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * cables


def stretch_parameter(cables: int, lopsided: bool) -> int:
    """Row of the first parameter that only robots with elastic cables, swivel pulleys or load
    friction have."""
    return FIRST_CABLE_PARAMETER + CABLE_PARAMETERS * cables + BODY_PARAMETERS * lopsided


def pulley_record(cables: int) -> int:
    """Row of the angle of the first pulley between a joint spring and an elastic cable."""
    return FIRST_CABLE_RECORD + CABLE_RECORDS * cables


def parameter_rows(form: Form) -> int:
    """Number of parameter rows of a tile."""
    stretch = STRETCH_PARAMETERS * form.cables * form.stretches
    return stretch_parameter(form.cables, form.lopsided) + stretch


def record_rows(form: Form) -> int:
    """Number of record rows of a tile."""
    return pulley_record(form.cables) + PULLEY_RECORDS * form.cables * form.double


def scratch_rows(form: Form) -> int:
    """Number of rows of the scratch memory."""
    pulleys = PULLEY_ROWS * form.cables * form.double
    return FIRST_CABLE + CABLE_ROWS * form.cables + pulleys


body_row = inline(body_parameter)
stretch_row = inline(stretch_parameter)
pulley_record_row = inline(pulley_record)
