"""Effects of uncertainty on an episode: true parameters, external wrench, sensor noise and delayed actions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats

from cablebot_gym import ENV_IDS
from cablebot_gym.envs import PAPER_ENV_IDS, env_robot
from cablebot_gym.physics import kernel, textbook
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.trajectories import Reference
from cablebot_gym.uncertainty import PARAMETERS, ExternalWrench, ParameterDistribution, Uncertainty

ROBOTS = {env_id: find_robot(env_robot(env_id)) for env_id in ENV_IDS}
MEASURED = ("pose", "velocity", "motor_angle", "motor_speed")
each_id = pytest.mark.parametrize("env_id", PAPER_ENV_IDS)
two_ids = pytest.mark.parametrize("env_id", ["CableBot-Planar-v0", "CableBot-FlexSpatial-v0"])


def has(robot, name):
    """Whether a robot has a parameter."""
    return PARAMETERS[name].belongs_to(robot)


each_parameter = pytest.mark.parametrize(
    ("env_id", "name"), [(env_id, name) for env_id, robot in ROBOTS.items() for name in PARAMETERS if has(robot, name)]
)


def single(env_id, **keywords) -> Any:
    """An environment without wrappers."""
    return gym.make(env_id, **keywords).unwrapped


def batch(env_id, count, **keywords) -> Any:
    """Vector environment whose episodes do not end."""
    lasting = {"termination_radius": 100.0, "slack_time": 100.0, "autoreset_mode": "Disabled"}
    wide = [(-9.0, 9.0), (-9.0, 9.0), (-9.0, 9.0), (-9.0, 9.0), (-1.5, 1.5), (-9.0, 9.0)]
    robot = ROBOTS[env_id].replace(workspace=wide[: ROBOTS[env_id].coordinates])
    made = {"robot": robot, "max_episode_steps": None} | lasting | keywords
    return gym.make_vec(env_id, num_envs=count, **made).unwrapped


def kind(env_id):
    return "planar" if ROBOTS[env_id].planar else "spatial"


def wrench_of(env):
    """Present external wrenches, (N, 6): force, then moment."""
    plant = env._simulation._plant
    return plant._read(plant._parameters, kernel.FORCE, 6)


def random_actions(env_id, steps, seed=0):
    """Random actions that mostly pull, (steps, m)."""
    return np.random.default_rng(seed).uniform(0.0, 0.8, (steps, ROBOTS[env_id].cables))


def rollout(env, actions, **reset):
    """Observations and infos of an open-loop episode from the reset on, and its rewards."""
    observation, info = env.reset(**reset)
    observations, infos, rewards = [observation], [info], []
    for action in actions:
        observation, reward, _, _, info = env.step(action)
        observations.append(observation)
        infos.append(info)
        rewards.append(reward)
    columns = {key: np.array([info[key] for info in infos]) for key in infos[0]}
    return np.array(observations), columns, np.array(rewards)


# ----------------------------------------------------------------------------------------------- true parameters


def spread_of(name, low=0.05, high=0.1):
    """A deviation that is never zero; absolute where the paper's value may be zero."""
    if PARAMETERS[name].position:
        return ParameterDistribution(low=0.005, high=0.01, relative=False)
    if name in ("damping", "motor_damping", "motor_lag", "coulomb_friction"):
        return ParameterDistribution(low=1e-3, high=2e-3, relative=False)
    return ParameterDistribution(low=low, high=high, each=name != "platform_inertia")


