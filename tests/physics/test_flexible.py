"""The flexible transmission: its values, the limit of stiff springs, statics, frequencies, and the environments."""

from __future__ import annotations

import math
import re

import gymnasium as gym
import numpy as np
import pytest
from oracles.plants import (
    State,
    advance,
    energies,
    evaluated,
    flexible_robots,
    free_motors,
    held_states,
    loaded_plant,
    motion_accelerations,
    off_centre,
    papers_flexible,
    state_of,
    with_transmission,
)
from scipy.linalg import block_diag, eigh

from cablebot_gym.envs.settings import make_settings
from cablebot_gym.physics import kernel, textbook
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Transmission

PAPERS = {"CableBot-FlexPlanar-v0": FLEX_PLANAR, "CableBot-FlexSpatial-v0": FLEX_SPATIAL}
each_id = pytest.mark.parametrize("env_id", PAPERS)

# --- values -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("flexible", "rigid"), [(FLEX_PLANAR, PLANAR), (FLEX_SPATIAL, SPATIAL)])
def test_flexible_robots_have_the_values_of_table_5(flexible, rigid):
    """J = J′ = 4e-4, half of the rigid robot's each; K = 3 of §5.2.3; Eq. 4 has no damping."""
    assert flexible.transmission == Transmission(
        pulley_radius=0.05, pulley_inertia=4e-4, damping=0.0, stiffness=3.0, motor_inertia=4e-4, motor_damping=0.0
    )
    assert flexible.replace(name=rigid.name, transmission=rigid.transmission) == rigid
    np.testing.assert_array_equal(flexible.stiffness, np.full(rigid.cables, 3.0))
    with pytest.raises(ValueError, match="has a transmission without motor_damping"):
        _ = rigid.motor_damping


@pytest.mark.parametrize(
    ("robot", "changes", "message"),
    [
        (PLANAR, {"stiffness": 3.0}, "needs stiffness and motor_inertia"),
        (PLANAR, {"motor_damping": 0.01}, "has no motor_damping"),
        (FLEX_PLANAR, {"motor_inertia": None}, "needs stiffness and motor_inertia"),
        (FLEX_PLANAR, {"stiffness": (3.0, 3.0, 0.0)}, "stiffness must be finite and greater than 0"),
        (FLEX_PLANAR, {"stiffness": (3.0, 3.0)}, "stiffness must be one number or one for each of the 3 motors"),
        (FLEX_PLANAR, {"motor_inertia": math.inf}, "motor_inertia must be finite and greater than 0"),
        (FLEX_PLANAR, {"motor_damping": -0.01}, "motor_damping must be finite and at least 0"),
    ],
)
def test_unphysical_transmission_raises(robot, changes, message):
    with pytest.raises(ValueError, match=message):
        with_transmission(robot, **changes)


# --- the limit of stiff springs -----------------------------------------------------------------------------------

RIGIDITIES = (30.0, 300.0, 3000.0)


def distance_from_rigid(flexible, rigid, stiffness):
    """Largest pose error over 0.3 s under the same torques, cables taut and springs wound to the torques at first."""
    flexible = free_motors(with_transmission(flexible, stiffness=stiffness))
    step = min(1e-4, 0.2 / textbook.highest_frequency(flexible))
    pose, velocity = (value[None] for value in off_centre(rigid))
    velocity = 0.3 * velocity
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
def test_stiff_springs_approach_the_rigid_plant(flexible, rigid, damping):
    """The error against J + J′ and the same c falls as 1/K. Reached: slopes −1.001 to −1.01."""
    flexible, rigid = (with_transmission(robot, damping=damping) for robot in (flexible, rigid))
    errors = [distance_from_rigid(flexible, rigid, stiffness) for stiffness in RIGIDITIES]
    assert -1.03 < np.polyfit(np.log(RIGIDITIES), np.log(errors), 1)[0] < -0.97


# --- statics and frequencies --------------------------------------------------------------------------------------


@flexible_robots
def test_wound_springs_hold_the_platform(robot):
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
    found, pulled = evaluated(loaded_plant(robot, state, "unilateral", mass), torques)
    np.testing.assert_allclose(found, 0, atol=1e-11)
    np.testing.assert_allclose(pulled, tension, rtol=1e-12)
    np.testing.assert_allclose(motion_accelerations(robot, state, torques, "unilateral", mass)[1], 0, atol=1e-6)


@flexible_robots
def test_highest_frequency_is_that_of_the_linearised_kernel(robot):
    """Within 1 %, which the pretension of the cables takes: the formula leaves it out."""
    robot = free_motors(with_transmission(robot, damping=0.0, motor_damping=0.0))
    period, nudge = 2e-3, 1e-5
    state, torques = held_states(robot, robot.home)
    sizes = np.cumsum([robot.coordinates, robot.coordinates, robot.cables])
    middle = np.concatenate([value[0] for value in vars(state).values()])
    nudged = np.concatenate([middle + nudge * np.eye(len(middle)), middle - nudge * np.eye(len(middle))])
    plant = loaded_plant(robot, State(*np.split(nudged, sizes, axis=1)))
    advance(plant, torques, period, 20)
    ends = np.concatenate(list(vars(state_of(plant)).values()), axis=1)
    step = (ends[: len(middle)] - ends[len(middle) :]).T / (2 * nudge)
    rates = np.log(np.linalg.eigvals(step).astype(complex)) / period
    assert np.abs(rates.imag).max() == pytest.approx(textbook.highest_frequency(robot), rel=0.01)


