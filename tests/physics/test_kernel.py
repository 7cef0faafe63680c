"""The compiled plant against itself in other batch sizes, the textbook, energy, and a Python loop over its steps."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cablebot_gym import kinematics
from cablebot_gym.physics import kernel, textbook
from cablebot_gym.physics.plant import Plant, pack_parameters
from cablebot_gym.robots import PLANAR, SPATIAL, Motors, Transmission

# Every motor and axis different, one motor without inertia.
UNEQUAL = SPATIAL.replace(
    name="unequal",
    inertia=(0.9, 0.3, 0.7),
    motors=Motors(stall_torque=(8.0, 9.0, 10.0, 11.0, 12.0, 13.0), free_speed=(50.0, 60.0, 70.0, 80.0, 90.0, 100.0)),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06, 0.07, 0.08),
        pulley_inertia=(4e-4, 6e-4, 8e-4, 1e-3, 1.2e-3, 0.0),
        damping=(0.0, 0.01, 0.02, 0.03, 0.04, 0.05),
    ),
)
QUAD = PLANAR.replace(
    name="quad",
    base_anchors=((-0.6, -0.3), (0.5, -0.4), (0.4, 0.5), (-0.5, 0.6)),
    motors=Motors(stall_torque=(4.0, 5.0, 6.0, 7.0), free_speed=(50.0, 60.0, 70.0, 80.0)),
    transmission=Transmission(
        pulley_radius=(0.03, 0.04, 0.05, 0.06), pulley_inertia=(4e-4, 0.0, 8e-4, 1e-3), damping=(0.0, 0.01, 0.02, 0.03)
    ),
    home_pose=(0.05, 0.1),
)
# So many cables and so much pulley inertia that changing all wrong cables at once goes round in circles.
NINE = PLANAR.replace(
    name="nine",
    base_anchors=tuple((math.cos(k * math.tau / 9), math.sin(k * math.tau / 9)) for k in range(9)),
    transmission=Transmission(pulley_radius=0.05, pulley_inertia=0.8),
)
ROBOTS = [PLANAR, QUAD, SPATIAL, UNEQUAL]

every_robot = pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
both_cables = pytest.mark.parametrize("cable", ["unilateral", "bilateral"])


def random_states(robot, count, seed=1):
    """Poses away from the anchors, velocities and actions (some beyond ±1) that slacken many cables."""
    rng = np.random.default_rng(seed)
    low, high = 0.6 * (robot.pose_bounds - robot.home) + robot.home
    pose = rng.uniform(low, high, (count, robot.coordinates))
    return pose, rng.uniform(-1, 1, pose.shape), rng.uniform(-0.7, 1.2, (count, robot.cables))


def loaded_plant(robot, mass, pose, velocity, cable="unilateral"):
    """A plant at these states, with one total mass or one for each robot."""
    count = len(pose)
    plant = Plant(robot, count, cable=cable)
    rows = np.tile(pack_parameters(robot), (count, 1))
    rows[:, kernel.MASS] = mass
    plant.set_parameters(np.arange(count), rows)
    plant.set_state(np.arange(count), pose, velocity)
    return plant


def record_of(plant):
    """The whole record, a row for each robot."""
    tiles = plant.record.reshape(plant.record.shape[0], -1, plant.lanes)
    return tiles.transpose(0, 2, 1).reshape(plant.width, -1)[: plant.count].copy()


def no_reference(robot):
    """References and their ends for runs in which nobody reads the errors."""
    return np.zeros((1, 1, robot.coordinates)), np.zeros(1, np.int64)


def evaluated(robot, mass, pose, velocity, torques, cable="unilateral"):
    """Accelerations and tensions from the kernel."""
    return loaded_plant(robot, mass, pose, velocity, cable).evaluate(torques)


# --- one lane and a tile of lanes ---------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [2, 31, 32, 33, 45])
@both_cables
@every_robot
def test_bits_exclude_a_lane_that_differs_from_a_robot_alone(robot, cable, count):
    """Over slack, clipped motors, unequal masses and wrenches, own references and a reset half way."""
    pose, velocity, _ = random_states(robot, count, seed=count)
    mass = robot.mass * np.linspace(1, 1.6, count)
    rng = np.random.default_rng(7)
    demands = rng.uniform(-0.7, 1.3, (8, count, robot.cables))
    references = rng.uniform(*robot.pose_bounds, (3, 25, robot.coordinates))
    ends = np.array([24, 11, 19])
    trajectory_index = np.arange(count) % 3
    late = count - 1  # reset half way: the lane that fills up the last tile
    force, moment = rng.uniform(-8, 8, (count, 2 if robot.planar else 3)), rng.uniform(-2, 2, (count, 3))

    def run(members):
        plant = loaded_plant(robot, mass[members], pose[members], velocity[members], cable)
        assert plant.lanes == (1 if len(members) == 1 else kernel.LANES)  # else a tile is compared with a tile
        plant.trajectory_index[: len(members)] = trajectory_index[members]
        plant.set_wrench(np.arange(len(members)), force[members], moment[members])
        records = []
        for step, demand in enumerate(demands):
            if step == 4 and late in members:
                at = np.flatnonzero(members == late)
                plant.set_state(at, pose[:1], velocity[:1])
            plant.set_action(demand[members])
            plant.advance(references, ends, substeps=3, step=2e-3)
            records.append(record_of(plant))
        return np.stack(records)

    tiled = run(np.arange(count))
    slack = tiled[:, :, kernel.FIRST_CABLE_RECORD + kernel.SLACK :: kernel.CABLE_RECORDS]
    assert 0.02 < np.mean(slack > 0) < 0.98
    assert np.all(np.isfinite(tiled))
    for lane in range(count):
        np.testing.assert_array_equal(run(np.array([lane]))[:, 0], tiled[:, lane])


@both_cables
@pytest.mark.parametrize("robot", [QUAD, UNEQUAL], ids=lambda robot: robot.name)
def test_repetition_excludes_a_result_that_depends_on_what_the_memory_held_before(robot, cable):
    """A reset leaves nothing of the earlier run: neither request, taut set, peak nor time."""
    pose, velocity, demand = random_states(robot, 5)
    references = np.random.default_rng(2).uniform(*robot.pose_bounds, (1, 30, robot.coordinates))

    def run(plant):
        for step in range(4):
            plant.set_action(demand * (1 - 0.3 * step))
            plant.advance(references, np.array([29]), substeps=4, step=2e-3)
        return record_of(plant)

    plant = loaded_plant(robot, robot.mass, pose, velocity, cable)
    fresh, first = record_of(plant), run(plant)
    plant.set_state(np.arange(5), pose, velocity)
    np.testing.assert_array_equal(record_of(plant), fresh)
    np.testing.assert_array_equal(run(plant), first)


@pytest.mark.parametrize("count", [1, 2, 65])
def test_the_memory_excludes_rows_that_straddle_cache_lines(count):
    """A fifth of the plant's speed, by the luck of the allocation otherwise."""
    others = [Plant(PLANAR, count) for _ in range(5)]  # so that a lucky allocation will not do
    for plant in (*others, Plant(SPATIAL, count)):
        for memory in (plant._parameters, plant.record, plant._scratch):
            assert memory.ctypes.data % 64 == 0
            assert not memory.any() or memory is plant._parameters


