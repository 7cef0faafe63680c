"""Effects of uncertainty on an episode: true parameters, external wrench, sensor noise and delayed
actions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import (
    FLEX_PLANAR,
    FLEX_SPATIAL,
    PLANAR,
    ROBOTS,
    SPATIAL,
    make,
    make_vector,
    motion,
    paper_ids,
    random_actions,
    rollout,
    two_ids,
    wrenches,
)
from scipy import stats

from cablebot_gym.physics import textbook
from cablebot_gym.robots import Robot
from cablebot_gym.trajectories import Reference
from cablebot_gym.uncertainty import (
    PARAMETERS,
    ExternalWrench,
    ParameterDistribution,
    Uncertainty,
)

MEASURED = ("pose", "velocity", "motor_angle", "motor_speed")


def has(env_id, name):
    """Whether the robot of an id has a parameter."""
    return PARAMETERS[name].belongs_to(ROBOTS[env_id])


def make_lasting(env_id, count, **keywords) -> Any:
    """Vector environment whose episodes do not end."""
    wide = [
        (-9.0, 9.0),
        (-9.0, 9.0),
        (-9.0, 9.0),
        (-9.0, 9.0),
        (-1.5, 1.5),
        (-9.0, 9.0),
    ]
    robot = ROBOTS[env_id].replace(workspace=wide[: ROBOTS[env_id].coordinates])
    lasting = {
        "robot": robot,
        "error_bounds": {"position": 9.0},
        "autoreset_mode": "Disabled",
    }
    return make_vector(env_id, count, **lasting | keywords)


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


CASES = [(PLANAR, name) for name in PARAMETERS if has(PLANAR, name)]
for parameter in PARAMETERS:
    robots = [env_id for env_id in (FLEX_SPATIAL, SPATIAL, *ROBOTS) if has(env_id, parameter)]
    CASES.append((robots[0], parameter))


def spread_of(name):
    """A deviation that is never zero; absolute where the paper's value may be zero."""
    if PARAMETERS[name].position:
        return ParameterDistribution(low=0.005, high=0.01, relative=False)
    if name in ("damping", "motor_damping", "motor_lag", "coulomb_friction"):
        return ParameterDistribution(low=1e-3, high=2e-3, relative=False)
    return ParameterDistribution(low=0.05, high=0.1, each=name != "platform_inertia")


def robot_with(robot: Robot, truth) -> Robot:
    """The robot whose nominal values are the true ones, with the nominal free speed."""
    names = ("stiffness", "motor_inertia", "motor_damping", "axial_stiffness")
    springs = {name: tuple(truth[name]) for name in names if name in truth}
    body = {}
    if not robot.point_mass:
        body = {
            "platform_anchors": truth["platform_anchors"],
            "inertia": truth["platform_inertia"],
        }
    transmission = robot.transmission.replace(
        pulley_inertia=tuple(truth["pulley_inertia"]),
        damping=tuple(truth["damping"]),
        coulomb_friction=tuple(truth["coulomb_friction"]),
        **springs,
    )
    motors = robot.motors.replace(
        stall_torque=tuple(truth["motor_strength"]),
        lag=tuple(truth["motor_lag"]),
    )
    mass = float(truth["platform_mass"])
    return robot.replace(
        mass=mass,
        base_anchors=truth["base_anchors"],
        motors=motors,
        transmission=transmission,
        **body,
    )


@pytest.mark.parametrize(("env_id", "name"), dict.fromkeys(CASES))
def test_every_parameter_reaches_the_plant_and_the_truth(env_id, name):
    """The uncertain environment is the one of a robot that nominally has the drawn values."""
    keywords = {
        "payload": 1.5,
        "payload_known": False,
        "substeps": 32 if ROBOTS[env_id].elastic else 8,
    }
    uncertain = make(
        env_id,
        uncertainty=Uncertainty(parameters={name: spread_of(name)}),
        **keywords,
    )
    nominal = make(env_id, **keywords)
    actions = random_actions(nominal, 30)
    ours = rollout(uncertain, actions, seed=3)
    theirs = rollout(nominal, actions, seed=3)
    truth = uncertain.truth
    assert [key for key in truth if not np.array_equal(truth[key], nominal.truth[key])] == [name]
    keywords["payload"] = float(truth["payload"])
    known = make(
        env_id,
        **keywords,
        robot=robot_with(ROBOTS[env_id], truth),
        trajectory=nominal.settings.trajectory,
    )
    expected = rollout(known, actions, seed=3)
    largest_change = 0.0
    for block in set(MEASURED) & set(uncertain.layout.slices()):
        values = uncertain.layout.split(ours.observations)[block]
        expected_values = uncertain.layout.split(expected.observations)[block]
        assert_allclose(values, expected_values, rtol=1e-12, atol=1e-12, err_msg=block)
        change = np.abs(values - uncertain.layout.split(theirs.observations)[block]).max()
        largest_change = max(largest_change, change)
    for key in (
        "payload",
        "tensions",
        "torques",
        "motor_speeds",
        "tracking_error",
        "slack",
    ):
        assert_allclose(
            ours.info[key],
            expected.info[key],
            rtol=1e-10,
            atol=1e-10,
            err_msg=key,
        )
    assert largest_change > 1e-7
    assert (ours.info["payload"][0] > 1.5 * 1.05 - 1e-12) == (name == "payload")


