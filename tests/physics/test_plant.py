"""The compiled plant against itself in other batch sizes, the textbook, a Python loop over its steps, and energy."""

from __future__ import annotations

import math
import re
from itertools import pairwise

import numpy as np
import pytest
from numba import njit
from oracles.one_dimension import line_robot
from oracles.plants import (
    FLEX_QUAD,
    FLEX_UNEQUAL,
    NINE,
    QUAD,
    UNEQUAL,
    State,
    advance,
    both_cables,
    differentiated,
    drive_speed,
    each_of,
    energies,
    evaluated,
    every_kind,
    every_robot,
    free_motors,
    loaded_plant,
    motion_accelerations,
    no_reference,
    off_centre,
    pulley_torques,
    random_states,
    record_of,
    rigid_robots,
    state_of,
    take_up_torques,
    textbook_rates,
    with_transmission,
    worst_relative_error,
)

from cablebot_gym.envs.settings import make_settings
from cablebot_gym.physics import kernel, textbook
from cablebot_gym.physics.kernel.arithmetic import sincos
from cablebot_gym.physics.plant import Plant, pack_parameters
from cablebot_gym.robots import PLANAR, ROBOTS

papers_robots = each_of(*ROBOTS.values())

# --- one lane and a tile of lanes ---------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [2, 33])
@both_cables
@every_kind
def test_lane_of_a_batch_has_the_bits_of_a_robot_alone(robot, cable, count):
    """Over slack, clipped motors, unequal masses and wrenches, own references and a reset of the last lane half way."""
    state, _ = random_states(robot, count, seed=count)
    mass = robot.mass * np.linspace(1, 1.6, count)
    rng = np.random.default_rng(7)
    demands = rng.uniform(-0.7, 1.3, (8, count, robot.cables))
    references, ends = rng.uniform(*robot.pose_bounds, (3, 25, robot.coordinates)), np.array([24, 11, 19])
    trajectory_index = np.arange(count) % 3
    late = count - 1
    force, moment = rng.uniform(-8, 8, (count, robot.dimensions)), rng.uniform(-2, 2, (count, 3))

    def run(members):
        plant = loaded_plant(robot, state[members], cable, mass[members])
        assert plant.lanes == (1 if len(members) == 1 else kernel.LANES)  # else a tile is compared with a tile
        plant.trajectory_index[: len(members)] = trajectory_index[members]
        plant.set_wrench(np.arange(len(members)), force[members], moment[members])
        records = []
        for step, demand in enumerate(demands):
            if step == 4 and late in members:
                at = np.flatnonzero(members == late)
                plant.set_state(at, state.pose[:1], state.velocity[:1])
                plant.set_motors(at, state.angle[:1], state.speed[:1])
            plant.set_action(demand[members])
            plant.advance(references, ends, substeps=3, step=5e-4 if robot.flexible else 2e-3)
            records.append(record_of(plant))
        return np.stack(records)

    tiled = run(np.arange(count))
    slack = tiled[:, :, kernel.FIRST_CABLE_RECORD + kernel.SLACK :: kernel.CABLE_RECORDS]
    assert count == 2 or 0.02 < np.mean(slack > 0) < 0.98
    assert np.all(np.isfinite(tiled))
    for lane in range(count):
        np.testing.assert_array_equal(run(np.array([lane]))[:, 0], tiled[:, lane])


@rigid_robots
def test_reset_leaves_nothing_of_the_earlier_run(robot):
    state, demand = random_states(robot, 5)
    references = np.random.default_rng(2).uniform(*robot.pose_bounds, (1, 30, robot.coordinates))

    def run(plant):
        for step in range(4):
            plant.set_action(demand * (1 - 0.3 * step))
            plant.advance(references, np.array([29]), substeps=4, step=2e-3)
        return record_of(plant)

    plant = loaded_plant(robot, state, "unilateral")
    fresh, first = record_of(plant), run(plant)
    plant.set_state(np.arange(5), state.pose, state.velocity)
    np.testing.assert_array_equal(record_of(plant), fresh)
    np.testing.assert_array_equal(run(plant), first)


@pytest.mark.parametrize("count", [1, 2, 65])
def test_memory_starts_at_cache_lines(count):
    """Otherwise the plant loses a fifth of its speed, by the luck of the allocation."""
    for plant in [Plant(PLANAR, count) for _ in range(5)]:  # so that a lucky allocation will not do
        for memory in (plant._parameters, plant.record, *(memory for part in plant._memory for memory in part[:3])):
            assert memory.ctypes.data % 64 == 0


