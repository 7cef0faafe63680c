"""Random streams: seeds determine all draws, and draws of different purposes are independent."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import PLANAR, check_equal, make, wrenches
from scipy import stats

from cablebot_gym.envs.streams import BLOCK, NormalRows, Purpose, Streams
from cablebot_gym.uncertainty import ExternalWrench, ParameterDistribution, SensorNoise, Uncertainty


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
    seeds = (0, 1, 2**32, 2**64, 2**64 + 1, 2**128, 2**128 + 2**64)
    everyone = np.arange(len(seeds))
    uniform = []
    normal = []
    for purpose in Purpose:
        random = streams(*seeds)
        for _ in range(2):
            uniform += list(random.uniform(everyone, purpose, 1600))
            for block in (0, 1, 300):
                blocks = np.full(len(seeds), block)
                numbers = random.normal(everyone, purpose, blocks, (32, 50))
                assert numbers.shape == (len(seeds), BLOCK, 50)
                normal += list(numbers.reshape(len(seeds), -1))
            random.start_episode(everyone)
    check_unrelated(uniform, "uniform")
    check_unrelated(normal, "norm")
    assert 0 <= np.min(uniform) < np.max(uniform) < 1


def test_rows_depend_on_the_interval_only():
    random = streams(1, 2)
    everyone = indices(0, 1)
    in_order, jumping = (NormalRows(random, Purpose.SENSORS, 2, 3) for _ in range(2))
    in_order.restart(everyone)
    jumping.restart(everyone)
    expected = np.array([in_order.at(everyone, indices(step, step)) for step in range(5 * BLOCK)])
    assert len(np.unique(expected)) == expected.size
    for steps in (indices(100, 3), indices(0, 159), indices(33, 32)):
        assert_array_equal(jumping.at(everyone, steps), expected[steps, everyone])
    random.start_episode(indices(0))
    jumping.restart(indices(0))
    rows = jumping.at(everyone, indices(33, 32))
    assert not np.any(rows[0] == expected[33, 0])
    assert_array_equal(rows[1], expected[32, 1])


# --- environments -------------------------------------------------------------------------------------------------


FIELDS = {
    "mass": {"parameters": {"platform_mass": ParameterDistribution(low=-0.2, high=0.2)}},
    "wrench": {"wrench": ExternalWrench(force_std=1.0, factor=(0.5, 2.0))},
    "sensors": {"sensors": SensorNoise(position=1e-3)},
    "bias": {"sensor_bias": SensorNoise(position=1e-3)},
    "delay": {"delay": (0, 9)},
}
"""Fields of an uncertainty by the draw that they make random."""
EVERYTHING = {field: value for fields in FIELDS.values() for field, value in fields.items()}


def make_uncertain(fields):
    ranges = {"payload_range": (0.5, 2.0), "initial_error_range": [0.001] * 2}
    return make(PLANAR, uncertainty=Uncertainty(**fields), **ranges)


def draws_of(env, **options):
    """Draws of four episodes of one step, by name; the options are those of the first."""
    rows = []
    for reset in ({"seed": 5, "options": options}, {}, {}, {}):
        env.reset(**reset)
        disturbances = env._simulation._disturbances
        bias = disturbances._bias[0, :2].copy()
        draws = {
            "payload": env.task.model_payload,
            "error": env.pose - env.settings.trajectory(0.0).position,
            "mass": env.truth["platform_mass"],
            "bias": bias,
            "sensors": disturbances.noise[0, :2] - bias,
            "delay": disturbances._delay[0],
            "factor": disturbances._factor[0].copy(),
        }
        env.step(np.full(3, 0.4))
        rows.append(draws | {"wrench": wrenches(env)[0, :2]})
    return {name: np.array([draws[name] for draws in rows]) for name in rows[0]}


def test_draws_do_not_depend_on_the_other_uncertainties():
    together = draws_of(make_uncertain(EVERYTHING))
    for name, values in together.items():
        assert len(np.unique(values)) >= 3, name
    for source, fields in FIELDS.items():
        draws = draws_of(make_uncertain(fields))
        for name in ("payload", "error", source):
            assert_allclose(draws[name], together[name], rtol=0, atol=1e-15, err_msg=source)
        assert [name for name in FIELDS if np.diff(draws[name], axis=0).any()] == [source]


def test_noise_seed_changes_the_noise_and_not_the_parameters():
    """Wrench and white noise follow it until the next seed; masses, factors, biases and delays
    follow the seed."""
    env = make_uncertain(EVERYTHING)
    draws = draws_of(env)
    others = draws_of(env, noise_seed=7)
    for name, values in draws.items():
        if name in ("wrench", "sensors"):
            assert not np.any(values == others[name])
        else:
            assert_array_equal(values, others[name])
    check_equal(draws_of(env), draws)
