"""Elastic cables and swivel pulleys in the compiled plant: the textbook, energy, limits and MuJoCo."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from numba import njit
from oracles.plants import evaluated, free_motors, no_reference, with_transmission, worst_relative_error
from oracles.platforms import CAMERA, CRANE, HANGING, TURNING

from cablebot_gym.envs.settings import make_settings
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.kinematics import turned
from cablebot_gym.physics import kernel, textbook
from cablebot_gym.physics.kernel.arithmetic import atan2
from cablebot_gym.physics.plant import Plant
from cablebot_gym.trajectories import Dwell

JOINTS = {"stiffness": 400.0, "motor_inertia": 3e-3, "motor_damping": 0.01}
ELASTIC = (
    with_transmission(HANGING, axial_stiffness=2e4, axial_damping=40.0, extra_length=0.5),
    with_transmission(TURNING, axial_stiffness=(2e4, 3e4, 1e4, 2e4, 5e4), **JOINTS),
    with_transmission(CAMERA, axial_stiffness=2e4, coulomb_friction=0.3).replace(swivel_radius=(0.1, 0.05, 0.0, 0.1)),
    with_transmission(CRANE, axial_stiffness=1e5, axial_damping=20.0, **JOINTS).replace(swivel_radius=0.05),
)
SWIVELLED = (CRANE.replace(swivel_radius=0.05), with_transmission(CAMERA, **JOINTS).replace(swivel_radius=0.1))
each_elastic = pytest.mark.parametrize("robot", ELASTIC, ids=lambda robot: robot.name)


@dataclasses.dataclass
class State:
    """States (N, ...) of platform, motors and pulleys; without joint springs the motors' are those of the pulleys."""

    pose: np.ndarray
    velocity: np.ndarray
    motor: np.ndarray
    motor_speed: np.ndarray
    pulley: np.ndarray
    pulley_speed: np.ndarray

    def moved(self, rate, time):
        return State(*(one + time * other for one, other in zip(vars(self).values(), vars(rate).values(), strict=True)))


def states(robot, count, tension=400.0, spread=1.0, seed=1):
    """Random states near home whose tensions lie between ``1 − spread`` and ``1 + spread`` of ``tension``."""
    random = np.random.default_rng(seed)
    size = (count, robot.coordinates)
    pose, velocity = robot.home + random.uniform(-0.15, 0.15, size), random.normal(size=size) / 3
    tensions = tension * (1 + spread * random.uniform(-1, 1, (count, robot.cables)))
    motor, pulley = textbook.rest_angles(robot, tensions, pose) if robot.elastic else (np.zeros_like(tensions),) * 2
    if robot.jointed and not robot.elastic:
        motor = textbook.pulley_angle(robot, pose) + robot.pulley_radius * tensions / robot.stiffness
    speed = textbook.pulley_speed(robot, pose, velocity)
    return State(pose, velocity, motor, speed.copy(), pulley, speed)


def plant_at(robot, state, cable="unilateral"):
    plant, every = Plant(robot, len(state.pose), cable=cable), np.arange(len(state.pose))
    plant.set_state(every, state.pose, state.velocity)
    if robot.flexible:
        plant.set_motors(every, state.motor, state.motor_speed)
    if robot.elastic and robot.jointed:
        plant.set_pulleys(every, state.pulley, state.pulley_speed)
    return plant


def state_of(plant):
    parts = (plant.motor_angle, plant.motor_speed, plant.pulley_angle, plant.pulley_speed)
    return State(plant.pose, plant.velocity, *parts)


def rates(robot, state, torques, cable="unilateral"):
    """Rates of a state of a robot with elastic cables, and the tensions, from the textbook."""
    tension, pulling = textbook.cable_springs(
        robot, state.pose, state.velocity, state.pulley, state.pulley_speed, cable=cable
    )
    pulls = np.einsum("kmn,km->kn", textbook.jacobian(robot, state.pose), tension)
    forces = pulls + textbook.bias(robot, robot.mass, state.pose, state.velocity)
    platform = -np.linalg.solve(textbook.mass_matrix(robot, robot.mass, state.pose), forces[..., None])[..., 0]
    drive = torques - textbook.coulomb_torque(robot, state.motor_speed)
    motor = twist = drive
    if robot.jointed:
        twist = robot.stiffness * (state.motor - state.pulley)
        motor = (drive - twist - robot.motor_damping * state.motor_speed) / robot.motor_inertia
    pulley = (twist - robot.damping * state.pulley_speed - pulling) / robot.pulley_inertia
    if not robot.jointed:
        motor = pulley
    return State(state.velocity, platform, state.motor_speed, motor, state.pulley_speed, pulley), tension


