"""The nonlinear program: its equations on symbols, its derivatives, and optima that are known in closed form."""

from __future__ import annotations

import math
import os
import signal
import threading
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from cablebot_gym import kinematics
from cablebot_gym.bounds import exact_payload
from cablebot_gym.physics import textbook
from cablebot_gym.planning import Infeasible, Margins, MotionProgram
from cablebot_gym.planning.stage_functions import TENSION, flexible_stage, rigid_stage
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL, Motors, Robot, Transmission
from cablebot_gym.task import ErrorBounds
from cablebot_gym.trajectories import Dwell, Reference, find_trajectory

ca = pytest.importorskip("casadi")

ROBOTS = [PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL]
BOUNDS = ErrorBounds(position=0.01, rotation=0.01)
CIRCLE, LINE = find_trajectory("paper-planar", 2), find_trajectory("line-planar", 2)


def robots(*given: Robot) -> Any:
    return pytest.mark.parametrize("robot", given or ROBOTS, ids=lambda robot: robot.name)


def random_state(robot: Robot) -> tuple[np.ndarray, ...]:
    """A pose near home, a velocity and an acceleration, each (1, n)."""
    rng = np.random.default_rng(0)
    pose = robot.home + rng.uniform(-0.05, 0.05, robot.coordinates)
    return pose[None], rng.uniform(-1, 1, (1, robot.coordinates)), rng.uniform(-3, 3, (1, robot.coordinates))


def on_symbols(function: Any, *values: np.ndarray) -> np.ndarray:
    """The function's value at numbers, computed through symbols."""
    symbols = [ca.SX.sym("s", value.size) for value in values]
    made = function(*(np.array([ca.vertsplit(symbol)], dtype=object) for symbol in symbols))
    call = ca.Function("f", symbols, [ca.vertcat(*made.ravel())])
    return np.array(call(*(value.ravel() for value in values))).reshape(made.shape)


# --- the textbook on symbols ------------------------------------------------------------------------------------------


@robots()
def test_equations_on_symbols_equal_those_on_numbers(robot: Robot) -> None:
    x, v, a = random_state(robot)
    mass, tension = np.array([[robot.mass + 2.3]]), np.linspace(20, 90, robot.cables)[None]
    functions = [
        (lambda x: textbook.jacobian(robot, x), (x,)),
        (lambda x, v: textbook.jacobian_rate(robot, x, v), (x, v)),
        (lambda m, x: textbook.mass_matrix(robot, m[..., 0], x), (mass, x)),
        (lambda m, x, v: textbook.bias(robot, m[..., 0], x, v), (mass, x, v)),
        (lambda m, x, v, a: textbook.load(robot, m[..., 0], x, v, a), (mass, x, v, a)),
        (lambda x: textbook.pulley_angle(robot, x), (x,)),
        (lambda x, v: textbook.pulley_speed(robot, x, v), (x, v)),
        (lambda x, v, a: textbook.pulley_acceleration(robot, x, v, a), (x, v, a)),
        (lambda t, x, v, a: textbook.required_torques(robot, t, x, v, a), (tension, x, v, a)),
        (lambda t, v: textbook.normalised_action(robot, t, v), (tension, tension[:, ::-1])),
        (lambda x: kinematics.cable_lengths(robot.base, robot.platform, x), (x,)),
    ]
    if not robot.planar:
        functions += [
            (kinematics.rotation_matrix, (x[..., 3:],)),
            (kinematics.euler_rate_matrix, (x[..., 3:],)),
            (kinematics.euler_rate_matrix_rate, (x[..., 3:], v[..., 3:])),
        ]
    for function, values in functions:
        expected = function(*values)
        assert expected.dtype == np.float64
        np.testing.assert_allclose(on_symbols(function, *values), expected, rtol=1e-11, atol=1e-11)


def test_lists_and_integers_give_floats_and_floats_are_not_copied() -> None:
    for values in (np.zeros((4, 2), np.int64), np.zeros((4, 2), np.float32), np.zeros((4, 2)).tolist()):
        assert textbook.pulley_speed(PLANAR, values, values).dtype == np.float64
        assert textbook.normalised_action(PLANAR, np.ones((4, 3), int), np.ones((4, 3), int)).dtype == np.float64
        assert kinematics.as_numbers(values).dtype == np.float64
    numbers, symbols = np.ones(3), np.array(ca.vertsplit(ca.SX.sym("s", 2)), dtype=object)
    assert kinematics.as_numbers(numbers) is numbers
    assert kinematics.as_numbers(symbols) is symbols


# --- one instant ------------------------------------------------------------------------------------------------------


