"""Effects of uncertainty on an episode: true parameters, external wrench, sensor noise and delayed
actions."""

from __future__ import annotations

from dataclasses import dataclass, replace

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
    motion,
    random_actions,
    rollout,
    two_ids,
    wrenches,
)
from oracles.plants import with_transmission
from scipy import stats

from cablebot_gym.physics import textbook
from cablebot_gym.trajectories import Reference
from cablebot_gym.uncertainty import PARAMETERS, ExternalWrench, ParameterDistribution, Uncertainty


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


def test_one_row_makes_an_attribute_of_the_robot_uncertain(monkeypatch):
    """As CONTRIBUTING.md says."""
    row = replace(PARAMETERS["axial_stiffness"], attribute="axial_damping", unit="N·s")
    parameters = {**PARAMETERS, "axial_damping": row}
    monkeypatch.setattr("cablebot_gym.uncertainty.PARAMETERS", parameters)
    monkeypatch.setattr("cablebot_gym.envs.simulation.PARAMETERS", parameters)
    uncertainty = {"parameters": {"axial_damping": {"low": 0.5, "high": 1.0}}}
    env = make("CableBot-FlexPoint-v0", uncertainty=uncertainty)
    env.reset(seed=0)
    ratio = env.truth["axial_damping"] / env.settings.robot.axial_damping
    assert np.all((ratio >= 1.5) & (ratio <= 2.0))
    nominal = make("CableBot-FlexPoint-v0")
    nominal.reset(seed=0)
    for _ in range(5):
        env.step(np.full(4, 0.3))
        nominal.step(np.full(4, 0.3))
    assert not np.array_equal(env.pose, nominal.pose)


def richest_env(name):
    """The environment with most kinds of parameters among those with this one, and its robot, which
    has load friction if the parameter needs it."""
    for env_id in (FLEX_SPATIAL, SPATIAL, *ROBOTS):
        robot = ROBOTS[env_id]
        if PARAMETERS[name].per_load:
            robot = with_transmission(robot, load_friction=0.05)
        if PARAMETERS[name].belongs_to(robot):
            return env_id, robot
    raise LookupError(name)


def spread_of(name):
    """A deviation that is never zero; absolute where the paper's value may be zero."""
    if PARAMETERS[name].position:
        return ParameterDistribution(low=0.005, high=0.01, relative=False)
    if name in ("damping", "motor_damping", "motor_lag", "coulomb_friction"):
        return ParameterDistribution(low=1e-3, high=2e-3, relative=False)
    return ParameterDistribution(low=0.05, high=0.1, each=name != "platform_inertia")


def robot_with(robot, truth):
    """The robot whose nominal values are the true ones, with the nominal free speed."""

    springs = ("stiffness", "motor_inertia", "motor_damping", "axial_stiffness")
    frictions = ("damping", "coulomb_friction", "load_friction")
    names = {"pulley_inertia", *frictions, *springs} & truth.keys()
    return robot.replace(
        mass=float(truth["platform_mass"]),
        base_anchors=truth["base_anchors"],
        platform_anchors=truth.get("platform_anchors", ()),
        inertia=truth.get("platform_inertia", ()),
        motors=robot.motors.replace(
            stall_torque=tuple(truth["motor_strength"]), lag=tuple(truth["motor_lag"])
        ),
        transmission=robot.transmission.replace(**{name: tuple(truth[name]) for name in names}),
    )