def energy(robot, state):
    """Kinetic and potential energy of platform, pulleys, motors and springs, (N,)."""
    center = state.pose[..., : robot.dimensions] + turned(state.pose, robot.mass_center[None])[..., 0, :]
    momentum = (textbook.mass_matrix(robot, robot.mass, state.pose) @ state.velocity[..., None])[..., 0]
    total = np.sum(momentum * state.velocity, axis=-1) / 2 - robot.mass * center @ robot.gravity_vector
    free = textbook.cable_lengths(robot, robot.home) + robot.extra_length - robot.pulley_radius * state.pulley
    strain = np.maximum((textbook.cable_lengths(robot, state.pose) + robot.extra_length) / free - 1, 0.0)
    total += (
        np.sum(robot.pulley_inertia * state.pulley_speed**2 + robot.axial_stiffness * strain**2 * free, axis=-1) / 2
    )
    if robot.jointed:
        twist = robot.stiffness * (state.motor - state.pulley) ** 2
        total += np.sum(robot.motor_inertia * state.motor_speed**2 + twist, axis=-1) / 2
    return total


def lossless(robot):
    changes = {"damping": 0.0, "axial_damping": 0.0, "coulomb_friction": 0.0}
    return with_transmission(free_motors(robot), **changes, **({"motor_damping": 0.0} if robot.jointed else {}))


def held(plant, torques, duration, substeps):
    """Advances under constant torques, for which the motors are strong enough."""
    plant.set_action(torques / plant.robot.stall_torque)
    plant.advance(*no_reference(plant.robot), substeps=substeps, step=duration / substeps)


def holding_torques(robot, state):
    """Torques (N, m) on the motors that the cables balance."""
    zero = 0 * state.velocity
    return textbook.cable_springs(robot, state.pose, zero, state.pulley, 0 * state.pulley)[1]


# --- equations ----------------------------------------------------------------------------------------------------


def test_arctangent_is_right_to_the_last_digits():
    random = np.random.default_rng(0)
    arctangent = njit(lambda y, x: atan2(y, x))
    for y, x in [
        *random.normal(size=(4000, 2)).tolist(),
        (0.0, 1.0),
        (1.0, 0.0),
        (-1.0, 0.0),
        (1.0, 1.0),
        (1e-9, -1.0),
    ]:
        assert abs(arctangent(y, x) - math.atan2(y, x)) <= 2 * math.ulp(math.atan2(y, x)) + 1e-17


