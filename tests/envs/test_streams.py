"""Seeded draws: which numbers are the same, which are new, and that none leans on another."""

from __future__ import annotations

import itertools
import random
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from scipy import stats

import cablebot_gym
from cablebot_gym.envs.streams import BLOCK, NormalRows, Purpose, Streams
from cablebot_gym.physics import kernel
from cablebot_gym.uncertainty import ExternalWrench, ParameterDistribution, SensorNoise, Uncertainty

each_id = pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)
MASS = {"platform_mass": ParameterDistribution(low=-0.2, high=0.2)}
FORCES = ExternalWrench(force_std=1.0)


def lanes(*trajectory_index):
    return np.array(trajectory_index, np.int64)


def streams(*seeds):
    """Streams of one lane for each seed, in their first episode."""
    made = Streams(len(seeds))
    made.seed(range(len(seeds)), seeds)
    made.start_episode(np.arange(len(seeds)))
    return made


def single(env_id="CableBot-Spatial-v0", **keywords) -> Any:
    return gym.make(env_id, **keywords).unwrapped


def batch(env_id, count, **keywords) -> Any:
    return gym.make_vec(env_id, num_envs=count, **keywords).unwrapped


def forces(env):
    """What pushes the platform now, (N, 3)."""
    plant = env._simulation._plant
    return plant._read(plant._parameters, kernel.FORCE, 3)


# ------------------------------------------------------------------------------------------------------- streams


def check_unrelated(rows):
    """Rows of many numbers: none equal, none correlated."""
    rows = np.array(rows)
    assert len(np.unique(rows)) == rows.size
    correlation = np.corrcoef(rows) - np.eye(len(rows))
    assert np.abs(correlation).max() < 6 / np.sqrt(rows.shape[1])


def test_other_seeds_episodes_and_purposes_give_unrelated_uniform_numbers():
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


def test_other_blocks_give_unrelated_normal_numbers():
    made, width, rows = streams(5, 6), 100, []
    for purpose in Purpose:
        for block in (0, 1, 2, 300):
            found = made.normal(lanes(0, 1), purpose, lanes(block, block), width)
            assert found.shape == (2, BLOCK, width)
            rows += list(found.reshape(2, -1))
    check_unrelated(rows)
    assert stats.kstest(np.concatenate(rows), "norm").pvalue > 0.01


def test_first_numbers_of_neighbouring_seeds_and_episodes_are_uniform_too():
    """Most draws of an environment are the first few numbers of a stream."""
    count = 4000
    made = streams(*range(count))
    seeds = made.uniform(np.arange(count), Purpose.PAYLOAD, 2)
    alone, episodes = streams(7), []
    for _ in range(count):
        episodes.append(alone.uniform(lanes(0), Purpose.PAYLOAD, 2)[0])
        alone.start_episode(lanes(0))
    for found in (seeds, np.array(episodes)):
        for column in found.T:
            assert stats.kstest(column, "uniform").pvalue > 0.01
            assert abs(np.corrcoef(column[1:], column[:-1])[0, 1]) < 5 / np.sqrt(count)
        assert abs(np.corrcoef(found.T)[0, 1]) < 5 / np.sqrt(count)


def test_reading_one_stream_moves_no_other():
    usual, disturbed = streams(3, 4), streams(3, 4)
    for purpose in Purpose:
        disturbed.uniform(lanes(1, 0), purpose, 17)
        disturbed.normal(lanes(0), purpose, lanes(9), 3)
    for purpose in Purpose:
        ours, theirs = (made.uniform(lanes(0, 1), purpose, 5) for made in (disturbed, usual))
        np.testing.assert_array_equal(ours, theirs)
        np.testing.assert_array_equal(disturbed.uniform(lanes(0, 1), purpose, 5), ours)  # read again, the same


def test_a_longer_read_begins_with_the_shorter_one():
    made = streams(3)
    short, long = (made.uniform(lanes(0), Purpose.PARAMETERS, size)[0] for size in (4, 9))
    np.testing.assert_array_equal(long[:4], short)


def test_lanes_of_one_seed_share_numbers_and_the_others_do_not():
    made = streams(8, 9, 8)
    found = made.uniform(lanes(0, 1, 2), Purpose.WRENCH, 6)
    np.testing.assert_array_equal(found[0], found[2])
    assert not np.any(found[0] == found[1])
    np.testing.assert_array_equal(made.uniform(lanes(2, 1), Purpose.WRENCH, 6), found[[2, 1]])
    made.start_episode(lanes(2))  # of the same seed, in another episode
    later = made.uniform(lanes(0, 1, 2), Purpose.WRENCH, 6)
    np.testing.assert_array_equal(later[:2], found[:2])
    assert not np.any(later[2] == found[0])
    blocks = made.normal(lanes(0, 0), Purpose.WRENCH, lanes(0, 1), 2)
    assert not np.any(blocks[0] == blocks[1])