@robots(PLANAR, SPATIAL)
def test_rigid_stage_agrees_with_inverse_dynamics(robot: Robot) -> None:
    x, v, a = random_state(robot)
    mass, period, n = robot.mass + 1.7, 0.004, robot.coordinates
    needed = textbook.inverse_dynamics(robot, mass, x, v, a, minimum=6.0, strict=False)
    numbers = np.concatenate([*(array[0] for array in (x, v, a, needed.tensions / TENSION)), [mass]])
    values = np.array(rigid_stage(robot, period)(numbers))[:, 0]
    np.testing.assert_allclose(values[:n], 0.0, atol=1e-12)
    for side, action in zip((-1, 1), values[n:].reshape(2, -1), strict=True):
        speeds = needed.speeds + side * 0.002 * needed.pulley_accelerations
        low, high = (limit[0] for limit in textbook.torque_limits(robot, speeds))
        expected = (needed.torques[0] - (low + high) / 2) / ((high - low) / 2)
        np.testing.assert_allclose(action, expected, rtol=1e-10)
    unbalanced = np.array(rigid_stage(robot, period)(np.append(numbers[:-1], mass + 1)))[:n, 0]
    assert np.abs(unbalanced).max() > 1e-3


@robots(FLEX_PLANAR, FLEX_SPATIAL)
def test_flexible_stage_agrees_with_inverse_dynamics(robot: Robot) -> None:
    x, v, a = random_state(robot)
    mass, n, m = robot.mass + 1.7, robot.coordinates, robot.cables
    needed = textbook.inverse_dynamics(robot, mass, x, v, a, minimum=6.0, strict=False)
    # The spring torque is the torque of a rigid motor: r T + J β̈ + c β̇.
    angle = textbook.pulley_angle(robot, x) + needed.torques / robot.stiffness
    speed, acceleration = np.linspace(-20, 30, m), np.linspace(400, -300, m)
    balance, limits, start = flexible_stage(robot, 0.004)
    numbers = np.concatenate([x[0], v[0], a[0], angle[0], speed, acceleration, [mass]])
    np.testing.assert_allclose(np.array(balance(numbers))[:, 0], 0.0, atol=1e-11)
    first, second, tensions, springs = np.array(limits(numbers))[:, 0].reshape(4, m)
    torque = needed.torques[0] + robot.motor_inertia * acceleration + robot.motor_damping * speed
    for side, action in ((-1, first), (1, second)):
        expected = textbook.normalised_action(robot, torque, speed + side * 0.002 * acceleration)
        np.testing.assert_allclose(action, expected, rtol=1e-9)
    np.testing.assert_allclose(TENSION * tensions, needed.tensions[0], rtol=1e-9)
    np.testing.assert_allclose(TENSION * springs, needed.torques[0] / robot.pulley_radius, rtol=1e-9)

    static = textbook.static_motor_angle(robot, mass, x, minimum=6.0)[0]
    rates = textbook.pulley_speed(robot, x, v)[0]
    at_rest = np.array(start(np.concatenate([x[0], v[0], static, rates, [mass]])))[:, 0]
    np.testing.assert_allclose(at_rest, 0.0, atol=1e-11)
    moving = np.array(start(np.concatenate([x[0], v[0], static + 0.1, rates + 1, [mass]])))[:, 0]
    assert np.abs(moving[:n]).max() > 1e-4
    np.testing.assert_allclose(moving[n:], 1 * robot.speed_slope / robot.stall_torque, rtol=1e-9)


# --- derivatives ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "lightest"),
    [
        (PLANAR, None),
        (PLANAR, 0.2),
        (FLEX_PLANAR, 0.2),
        pytest.param(SPATIAL, 0.2, marks=pytest.mark.slow),
        pytest.param(FLEX_SPATIAL, None, marks=pytest.mark.slow),
    ],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_assembled_derivatives_equal_casadis_own(robot: Robot, lightest: float | None) -> None:
    reference = find_trajectory("circle-planar" if robot.planar else "circle-spatial", robot.coordinates)
    margins = Margins(position=1e-3, rotation=1e-3, action=0.1, tension=1.0)
    program = MotionProgram(robot, reference, BOUNDS, intervals=3, margins=margins, lightest=lightest, period=0.002)
    solver, lowest, _ = program._assemble()
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


@dataclass(frozen=True, kw_only=True)
class Accelerating:
    """From rest at the origin along x with a constant acceleration."""

    rate: float = 2.0
    duration: float = 1.0
    name: str = "accelerating"
    coordinates: int = 2

    def __call__(self, times: Any) -> Reference:
        t = np.clip(np.asarray(times, float), 0.0, self.duration)[..., None]
        x = np.array([1.0, 0.0])
        zero = 0 * t * x
        return Reference(
            position=self.rate / 2 * t**2 * x,
            velocity=self.rate * t * x,
            acceleration=self.rate * x + zero,
            jerk=zero,
            snap=zero,
        )