# --- equations ----------------------------------------------------------------------------------------------------


@both_cables
@every_robot
def test_the_textbook_excludes_a_wrong_acceleration_tension_or_taut_set(robot, cable):
    """Against brute force over all taut sets. Reached: 4e-15."""
    pose, velocity, demand = random_states(robot, 500, seed=11)
    mass, torques = robot.mass * np.linspace(1, 2, 500), demand * robot.stall_torque
    found, pulled = evaluated(robot, mass, pose, velocity, torques, cable)
    expected, tension = textbook.forward_dynamics(robot, mass, pose, velocity, torques, cable=cable)
    if cable == "unilateral":
        assert 0.1 < np.mean(tension == 0) < 0.9
        np.testing.assert_array_equal(pulled == 0, tension == 0)
    else:
        assert tension.min() < -1
    for ours, theirs in ((found, expected), (pulled, tension)):
        size = np.maximum(1, np.linalg.norm(theirs, axis=1, keepdims=True))
        np.testing.assert_allclose(ours / size, theirs / size, rtol=0, atol=5e-14)


def complementarity(robot, pose, velocity, torques):
    """M and b of ``M T = b + u/r``, 0 ≤ T ⟂ u ≥ 0 (physics.md §2)."""
    structure = textbook.jacobian(robot, pose)
    inertia, damping = (value / robot.pulley_radius**2 for value in (robot.pulley_inertia, robot.damping))
    compliance = structure @ np.linalg.inv(textbook.mass_matrix(robot, robot.mass, pose))
    matrix = np.eye(robot.cables) + inertia[:, None] * (compliance @ np.swapaxes(structure, 1, 2))
    rate = np.einsum("nij,nj->ni", textbook.jacobian_rate(robot, pose, velocity), velocity)
    free = np.einsum("nij,nj->ni", compliance, textbook.bias(robot, robot.mass, pose, velocity))
    vector = torques / robot.pulley_radius + damping * np.einsum("nij,nj->ni", structure, velocity)
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
    ("robot", "changes", "least_share"),
    [(PLANAR, 1, 0.02), (QUAD, 1, 0.02), (SPATIAL, 1, 0.02), (UNEQUAL, 1, 0.02), (NINE, 10, 5e-4)],
    ids=lambda value: getattr(value, "name", None),
)
def test_complementarity_excludes_a_dropped_cable_that_should_have_come_back(robot, changes, least_share):
    """0 ≤ T ⟂ u ≥ 0 from the accelerations alone, u = r T − τ + J β̈ + c β̇.

    The sample has to hold states in which dropping the negative tensions once is wrong (8 % planar, 6 % spatial), and
    for nine cables states in which changing all wrong cables at once never ends (1 in 1000): there the least-index
    rule has to find the solution.
    """
    rng = np.random.default_rng(12)
    pose = rng.uniform(*robot.pose_bounds, (20_000, robot.coordinates))
    velocity = rng.uniform(-2, 2, pose.shape)
    torques = rng.uniform(-1, 1, (len(pose), robot.cables)) * robot.stall_torque
    matrix, vector = complementarity(robot, pose, velocity, torques)
    assert np.mean(wrong_after(changes, matrix, vector)) > least_share
    acceleration, tension = evaluated(robot, robot.mass, pose, velocity, torques)
    take_up = robot.pulley_radius * tension - torques
    take_up += robot.pulley_inertia * textbook.pulley_acceleration(robot, pose, velocity, acceleration)
    take_up += robot.damping * textbook.pulley_speed(robot, pose, velocity)
    size = 1 + np.abs(robot.pulley_radius * tension).max() + np.abs(vector * robot.pulley_radius).max(axis=1)
    taut = tension > 0
    assert tension.min() >= 0
    assert np.min(np.where(taut, 0, take_up) / size[:, None]) >= -1e-11
    assert np.max(np.abs(np.where(taut, take_up, 0)) / size[:, None]) <= 1e-11
    expected = np.einsum("nij,nj->ni", matrix, tension)  # the same from M T = b + u/r
    expected = (expected - vector) * robot.pulley_radius
    np.testing.assert_allclose(take_up / size[:, None], expected / size[:, None], rtol=0, atol=1e-11)


