"""The payload over draws against order statistics, single episodes and Clopper and Pearson's
bound."""

import math
from collections import Counter
from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from evaluation.conftest import play, verdict_of
from scipy.stats import binom, binomtest

from cablebot_baselines.laws import FeedbackLinearization
from cablebot_gym.evaluation import DLCCMonitor, Violation, evaluate_dlcc
from cablebot_gym.evaluation import batch as batch_module
from cablebot_gym.evaluation.batch import Trial, noise_seed
from cablebot_gym.evaluation.statistics import fewest_draws, plausible_successes, required_successes
from cablebot_gym.robots import SPATIAL

SPATIAL_ID = "CableBot-Spatial-v0"
GRAVITY = 9.81


def draw_seeds(seed, draws):
    """The seeds of the draws, as documented: from the evaluation's seed alone."""
    words = np.random.SeedSequence(seed).generate_state(draws, np.uint64)
    return [int(word) >> 11 for word in words]


# --- by hand: a constant pull -----------------------------------------------------------------------------------------

PULL = 12.0
"""Mass that the constant action holds at rest [kg]; the empty platform rises, a heavy one sinks."""
LONG = 0.02
"""Duration of the motion [s]."""
STILL = {"trajectory": {"name": "dwell-spatial", "duration": LONG}, "initial_error": 0.0}
SINKING = 4.0
"""Acceleration at which the bound is reached when the motion ends [m/s²]."""
BOUNDS = {"position": SINKING * LONG**2 / 2, "rotation": 1.0}
COSINE = 0.1 / math.hypot(0.47, -0.47 / math.sqrt(3) + 2 * 0.148 / math.sqrt(3), 0.1)
"""Of the angle between each cable and the vertical in the symmetric pose."""
RADIUS = 0.05


class Constant:
    """The constant action that holds ``PULL`` with the nominal motors."""

    action = PULL * GRAVITY / 6 / COSINE * RADIUS / 10.0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((*observation.shape[:-1], 6), self.action), state


def pulled(uncertainty, **keywords):
    """The evaluation of the constant pull."""
    conditions = STILL | {"error_bounds": BOUNDS, "resolution": 1e-4} | keywords
    return evaluate_dlcc(Constant(), SPATIAL_ID, uncertainty=uncertainty, **conditions)


@cache
def nominal_capacity():
    """Payload that the constant pull keeps within the bound, nominal robot [kg]."""
    return pulled(None, resolution=1e-7).payload


def true_masses(uncertainty, seed, draws):
    """Platform mass of each draw, as the single environment draws it."""
    env = gym.make(SPATIAL_ID, uncertainty=uncertainty)
    masses = []
    for draw_seed in draw_seeds(seed, draws):
        env.reset(seed=draw_seed)
        masses.append(env.unwrapped.truth["platform_mass"])
    env.close()
    return np.array(masses)


@pytest.mark.parametrize(("draws", "probability", "required"), [(20, 0.95, 19), (80, 0.6, 56)])
def test_payload_is_an_order_statistic_of_the_draws(draws, probability, required):
    """With 20 draws the fraction counts, with 80 the 95/95 lower tolerance bound."""
    unknown = {"parameters": {"platform_mass": {"low": -0.1, "high": 0.1}}}
    # Only the sum of platform and payload counts.
    capacities = nominal_capacity() + 10 - true_masses(unknown, 3, draws)
    assert np.ptp(capacities) > 1.0
    result = pulled(unknown, draws=draws, seed=3, probability=probability)
    expected = np.sort(capacities)[-required]
    assert result.payload - 1e-6 <= expected <= result.failed_payload + 1e-6
    assert 0 < result.resolution <= 1e-4
    assert list(result.draw_seeds) == draw_seeds(3, draws)
    assert result.assured == (draws == 80)
    assert sum(result.details.failures.values()) == draws - required + 1


def exact_low(carried, draws, confidence):
    """Lower end of Clopper and Pearson's one-sided interval of a success rate."""
    test = binomtest(carried, draws, alternative="greater")
    return test.proportion_ci(confidence, method="exact").low


@pytest.mark.parametrize("draws", [1, 58, 59, 512])
@pytest.mark.parametrize(("probability", "confidence"), [(0.5, 0.8), (0.95, 0.95)])
def test_required_successes_agree_with_scipys_interval(draws, probability, confidence):
    required, is_assured = required_successes(draws, probability, confidence)
    assert is_assured == (draws >= fewest_draws(probability, confidence))
    assert is_assured == (exact_low(draws, draws, confidence) >= probability)
    if is_assured:
        assert exact_low(required, draws, confidence) >= probability
        assert exact_low(required - 1, draws, confidence) < probability
    else:
        assert required == math.ceil(draws * probability - 1e-9)
    # 0.95 · 20 is 19 to the last bit or just above.
    assert required_successes(20, 0.95, 0.95) == (19, False)


