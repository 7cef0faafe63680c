"""The flexible transmission against MuJoCo, the rigid plant, energy and its linearisation, and in the environments."""

from __future__ import annotations

import dataclasses
import math
import re
from itertools import pairwise

import gymnasium as gym
import numpy as np
import pytest
from oracles import mujoco_model
from scipy.linalg import block_diag, eigh

from cablebot_gym import kinematics
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.envs.settings import MODE_LOSS, make_settings
from cablebot_gym.physics import kernel, textbook
from cablebot_gym.physics.plant import Plant, pack_parameters
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, ROBOTS, SPATIAL, Motors, Robot, Transmission

STATES = 200

# Every motor and axis different, one pulley without inertia.
UNEQUAL = FLEX_SPATIAL.replace(
    name="flex-unequal",
    inertia=(0.9, 0.3, 0.7),
    motors=Motors(stall_torque=(8.0, 9.0, 10.0, 11.0, 12.0, 13.0), free_speed=(50.0, 60.0, 70.0, 80.0, 90.0, 100.0)),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06, 0.07, 0.08),
        pulley_inertia=(4e-4, 6e-4, 8e-4, 1e-3, 1.2e-3, 0.0),
        damping=(0.0, 0.01, 0.02, 0.03, 0.04, 0.05),
        stiffness=(2.0, 3.0, 4.0, 5.0, 6.0, 7.0),
        motor_inertia=(9e-4, 8e-4, 7e-4, 6e-4, 5e-4, 4e-4),
        motor_damping=(0.0, 0.005, 0.01, 0.015, 0.02, 0.025),
    ),
)
QUAD = FLEX_PLANAR.replace(
    name="flex-quad",
    base_anchors=((-0.6, -0.3), (0.5, -0.4), (0.4, 0.5), (-0.5, 0.6)),
    motors=Motors(stall_torque=(4.0, 5.0, 6.0, 7.0), free_speed=(50.0, 60.0, 70.0, 80.0)),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06),
        pulley_inertia=(4e-4, 0.0, 8e-4, 1e-3),
        damping=(0.0, 0.01, 0.02, 0.03),
        stiffness=(2.0, 3.0, 4.0, 5.0),
        motor_inertia=(8e-4, 6e-4, 4e-4, 5e-4),
        motor_damping=(0.0, 0.01, 0.02, 0.03),
    ),
    home_pose=(0.05, 0.1),
)
PAPERS = {"CableBot-FlexPlanar-v0": FLEX_PLANAR, "CableBot-FlexSpatial-v0": FLEX_SPATIAL}

the_papers = pytest.mark.parametrize("robot", PAPERS.values(), ids=lambda robot: robot.name)
every_robot = pytest.mark.parametrize("robot", [FLEX_PLANAR, QUAD, FLEX_SPATIAL, UNEQUAL], ids=lambda robot: robot.name)
both_cables = pytest.mark.parametrize("cable", ["unilateral", "bilateral"])
each_id = pytest.mark.parametrize("env_id", PAPERS)


def free_motors(robot):
    """Motors without a line to run into: a demand of τ/τ_s holds the torque τ."""
    return robot.replace(motors=Motors(stall_torque=robot.motors.stall_torque, free_speed=1e100))


def with_transmission(robot, **changes):
    return robot.replace(transmission=dataclasses.replace(robot.transmission, **changes))


@dataclasses.dataclass
class State:
    """A batch of states (N, ...)."""

    pose: np.ndarray
    velocity: np.ndarray
    angle: np.ndarray
    speed: np.ndarray

    def __getitem__(self, members):
        return State(*(value[members] for value in vars(self).values()))


def random_states(robot, count=STATES, seed=1):
    """Poses away from the anchors, springs wound and unwound by 0.02 to 3 rad, and torques of both signs."""
    rng = np.random.default_rng(seed)
    low, high = 0.6 * (robot.pose_bounds - robot.home) + robot.home
    pose = rng.uniform(low, high, (count, robot.coordinates))
    twist = np.geomspace(0.02, 3.0, 200)[rng.integers(200, size=(count, robot.cables))]
    twist *= rng.choice([-1.0, 1.0, 1.0], twist.shape)
    speed = rng.uniform(-30, 30, (count, robot.cables))
    state = State(pose, rng.uniform(-1, 1, pose.shape), textbook.pulley_angle(robot, pose) + twist, speed)
    return state, rng.uniform(-0.9, 0.9, speed.shape) * robot.stall_torque


def held_states(robot, pose, velocity=0.0, minimum=20.0):
    """At rest up to the platform's velocity, springs wound as the robot's weight wants it; and the torques for it."""
    pose = np.atleast_2d(pose)
    velocity = np.broadcast_to(velocity, pose.shape)
    angle = textbook.static_motor_angle(robot, robot.mass, pose, minimum=minimum)
    torques = robot.stiffness * (angle - textbook.pulley_angle(robot, pose))
    return State(pose, velocity, angle, textbook.pulley_speed(robot, pose, velocity)), torques


def off_centre(robot):
    """A pose without symmetry."""
    return np.array([0.05, 0.02] if robot.planar else [0.05, 0.02, 0.15, 0.05, 0.03, 0.02])


def moving(robot):
    """A velocity in all coordinates."""
    return np.array([0.3, -0.4] if robot.planar else [0.2, -0.3, 0.1, 0.4, -0.3, 0.5])