# --- equations ----------------------------------------------------------------------------------------------------


@both_cables
@every_kind
def test_accelerations_tensions_and_taut_sets_are_those_of_the_textbook(robot, cable):
    """Against brute force over all taut sets. Reached: 4e-15, flexible 7e-14, and 1e-13 by differences.

    Coulomb friction changes within the step of the differences.
    """
    state, demand = random_states(robot, 300, seed=11)
    mass, torques = robot.mass * np.linspace(1, 2, 300), demand * robot.stall_torque
    found, pulled = evaluated(loaded_plant(robot, state, cable, mass), torques)
    expected, tension = textbook_rates(robot, state, torques, cable, mass)
    if cable == "unilateral":
        assert 0.03 < np.mean(tension == 0) < 0.9
        np.testing.assert_array_equal(pulled == 0, tension == 0)
    assert worst_relative_error(found, expected.velocity) <= 1e-13
    assert worst_relative_error(pulled, tension) <= 1e-13
    if robot.flexible and not robot.coulomb_friction.any():
        torques = np.clip(torques, -0.9 * robot.stall_torque, 0.9 * robot.stall_torque)
        expected, _ = textbook_rates(robot, state, torques, cable, mass)
        assert worst_relative_error(motion_accelerations(robot, state, torques, cable, mass)[1], expected.speed) < 1e-10


def complementarity(robot, state, at_pulley):
    """M and b of ``M T = b + u/r``, 0 ≤ T ⟂ u ≥ 0."""
    structure = textbook.jacobian(robot, state.pose)
    inertia, damping = (value / robot.pulley_radius**2 for value in (robot.pulley_inertia, robot.damping))
    compliance = structure @ np.linalg.inv(textbook.mass_matrix(robot, robot.mass, state.pose))
    matrix = np.eye(robot.cables) + inertia[:, None] * (compliance @ np.swapaxes(structure, 1, 2))
    rate = np.einsum("nij,nj->ni", textbook.jacobian_rate(robot, state.pose, state.velocity), state.velocity)
    free = np.einsum("nij,nj->ni", compliance, textbook.bias(robot, robot.mass, state.pose, state.velocity))
    vector = at_pulley / robot.pulley_radius + damping * np.einsum("nij,nj->ni", structure, state.velocity)
    return matrix, vector + inertia * (rate - free)


def wrong_after(changes, matrix, vector):
    """Whether a taut set is still wrong after so many changes of all wrong cables at once, all taut at first."""
    taut = np.ones(vector.shape, bool)
    for _ in range(changes + 1):
        tension = np.linalg.solve(
            np.where(taut[:, :, None], matrix, np.eye(taut.shape[1])), np.where(taut, vector, 0)[..., None]
        )[..., 0]
        right = np.where(taut, tension > 0, np.einsum("nij,nj->ni", matrix, tension) < vector)
        wrong = np.any(right != taut, axis=1)
        taut = right
    return wrong


@pytest.mark.parametrize(
    ("robot", "changes", "least_fraction"),
    [(QUAD, 1, 0.02), (UNEQUAL, 1, 0.02), (NINE, 10, 5e-4), (FLEX_QUAD, 0, 0.02), (FLEX_UNEQUAL, 0, 0.02)],
    ids=lambda value: getattr(value, "name", None),
)
def test_tensions_and_take_up_torques_are_complementary(robot, changes, least_fraction):
    """0 ≤ T ⟂ u ≥ 0 from the accelerations alone, u = r T − κ + J β̈ + c β̇.

    The sample holds states in which dropping the negative tensions once is wrong, and for nine cables states in which
    changing all wrong cables at once never ends: there the least-index rule has to find the solution.
    """
    count = 20_000 if robot is NINE else 5_000
    state, _ = random_states(robot, count, seed=12, reach=1.0)
    torques = np.random.default_rng(12).uniform(-1, 1, state.angle.shape) * robot.stall_torque
    at_pulley = pulley_torques(robot, state, torques, "unilateral")
    matrix, vector = complementarity(robot, state, at_pulley)
    assert np.mean(wrong_after(changes, matrix, vector)) > least_fraction
    acceleration, tension = evaluated(loaded_plant(robot, state, "unilateral"), torques)
    take_up = take_up_torques(robot, state, torques, acceleration, tension, "unilateral")
    size = 1 + np.abs(robot.pulley_radius * tension).max() + np.abs(vector * robot.pulley_radius).max(axis=1)
    taut = tension > 0
    assert tension.min() >= 0
    if robot.flexible:
        assert np.any(taut & (at_pulley == 0))  # only the pulley's inertia pulls
        assert np.any(~taut & (at_pulley > 0))  # the spring pulls, yet the pulley lags behind
    assert np.min(np.where(taut, 0, take_up) / size[:, None]) >= -1e-11
    assert np.max(np.abs(np.where(taut, take_up, 0)) / size[:, None]) <= 1e-11
    expected = (np.einsum("nij,nj->ni", matrix, tension) - vector) * robot.pulley_radius
    np.testing.assert_allclose(take_up / size[:, None], expected / size[:, None], rtol=0, atol=1e-11)