def replaced(robot: Robot, truth) -> Robot:
    """The robot whose nominal values are the true ones, with the nominal free speed."""
    names = ("stiffness", "motor_inertia", "motor_damping", "axial_stiffness")
    spring = {name: tuple(truth[name]) for name in names if name in truth}
    body = {}
    if not robot.point_mass:
        body = {"platform_anchors": truth["platform_anchors"], "inertia": truth["platform_inertia"]}
    return robot.replace(
        mass=float(truth["platform_mass"]),
        base_anchors=truth["base_anchors"],
        motors=robot.motors.replace(stall_torque=tuple(truth["motor_strength"]), lag=tuple(truth["motor_lag"])),
        transmission=robot.transmission.replace(
            pulley_inertia=tuple(truth["pulley_inertia"]),
            damping=tuple(truth["damping"]),
            coulomb_friction=tuple(truth["coulomb_friction"]),
            **spring,
        ),
        **body,
    )


@each_parameter
def test_every_parameter_reaches_the_plant_and_the_truth(env_id, name):
    """The uncertain environment is the one of a robot that nominally has the drawn values."""
    keywords = {"payload": 1.5, "payload_known": False, "substeps": 32 if ROBOTS[env_id].elastic else 8}
    uncertainty = Uncertainty(parameters={name: spread_of(name)})
    uncertain, usual = (single(env_id, uncertainty=form, **keywords) for form in (uncertainty, None))
    actions = random_actions(env_id, 30)
    ours, theirs = rollout(uncertain, actions, seed=3), rollout(usual, actions, seed=3)
    truth, nominal = uncertain.truth, usual.truth
    assert [other for other in nominal if not np.array_equal(truth[other], nominal[other])] == [name]
    known = single(
        env_id,
        **keywords | {"payload": float(truth["payload"])},
        robot=replaced(ROBOTS[env_id], truth),
        trajectory=usual.settings.trajectory,
    )
    made = rollout(known, actions, seed=3)
    blocks = [part for part in MEASURED if part in uncertain.layout.slices()]
    states = [uncertain.layout.split(one[0]) for one in (ours, theirs, made)]
    for block in blocks:
        np.testing.assert_allclose(states[0][block], states[2][block], rtol=1e-12, atol=1e-12, err_msg=block)
    for key in ("payload", "tensions", "torques", "motor_speeds", "tracking_error", "slack"):
        np.testing.assert_allclose(ours[1][key], made[1][key], rtol=1e-10, atol=1e-10, err_msg=key)
    assert max(np.abs(states[0][block] - states[1][block]).max() for block in blocks) > 1e-7
    if name == "payload":
        assert np.all(ours[1]["payload"] > 1.5 * 1.05 - 1e-12)


# -------------------------------------------------------------------------------------------------------- table 6


def wrenches(env, steps):
    """Wrenches in each control period, (steps, N, 6)."""
    found = []
    for _ in range(steps):
        env._simulation.step(np.full(env.action_space.shape, 0.3))
        found.append(wrench_of(env))
    return np.array(found)


@two_ids
@pytest.mark.parametrize(("frequency", "hold"), [(500.0, 5), (60.0, 1), (360.0, 4)])
def test_table_6_forces_last_ten_milliseconds(env_id, frequency, hold):
    env = batch(env_id, 3, uncertainty="table6", control_frequency=frequency)
    env.reset(seed=1)
    found = wrenches(env, 8 * hold)
    forces = 2 if ROBOTS[env_id].planar else 3
    changes = np.any(found[1:] != found[:-1], axis=-1)
    expected = (np.arange(1, 8 * hold) % hold == 0)[:, None]
    np.testing.assert_array_equal(changes, np.repeat(expected, 3, axis=1))
    assert np.all(found[..., :forces] != 0.0)
    assert not found[..., forces:].any()


