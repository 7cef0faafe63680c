"""The equations of motion of the paper with its errata corrected, in batched numpy.

This package is the readable reference for control laws and for tests of the compiled kernel. The
payload is a point mass at the platform's centre of mass, so it does not change the inertia about
it. All functions have these arguments:

    robot: the robot, or N robots whose uncertain values have a leading axis N.
    mass: mass of the platform and its payload [kg], shape (...).
    pose: X = (x, y), (x, y, φ), (x, y, z) or (x, y, z, ψ, θ, φ) [m, rad], shape (..., n).
    velocity, acceleration: Ẋ and Ẍ, shape (..., n).

``platform`` has the equations of the platform and its cables, ``drives`` those of motors and
springs, ``small_motion`` linear models.
"""

from cablebot_gym.kinematics import times_vector
from cablebot_gym.physics.textbook.drives import (
    MINIMUM_TENSION,
    TENSION_RESERVE,
    InverseDynamics,
    MotionEquations,
    allocated_minimum,
    cable_springs,
    central_tensions,
    coulomb_torque,
    forward_dynamics,
    holding_torque,
    inverse_dynamics,
    joint_equivalent,
    joint_stiffness,
    largest_tensions,
    least_action_tensions,
    load_friction,
    loaded_radius,
    motion_equations,
    motor_friction,
    motor_torques,
    normalised_action,
    required_tensions,
    required_torques,
    rest_angles,
    smooth_magnitude,
    spring_drive,
    static_motor_angle,
    static_torque,
    stretched_torque,
    torque_limits,
)
from cablebot_gym.physics.textbook.platform import (
    bias,
    cable_lengths,
    jacobian,
    jacobian_rate,
    load,
    mass_matrix,
    pulley_acceleration,
    pulley_angle,
    pulley_speed,
    tension_distribution,
)
from cablebot_gym.physics.textbook.small_motion import (
    LinearModel,
    StateSpace,
    fastest_decay_rate,
    free_modes,
    highest_frequency,
    linear_model,
    linearise,
    locked_modes,
    tension_stiffness,
    weight_stiffness,
)

__all__ = [
    "MINIMUM_TENSION",
    "TENSION_RESERVE",
    "InverseDynamics",
    "LinearModel",
    "MotionEquations",
    "StateSpace",
    "allocated_minimum",
    "bias",
    "cable_lengths",
    "cable_springs",
    "central_tensions",
    "coulomb_torque",
    "fastest_decay_rate",
    "forward_dynamics",
    "free_modes",
    "highest_frequency",
    "holding_torque",
    "inverse_dynamics",
    "jacobian",
    "jacobian_rate",
    "joint_equivalent",
    "joint_stiffness",
    "largest_tensions",
    "least_action_tensions",
    "linear_model",
    "linearise",
    "load",
    "load_friction",
    "loaded_radius",
    "locked_modes",
    "mass_matrix",
    "motion_equations",
    "motor_friction",
    "motor_torques",
    "normalised_action",
    "pulley_acceleration",
    "pulley_angle",
    "pulley_speed",
    "required_tensions",
    "required_torques",
    "rest_angles",
    "smooth_magnitude",
    "spring_drive",
    "static_motor_angle",
    "static_torque",
    "stretched_torque",
    "tension_distribution",
    "tension_stiffness",
    "times_vector",
    "torque_limits",
    "weight_stiffness",
]
