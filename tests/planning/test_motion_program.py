"""The program: its equations on symbols, its derivatives, and optima that can be had by hand."""

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
every_robot = pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)


def state(robot: Robot, seed: int = 0) -> tuple[np.ndarray, ...]:
    """A pose near home, a velocity and an acceleration, each (1, n)."""
    rng = np.random.default_rng(seed)
    pose = robot.home + rng.uniform(-0.05, 0.05, robot.coordinates)
    return pose[None], rng.uniform(-1, 1, (1, robot.coordinates)), rng.uniform(-3, 3, (1, robot.coordinates))


def on_symbols(function: Any, *values: np.ndarray) -> np.ndarray:
    """The function's value at numbers, had through symbols."""
    symbols = [ca.SX.sym("s", value.size) for value in values]
    made = function(*(np.array([ca.vertsplit(symbol)], dtype=object) for symbol in symbols))
    call = ca.Function("f", symbols, [ca.vertcat(*made.ravel())])
    return np.array(call(*(value.ravel() for value in values))).reshape(made.shape)


# --- the textbook on symbols ------------------------------------------------------------------------------------------


@every_robot
@pytest.mark.parametrize("seed", range(3))
def test_equations_on_symbols_are_not_other_ones_than_on_numbers(robot: Robot, seed: int) -> None:
    x, v, a = state(robot, seed)
    mass, tension = np.array([[robot.mass + 2.3]]), np.linspace(20, 90, robot.cables)[None]
    angles = x[..., 3:] if not robot.planar else None
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
    if angles is not None:
        functions += [
            (kinematics.rotation_matrix, (angles,)),
            (kinematics.euler_rate_matrix, (angles,)),
            (kinematics.euler_rate_matrix_rate, (angles, v[..., 3:])),
        ]
    for function, values in functions:
        np.testing.assert_allclose(on_symbols(function, *values), function(*values), rtol=1e-11, atol=1e-11)


@every_robot
@pytest.mark.parametrize("kind", [float, np.float32, np.int64], ids=["list", "float32", "int64"])
def test_numbers_do_not_come_out_as_another_type_than_float64(robot: Robot, kind: Any) -> None:
    n, m = robot.coordinates, robot.cables
    x = (np.zeros((4, n)) if kind is np.int64 else robot.home + np.zeros((4, n))).astype(kind)
    v, tension, mass = np.ones((4, n), kind), np.ones((4, m), kind), kind(2)
    if kind is float:
        x, v, tension = x.tolist(), v.tolist(), tension.tolist()
    for value in (
        textbook.jacobian(robot, x),
        textbook.jacobian_rate(robot, x, v),
        textbook.mass_matrix(robot, mass, x),
        textbook.bias(robot, mass, x, v),
        textbook.load(robot, mass, x, v, v),
        textbook.pulley_angle(robot, x),
        textbook.pulley_speed(robot, x, v),
        textbook.pulley_acceleration(robot, x, v, v),
        textbook.required_torques(robot, tension, x, v, v),
        textbook.normalised_action(robot, tension, tension),
        *textbook.torque_limits(robot, tension),
        kinematics.rotation_matrix(np.ones((4, 3), np.float32 if kind is float else kind)),
        kinematics.as_numbers(x),
    ):
        assert value.dtype == np.float64


def test_numbers_that_are_float64_are_not_copied_but_symbols_stay_themselves() -> None:
    numbers, symbols = np.ones(3), np.array(ca.vertsplit(ca.SX.sym("s", 2)), dtype=object)
    assert kinematics.as_numbers(numbers) is numbers
    assert kinematics.as_numbers(symbols) is symbols