def test_table_6_forces_have_the_mean_and_variance_of_the_paper():
    env = batch("CableBot-Spatial-v0", 128, uncertainty="table6", control_frequency=100.0)
    env.reset(seed=2)
    found = wrenches(env, 150)[..., :3]
    # A factor f uniform in [0.9, 1.1]: E f² = 1 + 0.04/12, and the variance is E f² · 0.2 + Var f · 0.5².
    assert found.mean() == pytest.approx(0.5, abs=4 * np.sqrt(0.2 / found.size) + 4 * 0.5 * 0.058 / np.sqrt(384))
    assert found.var() == pytest.approx(
        0.2 * (1 + 0.04 / 12) + 0.04 / 12 * 0.25, rel=4 * np.sqrt(2 / found.size) + 0.02
    )
    normal = (found - found.mean(axis=0)) / found.std(axis=0)
    assert stats.kstest(normal[::10].ravel(), "norm").pvalue > 0.01
    assert abs(np.mean(normal[1:] * normal[:-1])) < 5 / np.sqrt(found.size)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        assert abs(np.mean(normal[..., i] * normal[..., j])) < 5 / np.sqrt(found.size / 3)


def test_wrench_factor_is_drawn_once_per_episode_and_component():
    wrench = ExternalWrench(force_mean=(1.0, 2.0, -4.0), moment_mean=8.0, factor=(0.9, 1.1), correlation_time=0.002)
    env = batch("CableBot-Spatial-v0", 500, uncertainty=Uncertainty(wrench=wrench))
    factors = []
    for _ in range(2):
        env.reset(seed=3 if not factors else None)
        found = wrenches(env, 4)
        np.testing.assert_array_equal(found, np.broadcast_to(found[0], found.shape))
        factors.append(found[0] / [1.0, 2.0, -4.0, 8.0, 8.0, 8.0])
    both = np.concatenate(factors, axis=1)
    for column in both.T:
        assert stats.kstest(column, stats.uniform(0.9, 0.2).cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(both.T) - np.eye(12)).max() < 0.25


@each_id
@pytest.mark.parametrize("axis", range(6))
def test_constant_wrench_has_the_acceleration_of_the_closed_form(env_id, axis):
    """(D + (J/r²) SᵀS) Ẍ = w at the home pose, to which a rigid robot without torque adds its weight."""
    robot, frequency = ROBOTS[env_id], 1e4
    w = np.zeros(6)
    w[axis % 2 if robot.planar else axis] = 3.0
    wrench = ExternalWrench(force_mean=tuple(w[: 2 if robot.planar else 3]), moment_mean=tuple(w[3:]))
    env = single(
        env_id,
        trajectory={"name": f"dwell-{kind(env_id)}", "pose": robot.home.tolist()},
        cable="bilateral",
        control_frequency=frequency,
        uncertainty=Uncertainty(wrench=wrench),
        payload=3.3,
    )
    env.reset(seed=0)
    velocity = env.layout.split(env.step(np.zeros(robot.cables))[0])["velocity"]
    structure = textbook.jacobian(robot, robot.home)
    reflected = structure.T @ ((robot.pulley_inertia / robot.pulley_radius**2)[:, None] * structure)
    mass = robot.mass + 3.3
    matrix = textbook.mass_matrix(robot, mass, robot.home) + reflected
    load = w[: robot.coordinates].copy()
    if not robot.planar and not robot.flexible:
        load[2] += mass * robot.gravity
    expected = np.linalg.solve(matrix, load)
    np.testing.assert_allclose(velocity * frequency, expected, rtol=2e-3, atol=2e-3 * np.abs(expected).max())


# -------------------------------------------------------------------------------------------------------- sensors