def test_the_order_of_the_search_excludes_a_state_that_remembers_its_slack_cables():
    """Which cables were slack a moment ago speeds the search up and must not change what it finds."""
    for robot in (QUAD, UNEQUAL):
        pose, velocity, demand = random_states(robot, 40, seed=4)
        ends = []
        for remembered in (0.0, 1.0):
            plant = loaded_plant(robot, robot.mass, pose, velocity)
            tiles = plant.record.reshape(plant.record.shape[0], -1, plant.lanes)
            tiles[:, kernel.FIRST_CABLE_RECORD + kernel.SLACK :: kernel.CABLE_RECORDS] = remembered
            plant.set_action(demand)
            plant.advance(*no_reference(robot), substeps=5, step=2e-3)
            ends.append(record_of(plant))
        np.testing.assert_array_equal(ends[0], ends[1])


# --- integration --------------------------------------------------------------------------------------------------


def smooth_run(robot, substeps, duration):
    """One control period under constant torques that keep the cables taut and the motors off their lines."""
    if robot.planar:
        pose, velocity, torques = np.array([0.1, -0.05]), np.array([0.6, 0.9]), 0.3 * robot.stall_torque
    else:
        pose = np.array([0.03, -0.02, 0.35, 0.05, -0.04, 0.1])
        velocity = np.array([0.3, -0.4, 0.2, 0.5, 0.3, -0.6])
        torques = np.full(6, 2.2) * robot.pulley_radius / 0.05
    demand = (torques + robot.speed_slope * textbook.pulley_speed(robot, pose, velocity)) / robot.stall_torque
    plant = loaded_plant(robot, robot.mass, pose[None], velocity[None])
    plant.set_action(demand[None])
    plant.advance(*no_reference(robot), substeps=substeps, step=duration / substeps)
    assert np.all(plant.per_cable(kernel.SLACK) == 0)
    speed = textbook.pulley_speed(robot, plant.pose, plant.velocity)
    assert np.all(np.abs(torques + robot.speed_slope * speed) < robot.stall_torque)
    return np.append(plant.pose, plant.velocity)