def loaded_plant(robot, state, cable="bilateral", mass=None):
    """A plant at these states, with one total mass or one for each robot."""
    count = len(state.pose)
    plant = Plant(robot, count, cable=cable)
    rows = np.tile(pack_parameters(robot), (count, 1))
    rows[:, kernel.MASS] = robot.mass if mass is None else mass
    plant.set_parameters(np.arange(count), rows)
    plant.set_state(np.arange(count), state.pose, state.velocity)
    if robot.flexible:
        plant.set_motors(np.arange(count), state.angle, state.speed)
    return plant


def state_of(plant):
    motors = plant.motor_angle, plant.motor_speed
    return State(plant.pose, plant.velocity, *motors)


def record_of(plant):
    """The whole record, a row for each robot."""
    tiles = plant.record.reshape(plant.record.shape[0], -1, plant.lanes)
    return tiles.transpose(0, 2, 1).reshape(plant.width, -1)[: plant.count].copy()


def advance(plant, torques, duration, substeps):
    """Constant torques of free motors; nobody reads the errors."""
    references = np.zeros((1, 1, plant.robot.coordinates))
    plant.set_action(np.broadcast_to(torques / plant.robot.stall_torque, (plant.count, plant.robot.cables)))
    plant.advance(references, np.zeros(1, np.int64), substeps=substeps, step=duration / substeps)


def accelerations(robot, state, torques, cable="bilateral", mass=None):
    """Ẍ and β̈′ as :meth:`Plant.advance` makes them: central differences of its velocities, forward and backward."""
    robot, h = free_motors(robot), 4e-5
    platform, motors = 0.0, 0.0
    for multiple, weight in ((1, 45), (-1, -45), (2, -9), (-2, 9), (3, 1), (-3, -1)):
        plant = loaded_plant(robot, state, cable, mass)
        advance(plant, torques, multiple * h, 8)
        moved = state_of(plant)
        platform = platform + weight * (moved.velocity - state.velocity) / (60 * h)
        motors = motors + weight * (moved.speed - state.speed) / (60 * h)
    return platform, motors


def spring_torques(robot, state, cable):
    """κ of physics.md §2."""
    twist = state.angle - textbook.pulley_angle(robot, state.pose)
    return robot.stiffness * (np.maximum(twist, 0.0) if cable == "unilateral" else twist)


def textbook_accelerations(robot, state, torques, cable="bilateral", mass=None):
    """Ẍ, T and β̈′: the rigid robot's equations with κ for the torque, and J′ β̈′ = τ − κ − c′ β̇′ (Eq. 4)."""
    spring = spring_torques(robot, state, cable)
    mass = robot.mass if mass is None else mass
    platform, tension = textbook.forward_dynamics(robot, mass, state.pose, state.velocity, spring, cable=cable)
    return platform, tension, (torques - spring - robot.motor_damping * state.speed) / robot.motor_inertia


def worst_relative_error(found, expected):
    size = np.maximum(1.0, np.linalg.norm(expected, axis=-1))
    return np.max(np.linalg.norm(found - expected, axis=-1) / size)


# --- the paper's values, and refusals -----------------------------------------------------------------------------


@pytest.mark.parametrize(("flexible", "rigid"), [(FLEX_PLANAR, PLANAR), (FLEX_SPATIAL, SPATIAL)])
def test_table_5_excludes_a_flexible_robot_with_other_values(flexible, rigid):
    """J = J′ = 4e-4, half of the rigid robot's each; K = 3 of §5.2.3; Eq. 4 has no damping."""
    assert flexible.transmission == Transmission(
        pulley_radius=0.05, pulley_inertia=4e-4, damping=0.0, stiffness=3.0, motor_inertia=4e-4, motor_damping=0.0
    )
    assert flexible.replace(name=rigid.name, transmission=rigid.transmission) == rigid
    assert flexible.flexible
    assert not rigid.flexible
    assert ROBOTS[f"flex-{rigid.name}"] is flexible
    np.testing.assert_allclose(flexible.pulley_inertia + flexible.motor_inertia, rigid.pulley_inertia, rtol=1e-15)
    for field, value in (("stiffness", 3.0), ("motor_inertia", 4e-4), ("motor_damping", 0.0)):
        np.testing.assert_array_equal(getattr(flexible, field), np.full(rigid.cables, value))
    assert Robot.from_dict(flexible.to_dict()) == flexible


@pytest.mark.parametrize("field", ["stiffness", "motor_inertia", "motor_damping"])
def test_a_refusal_excludes_a_rigid_robot_asked_for_its_springs(field):
    with pytest.raises(ValueError, match=f"planar has a rigid transmission without {field}"):
        getattr(PLANAR, field)