@two_ids
def test_sensor_noise_is_white_and_affects_measured_blocks_only(env_id):
    robot = ROBOTS[env_id]
    noisy, clean = batch(env_id, 40, uncertainty="sensors"), batch(env_id, 40)
    actions = np.random.default_rng(0).uniform(0.0, 0.6, (150, 40, robot.cables))
    ours, theirs = rollout(noisy, actions, seed=9), rollout(clean, actions, seed=9)
    for key in theirs[1]:
        np.testing.assert_array_equal(ours[1][key], theirs[1][key], err_msg=key)
    np.testing.assert_array_equal(ours[2], theirs[2])
    np.testing.assert_array_equal(noisy.pose, clean.pose)
    noise = noisy.layout.split(ours[0] - theirs[0])
    again = noisy.reset()[0] - clean.reset()[0]
    assert not np.intersect1d(again[again != 0], ours[0][0] - theirs[0][0]).size, "the next episode has other noise"
    places = 2 if robot.planar else 3
    sigma = {"pose": (1e-4, 2e-4), "velocity": (2e-3, 4e-3), "motor_angle": (1e-3,) * 2, "motor_speed": (1e-2,) * 2}
    seen = []
    for name, values in noise.items():
        if name not in MEASURED:
            assert not values.any(), name
            continue
        for part, expected in zip((values[..., :places], values[..., places:]), sigma[name], strict=True):
            if part.size:
                seen.append(part / expected)
                assert part.std() == pytest.approx(expected, rel=5 / np.sqrt(2 * part.size)), name
                assert part[0].std() == pytest.approx(expected, rel=0.5), name  # after reset too
    white = np.concatenate(seen, axis=-1)  # (steps, N, components)
    assert stats.kstest(white[:, :4].ravel(), "norm").pvalue > 0.01
    for lag in (1, 2, 31, 32, 33, 64):
        assert abs(np.mean(white[lag:] * white[:-lag])) < 5 / np.sqrt(white[lag:].size), lag
    components = np.corrcoef(white.reshape(-1, white.shape[-1]).T) - np.eye(white.shape[-1])
    assert np.abs(components).max() < 6 / np.sqrt(151 * 40)
    lanes = np.corrcoef(white.transpose(1, 0, 2).reshape(40, -1)) - np.eye(40)
    assert np.abs(lanes).max() < 6 / np.sqrt(151 * white.shape[-1])


@two_ids
def test_sensor_bias_is_normal_and_constant_in_an_episode(env_id):
    """White noise is added to it; the second environment has none, and the next episode another one."""
    robot, sigma = ROBOTS[env_id], {"position": 1e-3, "rotation": 2e-3, "velocity": 3e-3, "motor_angle": 4e-3}
    biased, clean = batch(env_id, 400), batch(env_id, 400)
    forms = [{"sensor_bias": sigma}, {"sensors": {"position": 1e-3}}, {"sensor_bias": sigma}, None] * 100
    actions = np.random.default_rng(0).uniform(0.0, 0.6, (3, 400, robot.cables))
    options = {"uncertainty": forms}
    ours, theirs = (rollout(env, actions, seed=9, options=options if env is biased else {}) for env in (biased, clean))
    np.testing.assert_array_equal(ours[2], theirs[2])
    error = biased.layout.split(ours[0] - theirs[0])
    places = 2 if robot.planar else 3
    for name, values in error.items():
        constant = values[:, ::2]
        np.testing.assert_allclose(constant, np.broadcast_to(constant[0], constant.shape), rtol=0, atol=1e-14)
        assert not values[:, 3::4].any()
        expected = {"pose": 1e-3, "velocity": 3e-3, "motor_angle": 4e-3}.get(name)
        if expected is not None:
            normal = constant[0, :, :places].ravel() / expected
            assert stats.kstest(normal, "norm").pvalue > 0.01, name
            assert len(np.unique(normal)) == normal.size
        else:
            assert not values[:, ::2].any(), name
    assert np.ptp(error["pose"][:, 1], axis=0)[0] > 1e-4
    again = (biased.reset(options=options)[0] - clean.reset()[0])[0, 0]
    assert 0 < abs(again) != abs(error["pose"][0, 0, 0])
    np.testing.assert_array_equal(biased.reset(options={"uncertainty": None})[0], clean.reset()[0])