# --- wrench -------------------------------------------------------------------------------------------------------


def wrenches_over(env, steps):
    """Wrenches in each control period, (steps, N, 6)."""
    rows = []
    for _ in range(steps):
        env._simulation.step(np.full(env.action_space.shape, 0.3))
        rows.append(wrenches(env))
    return np.array(rows)


@pytest.mark.parametrize(("env_id", "forces"), [(PLANAR, 2), (FLEX_SPATIAL, 3)])
@pytest.mark.parametrize(("frequency", "periods"), [(500.0, 5), (60.0, 1), (360.0, 4)])
def test_table_6_forces_last_ten_milliseconds(env_id, forces, frequency, periods):
    env = make_lasting(env_id, 3, uncertainty="table6", control_frequency=frequency)
    env.reset(seed=1)
    rows = wrenches_over(env, 8 * periods)
    changes = np.any(np.diff(rows, axis=0) != 0, axis=-1)
    expected = np.arange(1, 8 * periods) % periods == 0
    assert_array_equal(changes, np.repeat(expected[:, None], 3, axis=1))
    assert np.all(rows[..., :forces] != 0.0)
    assert not rows[..., forces:].any()


def test_table_6_forces_have_the_mean_and_variance_of_the_paper():
    env = make_lasting(SPATIAL, 128, uncertainty="table6", control_frequency=100.0)
    env.reset(seed=2)
    forces = wrenches_over(env, 150)[..., :3]
    # A factor f uniform in [0.9, 1.1]: E f² = 1 + 0.04/12, and the variance is E f² · 0.2 + Var f ·
    # 0.5².
    variance = 0.2 * (1 + 0.04 / 12) + 0.04 / 12 * 0.25
    assert forces.mean() == pytest.approx(
        0.5, abs=4 * np.sqrt(0.2 / forces.size) + 4 * 0.5 * 0.058 / np.sqrt(384)
    )
    assert forces.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / forces.size) + 0.02)
    components = np.corrcoef(forces.reshape(-1, 3).T) - np.eye(3)
    assert np.abs(components).max() < 6 / np.sqrt(forces.size / 3)


def test_wrench_factor_is_drawn_once_per_episode_and_component():
    wrench = ExternalWrench(
        force_mean=(1.0, 2.0, -4.0),
        moment_mean=8.0,
        factor=(0.9, 1.1),
        correlation_time=0.002,
    )
    env = make_lasting(SPATIAL, 500, uncertainty=Uncertainty(wrench=wrench))
    factors = []
    for seed in (3, None):
        env.reset(seed=seed)
        rows = wrenches_over(env, 4)
        assert not np.ptp(rows, axis=0).any()
        factors.append(rows[0] / [1.0, 2.0, -4.0, 8.0, 8.0, 8.0])
    factors = np.concatenate(factors, axis=1)
    for column in factors.T:
        assert stats.kstest(column, stats.uniform(0.9, 0.2).cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(factors.T) - np.eye(12)).max() < 0.25


# --- sensors ------------------------------------------------------------------------------------------------------


