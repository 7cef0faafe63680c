"""Errors and warnings of the environments, also about trajectories of the user."""

import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from oracles.episodes import (
    FLEX_PLANAR,
    FLEX_SPATIAL,
    PLANAR,
    ROBOTS,
    check_equal,
    make,
    make_vector,
)

from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.motions import ORDERS, Reference, SmoothCircle

STIFF = {"parameters": {"stiffness": {"low": 0.0, "high": 8000.0}}}
MASS_ONLY = {"parameters": {"platform_mass": {"low": 0.1, "high": 0.2}}}

KEYWORDS = [
    ({"reward_weights": {"energy": 1.0}}, "energy"),
    ({"observation_dtype": "float16"}, "float64, float32"),
    ({"payload": 1.0, "payload_range": (0.0, 2.0)}, "exclude each other"),
    ({"error_bounds": {"position": 10}}, r"at most 1\.32 m, .* a bound of 10 mm is 0\.01"),
    ({"normalised_observation": 1}, "must be True or False"),
    ({"robot": ROBOTS["CableBot-FlexPlanar-v0"]}, "use CableBot-FlexPlanar-v0"),
    ({"trajectory": {"name": "dwell-planar", "duration": 1e4}}, r"at most 1000 s"),
    ({"control_frequency": 5e6}, "more than 1,000,000"),
    ({"measurement": "winches+gps"}, "unknown sensor 'gps'"),
    ({"measurement": "winches+imu"}, "no platform with three angles"),
    ({"measurement": {"tensions": True}}, "belong to the kind 'winches'"),
    ({"measurement": {"kind": "winches", "encoder_resolution": -1.0}}, "at least 0 rad"),
]
VECTOR_KEYWORDS = [
    ({"max_episode_steps": 0}, "max_episode_steps"),
    ({"autoreset_mode": "never"}, "NextStep, SameStep, Disabled"),
    ({"render_mode": "human"}, "render_mode"),
    ({"num_envs": 3, "payload": [1.0, 2.0]}, "payload"),
]


@pytest.mark.parametrize(
    ("construct", "keywords", "words"),
    [*((gym.make, *row) for row in KEYWORDS), *((gym.make_vec, *row) for row in VECTOR_KEYWORDS)],
)
def test_bad_keyword_raises(construct, keywords, words):
    with pytest.raises((TypeError, ValueError), match=words):
        construct(PLANAR, **keywords).reset()


def test_class_without_id_takes_any_robot():
    CableBotEnv(robot="spatial").reset(seed=0)


@pytest.mark.parametrize("construct", [gym.make, gym.make_vec])
def test_unknown_keyword_raises_type_error(construct):
    """TorchRL tries ``frameskip`` first, and looks for Python's own words."""
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
        construct(PLANAR, frameskip=1)


@pytest.mark.parametrize(
    ("count", "reset", "words"),
    [
        (None, {"options": {"paylaod": 1.0}}, "paylaod"),
        (None, {"options": {"uncertainty": STIFF}}, "substeps"),
        # no tensions hold it
        (
            None,
            {"options": {"uncertainty": "table6", "initial_error": [0, 0, -0.1, 0, 0, 0]}},
            "start pose",
        ),
        (3, {"options": {"uncertainty": ["table6"] * 2}}, "uncertainty"),
        (3, {"options": {"noise_seed": [1, 2]}}, "noise_seed must be"),
        (3, {"options": {"reset_mask": np.array([1, 0, 1])}}, "reset_mask"),
        (3, {"seed": [1, -2, 3]}, "seed"),
    ],
)
def test_bad_reset_raises_and_leaves_the_episode(count, reset, words):
    """Truth, task, seed, wrench, delay, noise and random streams. A bad action leaves it, too."""
    keywords = {
        "uncertainty": MASS_ONLY | {"delay": 2},
        "trajectory": "dwell-spatial",
        "payload_range": (0.0, 2.0),
        "initial_error_range": [1e-3] * 6,
    }
    env, twin = (
        make_vector(FLEX_SPATIAL, count, **keywords) if count else make(FLEX_SPATIAL, **keywords)
        for _ in range(2)
    )
    start = {"seed": 0, "options": {"uncertainty": "table6+sensors"}}
    check_equal(env.reset(**start), twin.reset(**start))
    for step in range(6):
        if step in (0, 5):
            with pytest.raises(ValueError, match=words):
                env.reset(**{"seed": 99} | reset)
            check_equal(env.truth, twin.truth)
            assert env.np_random_seed == twin.np_random_seed
        action = np.full(env.action_space.shape, 0.5 + 0.01 * step)
        for bad in (action[..., 1:], action * np.nan, action * 1e308):
            with pytest.raises(ValueError, match="action"):
                env.step(bad)
        check_equal(env.step(action), twin.step(action))
    check_equal(env.reset(), twin.reset())


def test_calls_before_a_reset_raise():
    """Also after a reset that failed, and with a mask."""
    painted = {"render_mode": "rgb_array"}
    envs = make_vector(PLANAR, 3, **painted)
    with pytest.raises(ResetNeeded, match="reset_mask"):
        envs.reset(options={"reset_mask": np.array([True, False, False])})
    env = make(PLANAR, **painted)
    with pytest.raises(ValueError, match="paylaod"):
        env.reset(options={"paylaod": 1.0})
    for each in (env, envs):
        with pytest.raises(ResetNeeded, match=r"reset\(\) before step"):
            each.step(np.zeros(each.action_space.shape))
        with pytest.raises(ResetNeeded, match=r"reset\(\) before render"):
            each.render()


class Altered:
    """A circle, altered by ``change`` of the times and the arrays by name."""

    name = "altered"
    duration = 1.0
    coordinates = 2

    def __init__(self, change):
        self._circle = SmoothCircle(radius=0.2165, center=(0.0, 0.0), duration=self.duration)
        self._change = change

    def __call__(self, times):
        times = np.asarray(times, float)
        arrays = {name: np.array(getattr(self._circle(times), name)) for name in ORDERS}
        self._change(times, arrays)
        return Reference(**arrays)


def warnings_of(change, env_id):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        make(env_id, trajectory=Altered(change)).reset()
    texts = [str(warning.message) for warning in caught]
    return [text for text in texts if "trajectory 'altered'" in text]


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_wrong_derivative_warns_where_it_is_used(order):
    """Rigid robots do not use jerk and snap."""

    def doubled(times, arrays):
        arrays[ORDERS[order]] *= 2.0

    wrong = f"the {ORDERS[order]} of trajectory 'altered' is not the time derivative of its {ORDERS[order - 1]}, "
    assert warnings_of(doubled, FLEX_PLANAR)[0].startswith(f"{wrong}first at 0")
    assert bool(warnings_of(doubled, PLANAR)) == (order < 3)


def test_motion_after_the_duration_warns():
    def continued(times, arrays):
        arrays["position"][..., 0] += 0.05 * times
        arrays["velocity"][..., 0] += 0.05

    assert "still moves after its duration" in " ".join(warnings_of(continued, PLANAR))


@pytest.mark.parametrize(
    ("order", "time", "message"),
    [
        ("acceleration", 0.25, "its acceleration at 0.25 s is not finite"),
        ("position", 1.1, "not finite after its duration"),
    ],
)
def test_values_that_are_not_finite_raise(order, time, message):
    def spoilt(times, arrays):
        arrays[order][times >= time - 1e-9, 1] = np.nan

    with pytest.raises(ValueError, match=message):
        make(PLANAR, trajectory=Altered(spoilt)).reset()