def test_noise_and_wrench_affect_their_environment_and_episode_only():
    env, clean = batch("CableBot-FlexPlanar-v0", 3), batch("CableBot-FlexPlanar-v0", 3)
    forms = ["table6+sensors", None, {"sensors": {"velocity": 0.01}}]
    noise = env.reset(seed=0, options={"uncertainty": forms})[0] - clean.reset(seed=0)[0]
    assert np.count_nonzero(noise[0]) == 2 + 2 + 3 + 3
    assert not noise[1].any()
    assert np.flatnonzero(noise[2]).tolist() == [2, 3]
    found = wrenches(env, 3)
    assert np.all(found[:, 0, :2] != 0)
    assert not found[:, 1:].any()
    np.testing.assert_array_equal(env.reset()[0], clean.reset()[0])
    action = np.full((3, 3), 0.4)
    np.testing.assert_array_equal(env.step(action)[0], clean.step(action)[0])
    assert not wrenches(env, 7).any()


# ---------------------------------------------------------------------------------------------------------- delay


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
        zero = np.zeros_like(position)
        velocity = np.where(times <= self.duration, 1.0, 0.0)[..., None] * rate
        return Reference(position=position, velocity=velocity, acceleration=zero, jerk=zero, snap=zero)


def holding(robot, payload, pose, velocity):
    """Actions that request the static torque at the present motor speed."""
    torque = textbook.static_torque(robot, robot.mass + payload, pose, minimum=textbook.MINIMUM_TENSION)
    return (torque + robot.speed_slope * textbook.pulley_speed(robot, pose, velocity)) / robot.stall_torque


@two_ids
@pytest.mark.parametrize("delay", [1, 5])
def test_actions_arrive_delayed(env_id, delay):
    robot = ROBOTS[env_id]
    keywords = {"trajectory": Drift(robot.coordinates), "payload": 1.0}
    late, prompt = single(env_id, uncertainty={"delay": delay}, **keywords), single(env_id, **keywords)
    actions = random_actions(env_id, 25)
    start = keywords["trajectory"](0.0)
    hold = holding(robot, 1.0, start.position, start.velocity)
    ours = rollout(late, actions, seed=0)
    theirs = rollout(prompt, np.concatenate([np.tile(hold, (delay, 1)), actions[:-delay]]), seed=0)
    sent = late.layout.slices()["last_actions"]
    for observations in (ours[0], theirs[0]):  # those hold the actions of the policy, before the delay
        observations[:, sent] = 0.0
    np.testing.assert_allclose(ours[0], theirs[0], rtol=1e-12, atol=1e-12)
    first = prompt.layout.split(theirs[0][0])
    np.testing.assert_allclose(first["velocity"], 0.01 * np.arange(1, robot.coordinates + 1), atol=1e-15)
    np.testing.assert_array_equal(first["pose"], first["reference_pose"])
    for key in theirs[1]:
        if theirs[1][key].dtype.kind == "f":
            np.testing.assert_allclose(ours[1][key], theirs[1][key], rtol=1e-9, atol=1e-11, err_msg=key)
    np.testing.assert_array_equal(ours[1]["commanded_action"][delay + 1 :], actions[:-delay])
    assert np.ptp(ours[1]["torques"][delay + 1 :], axis=0).min() > 0.1


@each_id
def test_motors_hold_the_true_robot_until_the_first_action_arrives(env_id):
    names = ["payload", "platform_mass", "motor_strength", *(["stiffness"] if ROBOTS[env_id].flexible else [])]
    uncertainty = Uncertainty(parameters={name: spread_of(name) for name in names}, delay=5)
    keywords = {"payload": 2.0, "trajectory": f"dwell-{kind(env_id)}", "initial_error": 0.0}
    env = single(env_id, uncertainty=uncertainty, **keywords)
    env.reset(seed=0)
    assert env.truth["payload"] > 2.05
    zero = np.zeros(ROBOTS[env_id].cables)
    for _ in range(5):
        info = env.step(zero)[4]
        assert info["tracking_error_peak"] < 1e-12
        assert info["rotation_error_peak"] < 1e-12
        assert np.all(info["torques"] > 0.1)
    for _ in range(10 if ROBOTS[env_id].flexible else 1):
        info = env.step(zero)[4]
    if ROBOTS[env_id].planar:
        assert not info["commanded_action"].any()
    else:
        assert info["tracking_error_peak"] > 1e-6


