"""The paper's flexible transmission, linear models of small motions against the equations of motion, and the physics
steps that the frequencies need."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles.plants import (
    FLEX_HANGING,
    ROUGH,
    State,
    drive_speed,
    each_of,
    free_motors,
    textbook_rates,
    with_transmission,
)
from oracles.platforms import CAMERA, SWIVELLED, TURNING
from scipy.linalg import eigh

from cablebot_gym.envs.settings import make_settings
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Transmission


@pytest.mark.parametrize(("flexible", "rigid"), [(FLEX_PLANAR, PLANAR), (FLEX_SPATIAL, SPATIAL)])
def test_flexible_robots_have_the_values_of_table_5(flexible, rigid):
    """J = J′ = 4e-4, half of the rigid robot's each; K = 3 of §5.2.3; Eq. 4 has no damping."""
    assert flexible.transmission == Transmission(
        pulley_radius=0.05,
        pulley_inertia=4e-4,
        damping=0.0,
        stiffness=3.0,
        motor_inertia=4e-4,
        motor_damping=0.0,
    )
    assert flexible.replace(name=rigid.name, transmission=rigid.transmission) == rigid
    with pytest.raises(ValueError, match="has a transmission without motor_damping"):
        _ = rigid.motor_damping


# --- frequencies --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "changes"),
    [
        (FLEX_SPATIAL, {"stiffness": 3e4}),
        (FLEX_SPATIAL, {"motor_inertia": 1e-6}),
        (FLEX_SPATIAL, {"coulomb_friction": 30.0}),
        (PLANAR, {"coulomb_friction": 30.0}),
    ],
)
def test_named_substeps_are_the_fewest_stable_ones(robot, changes):
    """RK4 is stable if a step is below 2.78 divided by the largest eigenvalue; 2.6 leaves a
    margin."""
    robot = free_motors(with_transmission(robot, **changes))
    with pytest.raises(ValueError, match="use at least") as refusal:
        make_settings(robot=robot, count=1, substeps=1)
    least = int(re.findall(r"at least (\d+)", str(refusal.value))[0])
    assert make_settings(robot=robot, count=1).substeps >= least > 1
    eigenvalues = np.linalg.eigvals(textbook.linearise(robot, robot.home, 0.0).A)
    fastest = np.abs(eigenvalues).max()
    assert fastest / (500 * least) < 2.6 < fastest / (500 * (least - 1))
    with pytest.raises(ValueError, match="physics steps in a control period"):
        make_settings(robot=with_transmission(FLEX_SPATIAL, motor_inertia=1e-12), count=1)


@each_of(FLEX_PLANAR, FLEX_SPATIAL)
def test_default_step_keeps_the_energy_of_the_fastest_mode(robot):
    """Undriven, in one second. In a step, RK4 multiplies the energy of a mode by 1 − φ⁶/72, where φ
    is the change of its phase."""
    model = textbook.linear_model(robot)
    frequency = eigh(model.stiffness, model.inertia, eigvals_only=True)[-1] ** 0.5
    assert frequency == pytest.approx(textbook.highest_frequency(robot))
    step = make_settings(robot=robot, count=1).physics_step
    assert (frequency * step) ** 6 / 72 / step < 1e-5


PAYLOAD = 2.5
SOFT = {"axial_stiffness": 2e4, "extra_length": 0.3}
SPRINGS = {"stiffness": 900.0, "motor_inertia": 1e-3}
ROBOTS = [PLANAR, *ROUGH, FLEX_HANGING]
for name, springs in (("soft", SOFT), ("sprung", SPRINGS)):
    for robot in (CAMERA, SWIVELLED, TURNING):
        ROBOTS.append(with_transmission(robot, **springs).replace(name=f"{name}-{robot.name}"))


def rates_of(robot, mass, states, actions):
    """Rates (N, k) of states, which are the pose and the angles of the motors of flexible robots, and
    their rates."""
    positions, rates = np.hsplit(states, 2)
    pose, angle = np.split(positions, [robot.coordinates], axis=1)
    velocity, speed = np.split(rates, [robot.coordinates], axis=1)
    state = State(pose, velocity, angle, speed)
    torques = robot.stall_torque * actions - robot.speed_slope * drive_speed(robot, state)
    slopes, _ = textbook_rates(robot, state, torques, mass=mass)
    accelerations = [slopes.velocity]
    if robot.flexible:
        accelerations.append(slopes.speed)
    return np.concatenate([rates, *accelerations], axis=1)


@each_of(*ROBOTS)
def test_state_space_has_the_differences_of_the_equations(robot):
    """Of friction, springs, elastic cables, tensions and weight."""
    robot = robot.replace(motors=robot.motors.replace(lag=0.0))
    mass = robot.mass + PAYLOAD
    pose = robot.home + np.linspace(0.02, 0.05, robot.coordinates)
    model = textbook.linearise(robot, pose, PAYLOAD)
    angles = textbook.rest_angles(robot, model.tensions, pose)[: robot.cables * robot.flexible]
    rest = np.concatenate([pose, angles])
    rest = np.concatenate([rest, 0 * rest])
    assert len(model.states) == len(model.units) == len(rest) == len(model.A)
    nudge = 1e-4
    size = len(rest)
    nudges = nudge * np.eye(size + robot.cables)
    both = np.concatenate([nudges, -nudges])
    states = rest + both[:, :size]
    ahead, behind = np.split(rates_of(robot, mass, states, model.action + both[:, size:]), 2)
    slopes = (ahead - behind).T / (2 * nudge)
    expected = np.concatenate([model.A, model.B], axis=1)
    scale = np.abs(expected).max(axis=1, keepdims=True)
    assert_allclose(slopes / scale, expected / scale, rtol=0, atol=1e-4)


@pytest.mark.parametrize(
    ("robot", "pose", "payload", "message"),
    [
        ("planar", [9.0, 9.0], 0.0, "outside the polygon of the base anchors"),
        ("spatial", [0.0, 0.0, -5.0, 0.0, 0.0, 0.0], 0.0, "no taut cables hold spatial"),
    ],
)
def test_linearising_asks_for_a_pose_at_rest(robot, pose, payload, message):
    with pytest.raises(ValueError, match=message):
        textbook.linearise(robot, pose, payload)