# --- one instant ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL], ids=lambda robot: robot.name)
def test_instant_of_a_rigid_robot_does_not_contradict_inverse_dynamics(robot: Robot) -> None:
    x, v, a = state(robot)
    mass, period, n = robot.mass + 1.7, 0.004, robot.coordinates
    needed = textbook.inverse_dynamics(robot, mass, x, v, a, minimum=6.0, strict=False)
    numbers = np.concatenate([*(array[0] for array in (x, v, a, needed.tensions / TENSION)), [mass]])
    values = np.array(rigid_stage(robot, period)(numbers))[:, 0]
    np.testing.assert_allclose(values[:n], 0.0, atol=1e-12)
    for side, command in zip((-1, 1), values[n:].reshape(2, -1), strict=True):
        low, high = (
            limit[0]
            for limit in textbook.torque_limits(robot, needed.speeds + side * 0.002 * needed.pulley_accelerations)
        )
        wanted = (needed.torques[0] - (low + high) / 2) / ((high - low) / 2)  # −1 on the lower line, 1 on the upper
        np.testing.assert_allclose(command, wanted, rtol=1e-10)
    heavier = np.append(numbers[:-1], mass + 1)
    unbalanced = np.array(rigid_stage(robot, period)(heavier))[:n, 0]
    assert np.abs(unbalanced).max() > 1e-3


@pytest.mark.parametrize("robot", [FLEX_PLANAR, FLEX_SPATIAL], ids=lambda robot: robot.name)
def test_instant_of_a_flexible_robot_does_not_contradict_inverse_dynamics(robot: Robot) -> None:
    x, v, a = state(robot)
    mass, n, m = robot.mass + 1.7, robot.coordinates, robot.cables
    needed = textbook.inverse_dynamics(robot, mass, x, v, a, minimum=6.0, strict=False)
    # Behind the spring stands what a rigid motor would give to the pulley: r T + J β̈ + c β̇.
    angle = textbook.pulley_angle(robot, x) + needed.torques / robot.stiffness
    speed, acceleration = np.linspace(-20, 30, m), np.linspace(400, -300, m)
    balance, limits, start = flexible_stage(robot, 0.004)
    numbers = np.concatenate([x[0], v[0], a[0], angle[0], speed, acceleration, [mass]])
    np.testing.assert_allclose(np.array(balance(numbers))[:, 0], 0.0, atol=1e-11)
    first, second, tensions, wound = np.array(limits(numbers))[:, 0].reshape(4, m)
    torque = needed.torques[0] + robot.motor_inertia * acceleration + robot.motor_damping * speed
    for side, command in ((-1, first), (1, second)):
        wanted = textbook.normalised_action(robot, torque, speed + side * 0.002 * acceleration)
        np.testing.assert_allclose(command, wanted, rtol=1e-9)
    np.testing.assert_allclose(TENSION * tensions, needed.tensions[0], rtol=1e-9)
    np.testing.assert_allclose(TENSION * wound, needed.torques[0] / robot.pulley_radius, rtol=1e-9)

    static = textbook.static_motor_angle(robot, mass, x, minimum=6.0)[0]
    rates = textbook.pulley_speed(robot, x, v)[0]
    at_rest = np.array(start(np.concatenate([x[0], v[0], static, rates, [mass]])))[:, 0]
    np.testing.assert_allclose(at_rest, 0.0, atol=1e-11)
    off = np.array(start(np.concatenate([x[0], v[0], static + 0.1, rates + 1, [mass]])))[:, 0]
    assert np.abs(off[:n]).max() > 1e-4
    np.testing.assert_allclose(off[n:], 1 * robot.speed_slope / robot.stall_torque, rtol=1e-9)


# --- derivatives ------------------------------------------------------------------------------------------------------