@two_ids
def test_sensor_noise_is_white_and_in_measured_blocks_only(env_id):
    robot = ROBOTS[env_id]
    noisy = make_lasting(env_id, 40, uncertainty="sensors")
    clean = make_lasting(env_id, 40)
    actions = random_actions(clean, 150, 0.0, 0.6)
    ours = rollout(noisy, actions, seed=9)
    theirs = rollout(clean, actions, seed=9)
    for key, value in theirs.info.items():
        assert_array_equal(ours.info[key], value, err_msg=key)
    assert_array_equal(ours.rewards, theirs.rewards)
    noise = ours.observations - theirs.observations
    again = noisy.reset()[0] - clean.reset()[0]
    assert not np.intersect1d(again[again != 0], noise[0]).size, "the next episode has other noise"
    deviations = {
        "motor_angle": [1e-3] * robot.cables,
        "motor_speed": [1e-2] * robot.cables,
    }
    deviations["pose"] = [1e-4] * robot.dimensions + [2e-4] * (robot.coordinates - robot.dimensions)
    deviations["velocity"] = [2e-3] * robot.dimensions + [4e-3] * (
        robot.coordinates - robot.dimensions
    )
    columns = []
    for name, values in noisy.layout.split(noise).items():
        if name in MEASURED:
            columns.append(values / deviations[name])
            assert columns[-1][0].std() == pytest.approx(1.0, rel=0.5), name  # after reset too
        else:
            assert not values.any(), name
    white = np.concatenate(columns, axis=-1)  # (steps, N, components)
    assert_allclose(white.std(axis=(0, 1)), 1.0, rtol=5 / np.sqrt(2 * 151 * 40))
    assert stats.kstest(white[:, :4].ravel(), "norm").pvalue > 0.01
    for lag in (1, 2, 31, 32, 33, 64):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 5 / np.sqrt(white[lag:].size), lag
    for axis in (1, 2):  # environments, components
        rows = np.moveaxis(white, axis, 0).reshape(white.shape[axis], -1)
        assert np.abs(np.corrcoef(rows) - np.eye(len(rows))).max() < 6 / np.sqrt(rows.shape[1])


def test_sensor_bias_is_normal_and_constant_in_an_episode():
    """White noise is added to it; the second environment has none, and the next episode another
    one."""
    sigma = {
        "position": 1e-3,
        "rotation": 2e-3,
        "velocity": 3e-3,
        "motor_angle": 4e-3,
    }
    biased = make_lasting(FLEX_SPATIAL, 400)
    clean = make_lasting(FLEX_SPATIAL, 400)
    forms = [
        {"sensor_bias": sigma},
        {"sensors": {"position": 1e-3}},
        {"sensor_bias": sigma},
        None,
    ] * 100
    actions = random_actions(clean, 3, 0.0, 0.6)
    ours = rollout(biased, actions, seed=9, options={"uncertainty": forms})
    theirs = rollout(clean, actions, seed=9)
    assert_array_equal(ours.rewards, theirs.rewards)
    error = biased.layout.split(ours.observations - theirs.observations)
    deviations = {
        "pose": [1e-3] * 3 + [2e-3] * 3,
        "velocity": [3e-3] * 3 + [0.0] * 3,
        "motor_angle": [4e-3] * 6,
    }
    for name, values in error.items():
        constant = values[:, ::2]
        assert np.ptp(constant, axis=0).max() < 1e-14, name
        assert not values[:, 3::4].any(), name
        expected = np.broadcast_to(deviations.get(name, 0.0), values.shape[-1:])
        assert not constant[..., expected == 0].any(), name
        if expected.any():
            normal = (constant[0] / np.where(expected > 0, expected, 1))[:, expected > 0].ravel()
            assert stats.kstest(normal, "norm").pvalue > 0.01, name
            assert len(np.unique(normal)) == normal.size
    assert np.ptp(error["pose"][:, 1], axis=0)[0] > 1e-4
    again = (biased.reset(options={"uncertainty": forms})[0] - clean.reset()[0])[0, 0]
    assert 0 < abs(again) != abs(error["pose"][0, 0, 0])


def test_noise_and_wrench_stay_in_their_environment():
    env = make_lasting(FLEX_PLANAR, 3)
    clean = make_lasting(FLEX_PLANAR, 3)
    forms = ["table6+sensors", None, {"sensors": {"velocity": 0.01}}]
    noise = env.reset(seed=0, options={"uncertainty": forms})[0] - clean.reset(seed=0)[0]
    assert np.count_nonzero(noise[0]) == 2 + 2 + 3 + 3
    assert not noise[1].any()
    assert np.flatnonzero(noise[2]).tolist() == [2, 3]
    rows = wrenches_over(env, 3)
    assert np.all(rows[:, 0, :2] != 0)
    assert not rows[:, 1:].any()
    assert_array_equal(env.reset()[0], clean.reset()[0])
    action = np.full((3, 3), 0.4)
    assert_array_equal(env.step(action)[0], clean.step(action)[0])
    assert not wrenches_over(env, 7).any()


