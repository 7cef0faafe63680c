"""Random streams: seeds determine all draws, and draws of different purposes are independent."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import (
    FLEX_SPATIAL,
    PLANAR,
    ROBOTS,
    make,
    make_vector,
    two_ids,
    wrenches,
)
from scipy import stats

from cablebot_gym.envs.streams import BLOCK, NormalRows, Purpose, Streams
from cablebot_gym.uncertainty import (
    ExternalWrench,
    ParameterDistribution,
    SensorNoise,
    Uncertainty,
)

MASS = {"platform_mass": ParameterDistribution(low=-0.2, high=0.2)}
FORCES = ExternalWrench(force_std=1.0)
NOISE = SensorNoise(position=1e-3)


def indices(*values):
    return np.array(values, np.int64)


def streams(*seeds):
    """Streams of one environment per seed, in the first episode."""
    everyone = np.arange(len(seeds))
    random = Streams(len(seeds))
    random.seed(everyone, seeds)
    random.start_episode(everyone)
    return random


# --- streams ------------------------------------------------------------------------------------------------------


def check_unrelated(rows, law):
    """Rows of many numbers of a law, all different and uncorrelated."""
    rows = np.array(rows)
    assert len(np.unique(rows)) == rows.size
    correlation = np.corrcoef(rows) - np.eye(len(rows))
    assert np.abs(correlation).max() < 6 / np.sqrt(rows.shape[1])
    assert stats.kstest(rows.ravel(), law).pvalue > 0.01


def test_seeds_episodes_and_purposes_have_independent_numbers():
    rows = []
    for purpose in Purpose:
        random = streams(
            0, 1, 2, 2**32, 2**64, 2**64 + 1, 2**65, 2**127, 2**128, 2**128 + 2**64, 2**200
        )
        everyone = np.arange(11)
        for _ in range(2):
            rows += list(random.uniform(everyone, purpose, 3000))
            random.start_episode(everyone)
    check_unrelated(rows, "uniform")
    assert 0 <= np.min(rows) < np.max(rows) < 1


def test_blocks_have_independent_normal_numbers():
    random = streams(5, 6)
    rows = []
    for purpose in Purpose:
        for block in (0, 1, 2, 300):
            numbers = random.normal_block(indices(0, 1), purpose, indices(block, block), 100)
            assert numbers.shape == (2, BLOCK, 100)
            rows += list(numbers.reshape(2, -1))
    check_unrelated(rows, "norm")


def test_streams_do_not_depend_on_what_was_read():
    fresh = streams(3, 4)
    disturbed = streams(3, 4)
    for purpose in Purpose:
        disturbed.uniform(indices(1, 0), purpose, 17)
        disturbed.normal_block(indices(0), purpose, indices(9), 3)
    for purpose in Purpose:
        expected = fresh.uniform(indices(0, 1), purpose, 5)
        for _ in range(2):
            assert_array_equal(disturbed.uniform(indices(0, 1), purpose, 5), expected)


def test_rows_depend_on_the_interval_only():
    random = streams(1, 2)
    everyone = indices(0, 1)

    def reader():
        rows = NormalRows(random, Purpose.SENSORS, 2, 3)
        rows.restart(everyone)
        return rows

    in_order = reader()
    expected = np.array([in_order.at(everyone, indices(step, step)) for step in range(5 * BLOCK)])
    assert len(np.unique(expected)) == expected.size
    jumping = reader()
    for one_index, two_index in ((100, 3), (0, 159), (33, 32)):
        rows = jumping.at(everyone, indices(one_index, two_index))
        assert_array_equal(rows, [expected[one_index, 0], expected[two_index, 1]])
        assert_array_equal(jumping.at(indices(1), indices(two_index)), [expected[two_index, 1]])
    random.start_episode(indices(0))
    jumping.restart(indices(0))
    rows = jumping.at(everyone, indices(33, 32))
    assert not np.any(rows[0] == expected[33, 0])
    assert_array_equal(rows[1], expected[32, 1])


# --- environments -------------------------------------------------------------------------------------------------


def draws_of(env_id, seed=5, steps=(1,), **keywords):
    """Draws of four episodes of given lengths, by name."""
    widths = [0.001] * ROBOTS[env_id].coordinates
    env = make(env_id, payload_range=(0.5, 2.0), initial_error_range=widths, **keywords)
    rows = {"payload": [], "error": [], "mass": [], "wrench": [], "sensors": []}
    for episode in range(4):
        observation, _ = env.reset(seed=seed if episode == 0 else None)
        rows["payload"].append(env.task.model_payload)
        rows["error"].append(env.pose - env.settings.trajectory(0.0).position)
        rows["mass"].append(env.truth["platform_mass"])
        rows["sensors"].append(env.layout.split(observation)["pose"] - env.pose)
        for step in range(steps[episode % len(steps)]):
            env.step(np.full(env.action_space.shape, 0.4))
            if step == 0:
                rows["wrench"].append(wrenches(env)[0, : ROBOTS[env_id].dimensions])
    return {name: np.array(values) for name, values in rows.items()}


@two_ids
def test_draws_do_not_depend_on_the_other_uncertainties(env_id):
    other_draws = MASS | {
        name: ParameterDistribution(low=-0.1, high=0.1) for name in ("motor_strength", "payload")
    }
    fields_of = {
        "mass": {"parameters": MASS},
        "wrench": {"wrench": FORCES},
        "sensors": {"sensors": NOISE},
    }
    everything = Uncertainty(parameters=other_draws, wrench=FORCES, sensors=NOISE, delay=2)
    together = draws_of(env_id, uncertainty=everything)
    nominal = draws_of(env_id)
    assert len(np.unique(nominal["payload"])) == 4
    for source, fields in fields_of.items():
        draws = draws_of(env_id, uncertainty=Uncertainty(**fields))
        for name in ("payload", "error"):
            assert_array_equal(draws[name], nominal[name], err_msg=source)
            assert_array_equal(together[name], nominal[name])
        assert [name for name in fields_of if np.ptp(draws[name])] == [source]
        assert_allclose(draws[source], together[source], rtol=0, atol=1e-15)


@two_ids
def test_draws_do_not_depend_on_the_length_of_the_last_episode(env_id):
    uncertainty = Uncertainty(parameters=MASS, wrench=FORCES, sensors=NOISE, delay=1)
    short = draws_of(env_id, uncertainty=uncertainty)
    long = draws_of(env_id, uncertainty=uncertainty, steps=(40, 3, 170, 1))
    for name, values in short.items():
        assert_array_equal(values, long[name], err_msg=name)
        assert len(np.unique(values)) >= 4


@pytest.mark.parametrize("seed", [0, 2**64 + 5, 2**200 + 1])
def test_seed_determines_all_draws(seed):
    uncertainty = Uncertainty(parameters=MASS, wrench=FORCES)
    draws = draws_of(PLANAR, seed=seed, uncertainty=uncertainty)
    again = draws_of(PLANAR, seed=seed, uncertainty=uncertainty)
    for near in (seed + 1, seed + 2**64, seed + 2**128):
        other_draws = draws_of(PLANAR, seed=near, uncertainty=uncertainty)
        for name in ("payload", "mass", "wrench"):
            assert_array_equal(draws[name], again[name])
            assert not np.any(draws[name] == other_draws[name])


def noise_and_parameters(env, **reset):
    """Of two episodes: white noise and force, and apart mass, factor, bias and delay."""
    noises = []
    parameters = []
    for options in (reset, {}):
        env.reset(**options)
        disturbances = env._simulation._disturbances
        white = np.round(disturbances.noise - disturbances._bias, 12)[:, :2]
        env.step(np.zeros((3, 3)))
        force = wrenches(env)[:, :2] / disturbances._factor[:, :2]
        noises.append([white, force])
        fixed = (
            env.truth["platform_mass"],
            disturbances._factor,
            disturbances._bias,
            disturbances._delay,
        )
        parameters.append([value.copy() for value in fixed])
    return noises, parameters


@pytest.mark.parametrize("noise_seed", [7, [9, 5, 7]])
def test_noise_seed_changes_the_noise_and_not_the_parameters(noise_seed):
    """Wrench and white noise follow it until the next seed; masses, factors, biases and delays
    follow the seed."""
    wrench = ExternalWrench(force_std=1.0, factor=(0.5, 2.0))
    uncertainty = Uncertainty(
        parameters=MASS,
        wrench=wrench,
        sensors=NOISE,
        sensor_bias=NOISE,
        delay=(0, 9),
    )
    env = make_vector(PLANAR, 3, uncertainty=uncertainty)
    noises, parameters = noise_and_parameters(env, seed=1)
    other_noises, same_parameters = noise_and_parameters(
        env, seed=1, options={"noise_seed": noise_seed}
    )
    assert not np.any(np.array(noises) == np.array(other_noises))
    white = np.array(other_noises)[:, 0]
    assert len(np.unique(white)) == white.size
    for episode, same in zip(parameters, same_parameters, strict=True):
        for value, expected in zip(episode, same, strict=True):
            assert_array_equal(value, expected)
    assert_array_equal(noise_and_parameters(env, seed=1)[0], noises)


@pytest.mark.parametrize("bad", [-1, 0.5, [1, 2], "seed"])
def test_impossible_noise_seed_raises_and_keeps_the_streams(bad):
    env, twin = (
        make(PLANAR, uncertainty=Uncertainty(parameters=MASS, sensors=NOISE)) for _ in range(2)
    )
    env.reset(seed=0)
    twin.reset(seed=0)
    with pytest.raises(ValueError, match="noise_seed must be"):
        env.reset(seed=1, options={"noise_seed": bad})
    assert_array_equal(env.reset()[0], twin.reset()[0])
    assert_array_equal(env.truth["platform_mass"], twin.truth["platform_mass"])


def test_noise_and_wrench_have_different_numbers():
    wrench = ExternalWrench(force_std=1.0, correlation_time=0.002)
    env = make(
        FLEX_SPATIAL,
        uncertainty=Uncertainty(sensors=SensorNoise(position=1.0), wrench=wrench),
    )
    env.reset(seed=0)
    noises = []
    forces = []
    for _ in range(BLOCK):
        noises.append(env._simulation._disturbances.noise[0].copy())
        env.step(np.full(env.action_space.shape, 0.4))
        forces.append(wrenches(env)[0, :3])
    noise = np.unique(np.round(noises, 12))
    assert len(noise) == 3 * BLOCK + 1, "and zeros"
    assert np.intersect1d(noise, np.round(forces, 12)).size == 0