@pytest.mark.parametrize(
    ("rigid", "changes", "message"),
    [
        (True, {"stiffness": 3.0}, "both stiffness and motor_inertia"),
        (True, {"motor_inertia": 4e-4}, "both stiffness and motor_inertia"),
        (True, {"motor_damping": 0.01}, "motor_damping requires a flexible transmission"),
        (False, {"stiffness": None}, "both stiffness and motor_inertia"),
        (False, {"motor_inertia": None}, "both stiffness and motor_inertia"),
        (False, {"stiffness": 0.0}, "stiffness must be greater than 0"),
        (False, {"stiffness": -3.0}, "stiffness must be greater than 0"),
        (False, {"stiffness": math.nan}, "stiffness must be greater than 0"),
        (False, {"stiffness": (3.0, 3.0, 0.0)}, "stiffness must be greater than 0"),
        (False, {"stiffness": (3.0, 3.0)}, "stiffness must be one number or one for each of the 3 motors"),
        (False, {"stiffness": "soft"}, "stiffness must be a number"),
        (False, {"motor_inertia": 0.0}, "motor_inertia must be greater than 0"),
        (False, {"motor_inertia": -4e-4}, "motor_inertia must be greater than 0"),
        (False, {"motor_inertia": math.inf}, "motor_inertia must be greater than 0"),
        (False, {"motor_damping": -0.01}, "motor_damping must be at least 0"),
        (False, {"motor_damping": (0.0, 0.0, -0.01)}, "motor_damping must be at least 0"),
    ],
)
def test_a_refusal_excludes_a_transmission_half_given_or_not_physical(rigid, changes, message):
    with pytest.raises(ValueError, match=message):
        with_transmission(PLANAR if rigid else FLEX_PLANAR, **changes)


# --- equations ----------------------------------------------------------------------------------------------------


@the_papers
def test_energy_excludes_a_fastest_mode_that_the_default_step_damps(robot):
    """A planar robot that swings in its fastest mode alone, nobody driving it: the worst that RK4 meets there."""
    robot = free_motors(robot)
    if not robot.planar:
        robot = robot.replace(gravity=1e-9)  # else it falls, and that is another motion
    turning = textbook.jacobian(robot, robot.home) / robot.pulley_radius[:, None]
    platform = textbook.mass_matrix(robot, robot.mass, robot.home) + turning.T * robot.pulley_inertia @ turning
    twist = np.concatenate([turning, np.eye(robot.cables)], axis=1)
    values, modes = eigh(twist.T * robot.stiffness @ twist, block_diag(platform, np.diag(robot.motor_inertia)))
    assert values[-1] ** 0.5 == pytest.approx(textbook.highest_frequency(robot))
    pose, angle = np.split(1e-3 / np.abs(modes[:, -1]).max() * modes[:, -1], [robot.coordinates])
    start = State((robot.home + pose)[None], np.zeros((1, robot.coordinates)), angle[None], np.zeros((1, robot.cables)))
    plant, kinetic, total = loaded_plant(robot, start), [], []
    step = make_settings(robot=robot, count=1).physics_step
    for _ in range(round(1 / step) + 1):
        moving_energy, stored = energies(robot, state_of(plant), "bilateral")
        kinetic.append(moving_energy[0])
        total.append(moving_energy[0] + stored[0])
        advance(plant, np.zeros((1, robot.cables)), step, 1)
    drift = np.abs(np.array(total) - total[0]).max()
    assert drift < MODE_LOSS["planar" if robot.planar else "spatial"] * max(kinetic)


@both_cables
@every_robot
def test_the_textbook_excludes_a_wrong_spring_in_the_compiled_kernel(robot, cable):
    """Ẍ and T of :meth:`Plant.evaluate`; β̈′ of the motion itself. Reached: 1e-14, and 1e-13 by differences."""
    state, torques = random_states(robot)
    mass = robot.mass * np.linspace(1, 2, STATES)
    platform, tension, motors = textbook_accelerations(robot, state, torques, cable, mass)
    found, pulled = loaded_plant(robot, state, cable, mass).evaluate(torques)
    assert worst_relative_error(found, platform) <= 5e-14
    assert worst_relative_error(pulled, tension) <= 5e-14
    assert worst_relative_error(accelerations(robot, state, torques, cable, mass)[1], motors) <= 1e-10


@pytest.mark.parametrize("payload", [0.0, 3.5])
@every_robot
def test_mujoco_excludes_a_wrong_term_in_textbook_and_kernel_alike(robot, payload):
    """Winches that slide and tendons that stretch, none of our equations. Reached: 2e-12, and 4e-12 by differences."""
    pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")
    state, torques = random_states(robot, seed=2)
    mass = robot.mass + payload
    peer = mujoco_model.MujocoRobot(robot, payload=payload)
    platform, motors = [], []
    for lane in range(STATES):
        peer.set_state(state.pose[lane], state.velocity[lane])
        peer.set_motors(state.angle[lane], state.speed[lane])
        platform.append(peer.accelerations(torques[lane]))
        motors.append(peer.motor_accelerations(torques[lane]))
    platform, motors = np.array(platform), np.array(motors)
    found, _, turned = textbook_accelerations(robot, state, torques, mass=mass)
    assert worst_relative_error(found, platform) <= 1e-11
    assert worst_relative_error(turned, motors) <= 1e-11
    evaluated, _ = loaded_plant(robot, state, mass=mass).evaluate(torques)
    assert worst_relative_error(evaluated, platform) <= 1e-11
    found, turned = accelerations(robot, state, torques, mass=mass)
    assert worst_relative_error(found, platform) <= 1e-10
    assert worst_relative_error(turned, motors) <= 1e-10


@every_robot
def test_mujocos_trajectory_excludes_motors_that_are_integrated_wrongly(robot):
    """100 RK4 steps of both, each a control period of the plant's."""
    pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")
    free, timestep, steps = free_motors(robot), 5e-4, 100
    state, torques = held_states(robot, off_centre(robot), moving(robot))
    torques = 0.7 * torques + 0.02
    peer, plant = mujoco_model.MujocoRobot(robot, timestep=timestep), loaded_plant(free, state)
    peer.set_state(state.pose[0], state.velocity[0])
    peer.set_motors(state.angle[0], state.speed[0])
    peer.step(torques[0], steps)
    for _ in range(steps):
        advance(plant, torques, timestep, 1)
    for found, expected, began in zip(
        vars(state_of(plant)).values(), (*peer.state(), *peer.motors()), vars(state).values(), strict=True
    ):
        assert np.abs(found - began).max() > 1e-3
        size = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(found[0] / size, expected / size, rtol=0, atol=1e-11)