@rigid_robots
def test_remembered_slack_cables_do_not_change_the_result(robot):
    """Which cables were slack a moment ago only speeds the search up."""
    state, demand = random_states(robot, 40, seed=4)
    ends = []
    for remembered in (0.0, 1.0):
        plant = loaded_plant(robot, state, "unilateral")
        tiles = plant.record.reshape(plant.record.shape[0], -1, plant.lanes)
        tiles[:, kernel.FIRST_CABLE_RECORD + kernel.SLACK :: kernel.CABLE_RECORDS] = remembered
        plant.set_action(demand)
        plant.advance(*no_reference(robot), substeps=5, step=2e-3)
        ends.append(record_of(plant))
    np.testing.assert_array_equal(ends[0], ends[1])


# --- integration --------------------------------------------------------------------------------------------------


@every_robot
def test_integrator_has_order_four_while_motors_are_saturated(robot):
    """Motors follow their torque-speed lines; limits once per step would give order one."""
    pose, velocity = (value[None] for value in off_centre(robot))
    angle = textbook.pulley_angle(robot, pose)
    state = State(pose, velocity, angle, textbook.pulley_speed(robot, pose, velocity))

    def end(substeps):
        plant = loaded_plant(robot, state)
        plant.set_action(np.ones((1, robot.cables)))
        plant.advance(*no_reference(robot), substeps=substeps, step=0.01 / substeps)
        assert np.mean(drive_speed(robot, state_of(plant)) > drive_speed(robot, state) + 1) >= 0.5  # saturated
        return np.concatenate([value.ravel() for value in vars(state_of(plant)).values()])

    fine = end(2048)
    coarsest = 8 if robot.flexible else 2
    errors = [np.abs(end(coarsest * 2**k) - fine).max() for k in range(3)]
    assert errors[-1] > 1e-13
    for coarse, halved in pairwise(errors):
        assert 3.7 < np.log2(coarse / halved) < 4.5


@papers_robots
def test_default_step_is_accurate_under_bang_bang(robot):
    """Against 1/50 of the step, 0.2 s of random full torques; with limits once per step the errors were 0.4 to 5 mm.

    The kinks where motors saturate and springs become slack remain. Reached: 1e-8 m, flexible 3e-5 m.
    """
    settings, count, period = make_settings(robot=robot, count=1), 32, 2e-3
    pose = np.tile(robot.home, (count, 1))
    torque = np.tile(textbook.static_torque(robot, robot.mass, robot.home, minimum=20.0), (count, 1))
    angle = torque / robot.stiffness if robot.flexible else 0 * torque
    actions = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], (10, count, robot.cables)), 10, axis=0)

    def path(substeps):
        plant, found = loaded_plant(robot, State(pose, 0 * pose, angle, 0 * torque), "unilateral"), []
        for action in actions:
            plant.set_action(action)
            plant.advance(*no_reference(robot), substeps=substeps, step=period / substeps)
            found.append(plant.pose)
        return np.array(found)[..., :3]

    fine = path(50 * settings.substeps)
    assert np.abs(fine - pose[:, :3]).max() > 0.05
    error = np.linalg.norm(path(settings.substeps) - fine, axis=-1).max()
    assert error < (1e-4 if robot.flexible else 1e-7)


def with_lag(lag):
    """A plant at rest between long parallel cables, whose motors lag."""
    robot = line_robot(inertia=8e-4, free_speed=1e100, damping=0.0)
    robot = robot.replace(motors=robot.motors.replace(lag=lag))
    return loaded_plant(robot, State(*np.zeros((2, 1, 2)), *np.zeros((2, 1, 4))))