@every_robot
@pytest.mark.parametrize("lightest", [None, 0.2], ids=["one load", "two loads"])
def test_derivatives_put_together_by_hand_are_not_other_than_casadis_own(robot: Robot, lightest: float | None) -> None:
    name = "circle-planar" if robot.planar else "circle-spatial"
    reference = find_trajectory(name, robot.coordinates)
    margins = Margins(position=1e-3, rotation=1e-3, action=0.1, tension=1.0)
    program = MotionProgram(robot, reference, BOUNDS, intervals=3, margins=margins, lightest=lightest, period=0.002)
    solver, lowest, _ = program._assemble()
    oracle, rng = solver.oracle(), np.random.default_rng(1)
    z, lam = rng.uniform(-0.5, 0.5, oracle.size1_in("x")), rng.uniform(-1, 1, len(lowest))
    by_hand = np.array(solver.get_function("nlp_jac_g")(z, [])[1])
    own = np.array(oracle.factory("j", ["x", "p"], ["jac:g:x"])(z, []))
    np.testing.assert_allclose(by_hand, own, rtol=1e-9, atol=1e-9 * np.abs(own).max())
    assert np.linalg.matrix_rank(own) > len(z) // 2
    by_hand = np.array(solver.get_function("nlp_hess_l")(z, [], 1.0, lam))
    inputs, outputs = ["x", "p", "lam:f", "lam:g"], ["triu:hess:gamma:x:x"]
    own = np.array(oracle.factory("h", inputs, outputs, {"gamma": ["f", "g"]})(z, [], 1.0, lam))
    np.testing.assert_allclose(by_hand, own, rtol=1e-8, atol=1e-9 * np.abs(own).max())
    assert np.count_nonzero(own) > len(z)


# --- optima by hand ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class SpeedingUp:
    """From rest at the origin along x with a constant acceleration."""

    rate: float = 2.0
    duration: float = 1.0
    name: str = "speeding-up"
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


def line_robot(*, inertia: float, free_speed: float, damping: float) -> Robot:
    """Two cables along x and two against it, so long that they stay parallel: along x there is one dimension."""
    return Robot(
        name="line",
        base_anchors=((10.0, 0.01), (10.0, -0.01), (-10.0, 0.01), (-10.0, -0.01)),
        mass=1.0,
        motors=Motors(stall_torque=5.0, free_speed=free_speed),
        transmission=Transmission(pulley_radius=0.05, pulley_inertia=inertia, damping=damping),
        home_pose=(0.0, 0.0),
    )


@pytest.mark.parametrize(
    ("inertia", "free_speed", "damping"),
    [(0.0, 1e9, 0.0), (0.02, 1e9, 0.0), (0.0, 100.0, 0.0), (0.0, 1e9, 0.05), (0.02, 100.0, 0.05)],
)
def test_one_dimension_is_not_off_from_the_hand_calculation(inertia: float, free_speed: float, damping: float) -> None:
    """Full throttle: (M + 2μ) ẍ + 2k ẋ = 2s has to come as far as x_d(T) − R; every M that does is carried."""
    robot, tube, end = line_robot(inertia=inertia, free_speed=free_speed, damping=damping), 0.05, 1.0
    radius, motion = 0.05, SpeedingUp()
    pull, mu, k = 5.0 / radius, inertia / radius**2, (5.0 / free_speed + damping) / radius**2

    def lag(mass: float) -> float:
        rate, throttle = 2 * k / (mass + 2 * mu), 2 * pull / (mass + 2 * mu)
        way = end**2 / 2 if rate < 1e-4 else end / rate - (1 - math.exp(-rate * end)) / rate**2
        return throttle * way - (motion.rate * end**2 / 2 - tube)

    largest = brentq(lag, 1.0, 1e4)
    found = MotionProgram(robot, motion, ErrorBounds(position=tube), intervals=30).solve()
    assert 1 + found.payload == pytest.approx(largest, rel=2e-3)


def test_sagging_adds_no_more_and_no_less_than_a_fall_that_a_tube_has_room_for() -> None:
    """Standing still in a tube of no width is the static payload; in a wider one the platform may fall by R."""
    hold = Dwell(pose=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0), duration=0.1)
    static = exact_payload(SPATIAL, hold)
    # By hand: the first motor's cable holds that fraction of the weight.
    fraction = textbook.required_tensions(SPATIAL, 1.0, np.array(hold.pose), np.zeros(6), np.zeros(6))
    by_hand = (SPATIAL.stall_torque / SPATIAL.pulley_radius / fraction).min() - SPATIAL.mass
    assert static.payload == pytest.approx(by_hand, rel=1e-9)
    payloads = []
    for width in (1e-5, 1e-3):
        tube = ErrorBounds(position=width, rotation=width)
        payloads.append(MotionProgram(SPATIAL, hold, tube, intervals=20).solve().payload)
    assert payloads[0] == pytest.approx(static.payload, rel=1e-3)
    # A free fall with the acceleration a sinks by a T²/2 = R: M (g − a) is what the static payload's g is. The ratio
    # of pulleys and tilts that help is not in this.
    least = static.total_mass * 9.81 / (9.81 - 2 * 1e-3 / 0.1**2) - SPATIAL.mass
    assert least < payloads[1] < 1.1 * least