@every_robot
def test_mujocos_start_excludes_springs_that_are_wound_before_anyone_winds_them(robot):
    """Without :meth:`set_motors` the springs are unwound and the motors turn with the pulleys; with it, as told."""
    pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")
    peer = mujoco_model.MujocoRobot(robot)
    np.testing.assert_allclose(peer.motors(), 0, atol=1e-12)
    state, torques = random_states(robot, 20, seed=3)
    for lane in range(20):
        pose, velocity = state.pose[lane], state.velocity[lane]
        peer.set_state(pose, velocity)
        angle, speed = peer.motors()
        np.testing.assert_allclose(angle, textbook.pulley_angle(robot, pose), rtol=0, atol=1e-11)
        np.testing.assert_allclose(speed, textbook.pulley_speed(robot, pose, velocity), rtol=0, atol=1e-11)
        driven = peer.motor_accelerations(torques[lane])
        np.testing.assert_allclose(driven, (torques[lane] - robot.motor_damping * speed) / robot.motor_inertia, 1e-9)
        np.testing.assert_allclose(peer.lengths(), kinematics.cable_lengths(robot.base, robot.platform, pose), 1e-13)
        peer.set_motors(state.angle[lane], state.speed[lane])
        np.testing.assert_allclose(peer.motors(), (state.angle[lane], state.speed[lane]), rtol=1e-14)


def test_a_refusal_excludes_motors_where_mujocos_robot_has_none():
    pytest.importorskip("mujoco", reason="needs the extra cablebot-gym[mujoco]")
    peer, still = mujoco_model.MujocoRobot(PLANAR), np.zeros(3)
    for call in (peer.motors, lambda: peer.set_motors(still, still), lambda: peer.motor_accelerations(still)):
        with pytest.raises(ValueError, match="rigid transmission"):
            call()
    with pytest.raises(ValueError, match=r"shape \(3,\)"):
        mujoco_model.MujocoRobot(FLEX_PLANAR).set_motors(0.0, still)


@every_robot
def test_complementarity_excludes_cables_that_push_and_springs_that_unwind(robot):
    """0 ≤ T ⟂ u ≥ 0 with u = r T − κ + J β̈ + c β̇, κ = K max(β′ − β, 0), from the accelerations alone."""
    state, torques = random_states(robot, 2000, seed=4)
    acceleration, tension = loaded_plant(robot, state, "unilateral").evaluate(torques)
    spring = spring_torques(robot, state, "unilateral")
    take_up = take_up_torques(robot, state, acceleration, tension, spring)
    size = 1 + np.abs(robot.pulley_radius * tension).max() + spring.max(axis=1, keepdims=True)
    taut = tension > 0
    assert 0.1 < taut.mean() < 0.98
    assert np.any(taut & (spring == 0))  # only the pulley's inertia pulls
    assert np.any(~taut & (spring > 0))  # the spring pulls, yet the pulley lags behind
    assert tension.min() >= 0
    assert np.min(np.where(taut, 0, take_up) / size) >= -1e-11
    assert np.max(np.abs(np.where(taut, take_up, 0)) / size) <= 1e-11


def take_up_torques(robot, state, acceleration, tension, spring):
    """u = r T − κ + J β̈ + c β̇."""
    winding = textbook.pulley_acceleration(robot, state.pose, state.velocity, acceleration)
    damping = robot.damping * textbook.pulley_speed(robot, state.pose, state.velocity)
    return robot.pulley_radius * tension - spring + robot.pulley_inertia * winding + damping


# --- batches ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [2, 33])
@both_cables
@every_robot
def test_bits_exclude_a_lane_that_differs_from_a_robot_alone(robot, cable, count):
    """Over slack, clipped motors, unequal masses and a reset half way of the lane that fills up the last tile."""
    state, _ = random_states(robot, count, seed=count)
    mass = robot.mass * np.linspace(1, 1.6, count)
    rng = np.random.default_rng(7)
    demands = rng.uniform(-0.7, 1.3, (8, count, robot.cables))
    references, ends = rng.uniform(*robot.pose_bounds, (1, 25, robot.coordinates)), np.array([24])
    late = count - 1

    def run(members):
        plant = loaded_plant(robot, state[members], cable, mass[members])
        assert plant.lanes == (1 if len(members) == 1 else kernel.LANES)  # else a tile is compared with a tile
        records = []
        for step, action in enumerate(demands):
            if step == 4 and late in members:
                at = np.flatnonzero(members == late)
                plant.set_state(at, state.pose[:1], state.velocity[:1])
                plant.set_motors(at, state.angle[:1], state.speed[:1])
            plant.set_action(action[members])
            plant.advance(references, ends, substeps=4, step=5e-4)
            records.append(record_of(plant))
        return np.stack(records)

    tiled = run(np.arange(count))
    slack = tiled[:, :, kernel.FIRST_CABLE_RECORD + kernel.SLACK :: kernel.CABLE_RECORDS]
    assert count == 2 or 0.02 < np.mean(slack > 0) < 0.98
    assert np.all(np.isfinite(tiled))
    for lane in range(count):
        np.testing.assert_array_equal(run(np.array([lane]))[:, 0], tiled[:, lane])