@pytest.mark.parametrize("robot", [PLANAR, QUAD, SPATIAL, UNEQUAL], ids=lambda robot: robot.name)
def test_the_measured_order_excludes_an_integrator_below_the_fourth(robot):
    """Reached: 3.9 to 4.1."""
    duration = 0.16
    fine = smooth_run(robot, 4096, duration)
    errors = [np.abs(smooth_run(robot, substeps, duration) - fine).max() for substeps in (8, 16, 32, 64)]
    assert errors[-1] > 1e-13  # above rounding, or the order means nothing
    for coarse, halved in pairwise(errors):
        assert 3.7 < math.log2(coarse / halved) < 4.5


def python_period(robot, mass, pose, velocity, demand, substeps, step, cable):
    """A control period as physics.md §3 has it: states at all physics steps, and the torques applied in each."""
    line = robot.speed_slope
    request = robot.stall_torque * demand - line * textbook.pulley_speed(robot, pose, velocity)
    poses, velocities, applied = [pose], [velocity], []

    def rate(x, v, torque):
        return textbook.forward_dynamics(robot, mass, x, v, torque, cable=cable)[0]

    for _ in range(substeps):
        x, v = poses[-1], velocities[-1]
        drop = line * textbook.pulley_speed(robot, x, v)
        torque = np.clip(request, -robot.stall_torque - drop, robot.stall_torque - drop)
        a1 = rate(x, v, torque)
        a2 = rate(x + step / 2 * v, v + step / 2 * a1, torque)
        a3 = rate(x + step / 2 * (v + step / 2 * a1), v + step / 2 * a2, torque)
        a4 = rate(x + step * (v + step / 2 * a2), v + step * a3, torque)
        poses.append(x + step * v + step**2 / 6 * (a1 + a2 + a3))
        velocities.append(v + step / 6 * (a1 + 2 * a2 + 2 * a3 + a4))
        applied.append(torque)
    return np.stack(poses), np.stack(velocities), np.stack(applied)