def test_seeding_again_starts_again():
    made = streams(8)
    first = made.uniform(lanes(0), Purpose.START, 3)
    made.start_episode(lanes(0))
    made.seed([0], [8])
    made.start_episode(lanes(0))
    np.testing.assert_array_equal(made.uniform(lanes(0), Purpose.START, 3), first)


def test_restored_streams_stand_where_they_stood():
    made, twin = streams(8, 9), streams(8, 9)
    standing = made.state()
    made.seed([1], [99])
    made.start_episode(lanes(0, 1))
    made.restore(standing)
    for one in (made, twin):
        one.start_episode(lanes(0, 1))
    ours, theirs = (one.uniform(lanes(0, 1), Purpose.START, 3) for one in (made, twin))
    np.testing.assert_array_equal(ours, theirs)


def test_rows_are_new_in_every_interval_and_do_not_depend_on_what_was_read():
    made = streams(1, 2)
    reader = NormalRows(made, Purpose.SENSORS, 2, 3)
    reader.restart(lanes(0, 1))
    count = 5 * BLOCK
    found = np.array([reader.at(lanes(0, 1), lanes(step, step)) for step in range(count)])
    assert len(np.unique(found)) == found.size
    late = NormalRows(made, Purpose.SENSORS, 2, 3)
    late.restart(lanes(0, 1))
    for first, second in ((100, 3), (0, 159), (33, 32)):  # backwards, forwards, and each lane at its own
        np.testing.assert_array_equal(late.at(lanes(0, 1), lanes(first, second)), [found[first, 0], found[second, 1]])
        np.testing.assert_array_equal(late.at(lanes(1), lanes(second)), [found[second, 1]])
    # Another episode has other rows; the lane that goes on keeps its own, even from a block that was read before.
    made.start_episode(lanes(0))
    late.restart(lanes(0))
    again = late.at(lanes(0, 1), lanes(33, 32))
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
def test_no_draw_depends_on_what_else_is_uncertain(env_id):
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
    """The noise itself: the noisy observation less that of an episode whose sensors alone are exact."""
    exact = {"parameters": uncertainty.parameters, "wrench": uncertainty.wrench, "delay": uncertainty.delay}
    found = []
    for form in (uncertainty, Uncertainty(**exact)):
        env = single(env_id, uncertainty=form)
        observations = [env.reset(seed=2)[0]]
        observations += [env.step(np.full(env.action_space.shape, 0.4))[0] for _ in range(steps)]
        found.append(np.array(observations))
    return found[0] - found[1]


@each_id
def test_noise_does_not_depend_on_the_wrench_nor_on_parameters(env_id):
    noise = SensorNoise(position=1e-3, velocity=1e-2)
    alone = noise_of(env_id, Uncertainty(sensors=noise))
    among = noise_of(env_id, Uncertainty(sensors=noise, parameters=MASS, wrench=FORCES, delay=2))
    np.testing.assert_allclose(among, alone, atol=1e-13)
    assert alone.std() > 1e-4


@each_id
def test_another_uncertain_parameter_does_not_change_the_truth_of_the_first(env_id):
    more = MASS | {
        "motor_strength": ParameterDistribution(low=-0.1, high=0.1),
        "pulley_inertia": ParameterDistribution(low=-0.1, high=0.1),
    }
    found = []
    for parameters in (MASS, more, dict(reversed(more.items()))):
        env = single(env_id, uncertainty=Uncertainty(parameters=parameters))
        env.reset(seed=1)
        found.append(env.truth["platform_mass"])
        env.reset()
        found.append(env.truth["platform_mass"])
    assert found[0] != found[1]
    assert found[0::2] == [found[0]] * 3
    assert found[1::2] == [found[1]] * 3