# --- delay --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drift:
    """A motion that moves already at time 0."""

    coordinates: int
    name: str = "drift"
    duration: float = 0.5

    def __call__(self, times):
        times = np.asarray(times, float)
        rate = np.arange(1, self.coordinates + 1) * 0.01
        center = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])[: self.coordinates]
        position = center + np.clip(times, 0, self.duration)[..., None] * rate
        velocity = (times <= self.duration)[..., None] * rate
        zero = np.zeros_like(position)
        return Reference(
            position=position,
            velocity=velocity,
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
    torque = textbook.static_torque(
        robot,
        robot.mass + 1.0,
        start.position,
        minimum=textbook.MINIMUM_TENSION,
    )
    drop = robot.speed_slope * textbook.pulley_speed(robot, start.position, start.velocity)
    hold = (torque + drop) / robot.stall_torque
    actions = random_actions(late, 25)
    ours = rollout(late, actions, seed=0)
    theirs = rollout(
        prompt,
        np.concatenate([np.tile(hold, (delay, 1)), actions[:-delay]]),
        seed=0,
    )
    for observations in (ours.observations, theirs.observations):
        observations[:, late.layout.slices()["last_actions"]] = (
            0.0  # those of the policy, before the delay
        )
    assert_allclose(ours.observations, theirs.observations, rtol=1e-12, atol=1e-12)
    for key, value in theirs.info.items():
        assert_allclose(ours.info[key], value, rtol=1e-9, atol=1e-11, err_msg=key)
    assert_array_equal(ours.info["commanded_action"][delay + 1 :], actions[:-delay])
    assert np.ptp(ours.info["torques"][delay + 1 :], axis=0).min() > 0.1


@two_ids
def test_motors_hold_the_true_robot_until_the_first_action(env_id):
    names = [
        "payload",
        "platform_mass",
        "motor_strength",
        *(["stiffness"] if ROBOTS[env_id].flexible else []),
    ]
    uncertainty = Uncertainty(parameters={name: spread_of(name) for name in names}, delay=5)
    keywords = {
        "payload": 2.0,
        "trajectory": motion("dwell", env_id),
        "initial_error": 0.0,
    }
    env = make(env_id, uncertainty=uncertainty, **keywords)
    info = rollout(env, np.zeros((15, ROBOTS[env_id].cables)), seed=0).info
    assert env.truth["payload"] > 2.05
    assert info["tracking_error_peak"][1:6].max() < 1e-12
    assert info["rotation_error_peak"][1:6].max() < 1e-12
    assert info["torques"][1:6].min() > 0.1
    assert not info["commanded_action"][6:].any()


def test_delays_of_environments_are_independent():
    """Delays 0, 3 and 1 at once; then one environment restarts with a longer delay, and again with
    none."""
    env = make_vector(FLEX_SPATIAL, 3, trajectory="dwell-spatial")
    singles = [make(FLEX_SPATIAL, trajectory="dwell-spatial") for _ in range(3)]
    env.reset(seed=0, options={"uncertainty": [None, {"delay": 3}, {"delay": 1}]})
    for single, delay in zip(singles, (0, 3, 1), strict=True):
        single.reset(seed=0, options={"uncertainty": {"delay": delay}})
    actions = random_actions(env, 24)
    for step, action in enumerate(actions):
        if step in (5, 14):
            uncertainty = {"delay": 7} if step == 5 else None
            env.reset(
                options={
                    "reset_mask": np.array([False, False, True]),
                    "uncertainty": uncertainty,
                }
            )
            singles[2].reset(options={"uncertainty": uncertainty})
        info = env.step(action)[4]
        for index, single in enumerate(singles):
            expected = single.step(action[index])[4]
            for key in (
                "commanded_action",
                "torques",
                "tensions",
                "tracking_error_peak",
            ):
                assert_array_equal(
                    info[key][index],
                    expected[key],
                    err_msg=f"{key} {index} {step}",
                )
    assert_array_equal(info["commanded_action"][1:], [actions[-4, 1], actions[-1, 2]])


def test_delay_is_drawn_uniformly_between_its_bounds():
    env = make_lasting(PLANAR, 600, uncertainty={"delay": [1, 3]})
    actions = np.tile(random_actions(make(PLANAR), 8)[:, None], (600, 1))
    commanded = rollout(env, actions, seed=0).info["commanded_action"][-1]
    counts = [np.sum(np.all(commanded == actions[-1 - delay], axis=1)) for delay in (1, 2, 3)]
    assert sum(counts) == 600
    assert stats.chisquare(counts).pvalue > 0.01


@paper_ids
def test_motors_with_lag_start_from_the_holding_torques(env_id):
    """A robot whose motors answer slowly stays at rest for some steps, whatever the action."""
    robot = ROBOTS[env_id]
    changes = []
    for lag in (1e3, 1e-3):
        slow = robot.replace(motors=robot.motors.replace(lag=lag))
        env = make(
            env_id,
            robot=slow,
            payload=2.0,
            trajectory=motion("dwell", env_id),
            initial_error=0.0,
        )
        torques = rollout(env, np.zeros((5, robot.cables)), seed=0).info["torques"]
        changes.append(np.abs(torques[-1] - torques[0]).max())
    assert changes[0] < 1e-3 < 0.1 < changes[1]