@both_cables
@every_robot
def test_a_python_loop_excludes_a_wrong_hold_of_the_request_or_a_wrong_peak_of_the_errors(robot, cable):
    """Request held over the period, line moving with the speed; peaks over the ends of all physics steps."""
    substeps, step, count = 10, 2e-3, 6
    pose, velocity, demand = random_states(robot, count, seed=5)
    mass = robot.mass * np.linspace(1, 1.5, count)
    rng = np.random.default_rng(6)
    references = pose[:, None] + rng.normal(0, 0.05, (count, 31, robot.coordinates))
    plant = loaded_plant(robot, mass, pose, velocity, cable)
    plant.trajectory_index[:count] = np.arange(count)
    peak_steps = []
    for period in range(3):
        plant.set_action(demand)
        plant.advance(references, np.full(count, 30), substeps=substeps, step=step)
        poses, velocities, applied = python_period(robot, mass, pose, velocity, demand, substeps, step, cable)
        if period == 0:
            assert np.abs(applied - applied[0]).max() > 0.01  # some motor runs into its line within the period
        at_start = {
            kernel.TORQUE: applied[0],
            kernel.SPEED: textbook.pulley_speed(robot, pose, velocity),
            kernel.TENSION: textbook.forward_dynamics(robot, mass, pose, velocity, applied[0], cable=cable)[1],
        }
        for row, expected in at_start.items():
            np.testing.assert_allclose(plant.per_cable(row), expected, rtol=1e-12, atol=1e-12)
        tensions = [
            textbook.forward_dynamics(robot, mass, poses[k], velocities[k], applied[k], cable=cable)[1]
            for k in range(substeps)
        ]
        np.testing.assert_array_equal(plant.per_cable(kernel.SLACK), np.sum(np.stack(tensions) <= 0, axis=0))
        lines = references[:, 10 * period + 1 : 10 * period + 11].swapaxes(0, 1)
        space = 2 if robot.planar else 3
        distance = np.linalg.norm((poses[1:] - lines)[..., :space], axis=-1)
        record = record_of(plant)
        np.testing.assert_allclose(record[:, kernel.POSITION_PEAK], distance.max(axis=0), rtol=0, atol=1e-13)
        turned = np.abs((poses[1:] - lines)[..., space:]).max(axis=(0, 2), initial=0)
        np.testing.assert_allclose(record[:, kernel.ROTATION_PEAK], turned, rtol=0, atol=1e-13)
        peak_steps.extend(distance.argmax(axis=0))
        pose, velocity = poses[-1], velocities[-1]
        np.testing.assert_allclose(plant.pose, pose, rtol=0, atol=1e-13)
        np.testing.assert_allclose(plant.velocity, velocity, rtol=0, atol=1e-13)
        pose, velocity = plant.pose, plant.velocity
    assert len(set(peak_steps)) > 3  # the peak is not always at the end or the start


@every_robot
def test_the_last_line_excludes_reading_references_beyond_the_end(robot):
    """What stands behind a trajectory's end is another one's, or nothing; here it is not a number."""
    count, end = 3, 5
    pose, velocity, demand = random_states(robot, count, seed=8)
    references = np.full((2, 20, robot.coordinates), np.nan)
    references[:, : end + 1] = pose[0] + np.linspace(0, 0.3, end + 1)[:, None]
    plant = loaded_plant(robot, robot.mass, pose, velocity)
    plant.trajectory_index[:count] = 1
    for period in range(5):
        before = plant.pose
        assert np.all(np.isfinite(before))
        plant.set_action(demand)
        plant.advance(references, np.array([19, end]), substeps=2, step=1e-3)
        if period >= 3:  # lines 7 and 8 on
            space = 2 if robot.planar else 3
            error = np.linalg.norm((plant.pose - references[1, end])[:, :space], axis=1)
            found = record_of(plant)[:, kernel.POSITION_PEAK]
            assert np.all(found >= error - 1e-12)
            assert np.all(found <= error + 0.01)  # as far as it moves in one step


# --- external wrench ----------------------------------------------------------------------------------------------


def wrench_rows(plant):
    """Force and moment of all lanes in memory, the fill included, shape (width, 6)."""
    tiles = plant._parameters.reshape(len(plant.record), -1, plant.lanes)
    return tiles[:, kernel.FORCE : kernel.FIRST_CABLE_PARAMETER].transpose(0, 2, 1).reshape(plant.width, 6)


