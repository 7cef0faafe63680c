"""The nonlinear program: its equations, its derivatives, and optima that are known in closed form."""

from __future__ import annotations

import os
import signal
import threading
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from oracles import one_dimension

from cablebot_gym.bounds import exact_payload
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.planning import Infeasible, Margins, MotionProgram
from cablebot_gym.planning.stage_functions import TENSION, flexible_stage, rigid_stage, start_stage
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Motors, Robot, find_robot
from cablebot_gym.task import ErrorBounds, start_pose
from cablebot_gym.trajectories import Dwell, find_trajectory

pytest.importorskip("casadi")

BOUNDS = ErrorBounds(position=0.01, rotation=0.01)
CIRCLE, LINE = find_trajectory("paper-planar", 2), find_trajectory("line-planar", 2)


def robots(*given: Robot) -> Any:
    return pytest.mark.parametrize("robot", given, ids=lambda robot: robot.name)


def random_state(robot: Robot) -> tuple[np.ndarray, ...]:
    """A pose near home, a velocity and an acceleration, each (1, n)."""
    rng = np.random.default_rng(0)
    pose = robot.home + rng.uniform(-0.05, 0.05, robot.coordinates)
    return pose[None], rng.uniform(-1, 1, (1, robot.coordinates)), rng.uniform(-3, 3, (1, robot.coordinates))


# --- one instant ------------------------------------------------------------------------------------------------------


def rubbing(robot: Robot) -> Robot:
    """A robot whose motors have Coulomb friction."""
    return robot.replace(transmission=robot.transmission.replace(coulomb_friction=0.1))


@robots(rubbing(PLANAR), rubbing(SPATIAL), rubbing(find_robot("cogiro")), rubbing(find_robot("ttk4900")))
def test_rigid_stage_agrees_with_inverse_dynamics(robot: Robot) -> None:
    x, v, a = random_state(robot)
    mass, period, n = robot.mass + 1.7, 0.004, robot.coordinates
    needed = textbook.inverse_dynamics(robot, mass, x, v, a, minimum=6.0, strict=False)
    numbers = np.concatenate([*(array[0] for array in (x, v, a, needed.tensions / TENSION)), [mass]])
    values = np.array(rigid_stage(robot, period)(numbers))[:, 0]
    np.testing.assert_allclose(values[:n], 0.0, atol=1e-12)
    frictionless = robot.replace(transmission=robot.transmission.replace(coulomb_friction=0.0))
    moved = textbook.required_torques(frictionless, needed.tensions, x, v, a)
    rub = 0.1 * needed.speeds / np.hypot(needed.speeds, textbook.FRICTION_SPEED)
    np.testing.assert_allclose(needed.torques, moved + rub, rtol=1e-12)
    for side, action in zip((-1, 1), values[n:].reshape(2, -1), strict=True):
        speeds = needed.speeds + side * 0.002 * needed.pulley_accelerations
        low, high = (limit[0] for limit in textbook.torque_limits(robot, speeds))
        expected = (needed.torques[0] - (low + high) / 2) / ((high - low) / 2)
        np.testing.assert_allclose(action, expected, rtol=1e-10)
    unbalanced = np.array(rigid_stage(robot, period)(np.append(numbers[:-1], mass + 1)))[:n, 0]
    assert np.abs(unbalanced).max() > 1e-3


@robots(rubbing(FLEX_PLANAR), rubbing(FLEX_SPATIAL))
def test_flexible_stage_agrees_with_inverse_dynamics(robot: Robot) -> None:
    x, v, a = random_state(robot)
    mass, m = robot.mass + 1.7, robot.cables
    needed = textbook.inverse_dynamics(robot, mass, x, v, a, minimum=6.0, strict=False)
    # The spring torque is the torque of a rigid motor: r T + J β̈ + c β̇.
    angle = textbook.pulley_angle(robot, x) + needed.torques / robot.stiffness
    speed, acceleration = np.linspace(-20, 30, m), np.linspace(400, -300, m)
    balance, limits = flexible_stage(robot, 0.004)
    numbers = np.concatenate([x[0], v[0], a[0], angle[0], speed, acceleration, [mass]])
    np.testing.assert_allclose(np.array(balance(numbers))[:, 0], 0.0, atol=1e-11)
    first, second, tensions, springs = np.array(limits(numbers))[:, 0].reshape(4, m)
    torque = needed.torques[0] + robot.motor_inertia * acceleration + robot.motor_damping * speed
    torque += 0.1 * speed / np.hypot(speed, textbook.FRICTION_SPEED)
    for side, action in ((-1, first), (1, second)):
        expected = textbook.normalised_action(robot, torque, speed + side * 0.002 * acceleration)
        np.testing.assert_allclose(action, expected, rtol=1e-9)
    np.testing.assert_allclose(TENSION * tensions, needed.tensions[0], rtol=1e-9)
    np.testing.assert_allclose(TENSION * springs, needed.torques[0] / robot.pulley_radius, rtol=1e-9)


