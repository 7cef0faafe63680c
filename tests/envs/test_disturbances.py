"""Effects of uncertainty on an episode: true parameters, external wrench, sensor noise and delayed
actions."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import (
    FLEX_SPATIAL,
    PLANAR,
    ROBOTS,
    SPATIAL,
    different_results,
    make,
    make_vector,
    random_actions,
    rollout,
    wrenches,
)
from oracles.plants import with_transmission
from scipy import stats

from cablebot_gym.bounds.drawn import drawn_robot
from cablebot_gym.physics import textbook
from cablebot_gym.uncertainty import (
    PARAMETERS,
    ExternalWrench,
    ParameterDistribution,
    Uncertainty,
    find_uncertainty,
)


def make_lasting(env_id, count, **keywords):
    """Vector environment whose episodes do not end."""
    wide = [(-9.0, 9.0)] * 4 + [(-1.5, 1.5), (-9.0, 9.0)]
    return make_vector(
        env_id,
        count,
        robot=ROBOTS[env_id].replace(workspace=wide[: ROBOTS[env_id].coordinates]),
        error_bounds={"position": 9.0},
        autoreset_mode="Disabled",
        **keywords,
    )


# --- true parameters ----------------------------------------------------------------------------------------------


JOINTED = with_transmission(ROBOTS[FLEX_SPATIAL], load_friction=0.05)
STRETCHING = with_transmission(ROBOTS[SPATIAL], axial_stiffness=5e4, load_friction=0.05)
"""Together they have all parameters."""


def spread_of(name):
    """A deviation that is never zero; absolute where the paper's value may be zero."""
    if PARAMETERS[name].position:
        return ParameterDistribution(low=0.005, high=0.01, relative=False)
    if name in ("damping", "motor_damping", "motor_lag", "coulomb_friction"):
        return ParameterDistribution(low=1e-3, high=2e-3, relative=False)
    return ParameterDistribution(low=0.05, high=0.1, each=name != "platform_inertia")


@pytest.mark.parametrize("name", PARAMETERS)
def test_every_parameter_reaches_the_plant_and_the_truth(name):
    """The uncertain environment is the one of a robot that nominally has the drawn values."""
    robot = STRETCHING if name == "axial_stiffness" else JOINTED
    keywords = {"payload": 1.5, "payload_known": False, "substeps": 32, "robot": robot}
    uncertainty = Uncertainty(parameters={name: spread_of(name)})
    uncertain = make(FLEX_SPATIAL, uncertainty=uncertainty, **keywords)
    nominal = make(FLEX_SPATIAL, **keywords)
    actions = random_actions(nominal, 12)
    ours, theirs = (rollout(env, actions, seed=3) for env in (uncertain, nominal))
    truth = uncertain.truth
    assert [key for key in truth if not np.array_equal(truth[key], nominal.truth[key])] == [name]
    same = {"payload": float(truth["payload"]), "robot": drawn_robot(robot, truth)}
    known = make(
        FLEX_SPATIAL,
        **keywords | same,
        trajectory=nominal.settings.trajectory,
    )
    expected = rollout(known, actions, seed=3)
    end = known.layout.slices()["reference_pose"].start  # the measured blocks come first
    values, known_values, nominal_values = (
        episode.observations[:, :end] for episode in (ours, expected, theirs)
    )
    assert_allclose(values, known_values, rtol=1e-12, atol=1e-12)
    assert np.abs(values - nominal_values).max() > 1e-7
    for key in ("payload", "tensions", "torques", "motor_speeds", "tracking_error", "slack"):
        values = expected.info[key]
        assert_allclose(ours.info[key], values, rtol=1e-10, atol=1e-10, err_msg=key)
    assert (ours.info["payload"][0] > 1.5 * 1.05 - 1e-12) == (name == "payload")


# --- wrench -------------------------------------------------------------------------------------------------------


def wrenches_over(env, steps):
    """Wrenches in each control period, (steps, N, 6)."""
    rows = []
    for _ in range(steps):
        env._simulation.step(np.full(env.action_space.shape, 0.3))
        rows.append(wrenches(env))
    return np.array(rows)


@pytest.mark.parametrize(("frequency", "periods"), [(500.0, 5), (60.0, 1), (360.0, 4)])
def test_table_6_forces_last_ten_milliseconds(frequency, periods):
    env = make_lasting(PLANAR, 1, uncertainty="table6", control_frequency=frequency)
    env.reset(seed=1)
    rows = wrenches_over(env, 8 * periods)[:, 0]
    changes = np.any(np.diff(rows, axis=0) != 0, axis=-1)
    assert_array_equal(changes, np.arange(1, 8 * periods) % periods == 0)
    assert np.all(rows[:, :2] != 0.0)
    assert not rows[:, 2:].any(), "neither a third force nor moments"