@pytest.mark.parametrize("draws", [2, 512])
def test_plausible_successes_agree_with_scipy(draws):
    required, _ = required_successes(draws, 0.95, 0.95)
    low = exact_low(required, draws, 1 - 1e-4)
    assert plausible_successes(required, draws, 12, 1e-4) == binom.ppf(1e-4, 12, low)
    assert plausible_successes(0, draws, 12, 1e-4) == 0


# --- single episodes --------------------------------------------------------------------------------------------------

SHORT = {"name": "dwell-spatial", "duration": 0.2}
BOUND = 0.003
UNKNOWN = {
    "parameters": {
        "payload": {"low": -0.2, "high": 0.2},
        "motor_strength": {"low": -0.03, "high": 0.03},
    },
    "wrench": {"force_mean": 0.5, "force_std": 0.5},
    "sensors": {"position": 1e-4},
    "delay": 1,
}


CONDITIONS = {"trajectory": SHORT, "uncertainty": UNKNOWN, "error_bounds": {"position": BOUND}}


@cache
def searched():
    """FL on a short hang, six draws of which five have to carry the payload."""
    options = {"draws": 6, "seed": 5, "probability": 0.6, "confidence": 0.6}
    options |= {"payload_max": 8.0, "resolution": 0.05}
    return evaluate_dlcc(FeedbackLinearization(SPATIAL), SPATIAL_ID, **CONDITIONS, **options)


def verdicts(payload):
    """Verdicts of the six draws, each in its own single environment."""
    policy = FeedbackLinearization(SPATIAL)
    verdicts_of_draws = []
    for seed in draw_seeds(5, 6):
        env = DLCCMonitor(gym.make(SPATIAL_ID, payload=payload, **CONDITIONS))
        verdicts_of_draws.append(play(env, policy, {"noise_seed": noise_seed(seed, payload)}, seed))
        env.close()
    return verdicts_of_draws


@pytest.mark.landing
def test_failures_are_those_of_single_episodes():
    result = searched()
    assert max(result.draw_seeds) < 2**53, "every JSON parser reads them exactly"
    assert noise_seed(1, 0.0) != noise_seed(1, 1.0)
    required, _ = required_successes(6, 0.6, 0.6)
    assert 0 < result.payload < 8
    above = verdicts(result.failed_payload)
    assert sum(verdict.carried for verdict in verdicts(result.payload)) >= required
    assert sum(verdict.carried for verdict in above) < required
    violations = [verdict.violation for verdict in above if verdict.violation]
    assert result.details.failures == Counter(violation.kind for violation in violations)
    draw = result.draw_seeds.index(result.details.violation_seed)
    assert above[draw].violation.time == result.violation.time


@pytest.mark.landing
def test_margins_are_those_of_the_tightest_single_episodes():
    result = searched()
    carried = [verdict for verdict in verdicts(result.payload) if verdict.carried]
    recorded = np.abs(result.rollout.arrays["commanded_action"]).max()
    assert recorded == pytest.approx(max(carried[0].peak_action), abs=1e-9)
    expected = {
        "position": 1 - max(verdict.position_peak for verdict in carried) / BOUND,
        "rotation": 1 - max(verdict.rotation_peak for verdict in carried) / 0.01,
        "torque": 1 - max(max(verdict.peak_action) for verdict in carried),
        "tension": min(verdict.least_tension for verdict in carried),
    }
    assert result.details.margins == pytest.approx(expected, abs=1e-9)


def test_limiting_violation_is_the_most_frequent_kind():
    kinds = {0.1: "slack", 0.4: "position", 0.3: "position", 0.2: "rotation"}
    verdicts_of_draws = [verdict_of()]
    for time, kind in kinds.items():
        violation = Violation(kind=kind, index=None, time=time, excess=None)
        verdicts_of_draws.append(verdict_of(violation))
    trial = Trial(payload=1.0, verdicts=tuple(verdicts_of_draws), seeds=tuple(range(5)))
    assert trial.carried == 1
    assert next(iter(trial.failures.items())) == ("position", 2)
    assert trial.failures == {"position": 2, "slack": 1, "rotation": 1}
    assert (trial.violation.kind, trial.violation.time) == ("position", 0.3)


@pytest.mark.landing
def test_batch_size_does_not_change_the_result(monkeypatch):
    default = searched()
    monkeypatch.setattr(batch_module, "BATCH", 100)
    searched.cache_clear()
    bounded = searched()
    assert bounded.to_json() == default.to_json()
    for name, array in default.rollout.arrays.items():
        assert array.tobytes() == bounded.rollout.arrays[name].tobytes()