def test_the_wrench_excludes_one_that_fades_spreads_or_leaves_a_moment_behind():
    """It lasts over resets until it is set anew or the parameters are; the fill does as the last robot does."""
    pose, velocity, demand = random_states(UNEQUAL, 33, seed=14)
    plant = loaded_plant(UNEQUAL, UNEQUAL.mass, pose, velocity)
    assert not wrench_rows(plant).any()
    pushed = np.array([4, 32])
    plant.set_wrench(pushed, np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), np.array([[7.0, 8.0, 9.0]] * 2))
    expected = np.zeros((plant.width, 6))
    expected[4], expected[32:] = [1, 2, 3, 7, 8, 9], [4, 5, 6, 7, 8, 9]
    plant.set_action(demand)
    plant.advance(*no_reference(UNEQUAL), substeps=2, step=1e-3)
    plant.set_state(np.arange(33), pose, velocity)
    np.testing.assert_array_equal(wrench_rows(plant), expected)
    plant.set_wrench(pushed[:1], np.array([[1.0, 0.0, 0.0]]))
    expected[4] = [1, 0, 0, 0, 0, 0]
    np.testing.assert_array_equal(wrench_rows(plant), expected)
    plant.set_parameters(pushed[1:], pack_parameters(UNEQUAL)[None])
    expected[32:] = 0
    np.testing.assert_array_equal(wrench_rows(plant), expected)


def test_a_planar_force_excludes_a_third_number_taken_for_another_robots():
    plant = Plant(PLANAR, 2)
    plant.set_wrench(np.arange(2), np.array([[1.0, 2.0], [3.0, 4.0]]))
    np.testing.assert_array_equal(wrench_rows(plant)[:2], [[1, 2, 0, 0, 0, 0], [3, 4, 0, 0, 0, 0]])


# --- motors -------------------------------------------------------------------------------------------------------


@every_robot
def test_the_line_excludes_torques_beyond_it_at_the_control_instant(robot):
    """Demands beyond ±1 give exactly U⁺ and U⁻, those between exactly the request; the raw demand is recorded."""
    pose, velocity, _ = random_states(robot, 40, seed=9)
    demand = np.random.default_rng(1).choice([-3.0, -1.0, -0.4, 0.0, 0.7, 1.0, 1.5], (40, robot.cables))
    plant = loaded_plant(robot, robot.mass, pose, velocity)
    plant.set_action(demand)
    plant.advance(*no_reference(robot), substeps=2, step=1e-3)
    speed, torque = plant.per_cable(kernel.SPEED), plant.per_cable(kernel.TORQUE)
    np.testing.assert_allclose(speed, textbook.pulley_speed(robot, pose, velocity), rtol=1e-12, atol=1e-12)
    drop = robot.speed_slope * speed
    assert np.abs(drop).max() > 0.3
    np.testing.assert_array_equal(torque, robot.stall_torque * np.clip(demand, -1, 1) - drop)
    np.testing.assert_array_equal(plant.per_cable(kernel.DEMAND), demand)


# --- energy -------------------------------------------------------------------------------------------------------


def energy(robot, mass, pose, velocity):
    """Kinetic and potential energy of the platform in its own frame, and the pulleys' Σ ½ J β̇²."""
    translation = velocity[..., : 2 if robot.planar else 3]
    total = mass / 2 * np.sum(translation**2, axis=-1)
    if not robot.planar:
        omega = np.einsum("...ij,...j->...i", kinematics.euler_rate_matrix(pose[..., 3:]), velocity[..., 3:])
        total += np.sum(np.array(robot.inertia) * omega**2, axis=-1) / 2 - mass * robot.gravity * pose[..., 2]
    return total + np.sum(robot.pulley_inertia * textbook.pulley_speed(robot, pose, velocity) ** 2, axis=-1) / 2


def with_damping(robot, damping):
    return robot.replace(transmission=dataclasses.replace(robot.transmission, damping=damping))


