"""The nonlinear program: its equations, its derivatives, and optima that are known in closed
form."""

import gc
import os
import signal
import threading
import weakref

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose
from oracles import one_dimension
from oracles.plants import each_of, random_motion, with_transmission

from cablebot_gym.envs import fitting_env_id
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.planning import Margins, MotionProgram
from cablebot_gym.planning.stage_functions import TENSION, flexible_stage, rigid_stage, start_stage
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, find_robot
from cablebot_gym.task import ErrorBounds, start_pose

pytest.importorskip("casadi")

BOUNDS = ErrorBounds(position=0.01, rotation=0.01)
LINE = find_trajectory("line-planar", 2)


# --- one instant ------------------------------------------------------------------------------------------------------


def rubbing(robot):
    """A robot whose motors have friction, constant and by load."""
    return with_transmission(robot, coulomb_friction=0.1, load_friction=0.05)


def check_actions(robot, actions, torque, speed, acceleration, tolerance):
    """Actions of the torque at the motor speeds of both ends of a period of 4 ms."""
    for side, action in zip((-0.002, 0.002), actions, strict=True):
        expected = textbook.normalised_action(robot, torque, speed + side * acceleration)
        assert_allclose(action, expected, rtol=tolerance)


@each_of(
    rubbing(PLANAR), rubbing(SPATIAL), rubbing(find_robot("cogiro")), rubbing(find_robot("ttk4900"))
)
def test_rigid_stage_agrees_with_inverse_dynamics(robot):
    mass, x, v, a = random_motion(robot, (1,), spread=0.1)
    n = robot.coordinates
    inverse = textbook.inverse_dynamics(robot, mass, x, v, a, minimum=6.0, strict=False)
    state = np.concatenate([x[0], v[0], a[0], inverse.tensions[0] / TENSION])
    balanced, unbalanced = (
        np.array(rigid_stage(robot, 0.004)(np.append(state, total)))[:, 0]
        for total in (mass, mass + 1)
    )
    assert_allclose(balanced[:n], 0.0, atol=1e-12)
    assert np.abs(unbalanced[:n]).max() > 1e-3
    motion = inverse.torques[0], inverse.speeds[0], inverse.pulley_accelerations[0]
    check_actions(robot, balanced[n:].reshape(2, -1), *motion, 1e-10)


def check_flexible_stage(robot, state, mass, motors, torque, tensions, springs, tolerances):
    """Balance, and actions, tensions and spring forces of the stage of a flexible robot."""
    balance, limits = flexible_stage(robot, 0.004)
    numbers = np.concatenate([*(order[0] for order in state), *motors, mass])
    assert_allclose(np.array(balance(numbers))[:, 0], 0.0, atol=tolerances[0])
    values = np.array(limits(numbers))[:, 0].reshape(4, robot.cables)
    check_actions(robot, values[:2], torque, *motors[1:], tolerances[1])
    assert_allclose(TENSION * values[2:], [tensions, springs], rtol=tolerances[1])


@each_of(rubbing(FLEX_PLANAR), rubbing(FLEX_SPATIAL))
def test_flexible_stage_agrees_with_inverse_dynamics(robot):
    mass, *state = random_motion(robot, (1,), spread=0.1)
    inverse = textbook.inverse_dynamics(robot, mass, *state, minimum=6.0, strict=False)
    # The spring torque is the torque of a rigid motor: r T + J β̈ + c β̇.
    springs = inverse.torques[0]
    angle = textbook.pulley_angle(robot, state[0][0]) + springs / robot.stiffness
    speed = np.linspace(-20, 30, robot.cables)
    acceleration = np.linspace(400, -300, robot.cables)
    torque = springs + robot.motor_inertia * acceleration + robot.motor_damping * speed
    torque += (0.1 + 0.05 * np.abs(springs)) * speed / np.hypot(speed, 0.5)
    check_flexible_stage(
        robot,
        state,
        mass,
        (angle, speed, acceleration),
        torque,
        inverse.tensions[0],
        springs / robot.pulley_radius,
        (1e-11, 1e-9),
    )


@pytest.mark.parametrize("name", ["stadium-camera", "ttk4900", "cogiro"])
def test_elastic_stage_agrees_with_inverse_dynamics(name):
    robot = find_robot(f"flex-{name}")
    mass, *state = random_motion(robot, (1,), spread=0.1)
    minimum = textbook.allocated_minimum(robot)
    rigid = find_robot(name)
    inverse = textbook.inverse_dynamics(rigid, mass, *state, minimum=minimum, strict=False)
    tensions = inverse.tensions[0]
    # The motors turn with the rigid cables, so that the damping of the elastic ones has no force.
    angle = textbook.rest_angles(robot, inverse.tensions, state[0])
    speed = inverse.speeds[0]
    acceleration = np.arange(robot.cables) - 2.0
    pulled = textbook.holding_torque(robot, robot.pulley_radius * tensions)
    torque = pulled + robot.pulley_inertia * acceleration + robot.damping * speed
    friction = robot.coulomb_friction + robot.load_friction * pulled
    torque += friction * speed / np.hypot(speed, robot.transmission.friction_speed)
    motors = angle[0], speed, acceleration
    check_flexible_stage(robot, state, mass, motors, torque, tensions, tensions, (1e-9, 1e-7))


SPRING_CAMERA = with_transmission(find_robot("stadium-camera"), stiffness=200.0, motor_inertia=1e-3)