@two_ids
def test_delays_of_environments_are_independent(env_id):
    """Delays 0, 3 and 1 at once; then one environment restarts with a longer delay, and again with none."""
    robot = ROBOTS[env_id]
    motion = f"dwell-{kind(env_id)}"
    env = batch(env_id, 3, trajectory=motion)
    env.reset(seed=0, options={"uncertainty": [None, {"delay": 3}, {"delay": 1}]})
    others = [single(env_id, trajectory=motion) for _ in range(3)]
    for other, delay in zip(others, (0, 3, 1), strict=True):
        other.reset(seed=0, options={"uncertainty": {"delay": delay}})
    actions = np.random.default_rng(1).uniform(0.0, 0.8, (24, 3, robot.cables))
    for number, action in enumerate(actions):
        if number in (5, 14):
            uncertainty = {"delay": 7} if number == 5 else None
            env.reset(options={"reset_mask": np.array([False, False, True]), "uncertainty": uncertainty})
            others[2].reset(options={"uncertainty": uncertainty})
        info = env.step(action)[4]
        for place, other in enumerate(others):
            expected = other.step(action[place])[4]
            for key in ("commanded_action", "torques", "tensions", "tracking_error_peak"):
                np.testing.assert_array_equal(info[key][place], expected[key], err_msg=f"{key} {place} {number}")
    assert np.array_equal(info["commanded_action"][1], actions[-4, 1])
    assert np.array_equal(info["commanded_action"][2], actions[-1, 2])


def test_delay_is_drawn_uniformly_between_its_bounds():
    """A drawn delay acts as a fixed one does."""
    keywords = {"trajectory": "dwell-planar", "payload": 1.0}
    env = batch("CableBot-Planar-v0", 600, uncertainty={"delay": [1, 3]}, **keywords)
    actions = np.tile(random_actions("CableBot-Planar-v0", 8)[:, None], (600, 1))
    infos = rollout(env, actions, seed=0)[1]
    found = []
    for delay in (1, 2, 3):
        fixed = rollout(single("CableBot-Planar-v0", uncertainty={"delay": delay}, **keywords), actions[:, 0], seed=0)[
            1
        ]
        same = np.all(infos["commanded_action"] == fixed["commanded_action"][:, None], axis=(0, 2))
        np.testing.assert_array_equal(infos["torques"][:, same], fixed["torques"][:, None].repeat(same.sum(), axis=1))
        found.append(same.sum())
    assert sum(found) == 600
    assert stats.chisquare(found).pvalue > 0.01


@each_id
def test_motors_with_lag_start_from_the_holding_torques(env_id):
    """A robot whose motors answer slowly stays at rest for some steps, whatever the action."""
    robot = ROBOTS[env_id]
    moved = []
    for lag in (1e3, 1e-3):
        slow = robot.replace(motors=robot.motors.replace(lag=lag))
        env = single(env_id, robot=slow, payload=2.0, trajectory=f"dwell-{kind(env_id)}", initial_error=0.0)
        _, info = env.reset(seed=0)
        held = info["torques"]
        for _ in range(5):
            info = env.step(np.zeros(robot.cables))[4]
        moved.append(np.abs(info["torques"] - held).max())
    assert moved[0] < 1e-3 < 0.1 < moved[1]


def test_delayed_action_is_a_copy():
    env = single("CableBot-Planar-v0", uncertainty={"delay": 1})
    env.reset(seed=0)
    action = np.array([0.1, 0.2, 0.3])
    env.step(action)
    action[:] = 0.9
    assert env.step(action)[4]["commanded_action"].tolist() == [0.1, 0.2, 0.3]
