"""The plant against what no equation of it states: energy and power."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.plants import (
    State,
    advance,
    both_cables,
    differentiated,
    drive_speed,
    each_of,
    energies,
    evaluated,
    every_kind,
    free_motors,
    friction_torques,
    loaded_plant,
    random_states,
    state_of,
    take_up_torques,
    textbook_rates,
    with_transmission,
)
from scipy.linalg import eigh

from cablebot_gym.envs.settings import make_settings
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL


@both_cables
@every_kind
def test_power_is_balanced_also_with_slack_cables(robot, cable):
    """d/dt E = Σ τ β̇′ + Σ u β̇ − Σ c β̇² − Σ c′ β̇′² − Σ (τ_c + μ load) |β̇′|, u from complementarity; rigid:
    β′ = β, c′ = 0.

    At low speeds |β̇′| is smooth.
    """
    damping = np.linspace(0.01, 0.05, robot.cables).tolist()
    robot = with_transmission(robot, damping=tuple(damping))
    if robot.flexible:
        robot = with_transmission(robot, motor_damping=tuple(damping[::-1]))
    state, action = random_states(robot, 200, seed=10)
    torques = action * robot.stall_torque
    mass = 1.2 * robot.mass
    platform, tension = evaluated(loaded_plant(robot, state, cable, mass), torques)
    motors = textbook_rates(robot, state, torques, cable, mass)[0].speed
    take_up = take_up_torques(robot, state, torques, platform, tension, cable)
    assert_allclose(take_up[(tension > 0) | (cable == "bilateral")], 0, atol=1e-10)
    pulley = textbook.pulley_speed(robot, state.pose, state.velocity)
    motor = drive_speed(robot, state)
    supplied = np.where(tension == 0, take_up, 0.0) * pulley
    # Without it the balance is off by watts.
    assert (np.mean(np.abs(supplied.sum(axis=1))) > 1) == (cable == "unilateral")
    spent = robot.damping * pulley**2
    spent += friction_torques(robot, state, torques, tension, cable) * motor
    if robot.flexible:
        spent += robot.motor_damping * motor**2
    power = np.sum(torques * motor + supplied - spent, axis=1)

    def energy(time):
        half_way = State(
            state.velocity + time / 2 * platform, platform, state.speed + time / 2 * motors, motors
        )
        return sum(energies(robot, state.moved(half_way, time), cable, mass))

    change = differentiated(energy, 4e-5 if robot.flexible else 2e-4)
    size = 1 + np.sum(np.abs(torques * motor), axis=1)
    assert_allclose(change / size, power / size, rtol=0, atol=1e-8)


@each_of(FLEX_PLANAR, FLEX_SPATIAL)
def test_default_step_keeps_the_energy_of_the_fastest_mode(robot):
    """The robot swings in its fastest mode alone, undriven: the worst case of RK4."""
    robot = free_motors(robot)
    if not robot.planar:
        robot = robot.replace(gravity=1e-9)  # otherwise it falls
    model = textbook.linear_model(robot)
    values, modes = eigh(model.stiffness, model.inertia)
    assert values[-1] ** 0.5 == pytest.approx(textbook.highest_frequency(robot))
    pose, angle = np.split(
        1e-3 / np.abs(modes[:, -1]).max() * modes[None, :, -1], [robot.coordinates], 1
    )
    still = 0 * angle
    plant = loaded_plant(robot, State(robot.home + pose, 0 * pose, angle, still))
    step = make_settings(robot=robot, count=1).physics_step
    history = []
    for _ in range(round(1 / step) + 1):
        history.append(energies(robot, state_of(plant)))
        advance(plant, still, step, 1)
    kinetic, potential = np.array(history)[..., 0].T
    total = kinetic + potential
    largest_loss = 1e-6 if robot.planar else 1e-5
    assert np.abs(total - total[0]).max() < largest_loss * kinetic.max()