@each_of(FLEX_SPATIAL, find_robot("flex-stadium-camera"), SPRING_CAMERA)
def test_start_of_a_flexible_robot_is_that_of_the_environment(robot):
    """The tensions of redundant cables at rest are not linear in the payload."""
    env = gym.make(fitting_env_id(robot), robot=robot, payload=3.1)
    observation, _ = env.reset(seed=0)
    blocks = env.unwrapped.layout.split(observation)
    pose = start_pose(robot, env.unwrapped.task.trajectory, env.unwrapped.task.error_bounds)
    masses = tuple(np.linspace(0.1, 2.0, 65) * (robot.mass + 3.1))
    start = start_stage(robot, tuple(pose), (0.0,) * robot.coordinates, masses)
    turned = np.concatenate([blocks["motor_angle"], blocks["motor_speed"], [robot.mass + 3.1]])
    tolerance = 1e-4 * np.ptp(blocks["motor_angle"])
    assert_allclose(np.array(start(turned))[:, 0], 0.0, atol=tolerance)
    moved = turned + np.append(np.repeat([0.1, 1.0], robot.cables), 0.0)
    angles, speeds = np.array(start(moved))[:, 0].reshape(2, -1)
    assert_allclose(angles, 0.1, atol=tolerance)
    assert_allclose(speeds, robot.speed_slope / robot.stall_torque, rtol=1e-9)


# --- derivatives ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "lightest"),
    [
        (PLANAR, 0.2),
        (FLEX_PLANAR, 0.2),
        (find_robot("flex-ttk4900"), 0.2),
        pytest.param(SPATIAL, None, marks=pytest.mark.landing),
    ],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_assembled_derivatives_equal_casadis_own(robot, lightest):
    program = MotionProgram(
        robot,
        find_trajectory(default_trajectory(robot), robot.kind),
        BOUNDS,
        intervals=3,
        margins=Margins(position=1e-3, rotation=1e-3, action=0.1, tension=1.0),
        lightest=lightest,
        period=0.002,
    )
    solver = program._assembled.cold_solver
    oracle = solver.oracle()
    rng = np.random.default_rng(1)
    z = rng.uniform(-0.5, 0.5, oracle.size1_in("x"))
    lam = rng.uniform(-1, 1, program._assembled.constraints)

    def check(assembled, expected, tolerance):
        expected = np.array(expected)
        floor = 1e-9 * np.abs(expected).max()
        assert_allclose(np.array(assembled), expected, rtol=tolerance, atol=floor)
        return expected

    expected = oracle.factory("j", ["x", "p"], ["jac:g:x"])(z, [])
    jacobian = check(solver.get_function("nlp_jac_g")(z, [])[1], expected, 1e-9)
    assert np.linalg.matrix_rank(jacobian) > len(z) // 2
    inputs = ["x", "p", "lam:f", "lam:g"]
    gamma = {"gamma": ["f", "g"]}
    expected = oracle.factory("h", inputs, ["triu:hess:gamma:x:x"], gamma)(z, [], 1.0, lam)
    hessian = check(solver.get_function("nlp_hess_l")(z, [], 1.0, lam), expected, 1e-8)
    assert np.count_nonzero(hessian) > len(z)


# --- optima in closed form --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("inertia", "free_speed", "damping"), [(0.0, 1e9, 0.0), (0.0, 100.0, 0.0), (0.02, 100.0, 0.05)]
)
def test_motion_in_one_dimension_has_the_payload_in_closed_form(inertia, free_speed, damping):
    drive = {"inertia": inertia, "free_speed": free_speed, "damping": damping}
    robot = one_dimension.line_robot(**drive)
    bounds = ErrorBounds(position=one_dimension.BOUND)
    plan = MotionProgram(robot, one_dimension.Accelerating(), bounds, intervals=30).solve()
    assert 1 + plan.payload == pytest.approx(one_dimension.largest_mass(**drive), rel=2e-3)


@pytest.mark.parametrize("margin", [0.0, 2.0])
def test_motion_in_one_dimension_keeps_the_maximum_tension(margin):
    """With T₁ in two cables and T₀ in the others, ``M ẍ = 2 (T₁ − T₀)`` up to the bound at the end."""
    drive = {"inertia": 0.02, "free_speed": 100.0, "damping": 0.05}
    robot = one_dimension.line_robot(**drive).replace(maximum_tension=20.0)
    bounds = ErrorBounds(position=one_dimension.BOUND)
    program = MotionProgram(
        robot, one_dimension.Accelerating(), bounds, intervals=30, margins=Margins(tension=margin)
    )
    pull = 2 * (20.0 - one_dimension.TENSION - 2 * margin)
    rate = one_dimension.Accelerating.rate
    expected = pull / (rate - 2 * one_dimension.BOUND)
    assert 1 + program.solve().payload == pytest.approx(expected, rel=4e-3)


# --- solving ----------------------------------------------------------------------------------------------------------


@each_of(PLANAR, FLEX_PLANAR)
def test_program_is_freed_with_its_last_reference(robot):
    """Excludes a cycle: a worker of the benchmark grew by 40 MB for each best known payload."""
    program = MotionProgram(robot, LINE, BOUNDS, intervals=3)
    assert program._assembled.bounds(program)
    freed = weakref.ref(program)
    gc.disable()
    del program
    gc.enable()
    assert freed() is None


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_interrupts_the_solver(interrupted_solver):
    """CasADi alone takes it for a failed evaluation and goes on."""
    program = MotionProgram(PLANAR, LINE, BOUNDS, intervals=10)
    with pytest.raises(KeyboardInterrupt):
        program.solve()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_solver_runs_outside_the_main_thread():
    payloads = []
    program = MotionProgram(PLANAR, LINE, BOUNDS, intervals=10)
    thread = threading.Thread(target=lambda: payloads.append(program.solve().payload))
    thread.start()
    thread.join()
    assert payloads[0] > 0