def test_lag_starts_within_the_stall_torque():
    """The recorded torque is the one that would hold the robot, which its motors may lack."""
    plant = with_lag(0.03)
    stall = plant.robot.stall_torque
    plant.set_torques(np.array([0]), 3 * stall[None])
    np.testing.assert_array_equal(plant.per_cable(kernel.TORQUE)[0], 3 * stall)
    plant.set_action(np.zeros((1, 4)))
    for k in range(3):
        plant.advance(*no_reference(plant.robot), substeps=2, step=1e-3)
        lagged = stall * math.exp(-k * 2e-3 / 0.03)
        np.testing.assert_allclose(plant.per_cable(kernel.TORQUE)[0], lagged, rtol=1e-12)


def test_lag_far_below_the_physics_step_delays_the_first_step_only():
    """Excludes a lagged torque that is not stored when it has decayed, and starts anew in every period."""
    gained = []
    for lag in (0.0, 1e-9):
        plant = with_lag(lag)
        plant.set_action(0.5 / plant.robot.stall_torque[None] * [1, 1, 0, 0])
        speeds = []
        for _ in range(6):
            plant.advance(*no_reference(plant.robot), substeps=2, step=1e-3)
            speeds.append(plant.velocity[0, 0])
        gained.append(np.diff(speeds))
    np.testing.assert_allclose(gained[1], gained[0], rtol=1e-6)


@papers_robots
def test_friction_too_steep_for_the_substeps_raises(robot):
    """Its slope at standstill is τ_c/ω₀. The named number of substeps is stable, one step of 2.9 time constants not."""
    steep = with_transmission(free_motors(robot), coulomb_friction=30.0)
    with pytest.raises(ValueError, match="use at least") as refusal:
        make_settings(robot=steep, count=1, substeps=1)
    needed = int(re.findall(r"at least (\d+)", str(refusal.value))[0])
    assert make_settings(robot=steep, count=1).substeps >= needed > 2
    within = {"parameters": {"coulomb_friction": {"low": 0.0, "high": 30.0, "relative": False}}}
    with pytest.raises(ValueError, match=f"use at least {needed}"):
        make_settings(robot=free_motors(robot), count=1, substeps=needed - 1, uncertainty=within)
    pose = robot.home[None]
    torque = textbook.static_torque(robot, robot.mass, pose, minimum=20.0)
    angle = torque / robot.stiffness if robot.flexible else 0 * torque
    speeds = []
    for step in (1 / (500 * needed), 2.9 / textbook.fastest_decay_rate(steep)):
        plant = loaded_plant(steep, State(pose, 1e-3 + 0 * pose, angle, 1e-3 + 0 * torque))
        for _ in range(40):
            advance(plant, torque, 20 * step, 20)
        speeds.append(np.abs(drive_speed(steep, state_of(plant))).max())
    assert speeds[0] < 1e-3 < 0.03 < speeds[1]


def python_period(robot, mass, state, action, lagged, substeps, step, cable):
    """States at all physics steps of a control period, the torques applied at each, and the lagged request."""
    line, states, applied = robot.speed_slope, [state], []
    request = robot.stall_torque * np.clip(action, -1, 1) - line * drive_speed(robot, state)

    def torque(time, state):
        lag = robot.motor_lag
        exponent = np.divide(-time, lag, out=np.full_like(lag, -np.inf), where=lag > 0)
        wanted = request + (lagged - request) * np.exp(exponent)
        drop = line * drive_speed(robot, state)
        return np.clip(wanted, -robot.stall_torque - drop, robot.stall_torque - drop), wanted

    for substep in range(substeps):
        start, time = states[-1], substep * step
        applied.append(torque(time, start)[0])
        rates = [textbook_rates(robot, start, applied[-1], cable, mass)[0]]
        for fraction in (0.5, 0.5, 1.0):
            state = start.moved(rates[-1], fraction * step)
            rates.append(textbook_rates(robot, state, torque(time + fraction * step, state)[0], cable, mass)[0])
        end = start
        for rate, weight in zip(rates, (1, 2, 2, 1), strict=True):
            end = end.moved(rate, weight * step / 6)
        states.append(end)
    return states, np.stack(applied), torque(substeps * step, end)[1]