@every_robot
def test_the_line_excludes_a_drive_that_sees_the_pulleys_speed(robot):
    """Requests and clips stand on the motor's own speed β̇′, not on the pulley's."""
    state, _ = random_states(robot, 40, seed=9)
    action = np.random.default_rng(1).choice([-3.0, -1.0, -0.4, 0.0, 0.7, 1.0, 1.5], (40, robot.cables))
    plant = loaded_plant(robot, state, "unilateral")
    plant.set_action(action)
    plant.advance(np.zeros((1, 1, robot.coordinates)), np.zeros(1, np.int64), substeps=2, step=1e-4)
    np.testing.assert_array_equal(plant.per_cable(kernel.SPEED), state.speed)
    expected = robot.stall_torque * np.clip(action, -1, 1) - robot.speed_slope * state.speed
    np.testing.assert_allclose(plant.per_cable(kernel.TORQUE), expected, rtol=0, atol=1e-14)


# --- the limit of stiff springs -----------------------------------------------------------------------------------

RIGIDITIES = (30.0, 300.0, 3000.0, 30000.0)


def distance_from_rigid(flexible, rigid, stiffness):
    """Largest pose error over 0.3 s under the same torques, cables taut and springs wound to the torques at first."""
    flexible = free_motors(with_transmission(flexible, stiffness=stiffness))
    step = min(1e-4, 0.2 / textbook.highest_frequency(flexible))
    pose, velocity = off_centre(rigid)[None], 0.3 * moving(rigid)[None]
    holding = textbook.required_tensions(rigid, rigid.mass, pose, 0 * pose, 0 * pose, minimum=30.0)
    torques = holding * rigid.pulley_radius * np.linspace(0.93, 1.07, rigid.cables)
    angle = textbook.pulley_angle(rigid, pose) + torques / stiffness
    state = State(pose, velocity, angle, textbook.pulley_speed(rigid, pose, velocity))
    plants = [loaded_plant(robot, state, "unilateral") for robot in (flexible, free_motors(rigid))]
    worst = 0.0
    for _ in range(60):
        for plant in plants:
            advance(plant, torques, 5e-3, math.ceil(5e-3 / step))
            assert np.all(plant.per_cable(kernel.SLACK) == 0)
        worst = max(worst, np.abs(plants[0].pose - plants[1].pose).max())
    assert np.abs(plants[1].pose - pose).max() > 0.02  # it goes somewhere
    return worst


@pytest.mark.parametrize("damping", [0.0, 0.01])
@pytest.mark.parametrize(("flexible", "rigid"), [(FLEX_PLANAR, PLANAR), (FLEX_SPATIAL, SPATIAL)])
def test_stiff_springs_exclude_a_flexible_plant_whose_limit_is_not_the_rigid_one(flexible, rigid, damping):
    """The error against J + J′ and the same c falls as 1/K. Reached: slopes −1.001 to −1.01."""
    flexible, rigid = (with_transmission(robot, damping=damping) for robot in (flexible, rigid))
    errors = [distance_from_rigid(flexible, rigid, stiffness) for stiffness in RIGIDITIES]
    slope = np.polyfit(np.log(RIGIDITIES), np.log(errors), 1)[0]
    assert -1.03 < slope < -0.97
    assert errors[-1] < errors[0] / 500


# --- energy -------------------------------------------------------------------------------------------------------


def energies(robot, state, cable, mass=None):
    """Kinetic energy of platform, pulleys and motors, and the potential energy of weight and springs."""
    mass = robot.mass if mass is None else mass
    translation = state.velocity[..., : 2 if robot.planar else 3]
    kinetic, potential = mass / 2 * np.sum(translation**2, axis=-1), 0.0
    if not robot.planar:
        to_omega = kinematics.euler_rate_matrix(state.pose[..., 3:])
        omega = np.einsum("...ij,...j->...i", to_omega, state.velocity[..., 3:])
        kinetic = kinetic + np.sum(np.array(robot.inertia) * omega**2, axis=-1) / 2
        potential = -mass * robot.gravity * state.pose[..., 2]
    pulley = textbook.pulley_speed(robot, state.pose, state.velocity)
    kinetic = kinetic + np.sum(robot.pulley_inertia * pulley**2 + robot.motor_inertia * state.speed**2, axis=-1) / 2
    stored = np.sum(spring_torques(robot, state, cable) ** 2 / robot.stiffness, axis=-1) / 2
    return kinetic, potential + stored


@pytest.mark.parametrize("held", [False, True], ids=["undriven", "held"])
@the_papers
def test_energy_excludes_an_undriven_plant_that_drifts_at_the_default_step(robot, held):
    """Over 1 s, wound springs let go; or swinging under constant torques, whose potential is −Σ τ β′."""
    step = make_settings(robot=robot, count=1).physics_step
    robot = free_motors(robot)
    state, torques = held_states(robot, off_centre(robot), moving(robot))
    torques = torques if held else 0 * torques
    plant = loaded_plant(robot, state)
    total, kinetic = [], []
    for _ in range(round(1 / step) + 1):
        now = state_of(plant)
        moving_energy, stored = energies(robot, now, "bilateral")
        kinetic.append(moving_energy[0])
        total.append(moving_energy[0] + stored[0] - np.sum(torques * now.angle))
        advance(plant, torques, step, 1)
    drift = np.abs(np.array(total) - total[0]).max()
    assert max(kinetic) > 0.1
    assert drift < 1e-6 * max(kinetic)