@pytest.mark.parametrize("name", ["stadium-camera", "ttk4900", "cogiro"])
def test_elastic_stage_agrees_with_inverse_dynamics(name: str) -> None:
    robot = find_robot(f"flex-{name}")
    x, v, a = random_state(robot)
    mass, m = robot.mass + 1.7, robot.cables
    minimum = textbook.allocated_minimum(robot)
    needed = textbook.inverse_dynamics(find_robot(name), mass, x, v, a, minimum=minimum, strict=False)
    # The motors turn with the rigid cables, so that the damping of the elastic ones has no force.
    angle, _ = textbook.rest_angles(robot, needed.tensions, x)
    speed, acceleration = needed.speeds[0], np.arange(m) - 2.0
    balance, limits = flexible_stage(robot, 0.004)
    numbers = np.concatenate([x[0], v[0], a[0], angle[0], speed, acceleration, [mass]])
    np.testing.assert_allclose(np.array(balance(numbers))[:, 0], 0.0, atol=1e-9)
    first, second, tensions, springs = np.array(limits(numbers))[:, 0].reshape(4, m)
    torque = textbook.holding_torque(robot, robot.pulley_radius * needed.tensions[0])
    torque += robot.pulley_inertia * acceleration + robot.damping * speed + textbook.coulomb_torque(robot, speed)
    for side, action in ((-1, first), (1, second)):
        expected = textbook.normalised_action(robot, torque, speed + side * 0.002 * acceleration)
        np.testing.assert_allclose(action, expected, rtol=1e-7)
    for found in (tensions, springs):
        np.testing.assert_allclose(TENSION * found, needed.tensions[0], rtol=1e-7)


SPRING_CAMERA = find_robot("stadium-camera").replace(
    transmission=find_robot("stadium-camera").transmission.replace(stiffness=200.0, motor_inertia=1e-3)
)


@robots(FLEX_SPATIAL, find_robot("flex-stadium-camera"), SPRING_CAMERA)
def test_start_of_a_flexible_robot_is_that_of_the_environment(robot: Robot) -> None:
    """The tensions of redundant cables at rest are not linear in the payload."""
    env = gym.make(fitting_env_id(robot), robot=robot, payload=3.1)
    observation, _ = env.reset(seed=0)
    blocks = env.unwrapped.layout.split(observation)
    at = start_pose(robot, env.unwrapped.task.trajectory, env.unwrapped.task.error_bounds)
    masses = tuple(np.linspace(0.1, 2.0, 65) * (robot.mass + 3.1))
    start = start_stage(robot, tuple(at), (0.0,) * robot.coordinates, masses)
    turned = np.concatenate([blocks["motor_angle"], blocks["motor_speed"], [robot.mass + 3.1]])
    tolerance = 1e-4 * np.ptp(blocks["motor_angle"])
    np.testing.assert_allclose(np.array(start(turned))[:, 0], 0.0, atol=tolerance)
    deviation = np.array(start(turned + np.r_[np.repeat([0.1, 1.0], robot.cables), 0.0]))[:, 0].reshape(2, -1)
    np.testing.assert_allclose(deviation[0], 0.1, atol=tolerance)
    np.testing.assert_allclose(deviation[1], robot.speed_slope / robot.stall_torque, rtol=1e-9)


# --- derivatives ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "lightest"),
    [
        (PLANAR, 0.2),
        (FLEX_PLANAR, 0.2),
        (find_robot("flex-ttk4900"), 0.2),
        pytest.param(SPATIAL, None, marks=pytest.mark.slow),
    ],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_assembled_derivatives_equal_casadis_own(robot: Robot, lightest: float | None) -> None:
    reference = find_trajectory(default_trajectory(robot), robot.kind)
    margins = Margins(position=1e-3, rotation=1e-3, action=0.1, tension=1.0)
    program = MotionProgram(robot, reference, BOUNDS, intervals=3, margins=margins, lightest=lightest, period=0.002)
    solver, lowest, _ = program._assemble({})
    oracle, rng = solver.oracle(), np.random.default_rng(1)
    z, lam = rng.uniform(-0.5, 0.5, oracle.size1_in("x")), rng.uniform(-1, 1, len(lowest))
    assembled = np.array(solver.get_function("nlp_jac_g")(z, [])[1])
    own = np.array(oracle.factory("j", ["x", "p"], ["jac:g:x"])(z, []))
    np.testing.assert_allclose(assembled, own, rtol=1e-9, atol=1e-9 * np.abs(own).max())
    assert np.linalg.matrix_rank(own) > len(z) // 2
    assembled = np.array(solver.get_function("nlp_hess_l")(z, [], 1.0, lam))
    inputs, outputs = ["x", "p", "lam:f", "lam:g"], ["triu:hess:gamma:x:x"]
    own = np.array(oracle.factory("h", inputs, outputs, {"gamma": ["f", "g"]})(z, [], 1.0, lam))
    np.testing.assert_allclose(assembled, own, rtol=1e-8, atol=1e-9 * np.abs(own).max())
    assert np.count_nonzero(own) > len(z)


