"""The compiled plant against itself in other batch sizes, the textbook, and a Python loop over its
steps."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.plants import (
    ELASTIC,
    KINDS,
    NINE,
    UNEQUAL,
    advance,
    both_cables,
    drive_speed,
    each_of,
    every_kind,
    free_motors,
    loaded_plant,
    nightly,
    no_reference,
    random_states,
    record_of,
    runge_kutta_step,
    set_states,
    state_of,
    take_up_torques,
    textbook_rates,
    wound_states,
)

from cablebot_gym.physics import textbook
from cablebot_gym.physics.kernel import rows
from cablebot_gym.physics.plant import FEW_ROBOTS, pack_parameters

# --- one lane and a tile of lanes ---------------------------------------------------------------------------------


SICK = [3, 4, 5, 6]


def run_with_late_reset(robot, cable, members, count):
    """Records of eight periods of some of ``count`` robots.

    Over slack, clipped motors, unequal masses and wrenches, three references and a reset of the
    last robot half way. Those of many that :data:`SICK` names have values that are not finite.
    """
    state, _ = random_states(robot, count, seed=count)
    rng = np.random.default_rng(7)
    actions = rng.uniform(-0.7, 1.3, (8, count, robot.cables))
    if count > 8:
        state.pose[3, 0] = state.velocity[4, -1] = actions[:, 5, 0] = np.nan
        state.pose[6, -1] = actions[:, 8, -1] = np.inf
    references = rng.uniform(*robot.pose_bounds, (3, 25, robot.coordinates))
    force = rng.uniform(-8, 8, (count, robot.dimensions))
    moment = rng.uniform(-2, 2, (count, 3))
    mass = robot.mass * np.linspace(1, 1.6, count)
    plant = loaded_plant(robot, state[members], cable, mass[members])
    plant.trajectory_index[: len(members)] = members % 3
    plant.set_wrench(np.arange(len(members)), force[members], moment[members])
    last_lane = np.flatnonzero(members == count - 1)
    records = []
    for period, action in enumerate(actions):
        if period == 4 and last_lane.size:
            plant.set_state(last_lane, state.pose[:1], state.velocity[:1])
            plant.set_motors(last_lane, state.angle[:1], state.speed[:1])
        plant.set_action(action[members])
        step = 5e-4 if robot.flexible else 2e-3
        plant.advance(references, np.array([24, 11, 19]), substeps=3, step=step)
        records.append(record_of(plant))
    # Otherwise a tile is compared with a tile.
    assert plant.lanes == (1 if len(members) == 1 else rows.LANES)
    return np.stack(records)


@pytest.mark.parametrize("count", [FEW_ROBOTS + 1, 33])
@both_cables
@every_kind
def test_lane_of_a_batch_has_the_bits_of_a_robot_alone(robot, cable, count):
    """A state or action that is not finite shows in the position error, spares its neighbours, and
    the search of taut cables ends. An infinite action is clipped like any other above 1."""
    tiled = run_with_late_reset(robot, cable, np.arange(count), count)
    slack = tiled[:, :, rows.FIRST_CABLE_RECORD + rows.SLACK :: rows.CABLE_RECORDS]
    assert count < 33 or 0.02 < np.mean(slack > 0) < 0.98
    finite = np.isfinite(tiled[-1, :, rows.POSITION_PEAK])
    assert np.flatnonzero(~finite).tolist() == SICK * (count > 8)
    assert not np.any(np.isnan(tiled[:, finite]))
    for lane in {0, 1, count // 4, count - 2, count - 1}:
        alone = run_with_late_reset(robot, cable, np.array([lane]), count)
        assert_array_equal(alone[:, 0], tiled[:, lane])


# --- equations ----------------------------------------------------------------------------------------------------


@each_of(*KINDS[:4], *nightly(*KINDS[4:], NINE))
def test_tensions_and_take_up_torques_are_complementary(robot):
    """0 ≤ T ⟂ u ≥ 0 from the accelerations alone, u = r T − κ + J β̈ + c β̇.

    In some states of NINE, changing all wrong cables at once never ends: there the least-index rule
    has to find the solution.
    """
    count = 20_000 if robot is NINE else 200
    robot = free_motors(robot)
    state, action = random_states(robot, count, seed=12, reach=1.0)
    torques = np.clip(action, -1, 1) * robot.stall_torque
    rates, tension = textbook_rates(robot, state, torques, "unilateral")
    acceleration = rates.velocity
    take_up = take_up_torques(robot, state, torques, acceleration, tension, "unilateral")
    winding = textbook.pulley_acceleration(robot, state.pose, state.velocity, acceleration)
    size = np.abs(robot.pulley_inertia * winding).max(axis=1, keepdims=True)
    take_up /= 1 + np.abs(robot.pulley_radius * tension).max() + size
    taut = tension > 0
    assert tension.min() >= 0
    assert take_up[~taut].min() >= -1e-11
    assert np.abs(take_up[taut]).max() <= 1e-11
    plant = loaded_plant(robot, state, "unilateral")
    advance(plant, torques, 1e-3, 1)
    assert_allclose(plant.per_cable(rows.TENSION), tension, rtol=1e-9, atol=1e-7)


# --- integration --------------------------------------------------------------------------------------------------


def python_period(robot, mass, state, action, lagged, substeps, step, cable):
    """States at all physics steps of a control period, the torques applied at each, and the lagged
    request."""
    stall = robot.stall_torque
    lag = robot.motor_lag
    request = stall * np.clip(action, -1, 1) - robot.speed_slope * drive_speed(robot, state)

    def lagged_request(time):
        exponent = np.divide(-time, lag, out=np.full_like(lag, -np.inf), where=lag > 0)
        return request + (lagged - request) * np.exp(exponent)

    def torque(time, state):
        drop = robot.speed_slope * drive_speed(robot, state)
        return np.clip(lagged_request(time), -stall - drop, stall - drop)

    states = [state]
    applied = []
    for substep in range(substeps):
        start = substep * step
        applied.append(torque(start, states[-1]))

        def rates(time, state, start=start):
            return textbook_rates(robot, state, torque(start + time, state), cable, mass)[0]

        states.append(runge_kutta_step(rates, states[-1], step))
    return states, np.stack(applied), lagged_request(substeps * step)


def check_record(plant, states, applied, tensions, lines):
    """The record of a period: values at its start, least and largest tensions, slack steps and peaks of the
    errors. Returns the steps of the peaks."""
    robot = plant.robot
    least = np.min(tensions, axis=0)
    assert np.any(least < tensions[0])
    expected = {
        rows.TORQUE: applied[0],
        rows.SPEED: drive_speed(robot, states[0]),
        rows.TENSION: tensions[0],
        rows.LEAST_TENSION: least,
        rows.LARGEST_TENSION: np.max(tensions, axis=0),
        rows.SLACK: np.sum(np.stack(tensions) <= 0, axis=0),
    }
    for row, values in expected.items():
        tolerance = 1e-8 if robot.elastic else 1e-12
        assert_allclose(plant.per_cable(row), values, rtol=tolerance, atol=tolerance)
    errors = np.stack([end.pose for end in states[1:]]) - lines
    distance = np.linalg.norm(errors[..., : robot.dimensions], axis=-1)
    turned = np.abs(errors[..., robot.dimensions :]).max(axis=(0, 2), initial=0)
    record = record_of(plant)
    for row, peaks in ((rows.POSITION_PEAK, distance.max(axis=0)), (rows.ROTATION_PEAK, turned)):
        assert_allclose(record[:, row], peaks, rtol=0, atol=1e-12)
    return distance.argmax(axis=0).tolist()


@both_cables
@each_of(*KINDS[:4], ELASTIC[-1], *nightly(*KINDS[4:], *ELASTIC[:-1]))
def test_control_period_is_that_of_a_python_loop(robot, cable):
    """The request follows its lag, and the limits the speed, at every stage; peaks over all physics
    steps. The reference stays at its last line. The lag starts within the stall torque. A reset
    leaves nothing of the earlier run."""
    lag = np.linspace(0.0, 0.02, robot.cables)
    lag[1] = 1e-9
    robot = robot.replace(motors=robot.motors.replace(lag=tuple(lag.tolist())))
    substeps = 10
    count = 6
    end = 25
    step = 5e-4 if robot.flexible else 2e-3
    state, action = random_states(robot, count, seed=5)
    if robot.elastic:
        state = wound_states(robot, count)
    at_reset = state
    mass = robot.mass * np.linspace(1, 1.5, count)
    wander = np.random.default_rng(6).normal(0, 0.05, (count, 31, robot.coordinates))
    references = state.pose[:, None] + wander
    references[:, end + 1 :] = np.nan
    plant = loaded_plant(robot, state, cable, mass)
    plant.trajectory_index[:count] = np.arange(count)
    fresh = record_of(plant)
    holding = robot.stall_torque * np.linspace(0.3, 1.5, count)[:, None]
    lagged = np.minimum(holding, robot.stall_torque)

    def start():
        """The motors of some robots lack the torque that would hold them."""
        plant.set_torques(np.arange(count), holding)
        assert_array_equal(plant.per_cable(rows.TORQUE), holding)

    def advance_period():
        plant.set_action(action)
        plant.advance(references, np.full(count, end), substeps=substeps, step=step)
        return record_of(plant)

    start()
    records = []
    peak_steps = set()
    for period in range(3):
        records.append(advance_period())
        states, applied, lagged = python_period(
            robot, mass, state, action, lagged, substeps, step, cable
        )
        # Some motor reaches its limit on the way.
        assert period > 0 or np.abs(applied - applied[0]).max() > 0.01
        tensions = []
        for before, torques in zip(states, applied, strict=False):
            tensions.append(textbook_rates(robot, before, torques, cable, mass)[1])
        steps = np.minimum(substeps * period + 1 + np.arange(substeps), end)
        lines = references[:, steps].swapaxes(0, 1)
        peak_steps.update(check_record(plant, states, applied, tensions, lines))
        state = state_of(plant)
        for value, expected in zip(vars(state).values(), vars(states[-1]).values(), strict=True):
            assert_allclose(value, expected, rtol=1e-12, atol=1e-9 if robot.elastic else 1e-12)
    assert len(peak_steps) > 3  # the peak is not always at the end or the start
    set_states(plant, at_reset)
    assert_array_equal(record_of(plant), fresh)
    start()
    assert_array_equal(advance_period(), records[0])


# --- external wrench ----------------------------------------------------------------------------------------------


def test_wrench_lasts_until_it_or_the_parameters_are_set_anew():
    """It survives a reset; the padding does as the last robot does; no moment is left behind."""
    state, action = random_states(UNEQUAL, 33, seed=14)
    plant = loaded_plant(UNEQUAL, state, "unilateral")
    expected = np.zeros((plant.width, 6))

    def check_wrenches():
        """Of all lanes in memory, the padding included."""
        tiles = plant._parameters.reshape(len(plant.record), -1, plant.lanes)
        wrenches = tiles[:, rows.FORCE : rows.FIRST_CABLE_PARAMETER]
        assert_array_equal(wrenches.transpose(0, 2, 1).reshape(plant.width, 6), expected)

    check_wrenches()
    wrench = np.arange(1.0, 13.0).reshape(2, 6)
    plant.set_wrench(np.array([4, 32]), wrench[:, :3], wrench[:, 3:])
    expected[4] = wrench[0]
    expected[32:] = wrench[1]
    plant.set_action(action)
    plant.advance(*no_reference(UNEQUAL), substeps=2, step=1e-3)
    plant.set_state(np.arange(33), state.pose, state.velocity)
    check_wrenches()
    plant.set_wrench(np.array([4]), wrench[:1, :3])
    plant.set_parameters(np.array([32]), pack_parameters(UNEQUAL)[None])
    expected[4, 3:] = 0
    expected[32:] = 0
    check_wrenches()
