"""Policies side by side: every number against single episodes, the intervals against SciPy's, and
the figure."""

import dataclasses
import json
import math
from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from cablebot_baselines.classical import FeedbackLinearization
from cablebot_gym.evaluation import DLCCMonitor, compare_policies
from cablebot_gym.evaluation.batch import draw_seeds, noise_seed
from cablebot_gym.evaluation.comparison import QUANTITIES, REDUCTION_QUANTITIES
from cablebot_gym.robots import SPATIAL

SPATIAL_ID = "CableBot-Spatial-v0"
PLANAR_ID = "CableBot-Planar-v0"
HANG = {"name": "dwell-spatial", "duration": 0.06}
MOVE = {"name": "line-spatial", "duration": 0.4, "dwell": 0.0}
UNKNOWN = {
    "parameters": {"platform_mass": {"low": -0.1, "high": 0.1}},
    "wrench": {"force_mean": 0.5, "force_std": 0.4},
    "sensors": {"position": 1e-4},
}


class Scaled(FeedbackLinearization):
    """FL whose actions are a little too large or too small."""

    def __init__(self, factor, robot=SPATIAL):
        super().__init__(robot)
        self.factor = factor

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, state = super().predict(observation, state)
        return self.factor * action, state


def limp(observation):
    return np.zeros(6)