@pytest.mark.parametrize("name", PARAMETERS)
def test_every_parameter_reaches_the_plant_and_the_truth(name):
    """The uncertain environment is the one of a robot that nominally has the drawn values."""
    env_id, robot = richest_env(name)
    substeps = 32 if robot.elastic else 8
    keywords = {"payload": 1.5, "payload_known": False, "substeps": substeps, "robot": robot}
    uncertainty = Uncertainty(parameters={name: spread_of(name)})
    uncertain = make(env_id, uncertainty=uncertainty, **keywords)
    nominal = make(env_id, **keywords)
    actions = random_actions(nominal, 30)
    ours, theirs = (rollout(env, actions, seed=3) for env in (uncertain, nominal))
    truth = uncertain.truth
    assert [key for key in truth if not np.array_equal(truth[key], nominal.truth[key])] == [name]
    known = make(
        env_id,
        **keywords | {"payload": float(truth["payload"]), "robot": robot_with(robot, truth)},
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
        assert_allclose(
            ours.info[key],
            expected.info[key],
            rtol=1e-10,
            atol=1e-10,
            err_msg=key,
        )
    assert (ours.info["payload"][0] > 1.5 * 1.05 - 1e-12) == (name == "payload")


# --- wrench -------------------------------------------------------------------------------------------------------


def wrenches_over(env, steps):
    """Wrenches in each control period, (steps, N, 6)."""
    rows = []
    for _ in range(steps):
        env._simulation.step(np.full(env.action_space.shape, 0.3))
        rows.append(wrenches(env))
    return np.array(rows)


@pytest.mark.parametrize(
    ("env_id", "forces", "frequency", "periods"),
    [(PLANAR, 2, 500.0, 5), (PLANAR, 2, 60.0, 1), (FLEX_SPATIAL, 3, 360.0, 4)],
)
def test_table_6_forces_last_ten_milliseconds(env_id, forces, frequency, periods):
    forms = ["table6", "table6", None]
    env = make_lasting(env_id, 3, uncertainty=forms, control_frequency=frequency)
    env.reset(seed=1)
    rows = wrenches_over(env, 8 * periods)
    changes = np.any(np.diff(rows, axis=0) != 0, axis=-1)
    expected = np.arange(1, 8 * periods) % periods == 0
    assert_array_equal(changes, expected[:, None] * [True, True, False])
    assert np.all(rows[:, :2, :forces] != 0.0)
    assert not rows[..., forces:].any()
    assert not rows[:, 2].any()


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
        for seed in (3, None):
            env.reset(seed=seed)
            rows.append(wrenches_over(env, 4))
    still, noisy = np.split(np.array(rows), 2)  # (2 episodes, 4 periods, 500, 6)
    assert not np.ptp(still, axis=1).any()
    factors = np.concatenate(still[:, 0] / mean, axis=1)
    for column in factors.T:
        assert stats.kstest(column, stats.uniform(0.9, 0.2).cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(factors.T) - np.eye(12)).max() < 0.25
    noise = (noisy - still) / (2.0 * still / mean)
    assert stats.kstest(noise.ravel(), "norm").pvalue > 0.01
    assert len(np.unique(noise.round(9))) > 0.99 * noise.size


# --- sensors ------------------------------------------------------------------------------------------------------


@two_ids
def test_sensor_noise_is_normal_and_in_measured_blocks_only(env_id):
    robot = ROBOTS[env_id]
    noisy, clean = (
        make_lasting(
            env_id,
            40,
            uncertainty=form,
        )
        for form in ("sensors", None)
    )
    actions = random_actions(clean, 150, 0.0, 0.6)
    ours, theirs = (rollout(env, actions, seed=9) for env in (noisy, clean))
    assert different_results(ours, theirs) == {"start", "observations"}
    noise = ours.observations - theirs.observations
    again = noisy.reset()[0] - clean.reset()[0]
    assert not np.intersect1d(again[again != 0], noise[0]).size, "the next episode has other noise"
    turns = np.arange(robot.coordinates) >= robot.dimensions
    deviations = {
        "pose": np.where(turns, 2e-4, 1e-4),
        "velocity": np.where(turns, 4e-3, 2e-3),
        "motor_angle": 1e-3,
        "motor_speed": 1e-2,
    }
    columns = []
    for name, values in noisy.layout.split(noise).items():
        if name in deviations:
            columns.append(values / deviations[name])
        else:
            assert not values.any(), name
    white = np.concatenate(columns, axis=-1)  # (steps, N, components)
    assert_allclose(white.std(axis=(0, 1)), 1.0, rtol=5 / np.sqrt(2 * 151 * 40))
    assert white[0].std() == pytest.approx(1.0, rel=0.3), "after a reset too"
    assert stats.kstest(white[:, :4].ravel(), "norm").pvalue > 0.01
    assert len(np.unique(white.round(9))) > 0.99 * white.size


def test_sensor_bias_is_normal_and_constant_in_an_episode():
    """Every second environment has none."""
    sigma = {"position": 1e-3, "rotation": 2e-3, "velocity": 3e-3, "motor_angle": 4e-3}
    biased, clean = (make_lasting(FLEX_SPATIAL, 400) for _ in range(2))
    options = {"uncertainty": [{"sensor_bias": sigma}, None] * 200}
    actions = random_actions(clean, 3, 0.0, 0.6)
    ours = rollout(biased, actions, seed=9, options=options)
    theirs = rollout(clean, actions, seed=9)
    assert different_results(ours, theirs) == {"start", "observations"}
    error = ours.observations - theirs.observations
    assert np.ptp(error, axis=0).max() < 1e-14
    assert not error[:, 1::2].any()
    deviations = {
        "pose": [1e-3] * 3 + [2e-3] * 3,
        "velocity": [3e-3] * 3 + [0.0] * 3,
        "motor_angle": [4e-3] * 6,
    }
    normal = []
    for name, values in biased.layout.split(error[0, ::2]).items():
        expected = np.broadcast_to(deviations.get(name, 0.0), values.shape[-1:])
        assert not values[:, expected == 0].any(), name
        normal.append(values[:, expected > 0] / expected[expected > 0])
    normal = np.concatenate(normal, axis=1)
    for column in normal.T:
        assert stats.kstest(column, "norm").pvalue > 1e-3
    assert len(np.unique(normal)) == normal.size == 200 * 15
    again = biased.reset(options=options)[0] - clean.reset()[0]
    assert np.abs(again[0]).max() > 0
    assert not np.intersect1d(again[again != 0], error[0]).size, "the next episode has another one"


# --- delay --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drift:
    """A motion that moves already at time 0."""

    coordinates: int
    name = "drift"
    duration = 0.5

    def __call__(self, times):
        times = np.asarray(times, float)[..., None]
        rate = 0.01 * np.arange(1, self.coordinates + 1)
        center = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])[: self.coordinates]
        zero = 0 * times * rate
        return Reference(
            position=center + np.clip(times, 0, self.duration) * rate,
            velocity=(times <= self.duration) * rate,
            acceleration=zero,
            jerk=zero,
            snap=zero,
        )