@both_cables
@every_kind
def test_control_period_is_that_of_a_python_loop(robot, cable):
    """The request follows its lag, and the limits the speed, at every stage; peaks over all physics steps."""
    substeps, step, count, space = 10, 5e-4 if robot.flexible else 2e-3, 6, robot.dimensions
    state, action = random_states(robot, count, seed=5)
    mass = robot.mass * np.linspace(1, 1.5, count)
    references = state.pose[:, None] + np.random.default_rng(6).normal(0, 0.05, (count, 31, robot.coordinates))
    plant = loaded_plant(robot, state, cable, mass)
    plant.trajectory_index[:count] = np.arange(count)
    lagged, peak_steps = 0.3 * robot.stall_torque * np.ones((count, 1)), []
    plant.set_torques(np.arange(count), lagged)
    for period in range(3):
        plant.set_action(action)
        plant.advance(references, np.full(count, 30), substeps=substeps, step=step)
        states, applied, lagged = python_period(robot, mass, state, action, lagged, substeps, step, cable)
        assert period > 0 or np.abs(applied - applied[0]).max() > 0.01  # some motor reaches its limit on the way
        tensions = [textbook_rates(robot, states[k], applied[k], cable, mass)[1] for k in range(substeps)]
        least = np.min(tensions, axis=0)
        at_start = {kernel.TORQUE: applied[0], kernel.SPEED: drive_speed(robot, state), kernel.TENSION: tensions[0]}
        for row, expected in (at_start | {kernel.LEAST_TENSION: least}).items():
            np.testing.assert_allclose(plant.per_cable(row), expected, rtol=1e-12, atol=1e-12)
        assert np.any(least < tensions[0])
        np.testing.assert_array_equal(plant.per_cable(kernel.SLACK), np.sum(np.stack(tensions) <= 0, axis=0))
        lines = references[:, 10 * period + 1 : 10 * period + 11].swapaxes(0, 1)
        errors = np.stack([end.pose for end in states[1:]]) - lines
        distance = np.linalg.norm(errors[..., :space], axis=-1)
        record = record_of(plant)
        np.testing.assert_allclose(record[:, kernel.POSITION_PEAK], distance.max(axis=0), rtol=0, atol=1e-13)
        turned = np.abs(errors[..., space:]).max(axis=(0, 2), initial=0)
        np.testing.assert_allclose(record[:, kernel.ROTATION_PEAK], turned, rtol=0, atol=1e-13)
        peak_steps.extend(distance.argmax(axis=0))
        state = states[-1]
        ends = vars(state_of(plant)).values() if robot.flexible else (plant.pose, plant.velocity)
        for found, expected in zip(ends, vars(state).values(), strict=False):
            np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-12)
        state = State(
            plant.pose,
            plant.velocity,
            *((plant.motor_angle, plant.motor_speed) if robot.flexible else (state.angle, state.speed)),
        )
    assert len(set(peak_steps)) > 3  # the peak is not always at the end or the start


@rigid_robots
def test_reference_stays_at_the_last_line(robot):
    """Behind the end of a trajectory stands another one or nothing; here it is not a number."""
    count, end, space = 3, 5, robot.dimensions
    state, demand = random_states(robot, count, seed=8)
    references = np.full((2, 20, robot.coordinates), np.nan)
    references[:, : end + 1] = state.pose[0] + np.linspace(0, 0.3, end + 1)[:, None]
    plant = loaded_plant(robot, state, "unilateral")
    plant.trajectory_index[:count] = 1
    for period in range(5):
        plant.set_action(demand)
        plant.advance(references, np.array([19, end]), substeps=2, step=1e-3)
        if period >= 3:  # lines 7 and 8 on
            error = np.linalg.norm((plant.pose - references[1, end])[:, :space], axis=1)
            found = record_of(plant)[:, kernel.POSITION_PEAK]
            assert np.all(found >= error - 1e-12)
            assert np.all(found <= error + 0.01)  # as far as it moves in one step


