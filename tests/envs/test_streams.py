"""Random streams: seeds determine all draws, and draws of different purposes are independent."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats

import cablebot_gym
from cablebot_gym.envs.streams import BLOCK, NormalRows, Purpose, Streams
from cablebot_gym.physics import kernel
from cablebot_gym.uncertainty import ExternalWrench, ParameterDistribution, SensorNoise, Uncertainty

each_id = pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)
two_ids = pytest.mark.parametrize("env_id", ["CableBot-Planar-v0", "CableBot-FlexSpatial-v0"])
MASS = {"platform_mass": ParameterDistribution(low=-0.2, high=0.2)}
FORCES = ExternalWrench(force_std=1.0)


def indices(*values):
    return np.array(values, np.int64)


def streams(*seeds):
    """Streams of one environment per seed, in the first episode."""
    made = Streams(len(seeds))
    made.seed(np.arange(len(seeds)), seeds)
    made.start_episode(np.arange(len(seeds)))
    return made


def single(env_id="CableBot-Spatial-v0", **keywords) -> Any:
    return gym.make(env_id, **keywords).unwrapped


def batch(env_id, count, **keywords) -> Any:
    return gym.make_vec(env_id, num_envs=count, **keywords).unwrapped


def forces(env):
    """Present external forces, (N, 3)."""
    plant = env._simulation._plant
    return plant._read(plant._parameters, kernel.FORCE, 3)


# ------------------------------------------------------------------------------------------------------- streams


def check_unrelated(rows):
    """Rows of many numbers, all different and uncorrelated."""
    rows = np.array(rows)
    assert len(np.unique(rows)) == rows.size
    correlation = np.corrcoef(rows) - np.eye(len(rows))
    assert np.abs(correlation).max() < 6 / np.sqrt(rows.shape[1])


def test_seeds_episodes_and_purposes_have_independent_uniform_numbers():
    size, rows = 3000, []
    for purpose in Purpose:
        made = streams(0, 1, 2, 2**32, 2**64, 2**64 + 1, 2**65, 2**127, 2**128, 2**128 + 2**64, 2**200)
        everyone = np.arange(11)
        for _ in range(2):
            rows += list(made.uniform(everyone, purpose, size))
            made.start_episode(everyone)
    assert len(rows) == 11 * 2 * len(Purpose)
    check_unrelated(rows)
    for row in rows:
        assert row.min() >= 0
        assert row.max() < 1
    assert stats.kstest(np.concatenate(rows), "uniform").pvalue > 0.01


def test_blocks_have_independent_normal_numbers():
    made, width, rows = streams(5, 6), 100, []
    for purpose in Purpose:
        for block in (0, 1, 2, 300):
            found = made.normal(indices(0, 1), purpose, indices(block, block), width)
            assert found.shape == (2, BLOCK, width)
            rows += list(found.reshape(2, -1))
    check_unrelated(rows)
    assert stats.kstest(np.concatenate(rows), "norm").pvalue > 0.01


def test_streams_do_not_depend_on_what_was_read():
    usual, disturbed = streams(3, 4), streams(3, 4)
    for purpose in Purpose:
        disturbed.uniform(indices(1, 0), purpose, 17)
        disturbed.normal(indices(0), purpose, indices(9), 3)
    for purpose in Purpose:
        ours, theirs = (made.uniform(indices(0, 1), purpose, 5) for made in (disturbed, usual))
        np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(disturbed.uniform(indices(0, 1), purpose, 5), ours)


def test_environments_of_equal_seed_and_episode_have_equal_numbers():
    made = streams(8, 9, 8)
    found = made.uniform(indices(0, 1, 2), Purpose.WRENCH, 6)
    np.testing.assert_array_equal(found[0], found[2])
    assert not np.any(found[0] == found[1])
    np.testing.assert_array_equal(made.uniform(indices(2, 1), Purpose.WRENCH, 6), found[[2, 1]])
    made.start_episode(indices(2))
    later = made.uniform(indices(0, 1, 2), Purpose.WRENCH, 6)
    np.testing.assert_array_equal(later[:2], found[:2])
    assert not np.any(later[2] == found[0])
    blocks = made.normal(indices(0, 0), Purpose.WRENCH, indices(0, 1), 2)
    assert not np.any(blocks[0] == blocks[1])


def test_rows_depend_on_the_interval_only():
    made = streams(1, 2)
    reader = NormalRows(made, Purpose.SENSORS, 2, 3)
    reader.restart(indices(0, 1))
    count = 5 * BLOCK
    found = np.array([reader.at(indices(0, 1), indices(step, step)) for step in range(count)])
    assert len(np.unique(found)) == found.size
    late = NormalRows(made, Purpose.SENSORS, 2, 3)
    late.restart(indices(0, 1))
    for first, second in ((100, 3), (0, 159), (33, 32)):
        np.testing.assert_array_equal(
            late.at(indices(0, 1), indices(first, second)), [found[first, 0], found[second, 1]]
        )
        np.testing.assert_array_equal(late.at(indices(1), indices(second)), [found[second, 1]])
    made.start_episode(indices(0))
    late.restart(indices(0))
    again = late.at(indices(0, 1), indices(33, 32))
    assert not np.any(again[0] == found[33, 0])
    np.testing.assert_array_equal(again[1], found[32, 1])


# -------------------------------------------------------------------------------------------------- environments


def drawn(env_id, episodes=4, seed=5, steps=(0,), **keywords):
    """Nominal payload, start error, true mass and first force of some episodes of given lengths."""
    env = single(env_id, payload_range=(0.5, 2.0), initial_error_range=errors(env_id), **keywords)
    found = []
    for number in range(episodes):
        env.reset(seed=seed if number == 0 else None)
        error = env.pose - env.settings.trajectory(0.0).position
        mass, force = env.truth["platform_mass"], []
        for _ in range(max(1, steps[number % len(steps)])):
            env.step(np.full(env.action_space.shape, 0.4))
            force.append(forces(env)[0])
        found.append((env.task.model_payload, error, mass, force[0]))
    return [np.array(column) for column in zip(*found, strict=True)]


def errors(env_id):
    return [0.001] * (2 if "Planar" in env_id else 6)


UNCERTAIN = {
    "mass": Uncertainty(parameters=MASS),
    "payload": {"parameters": {"payload": {"low": -0.5, "high": 0.5}}},
    "wrench": Uncertainty(wrench=FORCES),
    "sensors": "sensors",
    "delay": {"delay": 3},
    "mass and wrench": Uncertainty(parameters=MASS, wrench=FORCES),
    "all": Uncertainty(
        parameters=MASS
        | {
            "motor_strength": ParameterDistribution(low=-0.1, high=0.1),
            "payload": ParameterDistribution(low=-0.5, high=0.5),
        },
        wrench=FORCES,
        sensors=SensorNoise(position=1e-3),
        delay=2,
    ),
}


@each_id
def test_draws_do_not_depend_on_the_other_uncertainties(env_id):
    usual = drawn(env_id)
    assert len(np.unique(usual[0])) == 4
    found = {name: drawn(env_id, uncertainty=form) for name, form in UNCERTAIN.items()}
    for name, (payload, error, mass, force) in found.items():
        np.testing.assert_array_equal(payload, usual[0], err_msg=name)
        np.testing.assert_array_equal(error, usual[1], err_msg=name)
        assert bool(np.ptp(mass)) == (name in ("mass", "mass and wrench", "all")), name
        assert bool(np.ptp(force)) == (name in ("wrench", "mass and wrench", "all")), name
    np.testing.assert_array_equal(found["mass"][2], found["mass and wrench"][2])
    np.testing.assert_array_equal(found["mass"][2], found["all"][2])
    for name in ("mass and wrench", "all"):
        np.testing.assert_array_equal(found["wrench"][3], found[name][3])


def noise_of(env_id, uncertainty, steps=70):
    """Difference of the observations with and without sensor noise."""
    exact = {"parameters": uncertainty.parameters, "wrench": uncertainty.wrench, "delay": uncertainty.delay}
    found = []
    for form in (uncertainty, Uncertainty(**exact)):
        env = single(env_id, uncertainty=form)
        observations = [env.reset(seed=2)[0]]
        observations += [env.step(np.full(env.action_space.shape, 0.4))[0] for _ in range(steps)]
        found.append(np.array(observations))
    return found[0] - found[1]


@two_ids
def test_noise_does_not_depend_on_the_other_uncertainties(env_id):
    noise = SensorNoise(position=1e-3, velocity=1e-2)
    alone = noise_of(env_id, Uncertainty(sensors=noise))
    among = noise_of(env_id, Uncertainty(sensors=noise, parameters=MASS, wrench=FORCES, delay=2))
    np.testing.assert_allclose(among, alone, atol=1e-13)
    assert alone.std() > 1e-4


@two_ids
def test_draws_do_not_depend_on_the_length_of_the_last_episode(env_id):
    form = Uncertainty(parameters=MASS, wrench=FORCES, sensors=SensorNoise(position=1e-3), delay=1)
    short, long = (drawn(env_id, uncertainty=form, steps=steps) for steps in ((1,), (40, 3, 170, 1)))
    for one, other in zip(short, long, strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(np.unique(short[2])) == 4
    assert len(np.unique(short[3])) == 4 * (2 if "Planar" in env_id else 3) + ("Planar" in env_id)


@two_ids
@pytest.mark.parametrize("seed", [0, 2**64 + 5, 2**200 + 1])
def test_seed_determines_all_draws(env_id, seed):
    form = Uncertainty(parameters=MASS, wrench=FORCES)
    first, again = (drawn(env_id, seed=seed, uncertainty=form) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)
    for near in (seed + 1, seed + 2**64, seed + 2**128):
        other = drawn(env_id, seed=near, uncertainty=form)
        for place in (0, 2):
            assert not np.any(first[place] == other[place])
        assert not np.any((first[3] == other[3])[:, :2])


def test_noise_of_a_long_episode_does_not_repeat():
    steps = 13 * BLOCK + 5
    keywords = {"trajectory": "dwell-planar", "slack_time": 99.0}
    noisy, exact = (single("CableBot-Planar-v0", uncertainty=form, **keywords) for form in ("sensors", None))
    assert steps > 400
    rows = [noisy.reset(seed=0)[0] - exact.reset(seed=0)[0]]
    rows += [noisy.step(np.full(3, 0.2))[0] - exact.step(np.full(3, 0.2))[0] for _ in range(steps)]
    speed = np.array(rows)[:, 2:4] / 2e-3
    assert len(np.unique(speed.round(9))) > 0.999 * speed.size
    for lag in (1, BLOCK - 1, BLOCK, BLOCK + 1, 2 * BLOCK, 8 * BLOCK):
        assert abs(np.mean(speed[lag:] * speed[:-lag])) < 5 / np.sqrt(speed[lag:].size), lag
    assert stats.kstest(speed.ravel(), "norm").pvalue > 0.01


def test_noise_and_wrench_have_different_numbers():
    env_id = "CableBot-FlexSpatial-v0"
    form = Uncertainty(
        sensors=SensorNoise(position=1.0, rotation=1.0, velocity=1.0, rotation_rate=1.0, motor_angle=1, motor_speed=1),
        wrench=ExternalWrench(force_std=1.0, moment_std=1.0, correlation_time=0.002),
    )
    env = batch(env_id, 1, uncertainty=form)
    env.reset(seed=0)
    noise, wrench = [], []
    for _ in range(BLOCK):
        noise.append(env._simulation._disturbances.noise[0].copy())
        env._simulation.step(np.full(env.action_space.shape, 0.4))
        wrench.append(forces(env)[0, :2])
    noise, wrench = np.array(noise).round(12), np.array(wrench).round(12)
    assert len(np.unique(noise)) == noise.size
    assert np.intersect1d(noise, wrench).size == 0