@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name)
def test_energy_excludes_an_undriven_plant_that_drifts(robot):
    """No torque, no damping, cables that may push, so that the pulleys move along. Reached at 1 ms: 1e-11 J of 34 J.

    What remains is the integrator's: halving the step divides it by at least 16.
    """
    free = Motors(stall_torque=1.0, free_speed=1e9)  # no line to run into
    robot, mass = with_damping(robot.replace(motors=free), 0.0), 1.3 * robot.mass
    if robot.planar:
        pose, velocity = np.array([[-0.15, -0.2]]), np.array([[1.2, 0.8]])
    else:
        pose = np.array([[0.03, -0.02, 0.3, 0.05, -0.04, 0.1]])
        velocity = np.array([[0.3, -0.4, -0.5, 0.8, 0.5, -0.9]])
    start = energy(robot, mass, pose, velocity)[0]
    drifts = []
    for steps in (75, 150, 300):
        plant = loaded_plant(robot, mass, pose, velocity, "bilateral")
        for _ in range(steps):
            plant.set_action(robot.speed_slope * textbook.pulley_speed(robot, plant.pose, plant.velocity))
            plant.advance(*no_reference(robot), substeps=1, step=0.3 / steps)
            assert np.abs(plant.per_cable(kernel.TORQUE)).max() < 1e-15
        drifts.append(abs(energy(robot, mass, plant.pose, plant.velocity)[0] - start))
    pulleys = np.sum(robot.pulley_inertia * textbook.pulley_speed(robot, plant.pose, plant.velocity) ** 2) / 2
    assert pulleys > 0.01  # their share is worth checking
    moved = np.linalg.norm(plant.pose - pose)
    assert moved > 0.05
    assert drifts[2] < 3e-11
    assert drifts[0] > 14 * drifts[1]


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("robot", [QUAD, UNEQUAL], ids=lambda robot: robot.name)
def test_work_excludes_a_force_that_turns_with_the_platform_or_pushes_for_a_part_of_the_step(robot, count):
    """An undriven, undamped plant under a constant force F gains F·Δp. Reached at 1 ms: 1e-11 J of 24 J."""
    free = Motors(stall_torque=1.0, free_speed=1e100)  # no line to run into
    robot = with_damping(robot.replace(motors=free), 0.0)
    mass, space = 1.3 * robot.mass, 2 if robot.planar else 3
    pose, velocity, force = robot.home + 0.05, np.full(robot.coordinates, 0.4), np.array([25.0, -40.0, 30.0])[:space]
    if not robot.planar:
        pose[2] += 0.25
    pose, velocity = np.tile(pose, (count, 1)), np.tile(velocity, (count, 1))
    plant = loaded_plant(robot, mass, pose, velocity, "bilateral")
    plant.set_wrench(np.arange(count), np.tile(force, (count, 1)))
    plant.set_action(np.zeros((count, robot.cables)))
    plant.advance(*no_reference(robot), substeps=300, step=1e-3)
    work = (plant.pose - pose)[:, :space] @ force
    assert np.abs(work).min() > 0.5
    gained = energy(robot, mass, plant.pose, plant.velocity) - energy(robot, mass, pose, velocity)
    np.testing.assert_allclose(gained, work, rtol=0, atol=1e-9)


