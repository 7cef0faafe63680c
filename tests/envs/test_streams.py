"""Random streams: seeds determine all draws, and draws of different purposes are independent."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats

from cablebot_gym.envs import PAPER_ENV_IDS
from cablebot_gym.envs.streams import BLOCK, NormalRows, Purpose, Streams
from cablebot_gym.physics import kernel
from cablebot_gym.uncertainty import ExternalWrench, ParameterDistribution, SensorNoise, Uncertainty

each_id = pytest.mark.parametrize("env_id", PAPER_ENV_IDS)
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
            found = made.normal_block(indices(0, 1), purpose, indices(block, block), width)
            assert found.shape == (2, BLOCK, width)
            rows += list(found.reshape(2, -1))
    check_unrelated(rows)
    assert stats.kstest(np.concatenate(rows), "norm").pvalue > 0.01


def test_streams_do_not_depend_on_what_was_read():
    usual, disturbed = streams(3, 4), streams(3, 4)
    for purpose in Purpose:
        disturbed.uniform(indices(1, 0), purpose, 17)
        disturbed.normal_block(indices(0), purpose, indices(9), 3)
    for purpose in Purpose:
        ours, theirs = (made.uniform(indices(0, 1), purpose, 5) for made in (disturbed, usual))
        np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(disturbed.uniform(indices(0, 1), purpose, 5), ours)


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
    """Nominal payload, start error, true mass, first force and noise of some episodes of given lengths."""
    env = single(env_id, payload_range=(0.5, 2.0), initial_error_range=errors(env_id), **keywords)
    found = []
    for number in range(episodes):
        observation, _ = env.reset(seed=seed if number == 0 else None)
        noise = env.layout.split(observation)["pose"] - env.pose
        error = env.pose - env.settings.trajectory(0.0).position
        mass, force = env.truth["platform_mass"], []
        for _ in range(max(1, steps[number % len(steps)])):
            env.step(np.full(env.action_space.shape, 0.4))
            force.append(forces(env)[0])
        found.append((env.task.model_payload, error, mass, force[0], noise))
    return [np.array(column) for column in zip(*found, strict=True)]


def errors(env_id):
    return [0.001] * (2 if "Planar" in env_id else 6)


@each_id
def test_draws_do_not_depend_on_the_other_uncertainties(env_id):
    noise = SensorNoise(position=1e-3)
    others = MASS | {name: ParameterDistribution(low=-0.1, high=0.1) for name in ("motor_strength", "payload")}
    forms = {
        "mass": Uncertainty(parameters=MASS),
        "wrench": Uncertainty(wrench=FORCES),
        "sensors": Uncertainty(sensors=noise),
        "all": Uncertainty(parameters=others, wrench=FORCES, sensors=noise, delay=2),
    }
    usual = drawn(env_id)
    assert len(np.unique(usual[0])) == 4
    found = {name: drawn(env_id, uncertainty=form) for name, form in forms.items()}
    for name, draws in found.items():
        for one, other in zip(draws[:2], usual[:2], strict=True):
            np.testing.assert_array_equal(one, other, err_msg=name)
        varies = [bool(np.ptp(column)) for column in draws[2:]]
        assert varies == [name in (own, "all") for own in ("mass", "wrench", "sensors")], name
    for place, name in ((2, "mass"), (3, "wrench")):
        np.testing.assert_array_equal(found[name][place], found["all"][place])
    np.testing.assert_allclose(found["sensors"][4], found["all"][4], atol=1e-15)


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


@pytest.mark.parametrize("noise_seed", [7, [9, 5, 7]])
def test_noise_seed_changes_the_noise_and_not_the_parameters(noise_seed):
    """Wrench and white noise follow it until the next seed; masses, factors, biases and delays follow the seed."""
    wrench, noise = ExternalWrench(force_std=1.0, factor=(0.5, 2.0)), SensorNoise(position=1e-3)
    form = Uncertainty(parameters=MASS, wrench=wrench, sensors=noise, sensor_bias=noise, delay=(0, 9))
    env: Any = gym.make_vec("CableBot-Planar-v0", num_envs=3, uncertainty=form).unwrapped

    def draws(**reset):
        """Of two episodes: noise and force, then mass, factor, bias and delay."""
        found = []
        for number in range(2):
            env.reset(**reset if number == 0 else {})
            disturbances = env._simulation._disturbances
            white = np.round(disturbances.noise - disturbances._bias, 12)
            env.step(np.zeros((3, 3)))
            drawn = env.truth["platform_mass"], disturbances._factor, disturbances._bias, disturbances._delay
            force = forces(env)[:, :2] / disturbances._factor
            found.append([value.copy() for value in (white[:, :2], force, *drawn)])
        return found

    usual, other = draws(seed=1), draws(seed=1, options={"noise_seed": noise_seed})
    for ours, theirs in zip(usual, other, strict=True):
        assert not np.any(ours[0] == theirs[0])
        assert not np.any(ours[1] == theirs[1])
        for one, same in zip(ours[2:], theirs[2:], strict=True):
            np.testing.assert_array_equal(one, same)
        assert len(np.unique(theirs[0])) == theirs[0].size
    for ours, theirs in zip(draws(seed=1), usual, strict=True):
        for one, same in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(one, same)


@pytest.mark.parametrize("bad", [-1, 0.5, [1, 2], "seed"])
def test_impossible_noise_seed_raises_and_keeps_the_streams(bad):
    env = single("CableBot-Planar-v0", uncertainty=Uncertainty(parameters=MASS, sensors=SensorNoise(position=1e-3)))
    found = []
    for given in ({"noise_seed": bad}, None):
        env.reset(seed=0)
        if given:
            with pytest.raises(ValueError, match="noise_seed must be"):
                env.reset(seed=1, options=given)
        observation, _ = env.reset()
        found.append([*observation, *env.truth["platform_mass"].ravel()])
    np.testing.assert_array_equal(found[0], found[1])


def test_noise_and_wrench_have_different_numbers():
    wrench = ExternalWrench(force_std=1.0, correlation_time=0.002)
    env = single("CableBot-FlexSpatial-v0", uncertainty=Uncertainty(sensors=SensorNoise(position=1.0), wrench=wrench))
    env.reset(seed=0)
    noises, wrenches = [], []
    for _ in range(BLOCK):
        noises.append(env._simulation._disturbances.noise[0].copy())
        env.step(np.full(env.action_space.shape, 0.4))
        wrenches.append(forces(env)[0])
    noise = np.unique(np.round(noises, 12))
    assert len(noise) == 3 * BLOCK + 1, "and zeros"
    assert np.intersect1d(noise, np.round(wrenches, 12)).size == 0
