"""Robots without symmetry, random states, and what the tests of the physics compute from them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from cablebot_gym.physics import textbook
from cablebot_gym.physics.kernel import rows
from cablebot_gym.physics.plant import Plant, pack_parameters
from cablebot_gym.robots import PLANAR, SPATIAL, Motors, Transmission
from oracles.platforms import CAMERA, CRANE, HANGING, SWIVELLED, TURNING

UNEQUAL = SPATIAL.replace(
    name="unequal",
    inertia=(0.9, 0.3, 0.7),
    motors=Motors(
        stall_torque=(8.0, 9.0, 10.0, 11.0, 12.0, 13.0),
        free_speed=(50.0, 60.0, 70.0, 80.0, 90.0, 100.0),
    ),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06, 0.07, 0.08),
        pulley_inertia=(4e-4, 6e-4, 8e-4, 1e-3, 1.2e-3, 0.0),
        damping=(0.0, 0.01, 0.02, 0.03, 0.04, 0.05),
    ),
)
"""Every motor and axis different, one pulley without inertia."""

QUAD = PLANAR.replace(
    name="quad",
    base_anchors=((-0.6, -0.3), (0.5, -0.4), (0.4, 0.5), (-0.5, 0.6)),
    motors=Motors(stall_torque=(4.0, 5.0, 6.0, 7.0), free_speed=(50.0, 60.0, 70.0, 80.0)),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06),
        pulley_inertia=(4e-4, 0.0, 8e-4, 1e-3),
        damping=(0.0, 0.01, 0.02, 0.03),
    ),
    home_pose=(0.05, 0.1),
)
"""Four cables, every motor different, one pulley without inertia."""

FLEX_UNEQUAL = UNEQUAL.replace(
    name="flex-unequal",
    transmission=UNEQUAL.transmission.replace(
        stiffness=(2.0, 3.0, 4.0, 5.0, 6.0, 7.0),
        motor_inertia=(9e-4, 8e-4, 7e-4, 6e-4, 5e-4, 4e-4),
        motor_damping=(0.0, 0.005, 0.01, 0.015, 0.02, 0.025),
    ),
)
FLEX_QUAD = QUAD.replace(
    name="flex-quad",
    transmission=QUAD.transmission.replace(
        stiffness=(2.0, 3.0, 4.0, 5.0),
        motor_inertia=(8e-4, 6e-4, 4e-4, 5e-4),
        motor_damping=(0.0, 0.01, 0.02, 0.03),
    ),
)
NINE = PLANAR.replace(
    name="nine",
    base_anchors=tuple((math.cos(k * math.tau / 9), math.sin(k * math.tau / 9)) for k in range(9)),
    transmission=Transmission(pulley_radius=0.05, pulley_inertia=0.8),
)
"""So many cables and so much pulley inertia that changing all wrong cables at once goes round in
circles."""


def _rough(robot):
    friction = np.linspace(0.25, 0.0, robot.cables)
    per_load = np.linspace(0.0, 0.15, robot.cables)
    lag = np.linspace(0.0, 0.02, robot.cables)
    return with_transmission(
        robot, coulomb_friction=tuple(friction.tolist()), load_friction=tuple(per_load.tolist())
    ).replace(name=f"rough-{robot.name}", motors=robot.motors.replace(lag=tuple(lag.tolist())))


def with_transmission(robot, **changes):
    return robot.replace(transmission=robot.transmission.replace(**changes))


ROUGH = tuple(_rough(robot) for robot in (QUAD, UNEQUAL, FLEX_QUAD, FLEX_UNEQUAL))
"""With Coulomb friction, load friction and a lag, different in every motor; the first has no lag and
no load friction, and the last no Coulomb friction."""


def nightly(*robots):
    """Robots for :func:`each_of` that only the nightly tests run: each is compiled for itself."""
    return [pytest.param(robot, marks=pytest.mark.nightly) for robot in robots]


def each_of(*robots):
    """A mark that runs a test for each of some robots."""
    return pytest.mark.parametrize("robot", robots, ids=lambda robot: robot.name)


SWIVELLED_CAMERA = CAMERA.replace(swivel_radius=(0.1, 0.05, 0.0, 0.1))
ELASTIC = (
    with_transmission(HANGING, axial_stiffness=2e4, axial_damping=40.0, extra_length=0.5),
    with_transmission(TURNING, axial_stiffness=(2e4, 3e4, 1e4, 2e4, 5e4)),
    with_transmission(
        SWIVELLED_CAMERA, axial_stiffness=2e4, coulomb_friction=0.3, load_friction=0.1
    ),
    with_transmission(SWIVELLED, axial_stiffness=1e5, axial_damping=20.0, load_friction=0.05),
)
"""The last one has swivel pulleys, elastic cables, load friction, an inertia and a centre of mass
without symmetry."""

rigid_robots = each_of(QUAD, UNEQUAL)
FLEX_HANGING = with_transmission(
    HANGING, stiffness=5.0, motor_inertia=3e-3, motor_damping=0.01
).replace(name="flex-hanging", mass=1.0)
KINDS = (
    *(QUAD, UNEQUAL, FLEX_QUAD, FLEX_UNEQUAL),
    *(FLEX_HANGING, _rough(TURNING), CAMERA, CRANE, *ROUGH),
)
every_kind = each_of(*KINDS[:4], *nightly(*KINDS[4:]))
both_cables = pytest.mark.parametrize("cable", ["unilateral", "bilateral"])


@dataclasses.dataclass
class State:
    """A batch of states (N, ...); angle and speed of the motors are zero for a rigid robot."""

    pose: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    speed: np.ndarray

    def __getitem__(self, members):
        return type(self)(*(value[members] for value in vars(self).values()))

    def moved(self, rate, time):
        """The state after a time at a rate, itself a state."""
        pairs = zip(vars(self).values(), vars(rate).values(), strict=True)
        return type(self)(*(value + time * slope for value, slope in pairs))


def runge_kutta_step(rates, state, step):
    """The state after one step of RK4; ``rates`` are a function of the time within the step and the
    state."""
    slopes = [rates(0.0, state)]
    for fraction in (0.5, 0.5, 1.0):
        slopes.append(rates(fraction * step, state.moved(slopes[-1], fraction * step)))
    end = state
    for slope, weight in zip(slopes, (1, 2, 2, 1), strict=True):
        end = end.moved(slope, weight * step / 6)
    return end


def random_states(robot, count, seed=1, reach=0.6):
    """States that slacken many cables, springs wound and unwound by 0.02 to 3 rad; and actions,
    some beyond ± 1."""
    rng = np.random.default_rng(seed)
    pose = rng.uniform(
        *(reach * (robot.pose_bounds - robot.home) + robot.home), (count, robot.coordinates)
    )
    velocity = rng.uniform(-1, 1, pose.shape)
    actions = rng.uniform(-0.7, 1.2, (count, robot.cables))
    if not robot.flexible:
        return State(pose, velocity, np.zeros_like(actions), np.zeros_like(actions)), actions
    twist = np.geomspace(0.02, 3.0, 200)[rng.integers(200, size=actions.shape)]
    twist *= rng.choice([-1.0, 1.0, 1.0], twist.shape)
    angle = textbook.pulley_angle(robot, pose) + twist
    return State(pose, velocity, angle, rng.uniform(-30, 30, actions.shape)), actions


def wound_states(robot, count):
    """Random states near home of a robot with elastic cables, wound as at rest, whose tensions lie
    between −600 N and 1400 N."""
    random = np.random.default_rng(1)
    size = (count, robot.coordinates)
    pose = robot.home + random.uniform(-0.15, 0.15, size)
    velocity = random.normal(size=size) / 3
    tensions = 400 * (1 + 2.5 * random.uniform(-1, 1, (count, robot.cables)))
    angle = textbook.rest_angles(robot, tensions, pose)
    return State(pose, velocity, angle, textbook.pulley_speed(robot, pose, velocity))


def random_motion(robot, shape, seed=1, spread=1.0):
    """Masses from the robot's on, poses all over the workspace, velocities up to 2, accelerations
    up to 10."""
    rng = np.random.default_rng(seed)
    reach = robot.home + spread * (robot.pose_bounds - robot.home)
    pose = rng.uniform(*reach, (*shape, robot.coordinates))
    velocity = rng.uniform(-2, 2, pose.shape)
    acceleration = rng.uniform(-10, 10, pose.shape)
    return robot.mass + rng.uniform(0, 3, shape), pose, velocity, acceleration


def free_motors(robot):
    """Motors without lag, whose torque limits do not depend on the speed: an action of τ/τ_s holds
    the torque τ."""
    return robot.replace(motors=Motors(stall_torque=robot.motors.stall_torque, free_speed=1e100))


def loaded_plant(robot, state, cable="bilateral", mass=None):
    """A plant at these states, with one total mass or one for each robot."""
    count = len(state.pose)
    plant = Plant(robot, count, cable=cable)
    every = np.arange(count)
    parameters = np.tile(pack_parameters(robot), (count, 1))
    parameters[:, rows.MASS] = robot.mass if mass is None else mass
    plant.set_parameters(every, parameters)
    set_states(plant, state)
    return plant


def set_states(plant, state):
    every = np.arange(plant.count)
    plant.set_state(every, state.pose, state.velocity)
    if plant.robot.flexible:
        plant.set_motors(every, state.angle, state.speed)


def state_of(plant):
    state = plant.pose, plant.velocity
    if not plant.robot.flexible:
        return State(*state, *np.zeros((2, plant.count, plant.robot.cables)))
    return State(*state, plant.motor_angle, plant.motor_speed)


def record_of(plant):
    """The whole record, a row for each robot."""
    tiles = plant.record.reshape(plant.record.shape[0], -1, plant.lanes)
    return tiles.transpose(0, 2, 1).reshape(plant.width, -1)[: plant.count].copy()


def no_reference(robot):
    """References and their ends for runs in which nobody reads the errors."""
    return np.zeros((1, 1, robot.coordinates)), np.zeros(1, np.int64)


def advance(plant, torques, duration, substeps):
    """Constant torques of free motors; nobody reads the errors."""
    plant.set_action(
        np.broadcast_to(torques / plant.robot.stall_torque, (plant.count, plant.robot.cables))
    )
    plant.advance(*no_reference(plant.robot), substeps=substeps, step=duration / substeps)


def spring_torques(robot, state, cable):
    """Torques K (β′ − β) of the springs; those of unilateral cables cannot push."""
    twist = state.angle - textbook.pulley_angle(robot, state.pose)
    return robot.stiffness * (np.maximum(twist, 0.0) if cable == "unilateral" else twist)


def pulley_torques(robot, state, torques, cable):
    """The torques that turn the pulleys: of the motors, or of the springs."""
    return spring_torques(robot, state, cable) if robot.flexible else torques


def drive_speed(robot, state):
    """Speed of the motors."""
    return (
        state.speed if robot.flexible else textbook.pulley_speed(robot, state.pose, state.velocity)
    )


def textbook_rates(robot, state, torques, cable="bilateral", mass=None):
    """Rates of a state and the tensions: the rigid robot's equations, and J′ β̈′ = τ − κ − c′ β̇′
    (Eq. 4) − friction."""
    mass = robot.mass if mass is None else mass
    if robot.elastic:
        return _elastic_rates(robot, state, torques, cable, mass)
    at_pulley = pulley_torques(robot, state, torques, cable)
    platform, tension = textbook.forward_dynamics(
        robot, mass, state.pose, state.velocity, at_pulley, cable=cable
    )
    motors = 0.0 * state.speed
    if robot.flexible:
        motors = (
            torques - at_pulley - textbook.motor_friction(robot, state.speed, at_pulley)
        ) / robot.motor_inertia
    return State(state.velocity, platform, state.speed, motors), tension


def _elastic_rates(robot, state, torques, cable, mass):
    tension, pulling = textbook.cable_springs(
        robot, state.pose, state.velocity, state.angle, state.speed, cable=cable
    )
    forces = np.einsum("kmn,km->kn", textbook.jacobian(robot, state.pose), tension)
    forces += textbook.bias(robot, mass, state.pose, state.velocity)
    inertia = textbook.mass_matrix(robot, mass, state.pose)
    platform = -np.linalg.solve(inertia, forces[..., None])[..., 0]
    friction = robot.coulomb_friction + robot.load_friction * np.abs(pulling)
    driving = torques - friction * state.speed / np.hypot(state.speed, 0.5)
    motor = (driving - robot.damping * state.speed - pulling) / robot.pulley_inertia
    return State(state.velocity, platform, state.speed, motor), tension


def friction_torques(robot, state, torques, tension, cable):
    """(τ_c + μ load) ω/√(ω² + ω₀²); the load is r T of a rigid robot, else the spring's torque."""
    speed = drive_speed(robot, state)
    load = robot.pulley_radius * tension
    if robot.flexible:
        load = np.abs(spring_torques(robot, state, cable))
    return (robot.coulomb_friction + robot.load_friction * load) * speed / np.hypot(speed, 0.5)


def take_up_torques(robot, state, torques, acceleration, tension, cable):
    """u = r T − κ + J β̈ + c β̇ + friction, the torque with which a slack cable is wound up."""
    winding = textbook.pulley_acceleration(robot, state.pose, state.velocity, acceleration)
    speed = textbook.pulley_speed(robot, state.pose, state.velocity)
    damping = robot.damping * speed
    if not robot.flexible:
        damping = damping + friction_torques(robot, state, torques, tension, cable)
    at_pulley = pulley_torques(robot, state, torques, cable)
    return robot.pulley_radius * tension - at_pulley + robot.pulley_inertia * winding + damping


def worst_relative_error(values, expected):
    size = np.maximum(1.0, np.linalg.norm(expected, axis=-1))
    return np.max(np.linalg.norm(values - expected, axis=-1) / size)


def differentiated(function, step):
    """d/dt at 0 by central differences of fourth order."""
    narrow = function(step) - function(-step)
    wide = function(2 * step) - function(-2 * step)
    return (8 * narrow - wide) / (12 * step)