@every_robot
def test_torques_end_at_the_torque_speed_lines(robot):
    """Actions beyond ± 1 give exactly U⁺ and U⁻, those between exactly the request; the raw action is recorded."""
    state, _ = random_states(robot, 40, seed=9)
    action = np.random.default_rng(1).choice([-3.0, -1.0, -0.4, 0.0, 0.7, 1.0, 1.5], (40, robot.cables))
    plant = loaded_plant(robot, state, "unilateral")
    plant.set_action(action)
    plant.advance(*no_reference(robot), substeps=2, step=1e-4)
    speed, torque = plant.per_cable(kernel.SPEED), plant.per_cable(kernel.TORQUE)
    np.testing.assert_allclose(speed, drive_speed(robot, state), rtol=1e-12, atol=1e-12)
    drop = robot.speed_slope * speed
    assert np.abs(drop).max() > 0.3
    np.testing.assert_array_equal(torque, robot.stall_torque * np.clip(action, -1, 1) - drop)
    np.testing.assert_array_equal(plant.per_cable(kernel.DEMAND), action)


# --- external wrench ----------------------------------------------------------------------------------------------


def wrench_rows(plant):
    """Force and moment of all lanes in memory, the padding included, shape (width, 6)."""
    tiles = plant._parameters.reshape(len(plant.record), -1, plant.lanes)
    return tiles[:, kernel.FORCE : kernel.FIRST_CABLE_PARAMETER].transpose(0, 2, 1).reshape(plant.width, 6)


def test_wrench_lasts_until_it_or_the_parameters_are_set_anew():
    """It survives a reset; the padding does as the last robot does; no moment is left behind."""
    state, demand = random_states(UNEQUAL, 33, seed=14)
    plant = loaded_plant(UNEQUAL, state, "unilateral")
    assert not wrench_rows(plant).any()
    pushed = np.array([4, 32])
    plant.set_wrench(pushed, np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), np.array([[7.0, 8.0, 9.0]] * 2))
    expected = np.zeros((plant.width, 6))
    expected[4], expected[32:] = [1, 2, 3, 7, 8, 9], [4, 5, 6, 7, 8, 9]
    plant.set_action(demand)
    plant.advance(*no_reference(UNEQUAL), substeps=2, step=1e-3)
    plant.set_state(np.arange(33), state.pose, state.velocity)
    np.testing.assert_array_equal(wrench_rows(plant), expected)
    plant.set_wrench(pushed[:1], np.array([[1.0, 0.0, 0.0]]))
    expected[4] = [1, 0, 0, 0, 0, 0]
    np.testing.assert_array_equal(wrench_rows(plant), expected)
    plant.set_parameters(pushed[1:], pack_parameters(UNEQUAL)[None])
    expected[32:] = 0
    np.testing.assert_array_equal(wrench_rows(plant), expected)
    planar = Plant(PLANAR, 2)
    planar.set_wrench(np.arange(2), np.array([[1.0, 2.0], [3.0, 4.0]]))
    np.testing.assert_array_equal(wrench_rows(planar)[:2], [[1, 2, 0, 0, 0, 0], [3, 4, 0, 0, 0, 0]])


@pytest.mark.parametrize("count", [1, 2])
@rigid_robots
def test_work_of_a_constant_force_becomes_energy(robot, count):
    """The undriven, undamped plant gains F·Δp: the force neither turns nor pauses. Reached: 1e-11 J of 24 J."""
    robot = with_transmission(free_motors(robot), damping=0.0)
    mass, space = 1.3 * robot.mass, robot.dimensions
    pose, velocity, force = robot.home + 0.05, np.full(robot.coordinates, 0.4), np.array([25.0, -40.0, 30.0])[:space]
    if not robot.planar:
        pose[2] += 0.25
    start = State(*(np.tile(value, (count, 1)) for value in (pose, velocity)), *np.zeros((2, count, robot.cables)))
    plant = loaded_plant(robot, start, mass=mass)
    plant.set_wrench(np.arange(count), np.tile(force, (count, 1)))
    advance(plant, np.zeros(robot.cables), 0.3, 300)
    work = (plant.pose - pose)[:, :space] @ force
    assert np.abs(work).min() > 0.5
    gained = sum(energies(robot, state_of(plant), mass=mass)) - sum(energies(robot, start, mass=mass))
    np.testing.assert_allclose(gained, work, rtol=0, atol=1e-9)


# --- energy -------------------------------------------------------------------------------------------------------


