"""Elastic cables and swivel pulleys in the compiled plant: a Python loop over the textbook, and
energy."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.elastic import (
    ELASTIC,
    ElasticState,
    elastic_state_of,
    holding_torques,
    plant_at,
    states,
)
from oracles.plants import (
    advance,
    each_of,
    energies,
    free_motors,
    nightly,
    no_reference,
    runge_kutta_step,
    with_transmission,
)

from cablebot_gym.physics import textbook
from cablebot_gym.physics.kernel import rows
from cablebot_gym.robots import Transmission

each_elastic = each_of(ELASTIC[-1], *nightly(*ELASTIC[:-1]))


def rates(robot, state, torques, cable):
    """Rates of a state of a robot with elastic cables, and the tensions, from the textbook."""
    tension, pulling = textbook.cable_springs(
        robot, state.pose, state.velocity, state.pulley, state.pulley_speed, cable=cable
    )
    forces = np.einsum("kmn,km->kn", textbook.jacobian(robot, state.pose), tension)
    forces += textbook.bias(robot, robot.mass, state.pose, state.velocity)
    mass = textbook.mass_matrix(robot, robot.mass, state.pose)
    platform = -np.linalg.solve(mass, forces[..., None])[..., 0]
    load = pulling
    if robot.jointed:
        load = twist = robot.stiffness * (state.angle - state.pulley)
    friction = robot.coulomb_friction + robot.load_friction * np.abs(load)
    driving = torques - friction * state.speed / np.hypot(state.speed, 0.5)
    motor = None
    if robot.jointed:
        motor = (driving - twist - robot.motor_damping * state.speed) / robot.motor_inertia
        driving = twist
    pulley = (driving - robot.damping * state.pulley_speed - pulling) / robot.pulley_inertia
    motor = pulley if motor is None else motor
    return ElasticState(
        state.velocity, platform, state.speed, motor, state.pulley_speed, pulley
    ), tension


# --- equations ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cable", ["unilateral", "bilateral"])
@each_elastic
def test_steps_are_those_of_a_python_loop(robot, cable):
    """Tensions, and RK4 over slack and taut cables with joint springs, swivel pulleys and
    friction."""
    robot = free_motors(robot)
    step = 2e-4
    everyone = states(robot, 6, spread=2.5)
    actions = np.random.default_rng(3).uniform(-0.5, 0.5, (6, robot.cables))
    for members in (np.arange(6), np.array([0])):
        state = everyone[members]
        torques = actions[members] * robot.stall_torque
        plant = plant_at(robot, state, cable)
        slack = 0
        for _ in range(5):
            _, tension = rates(robot, state, torques, cable)
            slack += np.sum(tension <= 0)
            state = runge_kutta_step(
                lambda _, state, u=torques: rates(robot, state, u, cable)[0], state, step
            )
            plant.set_action(actions[members])
            plant.advance(*no_reference(robot), substeps=1, step=step)
            assert_allclose(plant.per_cable(rows.TENSION), tension, rtol=1e-9, atol=1e-7)
            assert_array_equal(plant.per_cable(rows.SLACK), tension <= 0)
        assert slack > 0 or len(members) == 1
        for name, value in vars(elastic_state_of(plant)).items():
            assert_allclose(value, getattr(state, name), rtol=1e-9, atol=1e-9)


# --- energy -------------------------------------------------------------------------------------------------------


def energy(robot, state):
    """Kinetic and potential energy of platform, pulleys, motors and springs, (N,)."""
    massless = Transmission(pulley_radius=0.05, pulley_inertia=0.0)
    platform = sum(energies(robot.replace(transmission=massless), state))
    lengths = textbook.cable_lengths(robot, state.pose) + robot.extra_length
    free = textbook.cable_lengths(robot, robot.home) + robot.extra_length
    free = free - robot.pulley_radius * state.pulley
    strain = np.maximum(lengths / free - 1, 0.0)
    stored = robot.pulley_inertia * state.pulley_speed**2 + robot.axial_stiffness * strain**2 * free
    if robot.jointed:
        stored += robot.motor_inertia * state.speed**2
        stored += robot.stiffness * (state.angle - state.pulley) ** 2
    return platform + np.sum(stored, axis=-1) / 2


@each_elastic
def test_energy_is_kept_while_slack_comes_and_goes(robot):
    """Less the work of constant torques on the motors."""
    undamped = {"damping": 0.0, "axial_damping": 0.0, "coulomb_friction": 0.0, "load_friction": 0.0}
    if robot.jointed:
        undamped["motor_damping"] = 0.0
    robot = with_transmission(free_motors(robot), **undamped)
    state = states(robot, 3, tension=40.0, spread=2.0)
    torques = holding_torques(robot, state)
    plant = plant_at(robot, state)

    def total():
        now = elastic_state_of(plant)
        return energy(robot, now) - np.sum(torques * now.angle, axis=1)

    start = total()
    slack = []
    for _ in range(20):
        advance(plant, torques, 0.01, 200)
        slack.append(plant.per_cable(rows.SLACK) > 0)
        assert_allclose(total(), start, rtol=1e-6, atol=1e-3)
    assert np.abs(plant.pose - state.pose).max() > 0.05
    assert np.any(np.any(slack, axis=0) & ~np.all(slack, axis=0))