@pytest.mark.parametrize("cable", ["unilateral", "bilateral"])
@each_elastic
def test_steps_are_those_of_a_python_loop(robot, cable):
    """Tensions, and RK4 over slack and taut cables with joint springs, swivel pulleys and friction."""
    robot, step, count = free_motors(robot), 2e-4, 6
    state = states(robot, count, spread=2.5)
    torques = np.random.default_rng(3).uniform(-0.5, 0.5, (count, robot.cables)) * robot.stall_torque
    for members in (np.arange(count), np.array([0])):
        start = State(*(value[members] for value in vars(state).values()))
        plant, expected = plant_at(robot, start, cable), start
        slack = 0.0
        for _ in range(5):
            first, tension = rates(robot, expected, torques[members], cable)
            slack += np.mean(tension <= 0)
            rate, parts = first, [first]
            for fraction in (0.5, 0.5, 1.0):
                middle = expected.moved(rate, fraction * step)
                rate, _ = rates(robot, middle, torques[members], cable)
                parts.append(rate)
            for part, weight in zip(parts, (1, 2, 2, 1), strict=True):
                expected = expected.moved(part, weight * step / 6)
            plant.set_action(torques[members] / robot.stall_torque)
            plant.advance(*no_reference(robot), substeps=1, step=step)
            np.testing.assert_allclose(plant.per_cable(kernel.TENSION), tension, rtol=1e-9, atol=1e-7)
            np.testing.assert_array_equal(plant.per_cable(kernel.SLACK), tension <= 0)
        assert slack > 0 or len(members) == 1
        for found, value in zip(vars(state_of(plant)).values(), vars(expected).values(), strict=True):
            np.testing.assert_allclose(found, value, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("robot", SWIVELLED, ids=lambda robot: robot.name)
def test_swivel_pulleys_are_those_of_the_textbook(robot):
    """Directions, bias, and lengths, which wind the joint springs of the second robot."""
    state = states(robot, 100)
    torques = np.random.default_rng(3).uniform(-1, 1, (100, robot.cables)) * robot.stall_torque
    at_pulley = robot.stiffness * (state.motor - textbook.pulley_angle(robot, state.pose)) if robot.jointed else torques
    expected, tension = textbook.forward_dynamics(
        robot, robot.mass, state.pose, state.velocity, at_pulley, cable="bilateral"
    )
    found, pulled = evaluated(plant_at(robot, state, "bilateral"), torques)
    assert worst_relative_error(found, expected) <= 1e-11
    assert worst_relative_error(pulled, tension) <= 1e-11


# --- energy -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("tension", "spread"), [(400.0, 0.2), (40.0, 2.0)], ids=["taut", "slack"])
@each_elastic
def test_energy_is_kept_while_slack_comes_and_goes(robot, tension, spread):
    """Less the work of constant torques on the motors."""
    robot = lossless(robot)
    state = states(robot, 3, tension=tension, spread=spread)
    torques, plant, slack = holding_torques(robot, state), plant_at(robot, state), []

    def total():
        now = state_of(plant)
        return energy(robot, now) - np.sum(torques * now.motor, axis=1)

    began = total()
    for _ in range(20):
        held(plant, torques, 0.01, 200)
        slack.append(plant.per_cable(kernel.SLACK) > 0)
        np.testing.assert_allclose(total(), began, rtol=1e-6, atol=1e-3)
    assert np.abs(plant.pose - state.pose).max() > 0.05
    assert spread < 1 or np.any(np.any(slack, axis=0) & ~np.all(slack, axis=0))


@each_elastic
def test_order_is_four_while_the_cables_are_taut(robot):
    robot = lossless(robot)
    state = states(robot, 2, spread=0.1)
    torques, first = holding_torques(robot, state), 0.25 / textbook.highest_frequency(robot)

    def end(steps):
        plant = plant_at(robot, state)
        held(plant, torques, 8 * first, 8 * steps)
        assert not plant.per_cable(kernel.SLACK).any()
        return np.concatenate([value.ravel() for value in vars(state_of(plant)).values()])

    fine = end(128)
    errors = [np.abs(end(steps) - fine).max() for steps in (2, 4, 8)]
    for coarse, halved in pairwise(errors):
        assert 3.7 < np.log2(coarse / halved) < 4.5


# --- limits -------------------------------------------------------------------------------------------------------

STIFFNESSES = (1e5, 1e6, 1e7)


def distance(robot, other, start, step):
    """Largest difference of the poses of two robots over 0.1 s from states of rest."""
    plants = [plant_at(free_motors(one), start(one)) for one in (robot, other)]
    torques = textbook.static_torque(other, other.mass, other.home, minimum=60.0) * np.linspace(0.9, 1.1, other.cables)
    worst = 0.0
    for _ in range(10):
        for plant in plants:
            plant.set_action(torques[None] / plant.robot.stall_torque)
            plant.advance(*no_reference(robot), substeps=math.ceil(0.01 / step), step=0.01 / math.ceil(0.01 / step))
            assert not plant.per_cable(kernel.SLACK).any()
        worst = max(worst, np.abs(plants[0].pose - plants[1].pose).max())
    assert np.abs(plants[1].pose - other.home).max() > 1e-3
    return worst


def at_rest(robot, holding, minimum=60.0):
    pose = robot.home[None]
    tensions = textbook.required_tensions(holding, holding.mass, pose, 0 * pose, 0 * pose, minimum=minimum)
    motor, pulley = textbook.rest_angles(robot, tensions, pose) if robot.flexible else (0 * tensions, 0 * tensions)
    return State(pose, 0 * pose, motor, 0 * motor, pulley, 0 * pulley)


@pytest.mark.parametrize("robot", [HANGING, CRANE], ids=lambda robot: robot.name)
def test_stiff_cables_approach_the_rigid_robot(robot):
    """The error falls as 1/EA. Damped cables, as the rigid robot has no waves."""
    errors = []
    for stiffness in STIFFNESSES:
        elastic = with_transmission(robot, axial_stiffness=stiffness)
        step = 0.3 / textbook.highest_frequency(elastic)
        errors.append(distance(elastic, robot, lambda one: at_rest(one, robot), step))
    assert -1.1 < np.polyfit(np.log(STIFFNESSES), np.log(errors), 1)[0] < -0.9


def test_stiff_joints_approach_the_robot_with_rigid_joints():
    """Motor and pulley turn together: their inertias add."""
    single = with_transmission(HANGING, axial_stiffness=2e4)
    stiffnesses, errors = (1e4, 1e5, 1e6), []
    for stiffness in stiffnesses:
        changes = {"stiffness": stiffness, "pulley_inertia": 1e-3, "motor_inertia": 3e-3}
        double = with_transmission(single, **changes)
        step = 0.3 / textbook.highest_frequency(double)
        errors.append(distance(double, single, lambda one: at_rest(one, HANGING), step))
    assert -1.1 < np.polyfit(np.log(stiffnesses), np.log(errors), 1)[0] < -0.9


# --- environments -------------------------------------------------------------------------------------------------


@each_elastic
def test_episode_starts_at_rest_with_the_true_payload(robot):
    motion = Dwell(name="stay", pose=robot.home_pose)
    env = CableBotEnv(robot=robot, trajectory=motion, initial_error=0, payload=1.0)
    _, info = env.reset(seed=1)
    for _ in range(50):
        _, _, _, _, info = env.step(info["torques"] / robot.stall_torque)
    assert info["tracking_error"] < 1e-9
    assert info["tensions"].min() > 1.0


@each_elastic
def test_default_substeps_keep_stiff_cables_stable(robot):
    robot = with_transmission(robot, axial_stiffness=5e5)
    settings = make_settings(robot=robot, count=1, trajectory=Dwell(name="stay", pose=robot.home_pose))
    state = at_rest(robot, robot, 20.0)
    plant = plant_at(robot, dataclasses.replace(state, velocity=state.velocity + 1e-3))
    torques = holding_torques(robot, state)
    for _ in range(100):
        held(plant, torques, settings.period, settings.substeps)
    assert np.abs(plant.pose - robot.home).max() < 1e-2