class LetsGo(Scaled):
    """FL that returns zero actions in the episodes whose measured x is positive at the third
    step."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        action, _ = super().predict(observation)
        count, gone = (0, np.zeros(len(observation), bool)) if state is None else state
        if count == 2:
            gone = observation[:, 0] > 0
        return np.where(gone[:, None], 0.0, action), (count + 1, gone)


@cache
def compared():
    """Two policies over five draws."""
    return compare_policies(
        [Scaled(1.0), Scaled(0.9)],
        SPATIAL_ID,
        names=["plain", "weak"],
        payload=1.5,
        uncertainty=UNKNOWN,
        draws=5,
        seed=3,
        trajectory=MOVE,
        error_bounds={"position": 0.005},
    )


def episode(policy, seed, *, payload=1.5, trajectory=MOVE, uncertainty=UNKNOWN, position=0.005):
    """One episode in a single environment, summed up by hand."""
    keywords = {
        "trajectory": trajectory,
        "uncertainty": uncertainty,
        "error_bounds": {"position": position},
    }
    env = DLCCMonitor(gym.make(SPATIAL_ID, payload=payload, **keywords))
    observation, start = env.reset(seed=seed, options={"noise_seed": noise_seed(seed, payload)})
    infos = []
    state = None
    terminated = False
    while len(infos) < round(500 * trajectory["duration"]) and not terminated:
        action, state = policy.predict(observation[None], state=state)
        observation, _, terminated, _, info = env.step(action[0])
        infos.append(info)
    series = {name: np.array([info[name] for info in infos]) for name in infos[0]}
    carried = env.verdict.carried
    env.close()
    error = series["tracking_error"]
    steps = round(500 * trajectory["duration"])
    lost = max(error[-1], 0.1)  # after an early end
    lost_steps = steps - len(error)
    peak = max(start["tracking_error_peak"], series["tracking_error_peak"].max())
    return {
        "mean_error": (error.sum() + lost_steps * lost) / steps,
        "rms_error": math.sqrt(((error**2).sum() + lost_steps * lost**2) / steps),
        "max_error": max(peak, lost) if terminated else peak,
        "max_rotation": max(start["rotation_error_peak"], series["rotation_error_peak"].max()),
        "rms_torque": math.sqrt((series["torques"] ** 2).mean()),
        "peak_torque": np.abs(series["torques"]).max(),
        "torque_margin": 1 - np.abs(series["commanded_action"]).max(),
        "least_tension": series["least_tensions"].min(),
        "carried": carried,
        "ended": bool(terminated),
        "error": error,
        "rotation": series["rotation_error"],
    }


# --- numbers ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("index", "factor"), [(0, 1.0), (1, 0.9)])
def test_metrics_equal_those_of_single_episodes(index, factor):
    measured = compared().metrics[index]
    for draw, seed in enumerate(draw_seeds(3, 5)):
        by_hand = episode(Scaled(factor), seed)
        for name, value in by_hand.items():
            ours = getattr(measured, name)[..., draw]
            assert_allclose(ours, value, rtol=0, atol=1e-12, err_msg=name)
    assert np.all(np.ptp([getattr(measured, name) for name in QUANTITIES], axis=1) > 0)
    assert measured.carried.tolist() == (measured.max_error <= 0.005).tolist()
    assert set(QUANTITIES) == set(by_hand) - {"carried", "ended", "error", "rotation"}


def test_one_draw_is_the_episode_of_its_seed():
    comparison = compare_policies(
        [Scaled(1.0), Scaled(0.9)],
        SPATIAL_ID,
        names="ab",
        uncertainty=UNKNOWN,
        draws=1,
        seed=7,
        trajectory=HANG,
    )
    by_hand = episode(Scaled(1.0), 7, payload=0.0, trajectory=HANG, position=0.01)
    for name in QUANTITIES:
        estimate = comparison.metrics[0].estimate(name)
        assert estimate.mean == pytest.approx(by_hand[name], abs=1e-12)
        assert estimate.low == estimate.mean == estimate.high
    fraction = comparison.reduction(1, "mean_error")
    assert fraction.low == fraction.mean == fraction.high < 0


def test_error_counts_as_constant_after_an_early_termination():
    motion = {"name": "dwell-spatial", "duration": 0.3}
    keywords = {"uncertainty": "sensors", "draws": 6, "trajectory": motion, "seed": 2}
    comparison = compare_policies([LetsGo(1.0)], SPATIAL_ID, **keywords)
    (measured,) = comparison.metrics
    assert 0 < measured.ended.sum() < 6
    for draw, seed in enumerate(draw_seeds(2, 6)):
        by_hand = episode(
            LetsGo(1.0), seed, payload=0.0, trajectory=motion, uncertainty="sensors", position=0.01
        )
        for name in (*QUANTITIES, "carried", "ended"):
            assert getattr(measured, name)[draw] == pytest.approx(by_hand[name], abs=1e-12), name
        steps = len(by_hand["error"])
        assert np.isnan(measured.error[steps:, draw]).all()
        assert not np.isnan(measured.error[:steps, draw]).any()
    json.loads(comparison.to_json(), parse_constant=pytest.fail)


def test_comparison_ends_with_the_last_episode():
    progress = []
    comparison = compare_policies(
        [limp, Scaled(1.0)],
        SPATIAL_ID,
        names=["limp", "plain"],
        trajectory={"name": "dwell-spatial", "duration": 0.3},
        progress=lambda done, expected: progress.append((done, expected)),
    )
    fallen, carried = comparison.metrics
    assert fallen.ended.tolist() == [True]
    assert carried.ended.tolist() == [False]
    assert len(fallen.error) < 150 == len(carried.error)
    assert fallen.max_error[0] > 0.1
    assert np.nanmax(fallen.error) < 0.11, "not the next episode, which starts where this one did"
    done, expected = zip(*progress, strict=True)
    assert list(done) == sorted(done)
    assert set(expected) == {300}
    assert done[-1] == 300
    assert 150 in done, "skipped steps of the first policy count"


def test_error_after_a_slack_cable_is_the_radius():
    motion = {"name": "dwell-planar", "duration": 0.3}
    (measured,) = compare_policies([lambda _: np.zeros(3)], PLANAR_ID, trajectory=motion).metrics
    assert measured.ended[0]
    assert np.nanmax(measured.error) < 0.001
    lost_fraction = 1 - len(measured.error) / 150
    assert measured.mean_error[0] == pytest.approx(0.1 * lost_fraction, abs=0.001)
    assert measured.max_error[0] == 0.1


# --- intervals --------------------------------------------------------------------------------------------------------


def made(*mean_errors):
    """A comparison with given mean errors for each policy."""
    measured = []
    for index, errors in enumerate(mean_errors):
        metrics = compared().metrics[0]
        measured.append(
            dataclasses.replace(metrics, policy=f"p{index}", mean_error=np.array(errors, float))
        )
    return dataclasses.replace(
        compared(), metrics=tuple(measured), draw_seeds=tuple(range(len(mean_errors[0])))
    )


@pytest.mark.parametrize("quantity", ["mean_error", "least_tension"])
def test_interval_of_a_mean_is_students(quantity):
    values = getattr(compared().metrics[1], quantity)
    low, high = stats.t.interval(0.95, 4, loc=values.mean(), scale=stats.sem(values))
    estimate = compared().metrics[1].estimate(quantity)
    assert (estimate.mean, estimate.low, estimate.high) == pytest.approx(
        (values.mean(), low, high), rel=1e-12
    )
    assert estimate.low < estimate.mean < estimate.high


def test_reduction_compares_means_of_paired_draws():
    # (1, 3) and (1, 1): 1 − 2/4. The resamples give 0, 1/2 or 1 − 1/3.
    fraction = made((1, 3), (1, 1)).reduction(1, "mean_error")
    assert (fraction.mean, fraction.low, fraction.high) == pytest.approx((0.5, 0.0, 2 / 3))
    fraction = made((1, 2, 3, 10), (2, 4, 6, 20)).reduction(1, "mean_error")
    assert (fraction.mean, fraction.low, fraction.high) == pytest.approx((-1, -1, -1), abs=1e-12)
    comparison = made((2, 4), (1, 2), (0.5, 1))
    assert [comparison.reduction(index, "mean_error").mean for index in range(3)] == pytest.approx(
        [0, 0.5, 0.75]
    )


def test_interval_of_a_reduction_is_scipys_bootstrap():
    random = np.random.default_rng(0)
    base = random.uniform(1, 2, 40)
    comparison = made(base, base * random.uniform(0.3, 0.7, 40))
    fraction = comparison.reduction(1, "mean_error")
    assert fraction == comparison.reduction(1, "mean_error")
    samples = (comparison.metrics[0].mean_error, comparison.metrics[1].mean_error)
    reference = stats.bootstrap(
        samples,
        lambda base_sample, sample, axis: 1 - sample.mean(axis=axis) / base_sample.mean(axis=axis),
        paired=True,
        vectorized=True,
        method="percentile",
        confidence_level=0.95,
        n_resamples=20000,
        rng=np.random.default_rng(1),
    ).confidence_interval
    width = reference.high - reference.low
    assert fraction.low == pytest.approx(reference.low, abs=0.1 * width)
    assert fraction.high == pytest.approx(reference.high, abs=0.1 * width)


# --- output and errors ------------------------------------------------------------------------------------------------


def test_json_has_conditions_estimates_and_values_per_draw():
    comparison = compared()
    data = json.loads(comparison.to_json(), parse_constant=pytest.fail)
    assert data["uncertainty"] == "custom"
    assert data["draws"] == 5
    assert data["seed"] == 3
    assert data["draw_seeds"] == draw_seeds(3, 5)
    assert data["error_bounds"] == {"position": 0.005, "rotation": 0.01}
    for policy, measured in zip(data["policies"], comparison.metrics, strict=True):
        assert policy["estimates"]["rms_error"] == vars(measured.estimate("rms_error"))
        for name in (*QUANTITIES, "carried", "ended"):
            assert policy["per_draw"][name] == getattr(measured, name).tolist()
    plain, weak = data["policies"]
    assert plain["policy"] == "plain"
    assert weak["policy"] == "weak"
    assert plain["reductions"] == {}
    assert set(weak["reductions"]) == set(REDUCTION_QUANTITIES)
    assert weak["reductions"]["rms_error"] == vars(comparison.reduction(1, "rms_error"))


def test_figure_shows_draws_that_end_early():
    pytest.importorskip("matplotlib")
    from cablebot_gym.plotting.comparison import draw_comparison

    motion = {"name": "dwell-spatial", "duration": 0.3}
    keywords = {
        "names": "ab",
        "uncertainty": "sensors",
        "draws": 6,
        "seed": 2,
        "trajectory": motion,
    }
    comparison = compare_policies(
        [LetsGo(1.0), limp], SPATIAL_ID, error_bounds={"position": 0.005}, **keywords
    )
    lines = draw_comparison(comparison).axes[0].get_lines()
    bound = [line for line in lines if line.get_color() == "black"]
    long_line, short_line = [line for line in lines if line.get_color() != "black"]
    assert set(bound[0].get_ydata()) == {5.0}
    assert np.isfinite(long_line.get_ydata()).all()
    assert np.isfinite(short_line.get_ydata()).all()
    assert short_line.get_xdata()[-1] < 0.2 < long_line.get_xdata()[-1]