@papers_flexible
def test_default_step_keeps_the_energy_of_the_fastest_mode(robot):
    """The robot swings in its fastest mode alone, undriven: the worst case of RK4."""
    robot = free_motors(robot)
    if not robot.planar:
        robot = robot.replace(gravity=1e-9)  # otherwise it falls
    turning = textbook.jacobian(robot, robot.home) / robot.pulley_radius[:, None]
    platform = textbook.mass_matrix(robot, robot.mass, robot.home) + turning.T * robot.pulley_inertia @ turning
    twist = np.concatenate([turning, np.eye(robot.cables)], axis=1)
    values, modes = eigh(twist.T * robot.stiffness @ twist, block_diag(platform, np.diag(robot.motor_inertia)))
    assert values[-1] ** 0.5 == pytest.approx(textbook.highest_frequency(robot))
    pose, angle = np.split(1e-3 / np.abs(modes[:, -1]).max() * modes[:, -1], [robot.coordinates])
    start = State((robot.home + pose)[None], np.zeros((1, robot.coordinates)), angle[None], np.zeros((1, robot.cables)))
    plant, found = loaded_plant(robot, start), []
    step = make_settings(robot=robot, count=1).physics_step
    for _ in range(round(1 / step) + 1):
        found.append(energies(robot, state_of(plant)))
        advance(plant, np.zeros((1, robot.cables)), step, 1)
    kinetic, total = np.array(found)[:, 0, 0], np.sum(found, axis=1)[:, 0]
    assert np.abs(total - total[0]).max() < (1e-6 if robot.planar else 1e-5) * kinetic.max()


# --- environments -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("changes", [{"stiffness": 3e4}, {"motor_inertia": 1e-6}], ids=["stiff", "light"])
@each_id
def test_springs_too_stiff_for_the_substeps_raise(env_id, changes):
    """The message names the number of substeps that suffices; one less does not."""
    robot = with_transmission(PAPERS[env_id], **changes)
    with pytest.raises(ValueError, match="use at least") as refusal:
        gym.make_vec(env_id, num_envs=2, robot=robot, substeps=1)
    needed = int(re.findall(r"at least (\d+)", str(refusal.value))[0])
    make_settings(robot=robot, count=1, substeps=needed)
    with pytest.raises(ValueError, match=f"use at least {needed}"):
        gym.make(env_id, robot=robot, substeps=needed - 1)
    make_settings(robot=robot, count=1)  # the default takes as many as it needs
    with pytest.raises(ValueError, match="physics steps in a control period"):
        make_settings(robot=with_transmission(robot, motor_inertia=1e-12), count=1)


@papers_flexible
def test_least_substeps_are_stable_and_larger_steps_are_not(robot):
    """At home under holding torques a nudge stays one with the substeps that the error names."""
    stiff = free_motors(with_transmission(robot, stiffness=3e4))
    with pytest.raises(ValueError, match="use at least") as refusal:
        make_settings(robot=stiff, count=1, substeps=1)
    needed = int(re.findall(r"at least (\d+)", str(refusal.value))[0])
    growth = []
    for step in (1 / (500 * needed), 2.9 / textbook.highest_frequency(stiff)):
        state, torques = held_states(stiff, stiff.home)
        plant = loaded_plant(stiff, State(state.pose, state.velocity, state.angle + 1e-9, state.speed))
        for _ in range(50):
            advance(plant, torques, 20 * step, 20)
        growth.append(np.abs(plant.motor_angle - state.angle).max())
    assert growth[0] < 1e-6
    assert not growth[1] < 1e-3


@each_id
def test_observation_holds_the_motors_and_the_higher_derivatives(env_id):
    """β′ and β̇′ against a plant of our own under the same actions; jerk and snap against the motion itself."""
    robot, payload = PAPERS[env_id], 0.8
    env = gym.make(env_id, payload=payload, payload_known=False, initial_error=0.0)
    settings, layout = env.unwrapped.settings, env.unwrapped.layout
    observation, _ = env.reset(seed=3)
    start = settings.trajectory(0.0)
    angle = layout.split(observation)["motor_angle"].copy()
    static = textbook.static_motor_angle(robot, robot.mass + payload, start.position, minimum=5.0)
    np.testing.assert_allclose(angle, static, rtol=1e-13)
    speed = textbook.pulley_speed(robot, start.position, start.velocity)
    state = State(*(np.array([value]) for value in (start.position, start.velocity, angle, speed)))
    plant = loaded_plant(robot, state, "unilateral", robot.mass + payload)
    rng = np.random.default_rng(4)
    holding = robot.stiffness * (angle - textbook.pulley_angle(robot, start.position)) / robot.stall_torque
    for step in range(40):
        blocks = layout.split(observation)
        for name in ("motor_angle", "motor_speed", "pose"):
            np.testing.assert_array_equal(blocks[name], getattr(plant, name)[0])
        reference = settings.trajectory(step / settings.control_frequency)
        for name in ("jerk", "snap"):
            np.testing.assert_allclose(blocks[f"reference_{name}"], getattr(reference, name), rtol=1e-12, atol=1e-12)
        action = (holding + rng.uniform(-0.2, 0.2, robot.cables)).astype(np.float32)
        observation, _, terminated, _, _ = env.step(action)
        assert not terminated
        plant.set_action(action.astype(float)[None])
        no_pose = np.zeros((1, 1, robot.coordinates))
        plant.advance(no_pose, np.zeros(1, np.int64), substeps=settings.substeps, step=settings.physics_step)
    assert np.all(plant.motor_angle != angle)
    env.close()