@both_cables
@every_robot
def test_the_power_balance_excludes_power_from_nowhere_also_with_stored_slack(robot, cable):
    """d/dt E = Σ τ β̇′ + Σ u β̇ − Σ c β̇² − Σ c′ β̇′², E with Σ ½ K max(β′ − β, 0)²; u from complementarity."""
    damping = tuple(np.linspace(0.01, 0.05, robot.cables).tolist())
    robot = with_transmission(robot, damping=damping, motor_damping=damping[::-1])
    state, torques = random_states(robot, seed=10)
    mass = 1.2 * robot.mass
    platform, tension = loaded_plant(robot, state, cable, mass).evaluate(torques)
    _, motors = accelerations(robot, state, torques, cable, mass)
    take_up = take_up_torques(robot, state, platform, tension, spring_torques(robot, state, cable))
    pulley = textbook.pulley_speed(robot, state.pose, state.velocity)
    if cable == "bilateral":
        np.testing.assert_allclose(take_up, 0, atol=1e-10)
    supplied = np.sum(np.where(tension == 0, take_up, 0.0) * pulley, axis=1)
    spent = np.sum(robot.damping * pulley**2 + robot.motor_damping * state.speed**2, axis=1)
    power = np.sum(torques * state.speed, axis=1) + supplied - spent
    if cable == "unilateral":
        assert np.mean(np.abs(supplied)) > 1  # without it the balance is off by watts
    assert np.median(spent) > 1

    def at(time):
        moved = State(
            state.pose + time * state.velocity + time**2 / 2 * platform,
            state.velocity + time * platform,
            state.angle + time * state.speed + time**2 / 2 * motors,
            state.speed + time * motors,
        )
        return sum(energies(robot, moved, cable, mass))

    h = 4e-5
    rate = (8 * (at(h) - at(-h)) - at(2 * h) + at(-2 * h)) / (12 * h)
    size = 1 + np.sum(np.abs(torques * state.speed), axis=1)
    np.testing.assert_allclose(rate / size, power / size, rtol=0, atol=1e-8)


# --- statics and frequencies --------------------------------------------------------------------------------------


@every_robot
def test_an_equilibrium_excludes_a_wind_up_that_does_not_hold_the_platform(robot):
    """β′ = β + r T/K with τ = r T: nothing accelerates, in poses where all cables pull."""
    rng = np.random.default_rng(5)
    span = 0.15 * (robot.pose_bounds[1] - robot.pose_bounds[0])
    pose = robot.home + rng.uniform(-span, span, (200, robot.coordinates)) * (1.0 if robot.planar else 0.5)
    rest, mass = np.zeros_like(pose), robot.mass + 2.0
    tension = textbook.required_tensions(robot, mass, pose, rest, rest, minimum=5.0)
    torques = robot.pulley_radius * tension
    usable = np.all((tension > 0.1) & (torques < robot.stall_torque), axis=1)
    assert usable.sum() > 50
    pose, rest, tension, torques = pose[usable], rest[usable], tension[usable], torques[usable]
    state = State(pose, rest, textbook.static_motor_angle(robot, mass, pose, minimum=5.0), 0 * tension)
    found, pulled = loaded_plant(robot, state, "unilateral", mass).evaluate(torques)
    np.testing.assert_allclose(found, 0, atol=1e-11)
    np.testing.assert_allclose(pulled, tension, rtol=1e-12)
    np.testing.assert_allclose(accelerations(robot, state, torques, "unilateral", mass)[1], 0, atol=1e-6)
    plant = loaded_plant(free_motors(robot), state, "unilateral", mass)
    advance(plant, torques, 0.02, 40)
    for value, began in zip(vars(state_of(plant)).values(), vars(state).values(), strict=True):
        np.testing.assert_allclose(value, began, rtol=0, atol=1e-9)


def linearised(robot):
    """Eigenvalues of the kernel about home under constant torques, by differences over 2 ms [1/s]."""
    robot, period, nudge = free_motors(robot), 2e-3, 1e-5
    state, torques = held_states(robot, robot.home)
    sizes = np.cumsum([robot.coordinates, robot.coordinates, robot.cables])
    middle = np.concatenate([value[0] for value in vars(state).values()])
    nudged = np.concatenate([middle + nudge * np.eye(len(middle)), middle - nudge * np.eye(len(middle))])
    plant = loaded_plant(robot, State(*np.split(nudged, sizes, axis=1)))
    advance(plant, torques, period, 20)
    ends = np.concatenate(list(vars(state_of(plant)).values()), axis=1)
    step = (ends[: len(middle)] - ends[len(middle) :]).T / (2 * nudge)
    return np.log(np.linalg.eigvals(step).astype(complex)) / period


@every_robot
def test_a_linearisation_excludes_a_wrong_highest_frequency(robot):
    """Within 1 %, which the cables' pretension takes: it is left out of the formula."""
    robot = with_transmission(robot, damping=0.0, motor_damping=0.0)
    rates = linearised(robot)
    assert np.abs(rates.imag).max() == pytest.approx(textbook.highest_frequency(robot), rel=0.01)