def test_payload_does_not_fall_with_a_wider_tube_or_stronger_motors() -> None:
    reference = find_trajectory("paper-planar", 2)
    widths = [
        MotionProgram(PLANAR, reference, ErrorBounds(position=r), intervals=30).solve().payload for r in (5e-3, 1e-2)
    ]
    assert widths[1] > 1.05 * widths[0]
    motors = Motors(stall_torque=5.25, free_speed=PLANAR.motors.free_speed)
    stronger = MotionProgram(PLANAR.replace(motors=motors), reference, BOUNDS, intervals=30).solve().payload
    assert stronger > 1.03 * widths[1]


@pytest.mark.parametrize("factor", [0.5, 3.0])
def test_motors_and_inertia_in_proportion_do_not_carry_another_share_of_mass(factor: float) -> None:
    """Planar: M Ẍ = −SᵀT with T, J and M scaled alike is the same motion."""
    reference = find_trajectory("line-planar", 2)
    motors = Motors(stall_torque=factor * 5.0, free_speed=PLANAR.motors.free_speed)
    transmission = Transmission(pulley_radius=0.05, pulley_inertia=factor * 8e-4, damping=0.0)
    scaled = PLANAR.replace(motors=motors, transmission=transmission)
    masses = [1 + MotionProgram(robot, reference, BOUNDS, intervals=30).solve().payload for robot in (PLANAR, scaled)]
    assert masses[1] == pytest.approx(factor * masses[0], rel=1e-3)


def test_holding_torques_for_a_period_does_not_leave_the_payload_as_it_was() -> None:
    reference = find_trajectory("paper-planar", 2)
    payloads = [
        MotionProgram(PLANAR, reference, BOUNDS, intervals=30, period=period).solve().payload for period in (0.0, 0.02)
    ]
    assert payloads[1] < payloads[0] - 0.02


# --- solving ----------------------------------------------------------------------------------------------------------


def test_starts_and_meshes_do_not_end_in_other_optima() -> None:
    reference = find_trajectory("paper-planar", 2)
    coarse = MotionProgram(PLANAR, reference, BOUNDS, intervals=30)
    first = coarse.solve()
    assert coarse.solve().payload == first.payload
    np.testing.assert_array_equal(coarse.solve().poses, first.poses)
    shifted = coarse.solve(shift=np.array([0.3, -0.4]))
    assert shifted.payload == pytest.approx(first.payload, rel=1e-4)
    fine = MotionProgram(PLANAR, reference, BOUNDS, intervals=60)
    warm, cold = fine.solve(first), fine.solve()
    assert warm.payload == pytest.approx(cold.payload, rel=1e-4)
    assert warm.payload == pytest.approx(first.payload, rel=0.02)


def test_a_motion_that_nothing_lets_through_is_not_returned() -> None:
    reference = find_trajectory("paper-planar", 2)
    with pytest.raises(Infeasible):
        MotionProgram(PLANAR, reference, ErrorBounds(position=1e-6), intervals=20).solve()


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_does_not_pass_for_an_evaluation_that_failed() -> None:
    """CasADi alone would go on for as long as the program takes."""
    reference = find_trajectory("paper-spatial", 6)
    program = MotionProgram(SPATIAL, reference, BOUNDS, intervals=120)
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


def test_solving_beside_the_main_thread_does_not_ask_for_signals() -> None:
    found: list[float] = []
    program = MotionProgram(PLANAR, find_trajectory("line-planar", 2), BOUNDS, intervals=10)
    thread = threading.Thread(target=lambda: found.append(program.solve().payload))
    thread.start()
    thread.join()
    assert found[0] > 0