def test_wrench_is_a_factor_of_the_episode_times_normal_numbers():
    """The factor is uniform, one for each component; mean and noise are multiplied by it."""
    mean = np.array([1.0, 2.0, -4.0, 8.0, 8.0, 8.0])
    rows = []
    for std in (0.0, 2.0):
        wrench = ExternalWrench(
            force_mean=(1.0, 2.0, -4.0),
            force_std=std,
            moment_mean=8.0,
            moment_std=std,
            factor=(0.9, 1.1),
            correlation_time=0.002,
        )
        env = make_lasting(SPATIAL, 500, uncertainty=Uncertainty(wrench=wrench))
        env.reset(seed=3)
        rows.append(wrenches_over(env, 4))
    still, noisy = rows  # (4 periods, 500, 6)
    assert not np.ptp(still, axis=0).any()
    factors = still[0] / mean
    for column in factors.T:
        assert stats.kstest(column, stats.uniform(0.9, 0.2).cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(factors.T) - np.eye(6)).max() < 0.25
    noise = (noisy - still) / (2.0 * still / mean)
    assert stats.kstest(noise.ravel(), "norm").pvalue > 0.01
    assert len(np.unique(noise.round(9))) > 0.99 * noise.size


# --- sensors ------------------------------------------------------------------------------------------------------


DEVIATIONS = {
    "pose": np.repeat([1e-4, 2e-4], 3),
    "velocity": np.repeat([2e-3, 4e-3], 3),
    "motor_angle": 1e-3,
    "motor_speed": 1e-2,
}
"""Standard deviations of the uncertainty ``sensors`` by block."""
BIAS = {"sensor_bias": find_uncertainty("sensors", ROBOTS[FLEX_SPATIAL]).sensors}


@pytest.mark.parametrize(("uncertainty", "constant"), [("sensors", False), (BIAS, True)])
def test_sensor_errors_are_normal_in_the_measured_blocks(uncertainty, constant):
    """White noise is new in each step, a bias constant in an episode."""
    wrong, clean = (
        make_lasting(FLEX_SPATIAL, 100, uncertainty=form) for form in (uncertainty, None)
    )
    actions = random_actions(clean, 20, 0.0, 0.6)
    ours, theirs = (rollout(env, actions, seed=9) for env in (wrong, clean))
    assert different_results(ours, theirs) == {"start", "observations"}
    errors = ours.observations - theirs.observations
    columns = []
    for name, values in wrong.layout.split(errors).items():
        if name in DEVIATIONS:
            columns.append(values / DEVIATIONS[name])
        else:
            assert not values.any(), name
    normal = np.concatenate(columns, axis=-1)  # (steps, N, components)
    if constant:
        assert np.ptp(normal, axis=0).max() < 1e-9
        normal = normal[:1]
    for component in range(normal.shape[-1]):
        assert stats.kstest(normal[..., component].ravel(), "norm").pvalue > 1e-3
    assert len(np.unique(normal.round(9))) > 0.99 * normal.size


# --- delay --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("env_id", "delay"), [(PLANAR, 1), (FLEX_SPATIAL, 5)])
def test_actions_arrive_delayed(env_id, delay):
    """Until then the motors request the static torque at their present speed."""
    robot = ROBOTS[env_id]
    moving = {"trajectory": f"paper-{robot.kind}", "payload": 1.0}
    late = make(env_id, uncertainty={"delay": delay}, **moving)
    prompt = make(env_id, **moving)
    start = prompt.settings.trajectory(0.0)
    torque = textbook.static_torque(robot, robot.mass + 1.0, start.position)
    drop = robot.speed_slope * textbook.pulley_speed(robot, start.position, start.velocity)
    hold = np.tile((torque + drop) / robot.stall_torque, (delay, 1))
    actions = random_actions(late, 25)
    ours = rollout(late, actions, seed=0)
    theirs = rollout(prompt, np.concatenate([hold, actions[:-delay]]), seed=0)
    sent = np.r_[late.layout.slices()["last_actions"]]  # those of the policy, before the delay
    delayed, expected = (np.delete(episode.observations, sent, 1) for episode in (ours, theirs))
    assert_allclose(delayed, expected, rtol=1e-12, atol=1e-12)
    for key, value in theirs.info.items():
        assert_allclose(ours.info[key], value, rtol=1e-9, atol=1e-11, err_msg=key)
    assert_array_equal(ours.info["commanded_action"][delay + 1 :], actions[:-delay])


def test_delay_is_drawn_uniformly_between_its_bounds():
    env = make_lasting(PLANAR, 600, uncertainty={"delay": [1, 3]})
    actions = np.tile(random_actions(make(PLANAR), 8)[:, None], (600, 1))
    commanded = rollout(env, actions, seed=0).info["commanded_action"][-1]
    counts = [np.sum(np.all(commanded == actions[-1 - delay], axis=1)) for delay in (1, 2, 3)]
    assert sum(counts) == 600
    assert stats.chisquare(counts).pvalue > 0.01