@two_ids
@pytest.mark.parametrize("delay", [1, 5])
def test_actions_arrive_delayed(env_id, delay):
    """Until then the motors request the static torque at their present speed."""
    robot = ROBOTS[env_id]
    drift = Drift(robot.coordinates)
    late = make(env_id, uncertainty={"delay": delay}, trajectory=drift, payload=1.0)
    prompt = make(env_id, trajectory=drift, payload=1.0)
    start = drift(0.0)
    minimum = textbook.MINIMUM_TENSION
    torque = textbook.static_torque(
        robot,
        robot.mass + 1.0,
        start.position,
        minimum=minimum,
    )
    drop = robot.speed_slope * textbook.pulley_speed(
        robot,
        start.position,
        start.velocity,
    )
    hold = np.tile((torque + drop) / robot.stall_torque, (delay, 1))
    actions = random_actions(late, 25)
    ours = rollout(late, actions, seed=0)
    theirs = rollout(prompt, np.concatenate([hold, actions[:-delay]]), seed=0)
    sent = np.r_[late.layout.slices()["last_actions"]]  # those of the policy, before the delay
    delayed, expected = (
        np.delete(
            episode.observations,
            sent,
            1,
        )
        for episode in (ours, theirs)
    )
    assert_allclose(delayed, expected, rtol=1e-12, atol=1e-12)
    for key, value in theirs.info.items():
        assert_allclose(ours.info[key], value, rtol=1e-9, atol=1e-11, err_msg=key)
    assert_array_equal(ours.info["commanded_action"][delay + 1 :], actions[:-delay])


def test_delays_of_environments_are_independent():
    """Delays 0, 3 and 1 at once; then one environment restarts with a longer delay, and again with
    none."""
    env = make_vector(FLEX_SPATIAL, 3, trajectory="dwell-spatial")
    singles = [make(FLEX_SPATIAL, trajectory="dwell-spatial") for _ in range(3)]
    delays = [{"delay": 0}, {"delay": 3}, {"delay": 1}]
    env.reset(seed=0, options={"uncertainty": delays})
    for single, delay in zip(singles, delays, strict=True):
        single.reset(seed=0, options={"uncertainty": delay})
    restarts = {5: {"uncertainty": {"delay": 7}}, 14: {"uncertainty": None}}
    actions = random_actions(env, 24)
    for step, action in enumerate(actions):
        if step in restarts:
            env.reset(options=restarts[step] | {"reset_mask": np.array([False, False, True])})
            singles[2].reset(options=restarts[step])
        info = env.step(action)[4]
        for index, single in enumerate(singles):
            expected = single.step(action[index])[4]
            for key in ("commanded_action", "torques", "tensions", "tracking_error_peak"):
                assert_array_equal(
                    info[key][index],
                    expected[key],
                    f"{key} {index} {step}",
                )
    assert_array_equal(info["commanded_action"][1:], [actions[-4, 1], actions[-1, 2]])


def test_delay_is_drawn_uniformly_between_its_bounds():
    env = make_lasting(PLANAR, 600, uncertainty={"delay": [1, 3]})
    actions = np.tile(random_actions(make(PLANAR), 8)[:, None], (600, 1))
    commanded = rollout(env, actions, seed=0).info["commanded_action"][-1]
    counts = [np.sum(np.all(commanded == actions[-1 - delay], axis=1)) for delay in (1, 2, 3)]
    assert sum(counts) == 600
    assert stats.chisquare(counts).pvalue > 0.01


@two_ids
def test_motors_with_lag_start_from_the_holding_torques(env_id):
    """A robot whose motors answer slowly stays at rest for some steps, whatever the action."""
    robot = ROBOTS[env_id]
    slow = robot.replace(motors=robot.motors.replace(lag=1e3))
    env = make(
        env_id, robot=slow, payload=2.0, trajectory=motion("dwell", env_id), initial_error=0.0
    )
    torques = rollout(env, np.zeros((5, robot.cables)), seed=0).info["torques"]
    assert np.abs(torques[-1] - torques[0]).max() < 1e-3
    assert torques[0].min() > 0.1