@both_cables
@every_robot
def test_the_power_balance_excludes_power_from_nowhere_also_with_slack_cables(robot, cable):
    """d/dt E = Σ τ β̇ + Σ u β̇ − Σ c β̇², with u from complementarity: u = r T − τ + J β̈ + c β̇ where T = 0."""
    robot = with_damping(robot, tuple(np.linspace(0.05, 0.3, robot.cables).tolist()))
    pose, velocity, demand = random_states(robot, 300, seed=10)
    torques, mass = demand * robot.stall_torque, 1.2 * robot.mass
    acceleration, tension = evaluated(robot, mass, pose, velocity, torques, cable)
    speed = textbook.pulley_speed(robot, pose, velocity)
    take_up = robot.pulley_radius * tension - torques + robot.damping * speed
    take_up += robot.pulley_inertia * textbook.pulley_acceleration(robot, pose, velocity, acceleration)
    if cable == "bilateral":
        np.testing.assert_allclose(take_up, 0, atol=1e-10)
    else:
        np.testing.assert_allclose(take_up[tension > 0], 0, atol=1e-10)
    supplied = np.sum(np.where(tension == 0, take_up, 0.0) * speed, axis=1)
    if cable == "unilateral":
        assert np.median(np.abs(supplied)) > 1  # without it the balance is off by watts
    power = np.sum(torques * speed - robot.damping * speed**2, axis=1) + supplied

    def at(time):
        moved = pose + time * velocity + time**2 / 2 * acceleration
        return energy(robot, mass, moved, velocity + time * acceleration)

    h = 2e-4
    rate = (8 * (at(h) - at(-h)) - at(2 * h) + at(-2 * h)) / (12 * h)
    size = 1 + np.sum(np.abs(torques * speed), axis=1)
    np.testing.assert_allclose(rate / size, power / size, rtol=0, atol=1e-8)


# --- helpers and broken states ------------------------------------------------------------------------------------


@settings(deadline=None, derandomize=True)  # the first call compiles
@given(st.floats(-100, 100))
def test_the_math_library_excludes_a_sine_or_cosine_off_by_more_than_rounding(angle):
    for found, expected in zip(kernel._sincos(angle), (math.sin(angle), math.cos(angle)), strict=True):
        assert abs(found - expected) <= 1.2e-16


def test_the_math_library_excludes_a_wrong_quadrant_or_a_loss_of_digits():
    """Worst over ±100 rad in steps of 1 mrad, and near multiples of π/2: 1 ulp, and 1.2e-16 absolute.

    Closer than 1e-9 to a zero the reduction's last digit shows (3e-27 at π/2), and relative errors mean nothing.
    """
    quarter = np.arange(-63, 64) * (math.pi / 2)
    near = (quarter[:, None] + np.array([-1e-3, -1e-6, -1e-8, 0.0, 1e-8, 1e-6, 1e-3])).ravel()
    for angle in np.concatenate(
        [np.linspace(-100, 100, 200_001)[::7], near, np.linspace(-math.pi, math.pi, 9)]
    ).tolist():
        for found, expected in zip(kernel._sincos(angle), (math.sin(angle), math.cos(angle)), strict=True):
            assert abs(found - expected) <= 1.2e-16
            if abs(expected) > 1e-9:
                assert abs(found - expected) <= 2 * math.ulp(expected)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("row", ["pose", "velocity", "angle", "demand"])
@every_robot
def test_a_state_that_is_no_number_excludes_an_endless_search_and_damage_to_its_neighbours(robot, row, bad):
    """It ends, it shows in the state and in the position error, and the other lanes keep every bit."""
    pose, velocity, demand = random_states(robot, 33, seed=13)
    references = np.zeros((1, 50, robot.coordinates))
    sick = [3, 32]

    def run(pose, velocity, demand):
        plant = loaded_plant(robot, robot.mass, pose, velocity)
        for _ in range(3):
            plant.set_action(demand)
            plant.advance(references, np.array([49]), substeps=5, step=2e-3)
        return record_of(plant)

    healthy = run(pose, velocity, demand)
    spoilt = {"pose": pose.copy(), "velocity": velocity.copy(), "demand": demand.copy()}
    for lane in sick:
        if row == "angle":
            spoilt["pose"][lane, -1] = bad
        else:
            spoilt[row][lane, 0] = bad
    found = run(**spoilt)
    others = np.setdiff1d(np.arange(33), sick)
    np.testing.assert_array_equal(found[others], healthy[others])
    if row == "demand" and np.isinf(bad):  # clipped like any other demand above 1
        assert np.all(np.isfinite(found[sick, kernel.POSE : kernel.POSE + robot.coordinates]))
    else:
        assert not np.any(np.isfinite(found[sick, kernel.POSITION_PEAK]))