def test_the_planar_robots_frequency_excludes_a_formula_that_agrees_only_with_itself():
    """Three equal cables at 120°: SᵀS = 1.5 I, so each direction is one spring between J′ and the rest."""
    found = textbook.highest_frequency(FLEX_PLANAR)
    J, K, r, m = 4e-4, 3.0, 0.05, 1.0
    reflected = J + m * r**2 / 1.5  # the platform, seen from a pulley
    assert found == pytest.approx(max(math.sqrt(K * (1 / J + 1 / reflected)), math.sqrt(K / J)), rel=1e-12)


@pytest.mark.parametrize("robot", [FLEX_PLANAR, QUAD, FLEX_SPATIAL, UNEQUAL], ids=lambda robot: robot.name)
def test_the_measured_order_excludes_an_integrator_below_the_fourth(robot):
    """All four parts of the state; cables that may push, so that nothing has a kink. Reached: 3.9 to 4.26."""
    robot = free_motors(robot)
    state, torques = held_states(robot, off_centre(robot), moving(robot))

    def end(substeps):
        plant = loaded_plant(robot, state)
        advance(plant, 0.8 * torques, 0.1, substeps)
        return list(vars(state_of(plant)).values())

    fine = end(8192)
    errors = [
        np.array([np.abs(value - exact).max() for value, exact in zip(end(substeps), fine, strict=True)])
        for substeps in (64, 128, 256, 512)
    ]
    for coarse, halved in pairwise(errors):
        order = np.log2(coarse / halved)
        assert np.all((order > 3.8) & (order < 4.3)), order


# --- environments -------------------------------------------------------------------------------------------------


@each_id
@pytest.mark.parametrize("vector", [False, True], ids=["single", "vector"])
@pytest.mark.parametrize("changes", [{"stiffness": 3e4}, {"motor_inertia": 1e-6}], ids=["stiff", "light"])
def test_a_refusal_excludes_springs_too_stiff_for_the_substeps(env_id, vector, changes):
    """It names the frequency and the number of substeps that will do; that number does, and one less does not."""
    robot = with_transmission(PAPERS[env_id], **changes)

    def make(**keywords):
        return gym.make_vec(env_id, num_envs=2, **keywords) if vector else gym.make(env_id, **keywords)

    with pytest.raises(ValueError, match="Hz") as refusal:
        make(robot=robot, substeps=1)
    found = re.search(r"oscillate or settle at (\S+) Hz: use at least (\d+)", str(refusal.value))
    assert found is not None, refusal.value
    assert float(found[1]) == pytest.approx(
        max(textbook.highest_frequency(robot), textbook.fastest_motor_rate(robot)) / (2 * math.pi), rel=0.01
    )
    needed = int(found[2])
    assert needed > 1
    make(robot=robot, substeps=needed).close()
    with pytest.raises(ValueError, match=f"use at least {needed}"):
        make(robot=robot, substeps=needed - 1)
    make(robot=robot).close()  # the default takes as many as it needs


@each_id
def test_default_excludes_physics_steps_by_the_million(env_id):
    robot = with_transmission(PAPERS[env_id], motor_inertia=1e-12)
    with pytest.raises(ValueError, match=r"up to \S+ Hz and needs \S+ physics steps in a control period"):
        gym.make(env_id, robot=robot)


@the_papers
def test_the_bound_of_the_substeps_excludes_one_that_refuses_or_admits_the_wrong_steps(robot):
    """At home under holding torques a nudge stays one with the substeps the refusal names, and grows with fewer."""
    stiff = free_motors(with_transmission(robot, stiffness=3e4))
    with pytest.raises(ValueError, match="use at least") as refusal:
        make_settings(robot=stiff, count=1, substeps=1)
    needed = int(re.findall(r"at least (\d+)", str(refusal.value))[0])
    assert make_settings(robot=stiff, count=1, substeps=needed).substeps == needed
    frequency = textbook.highest_frequency(stiff)
    growth = []
    for step in (1 / (500 * needed), 2.9 / frequency):
        state, torques = held_states(stiff, stiff.home)
        plant = loaded_plant(stiff, dataclasses.replace(state, angle=state.angle + 1e-9))
        for _ in range(50):
            advance(plant, torques, 20 * step, 20)
        growth.append(np.abs(state_of(plant).angle - state.angle).max())
    assert growth[0] < 1e-6
    assert not growth[1] < 1e-3