# --- optima in closed form --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("inertia", "free_speed", "damping"), [(0.0, 1e9, 0.0), (0.0, 100.0, 0.0), (0.02, 100.0, 0.05)]
)
def test_motion_in_one_dimension_has_the_payload_in_closed_form(
    inertia: float, free_speed: float, damping: float
) -> None:
    drive = {"inertia": inertia, "free_speed": free_speed, "damping": damping}
    robot, bounds = one_dimension.line_robot(**drive), ErrorBounds(position=one_dimension.BOUND)
    found = MotionProgram(robot, one_dimension.Accelerating(), bounds, intervals=30).solve()
    assert 1 + found.payload == pytest.approx(one_dimension.largest_mass(**drive), rel=2e-3)


@pytest.mark.slow
def test_dwell_has_the_payload_that_the_motors_hold_at_the_start_pose() -> None:
    """A heavier one could fall through the bound until the end of this short dwell."""
    dwell, bounds = Dwell(pose=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0), duration=0.1), ErrorBounds(position=1e-3, rotation=1e-3)

    def held(pose: np.ndarray) -> float:
        # The cable of the first motor to saturate holds this fraction of the weight.
        fraction = textbook.required_tensions(SPATIAL, 1.0, pose, np.zeros(6), np.zeros(6))
        return float((SPATIAL.stall_torque / SPATIAL.pulley_radius / fraction).min() - SPATIAL.mass)

    pose = np.array(dwell.pose)
    assert exact_payload(SPATIAL, dwell).payload == pytest.approx(held(pose), rel=1e-9)
    found = MotionProgram(SPATIAL, dwell, bounds, intervals=20).solve().payload
    assert found == pytest.approx(held(pose + 0.5e-3 * np.eye(6)[2]), abs=1e-5)


def test_payload_depends_on_bounds_motors_and_control_period() -> None:
    def payload(robot: Robot = PLANAR, position: float = 0.01, **keywords: Any) -> float:
        program = MotionProgram(robot, CIRCLE, ErrorBounds(position=position), intervals=30, **keywords)
        return program.solve().payload

    usual, motors = payload(), Motors(stall_torque=5.25, free_speed=PLANAR.motors.free_speed)
    assert payload(PLANAR.replace(motors=motors)) > 1.03 * usual
    assert 1.05 * payload(position=5e-3) < usual
    assert payload(period=0.02) < usual - 0.02


# --- solving ----------------------------------------------------------------------------------------------------------


def test_optimum_does_not_depend_on_the_initial_guess() -> None:
    coarse = MotionProgram(PLANAR, CIRCLE, BOUNDS, intervals=30)
    first, again = coarse.solve(), coarse.solve()
    np.testing.assert_array_equal(again.poses, first.poses)
    shifted = coarse.solve(shift=np.array([0.3, -0.4]))
    assert shifted.payload == pytest.approx(first.payload, rel=1e-4)
    fine = MotionProgram(PLANAR, CIRCLE, BOUNDS, intervals=45)
    warm, cold = fine.solve(first), fine.solve()
    assert warm.payload == pytest.approx(cold.payload, rel=1e-4)
    assert warm.payload == pytest.approx(first.payload, rel=0.02)


def test_other_margins_are_solved_from_the_last_solution_with_the_same_optimum() -> None:
    margins, problem = Margins(position=1e-3, action=0.05, tension=2.0), (PLANAR, CIRCLE, BOUNDS)
    fresh = MotionProgram(*problem, intervals=30, margins=margins).solve()
    program = MotionProgram(*problem, intervals=30)
    with pytest.raises(Infeasible, match="no solution to start from"):
        program.resolve(Margins())
    free, again = program.solve(), program.resolve(margins)
    assert again.payload == pytest.approx(fresh.payload, abs=1e-4)
    assert again.payload < free.payload - 0.1


def test_robot_with_motor_lag_is_rejected() -> None:
    """A plan that ignores the lag would fail in the environment."""
    robot = PLANAR.replace(motors=PLANAR.motors.replace(lag=0.01))
    with pytest.raises(ValueError, match="need motors without lag, but the motors of robot 'planar' have a lag"):
        MotionProgram(robot, CIRCLE, BOUNDS, intervals=30)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_interrupts_the_solver(interrupted_solver: None) -> None:
    """CasADi alone takes it for a failed evaluation and goes on."""
    program = MotionProgram(PLANAR, LINE, BOUNDS, intervals=10)
    with pytest.raises(KeyboardInterrupt):
        program.solve()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_solver_runs_outside_the_main_thread() -> None:
    found: list[float] = []
    program = MotionProgram(PLANAR, LINE, BOUNDS, intervals=10)
    thread = threading.Thread(target=lambda: found.append(program.solve().payload))
    thread.start()
    thread.join()
    assert found[0] > 0