@each_id
def test_an_episodes_draws_do_not_depend_on_the_length_of_the_one_before(env_id):
    form = Uncertainty(parameters=MASS, wrench=FORCES, sensors=SensorNoise(position=1e-3), delay=1)
    short, long = (drawn(env_id, uncertainty=form, steps=steps) for steps in ((1,), (40, 3, 170, 1)))
    for one, other in zip(short, long, strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(np.unique(short[2])) == 4
    assert len(np.unique(short[3])) == 4 * (2 if "Planar" in env_id else 3) + ("Planar" in env_id)  # and z: zero


@each_id
@pytest.mark.parametrize("seed", [0, 2**63, 2**64 + 5, 2**100, 2**200 + 1])
def test_a_seed_gives_the_same_numbers_again_and_another_gives_others(env_id, seed):
    form = Uncertainty(parameters=MASS, wrench=FORCES)
    first, again = (drawn(env_id, seed=seed, uncertainty=form) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one, other)
    for near in (seed + 1, seed + 2**64, seed + 2**128):
        other = drawn(env_id, seed=near, uncertainty=form)
        for place in (0, 2):
            assert not np.any(first[place] == other[place])
        assert not np.any((first[3] == other[3])[:, :2])


def test_lanes_of_one_seed_share_truth_wrench_and_noise():
    env = batch("CableBot-FlexSpatial-v0", 4, uncertainty="table6+sensors")
    observation, _ = env.reset(seed=[3, 4, 3, 3])
    for _ in range(40):
        np.testing.assert_array_equal(observation[[0, 0]], observation[[2, 3]])
        assert np.all(observation[0, :24] != observation[1, :24])
        observation = env.step(np.full((4, 6), 0.6))[0]
        np.testing.assert_array_equal(forces(env)[[0, 0]], forces(env)[[2, 3]])
        assert not np.any(forces(env)[0] == forces(env)[1])
    assert len(set(env.truth["platform_mass"])) == 2


def test_numpy_integers_are_seeds_too():
    for found, expected in (
        (batch("CableBot-Planar-v0", 2, uncertainty="table6"), [3, 9]),
        (batch("CableBot-Planar-v0", 2, uncertainty="table6"), np.array([3, 9])),
        (batch("CableBot-Planar-v0", 2, uncertainty="table6"), [np.uint64(3), np.int32(9)]),
    ):
        found.reset(seed=expected)
        usual = single("CableBot-Planar-v0", uncertainty="table6")
        for lane, seed in enumerate((3, np.int64(9))):
            usual.reset(seed=seed)
            assert found.truth["platform_mass"][lane] == usual.truth["platform_mass"]


def test_noise_of_a_long_episode_never_repeats():
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


def test_the_wrench_of_a_long_episode_never_repeats():
    wrench = ExternalWrench(force_std=1.0, correlation_time=0.002)
    env = batch("CableBot-Planar-v0", 2, uncertainty=Uncertainty(wrench=wrench))
    env.reset(seed=0)
    found = []
    for _ in range(450):
        env._simulation.step(np.full((2, 3), 0.2))
        found.append(forces(env)[:, :2])
    found = np.array(found)
    assert len(np.unique(found)) == found.size
    for lag in (1, BLOCK - 1, BLOCK, 2 * BLOCK):
        assert abs(np.mean(found[lag:] * found[:-lag])) < 5 / np.sqrt(found[lag:].size), lag


@each_id
@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
def test_an_autoreset_goes_on_with_the_next_episodes_draws(env_id, mode):
    """Episode k of a lane after autoresets is episode k after resets by hand."""
    keywords = {"uncertainty": "table6+sensors", "payload_range": (0.0, 1.0)}
    env = batch(env_id, 3, max_episode_steps=4, autoreset_mode=mode, **keywords)
    observation, info = env.reset(seed=4)
    starts, done = [(observation, info["payload"], env.truth["platform_mass"])], np.zeros(3, bool)
    while len(starts) < 5:
        if mode is AutoresetMode.DISABLED and done.all():
            observation, info = env.reset(options={"reset_mask": done})
            done[:] = False
        else:
            observation, _, terminated, truncated, info = env.step(np.full(env.action_space.shape, 0.4))
            done = terminated | truncated
        if not info["time"].any():
            starts.append((observation, info["payload"], env.truth["platform_mass"]))
    for lane in range(3):
        alone = single(env_id, **keywords)
        for number, (observation, payload, mass) in enumerate(starts):
            expected, info = alone.reset(seed=4 + lane if number == 0 else None)
            np.testing.assert_array_equal(observation[lane], expected)
            assert payload[lane] == info["payload"]
            assert mass[lane] == alone.truth["platform_mass"]
    assert len(np.unique([mass for _, _, mass in starts])) == 15
    assert len(np.unique([observation[:, 0] for observation, _, _ in starts])) == 15


def test_global_random_state_is_neither_read_nor_touched_by_uncertainty():
    def run():
        env = batch("CableBot-FlexSpatial-v0", 3, uncertainty="table6+sensors", max_episode_steps=5)
        observations = [env.reset(seed=0)[0]]
        return np.array(observations + [env.step(np.full((3, 6), 0.5))[0] for _ in range(40)])

    np.random.seed(0)  # noqa: NPY002 - the global generator is what the test is about
    random.seed(0)
    before, plain = np.random.get_state(), random.getstate()  # noqa: NPY002
    first = run()
    after = np.random.get_state()  # noqa: NPY002
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))
    assert random.getstate() == plain
    np.random.seed(1)  # noqa: NPY002
    np.testing.assert_array_equal(run(), first)


def test_two_environments_do_not_read_each_others_numbers():
    def rows(disturb):
        env, other = (single("CableBot-Planar-v0", uncertainty="table6+sensors") for _ in range(2))
        other.reset(seed=77)
        found = [env.reset(seed=0)[0]]
        for number, _ in itertools.product(range(9), range(9)):
            if disturb:
                other.step(np.full(3, 0.1 * number))
            found.append(env.step(np.full(3, 0.2))[0])
        return np.array(found)

    np.testing.assert_array_equal(rows(True), rows(False))


@each_id
def test_noise_and_wrench_are_not_the_same_numbers(env_id):
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