@each_id
def test_the_observation_excludes_motors_and_higher_derivatives_that_are_not_what_they_say(env_id):
    """β′ and β̇′ against a plant of our own under the same commands; jerk and snap against the motion itself."""
    robot, payload = PAPERS[env_id], 0.8
    env = gym.make(env_id, payload=payload, payload_known=False)
    settings, layout = env.unwrapped.settings, env.unwrapped.layout
    assert layout == observation_layout(robot)
    observation, _ = env.reset(seed=3)
    start = settings.trajectory(0.0)
    angle = textbook.static_motor_angle(robot, robot.mass + payload, start.position, minimum=5.0)
    speed = textbook.pulley_speed(robot, start.position, start.velocity)
    state = State(*(np.array([value]) for value in (start.position, start.velocity, angle, speed)))
    plant = loaded_plant(robot, state, "unilateral", robot.mass + payload)
    rng = np.random.default_rng(4)
    holding = robot.stiffness * (angle - textbook.pulley_angle(robot, start.position)) / robot.stall_torque
    seen = []
    for step in range(60):
        blocks = layout.split(observation)
        now = state_of(plant)
        np.testing.assert_array_equal(blocks["motor_angle"], now.angle[0])
        np.testing.assert_array_equal(blocks["motor_speed"], now.speed[0])
        np.testing.assert_array_equal(blocks["pose"], now.pose[0])
        reference = settings.trajectory(step / settings.control_frequency)
        for name in ("jerk", "snap"):
            np.testing.assert_allclose(blocks[f"reference_{name}"], getattr(reference, name), rtol=1e-12, atol=1e-12)
        seen.append(np.concatenate([blocks["motor_angle"], blocks["motor_speed"], blocks["reference_jerk"]]))
        action = (holding + rng.uniform(-0.2, 0.2, robot.cables)).astype(np.float32)
        observation, _, terminated, _, _ = env.step(action)
        assert not terminated
        plant.set_action(action.astype(float)[None])
        pose = np.zeros((1, 1, robot.coordinates))
        plant.advance(pose, np.zeros(1, np.int64), substeps=settings.substeps, step=settings.physics_step)
    moved = np.ptp(seen, axis=0)
    assert np.all(moved[: 2 * robot.cables] > 0)  # no block is constant
    assert moved[2 * robot.cables :].max() > 0
    env.close()


@each_id
def test_differences_exclude_a_jerk_or_snap_of_another_motion(env_id):
    """The observed jerk is the slope of the observed acceleration, the snap that of the jerk."""
    env = gym.make(env_id, payload=0.5, control_frequency=2000.0, termination_radius=1e6)
    layout = env.unwrapped.layout
    observation, _ = env.reset(seed=0)
    rows = [observation]
    for _ in range(200):
        rows.append(env.step(np.zeros(env.action_space.shape, np.float32))[0])
    blocks = layout.split(np.array(rows))
    for lower, higher in (("acceleration", "jerk"), ("jerk", "snap")):
        values, slopes = blocks[f"reference_{lower}"], blocks[f"reference_{higher}"]
        found = (8 * (values[3:-1] - values[1:-3]) - values[4:] + values[:-4]) * 2000 / 12
        size = np.abs(slopes).max()
        assert size > 0.1
        np.testing.assert_allclose(found[1:] / size, slopes[3:-2] / size, rtol=0, atol=1e-6)
    env.close()


@pytest.mark.parametrize("known", [True, False])
@each_id
def test_a_reset_excludes_a_platform_that_drops_because_its_springs_know_the_told_payload(env_id, known):
    """Wound for the true payload, told or not: under the holding torques nothing moves."""
    robot, payload = PAPERS[env_id], 2.0
    env = gym.make(env_id, payload=payload, payload_known=known)
    start = env.unwrapped.settings.trajectory(0.0)
    observation, _ = env.reset(seed=1, options={"payload": payload + 1})
    blocks = env.unwrapped.layout.split(observation)
    expected = textbook.static_motor_angle(robot, robot.mass + payload + 1, start.position, minimum=5.0)
    np.testing.assert_allclose(blocks["motor_angle"], expected, rtol=1e-14)
    np.testing.assert_allclose(
        blocks["motor_speed"], textbook.pulley_speed(robot, start.position, start.velocity), rtol=0, atol=1e-14
    )
    assert blocks["model_payload"] == (payload + 1 if known else 0)
    twist = blocks["motor_angle"] - textbook.pulley_angle(robot, start.position)
    assert twist.min() > 0
    action = robot.stiffness * twist / robot.stall_torque
    for _ in range(5):
        observation, *_, info = env.step(action)
        assert not info["slack"].any()
    moved = env.unwrapped.layout.split(observation)["pose"] - start.position - 0.01 * start.velocity
    assert np.abs(moved).max() < 1e-6
    env.close()


@each_id
def test_a_batch_excludes_a_vector_environment_that_differs_from_the_single_one(env_id):
    """Every bit of observation, reward and info, over payloads, start errors and a next-step reset."""
    robot, count, steps = PAPERS[env_id], 3, 80
    error = tuple([0.002] * robot.coordinates)
    keywords = {"payload_range": (0.0, 1.0), "initial_error_range": error, "payload_known": False}
    keywords |= {"termination_radius": 0.015}
    batch = gym.make_vec(env_id, num_envs=count, **keywords)
    envs = [gym.make(env_id, **keywords) for _ in range(count)]
    observations, _ = batch.reset(seed=5)
    alone = [env.reset(seed=5 + lane)[0] for lane, env in enumerate(envs)]
    rng, ended = np.random.default_rng(6), np.zeros(count, bool)
    episodes = 0
    for _ in range(steps):
        np.testing.assert_array_equal(observations, np.array(alone))
        actions = rng.uniform(-0.4, 1.0, (count, robot.cables)).astype(np.float32)
        observations, rewards, terminations, truncations, infos = batch.step(actions)
        for lane, env in enumerate(envs):
            if ended[lane]:
                alone[lane], _ = env.reset()
                episodes += 1
                continue
            alone[lane], reward, terminated, truncated, info = env.step(actions[lane])
            assert (reward, terminated, truncated) == (rewards[lane], terminations[lane], truncations[lane])
            for name in ("torques", "tensions", "motor_speeds", "slack"):
                np.testing.assert_array_equal(infos[name][lane], info[name])
        ended = terminations | truncations
    assert episodes > 0
    np.testing.assert_array_equal(observations, np.array(alone))
    batch.close()