@both_cables
@every_kind
def test_power_is_balanced_also_with_slack_cables(robot, cable):
    """d/dt E = Σ τ β̇′ + Σ u β̇ − Σ c β̇² − Σ c′ β̇′² − Σ τ_c |β̇′|, u from complementarity; rigid: β′ = β, c′ = 0.

    At low speeds |β̇′| is smooth.
    """
    damping = tuple(np.linspace(0.01, 0.05, robot.cables).tolist())
    robot = with_transmission(robot, damping=damping, **({"motor_damping": damping[::-1]} if robot.flexible else {}))
    state, action = random_states(robot, 200, seed=10)
    torques, mass = action * robot.stall_torque, 1.2 * robot.mass
    platform, tension = evaluated(loaded_plant(robot, state, cable, mass), torques)
    rate, _ = textbook_rates(robot, state, torques, cable, mass)
    take_up = take_up_torques(robot, state, torques, platform, tension, cable)
    np.testing.assert_allclose(take_up if cable == "bilateral" else take_up[tension > 0], 0, atol=1e-10)
    pulley, motor = textbook.pulley_speed(robot, state.pose, state.velocity), drive_speed(robot, state)
    supplied = np.sum(np.where(tension == 0, take_up, 0.0) * pulley, axis=1)
    spent = np.sum(robot.damping * pulley**2, axis=1)
    if robot.flexible:
        spent += np.sum(robot.motor_damping * state.speed**2, axis=1)
    spent += np.sum(textbook.coulomb_torque(robot, motor) * motor, axis=1)
    if cable == "unilateral":
        assert np.mean(np.abs(supplied)) > 1  # without it the balance is off by watts
    power = np.sum(torques * motor, axis=1) + supplied - spent

    def energy(time):
        rates = State(state.velocity + time / 2 * platform, platform, state.speed + time / 2 * rate.speed, rate.speed)
        return sum(energies(robot, state.moved(rates, time), cable, mass))

    size = 1 + np.sum(np.abs(torques * motor), axis=1)
    change = differentiated(energy, 4e-5 if robot.flexible else 2e-4)
    np.testing.assert_allclose(change / size, power / size, rtol=0, atol=1e-8)


# --- helpers and broken states ------------------------------------------------------------------------------------


def test_sine_and_cosine_are_right_to_the_last_digit():
    """Over ± 100 rad and near multiples of π/2: 1 ulp, and 1.2e-16 absolute.

    Closer than 1e-9 to a zero the reduction's last digit shows (3e-27 at π/2), and relative errors mean nothing.
    """
    sine_and_cosine = njit(lambda angle: sincos(angle))
    quarter = np.arange(-63, 64) * (math.pi / 2)
    near = (quarter[:, None] + np.array([-1e-3, -1e-6, -1e-8, 0.0, 1e-8, 1e-6, 1e-3])).ravel()
    for angle in np.concatenate([np.linspace(-100, 100, 20_001), near, np.linspace(-math.pi, math.pi, 9)]).tolist():
        for found, expected in zip(sine_and_cosine(angle), (math.sin(angle), math.cos(angle)), strict=True):
            assert abs(found - expected) <= 1.2e-16
            if abs(expected) > 1e-9:
                assert abs(found - expected) <= 2 * math.ulp(expected)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("row", ["pose", "velocity", "angle", "demand"])
@rigid_robots
def test_state_that_is_not_finite_ends_the_search_and_spares_its_neighbours(robot, row, bad):
    """It shows in the state and in the position error, and the other lanes keep every bit."""
    state, demand = random_states(robot, 33, seed=13)
    references, sick = np.zeros((1, 50, robot.coordinates)), [3, 32]

    def run(pose, velocity, demand):
        plant = loaded_plant(robot, State(pose, velocity, state.angle, state.speed), "unilateral")
        for _ in range(3):
            plant.set_action(demand)
            plant.advance(references, np.array([49]), substeps=5, step=2e-3)
        return record_of(plant)

    healthy = run(state.pose, state.velocity, demand)
    spoilt = {"pose": state.pose.copy(), "velocity": state.velocity.copy(), "demand": demand.copy()}
    for lane in sick:
        spoilt["pose" if row == "angle" else row][lane, -1 if row == "angle" else 0] = bad
    found = run(**spoilt)
    others = np.setdiff1d(np.arange(33), sick)
    np.testing.assert_array_equal(found[others], healthy[others])
    if row == "demand" and np.isinf(bad):  # clipped like any other action above 1
        assert np.all(np.isfinite(found[sick, kernel.POSE : kernel.POSE + robot.coordinates]))
    else:
        assert not np.any(np.isfinite(found[sick, kernel.POSITION_PEAK]))