@pytest.mark.parametrize(
    ("inertia", "free_speed", "damping"), [(0.0, 1e9, 0.0), (0.0, 100.0, 0.0), (0.02, 100.0, 0.05)]
)
def test_motion_in_one_dimension_has_the_payload_in_closed_form(
    inertia: float, free_speed: float, damping: float
) -> None:
    """At full torque (M + 2μ) ẍ + 2k ẋ = 2s must reach x_d(T) − R.

    Two cables along x and two against it are so long that they stay parallel.
    """
    radius, motion, bound, end = 0.05, Accelerating(), 0.05, 1.0
    robot = Robot(
        name="line",
        base_anchors=((10.0, 0.01), (10.0, -0.01), (-10.0, 0.01), (-10.0, -0.01)),
        mass=1.0,
        motors=Motors(stall_torque=5.0, free_speed=free_speed),
        transmission=Transmission(pulley_radius=radius, pulley_inertia=inertia, damping=damping),
        home_pose=(0.0, 0.0),
    )
    pull, mu, k = 5.0 / radius, inertia / radius**2, (5.0 / free_speed + damping) / radius**2

    def surplus(mass: float) -> float:
        rate, acceleration = 2 * k / (mass + 2 * mu), 2 * pull / (mass + 2 * mu)
        distance = end**2 / 2 if rate < 1e-4 else end / rate - (1 - math.exp(-rate * end)) / rate**2
        return acceleration * distance - (motion.rate * end**2 / 2 - bound)

    found = MotionProgram(robot, motion, ErrorBounds(position=bound), intervals=30).solve()
    assert 1 + found.payload == pytest.approx(brentq(surplus, 1.0, 1e4), rel=2e-3)


@pytest.mark.slow
def test_dwell_has_the_static_payload_plus_that_of_a_fall_through_the_bound() -> None:
    dwell = Dwell(pose=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0), duration=0.1)
    static = exact_payload(SPATIAL, dwell)
    # The cable of the first motor to saturate holds this fraction of the weight.
    fraction = textbook.required_tensions(SPATIAL, 1.0, np.array(dwell.pose), np.zeros(6), np.zeros(6))
    expected = (SPATIAL.stall_torque / SPATIAL.pulley_radius / fraction).min() - SPATIAL.mass
    assert static.payload == pytest.approx(expected, rel=1e-9)
    narrow, wide = (
        MotionProgram(SPATIAL, dwell, ErrorBounds(position=bound, rotation=bound), intervals=20).solve().payload
        for bound in (1e-5, 1e-3)
    )
    assert narrow == pytest.approx(static.payload, rel=1e-3)
    # A fall with the acceleration a sinks by a T²/2 = R, so M (g − a) is the static weight. Pulley inertia and tilts
    # help in addition.
    least = static.total_mass * 9.81 / (9.81 - 2 * 1e-3 / 0.1**2) - SPATIAL.mass
    assert least < wide < 1.1 * least


@pytest.fixture(scope="module")
def circle() -> float:
    """Payload on the paper's planar circle."""
    return MotionProgram(PLANAR, CIRCLE, BOUNDS, intervals=30).solve().payload


def test_payload_depends_on_bounds_motors_and_control_period(circle: float) -> None:
    motors = Motors(stall_torque=5.25, free_speed=PLANAR.motors.free_speed)
    stronger = MotionProgram(PLANAR.replace(motors=motors), CIRCLE, BOUNDS, intervals=30).solve().payload
    narrower = MotionProgram(PLANAR, CIRCLE, ErrorBounds(position=5e-3), intervals=30).solve().payload
    sampled = MotionProgram(PLANAR, CIRCLE, BOUNDS, intervals=30, period=0.02).solve().payload
    assert stronger > 1.03 * circle
    assert 1.05 * narrower < circle
    assert sampled < circle - 0.02


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


def test_infeasible_motion_raises() -> None:
    with pytest.raises(Infeasible):
        MotionProgram(PLANAR, CIRCLE, ErrorBounds(position=1e-6), intervals=20).solve()


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_interrupts_the_solver() -> None:
    """CasADi alone takes it for a failed evaluation and goes on."""
    program = MotionProgram(SPATIAL, find_trajectory("paper-spatial", 6), BOUNDS, intervals=80)
    program._solver = program._assemble()
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    try:
        timer.start()
        with pytest.raises(KeyboardInterrupt):
            program.solve()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        timer.join()
        signal.signal(signal.SIGINT, before)


def test_solver_runs_outside_the_main_thread() -> None:
    found: list[float] = []
    program = MotionProgram(PLANAR, LINE, BOUNDS, intervals=10)
    thread = threading.Thread(target=lambda: found.append(program.solve().payload))
    thread.start()
    thread.join()
    assert found[0] > 0
