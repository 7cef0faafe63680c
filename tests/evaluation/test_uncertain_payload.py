"""The payload over draws against single episodes, order statistics and Clopper and Pearson's bound."""

from __future__ import annotations

import json
import math
from functools import cache

import gymnasium as gym
import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import binomtest

from cablebot_baselines.classical import FeedbackLinearization
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.evaluation import DLCCMonitor, PolicyError, Verdict, Violation, evaluate_dlcc
from cablebot_gym.evaluation import batch as batch_module
from cablebot_gym.evaluation.batch import DEFAULT_DRAWS, Trial
from cablebot_gym.evaluation.evaluator import DRAWN_RESOLUTION, SCAN_POINTS
from cablebot_gym.evaluation.statistics import RequiredDraws
from cablebot_gym.robots import SPATIAL
from cablebot_gym.uncertainty import find_uncertainty

SPATIAL_ID = "CableBot-Spatial-v0"
GRAVITY = 9.81


def draw_seeds(seed, draws):
    """The seeds of the draws, as documented: from the evaluation's seed alone."""
    return [int(one) >> 11 for one in np.random.SeedSequence(seed).generate_state(draws, np.uint64)]


def spread(**parameters):
    """Uniform ± a fraction of each parameter, one deviation for all motors."""
    return {"parameters": {name: {"low": -w, "high": w, "each": False} for name, w in parameters.items()}}


def refuse(constant):
    raise AssertionError(f"{constant} is no JSON")


# --- by hand: a constant pull -----------------------------------------------------------------------------------------

PULL = 12.0
"""Mass that the constant command would hold at rest [kg]; the empty platform rises, a heavy one sinks."""
LONG = 0.02
"""Duration of the motion [s]."""
SINKING = 4.0
"""Acceleration at which the bound is reached when the motion ends [m/s²]."""
BOUNDS = {"position": SINKING * LONG**2 / 2, "rotation": 1.0}
COSINE = 0.1 / math.hypot(0.47, -0.47 / math.sqrt(3) + 2 * 0.148 / math.sqrt(3), 0.1)
"""Of the angle between each cable and the vertical in the symmetric pose."""
RADIUS = 0.05


class Constant:
    """The same command for ever: what holds ``PULL`` with the nominal motors."""

    command = PULL * GRAVITY / 6 / COSINE * RADIUS / 10.0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((*observation.shape[:-1], 6), self.command), state


def pulled(uncertainty, **keywords):
    """The evaluation of the constant pull."""
    defaults = {"trajectory": {"name": "dwell-spatial", "duration": LONG}, "error_bounds": BOUNDS, "resolution": 1e-4}
    return evaluate_dlcc(Constant(), SPATIAL_ID, uncertainty=uncertainty, **defaults | keywords)


@cache
def nominal_capacity():
    """Payload that the constant pull keeps within the bound, nominal robot [kg]."""
    return pulled(None, resolution=1e-7).payload


def sunk(payload, strength):
    """How far the platform sinks, from the motor's line and the cables' geometry, which hardly changes on the way."""
    lever = COSINE / RADIUS
    inertia = 10 + payload + 6 * 8e-4 * lever**2
    pull = 6 * lever * strength * 10.0 * Constant.command
    drag = 6 * lever**2 * (0.01 + strength * SPATIAL.speed_slope[0])
    settling = inertia / drag
    speed = ((10 + payload) * GRAVITY - pull) / drag
    return speed * (LONG - settling * -math.expm1(-LONG / settling))


def truths(uncertainty, seed, draws):
    """The true parameters of each draw, as the single environment draws them."""
    env = gym.make(SPATIAL_ID, uncertainty=uncertainty)
    found = []
    for one in draw_seeds(seed, draws):
        env.reset(seed=one)
        found.append(env.unwrapped.truth)
    env.close()
    return found


def order_statistic(capacities, probability):
    """The largest payload that the fraction of the draws carries."""
    return sorted(capacities, reverse=True)[math.ceil(len(capacities) * probability - 1e-9) - 1]


@pytest.mark.parametrize("probability", [0.05, 0.5, 0.8, 0.95])
def test_payload_is_not_another_order_statistic_of_the_draws_capacities(probability):
    unknown = spread(platform_mass=0.1)
    # Payload and platform weigh alike: what the platform of a draw weighs more, its payload has to weigh less.
    capacities = [nominal_capacity() + 10 - truth["platform_mass"] for truth in truths(unknown, 3, 20)]
    result = pulled(unknown, draws=20, seed=3, probability=probability)
    expected = order_statistic(capacities, probability)
    assert max(capacities) - min(capacities) > 1.0
    assert result.payload - 1e-6 <= expected <= result.payload + result.resolution + 1e-6
    assert 0 < result.resolution <= 1e-4
    for payload, fraction in result.success:
        away = min(abs(payload - capacity) for capacity in capacities)
        assert away < 1e-6 or fraction == np.mean([capacity >= payload for capacity in capacities])


def test_weak_motor_of_a_draw_is_not_stronger_than_its_line():
    unknown = spread(motor_strength=0.1)
    strengths = [truth["motor_strength"][0] / 10 for truth in truths(unknown, 0, 9)]
    assert max(strengths) - min(strengths) > 0.08
    capacities = [brentq(lambda m, s=s: sunk(m, s) - BOUNDS["position"], 0, 30) for s in strengths]
    for probability in (0.3, 0.9):
        result = pulled(unknown, draws=9, probability=probability, resolution=1e-3)
        assert result.payload == pytest.approx(order_statistic(capacities, probability), abs=0.05)
    assert nominal_capacity() == pytest.approx(brentq(lambda m: sunk(m, 1.0) - BOUNDS["position"], 0, 30), abs=0.05)


def test_higher_probability_never_gives_more():
    unknown = spread(platform_mass=0.1, motor_strength=0.05)
    results = [pulled(unknown, draws=10, probability=p, resolution=0.01) for p in (0.05, 0.3, 0.55, 0.8, 0.99)]
    payloads = [result.payload for result in results]
    assert payloads == sorted(payloads, reverse=True)
    assert payloads[0] > payloads[2] > payloads[-1]


def test_share_of_the_draws_is_not_rounded_down_nor_off_by_rounding():
    # 0.95 · 20 is 19 to the last bit or just above; 0.5 · 5 needs three.
    assert [RequiredDraws.of(20, 0.95, 0.95).fraction, RequiredDraws.of(5, 0.5, 0.95).fraction] == [19, 3]
    assert [RequiredDraws.of(10, p / 10, 0.95).fraction for p in range(1, 10)] == list(range(1, 10))
    assert RequiredDraws.of(7, 1e-15, 0.95).fraction == 1, "no draw at all is not enough"
    assert RequiredDraws.of(1, 0.3, 0.95) == RequiredDraws(fraction=1, assured=None)


def test_spread_without_width_is_not_another_robot_than_the_nominal_one():
    # Noise makes the draws differ, and nobody who pulls blindly looks at it.
    none = {"parameters": {"platform_mass": {"low": 0.0, "high": 0.0}}, "sensors": {"position": 1e-4}}
    drawn, nominal = pulled(none, draws=3, resolution=1e-3), pulled(None, resolution=1e-3)
    assert drawn.payload == nominal.payload
    assert drawn.violation == nominal.violation
    assert drawn.margins == nominal.margins
    assert drawn.failures == {"position": 3}
    assert set(dict(drawn.success).values()) == {0.0, 1.0}


# --- single episodes --------------------------------------------------------------------------------------------------

SHORT = {"name": "dwell-spatial", "duration": 0.25}
BOUND = 0.004
UNKNOWN = {
    "parameters": {"payload": {"low": -0.2, "high": 0.2}, "motor_strength": {"low": -0.03, "high": 0.03}},
    "wrench": {"force_mean": 0.5, "force_std": 0.5},
    "sensors": {"position": 1e-4},
    "delay": 1,
}


@cache
def searched(probability=0.6):
    """FL on a short hang, six draws."""
    return evaluate_dlcc(
        FeedbackLinearization(SPATIAL),
        SPATIAL_ID,
        trajectory=SHORT,
        uncertainty=UNKNOWN,
        draws=6,
        seed=5,
        probability=probability,
        confidence=0.97,
        error_bounds={"position": BOUND, "rotation": 0.01},
        payload_max=8.0,
        resolution=0.05,
    )


def verdicts(payload):
    """Of the six draws, each in a single environment of its own."""
    policy, found = FeedbackLinearization(SPATIAL), []
    for seed in draw_seeds(5, 6):
        env = DLCCMonitor(
            gym.make(SPATIAL_ID, payload=payload, trajectory=SHORT, uncertainty=UNKNOWN, max_episode_steps=-1),
            error_bounds={"position": BOUND},
        )
        observation, _ = env.reset(seed=seed)
        terminated = False
        while not (env.verdict.complete or terminated or env.verdict.violation):
            observation, _, terminated, _, _ = env.step(policy.predict(observation)[0])
        found.append(env.verdict)
        env.close()
    return found


def test_share_of_the_draws_does_not_contradict_single_episodes():
    result = searched()
    assert 0 < result.payload < 8
    below, above = verdicts(result.payload), verdicts(result.payload + result.resolution)
    carried = [sum(verdict.carried for verdict in some) for some in (below, above)]
    assert carried[0] >= 4 > carried[1], "four of six are 60 %"
    fractions = dict(result.success)
    assert fractions[result.payload] == carried[0] / 6
    first_failing = min(payload for payload in fractions if payload > result.payload)
    assert fractions[first_failing] == carried[1] / 6
    error_bounds = [verdict.violation for verdict in above if verdict.violation]
    assert result.failures == {
        kind: [violation.kind for violation in error_bounds].count(kind) for kind in result.failures
    }
    assert sum(result.failures.values()) == len(error_bounds) == 6 - carried[1]
    assert next(iter(result.failures.values())) == max(result.failures.values())
    assert result.violation.time == min(
        violation.time for violation in error_bounds if violation.kind == result.violation.kind
    )
    # Margins are those of the tightest draw that carried.
    tight = [verdict for verdict in below if verdict.carried]
    assert result.margins["position"] == pytest.approx(1 - max(v.position_peak for v in tight) / BOUND, abs=1e-9)
    assert result.margins["rotation"] == pytest.approx(1 - max(v.rotation_peak for v in tight) / 0.01, abs=1e-9)
    assert result.margins["torque"] == pytest.approx(1 - max(max(v.peak_action) for v in tight), abs=1e-9)
    assert result.margins["tension"] == pytest.approx(min(v.least_tension for v in tight), abs=1e-9)


def test_history_is_not_that_of_a_draw_that_failed():
    result = searched()
    shown = verdicts(result.payload)
    first = next(verdict for verdict in shown if verdict.carried)
    assert not all(verdict.carried for verdict in shown)
    assert len(result.history["action_time"]) == 125
    assert np.abs(result.history["commanded_action"]).max() == pytest.approx(max(first.peak_action), abs=1e-9)
    assert result.history["tensions"].min() == pytest.approx(first.least_tension, abs=1e-9)


def test_history_is_not_that_of_the_first_draw_where_another_carries():
    unknown = spread(platform_mass=0.1)
    masses = [[truth["platform_mass"] for truth in truths(unknown, seed, 4)] for seed in range(8)]
    seed = next(seed for seed, some in enumerate(masses) if max(some) == some[0])  # its first draw fails first
    result = pulled(unknown, draws=4, seed=seed, probability=0.5, resolution=1e-3)
    assert dict(result.success)[result.payload] == 0.5
    assert result.history["tracking_error"].max() <= BOUNDS["position"]


def test_history_does_not_go_on_after_the_draw_has_failed():
    unknown = spread(platform_mass=0.4)
    result = evaluate_dlcc(
        FeedbackLinearization(SPATIAL),
        SPATIAL_ID,
        trajectory={"name": "dwell-spatial", "duration": 0.5},
        uncertainty=unknown,
        draws=6,
        seed=3,
        payload_max=1.0,
        resolution=0.5,
    )
    assert result.payload is None
    assert 0 < sum(result.failures.values()) < 6, "another draw lasts to the end"
    error = np.linalg.norm(result.history["pose"][:, :3] - [0, 0, 0.1], axis=1)
    assert np.all(error[:-1] <= 0.01)
    assert error[-1] > 0.01
    assert np.all(np.diff(result.history["action_time"]) > 0)
    assert np.all(result.history["commanded_action"] != 0), "commands of the policy, not those after the judgement"


def test_failure_beyond_the_payload_is_not_lost_for_good():
    law, motion = FeedbackLinearization(SPATIAL), {"name": "dwell-spatial", "duration": 0.5}
    told = {"trajectory": motion, "uncertainty": "table6", "payload_known": False}
    result = evaluate_dlcc(law, SPATIAL_ID, draws=20, probability=0.5, payload_max=8.0, **told)
    assert result.violation_seed in result.draw_seeds
    assert max(result.draw_seeds) < 2**53, "readers of JSON keep no longer numbers"
    env = DLCCMonitor(gym.make(SPATIAL_ID, payload=result.payload + result.resolution, **told))
    observation, _ = env.reset(seed=result.violation_seed)
    for _ in range(250):
        observation, *_ = env.step(law.predict(observation)[0])
    assert env.verdict.violation == result.violation


def verdict(kind, time):
    """Of an episode in which something gave way, or nothing for None."""
    violation = None if kind is None else Violation(kind=kind, index=None, time=time, excess=None)
    peaks = {"peak_action": (0.5,), "position_peak": 0.0, "rotation_peak": 0.0, "least_tension": 1.0}
    return Verdict(carried=kind is None, complete=kind is None, violation=violation, payload=1.0, **peaks)


def test_limit_of_many_draws_is_not_that_of_a_rare_kind():
    failed = [("slack", 0.1), ("position", 0.4), (None, None), ("position", 0.3), ("position", 0.5), ("rotation", 0.2)]
    trial = Trial(payload=1.0, verdicts=tuple(verdict(*one) for one in failed))
    assert trial.carried == 1
    assert next(iter(trial.failures.items())) == ("position", 3)
    assert trial.failures == {"position": 3, "slack": 1, "rotation": 1}
    assert (trial.violation.kind, trial.violation.time) == ("position", 0.3)
    assert Trial(payload=1.0, verdicts=(verdict(None, None),) * 2).violation is None


# --- the draws --------------------------------------------------------------------------------------------------------


class Spy(FeedbackLinearization):
    """FL that writes down the observations at the start of each batch."""

    def __init__(self, gain=1.0):
        super().__init__(SPATIAL)
        self.gain, self.starts = gain, []

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        if np.all(episode_start):
            self.starts.append(np.array(observation))
        action, state = super().predict(observation)
        return self.gain * action, state


HANG = {"name": "dwell-spatial", "duration": 0.02}


def noisy_starts(policy, **keywords):
    """Noisy poses at the start, (payloads, draws, 6)."""
    draws = keywords.setdefault("draws", 3)
    evaluate_dlcc(policy, SPATIAL_ID, trajectory=HANG, uncertainty="sensors", payload_max=2.0, **keywords)
    pose = observation_layout(SPATIAL).slices()["pose"]
    return policy.starts[0][:, pose].reshape(-1, draws, 6)


def test_draws_do_not_differ_between_policies_or_payloads():
    one, other = noisy_starts(Spy()), noisy_starts(Spy(0.97))
    np.testing.assert_array_equal(one, other)
    assert one.shape == (SCAN_POINTS, 3, 6)
    assert np.all(np.ptp(one, axis=0) == 0), "for every payload the same"
    assert np.all(np.ptp(one, axis=1) > 0), "three different ones"
    assert np.all(one[0] != noisy_starts(Spy(), seed=1)[0])


def test_more_draws_do_not_replace_the_first_ones():
    few, many = noisy_starts(Spy(), draws=2), noisy_starts(Spy(), draws=5)
    np.testing.assert_array_equal(few, many[:, :2])


def test_draws_are_not_other_episodes_than_the_environments_own():
    starts = noisy_starts(Spy(), seed=11)[0]
    env = gym.make(SPATIAL_ID, trajectory=HANG, uncertainty="sensors")
    pose = observation_layout(SPATIAL).slices()["pose"]
    for start, seed in zip(starts, draw_seeds(11, 3), strict=True):
        np.testing.assert_array_equal(env.reset(seed=seed)[0][pose], start)
    single = noisy_starts(Spy(), seed=11, draws=1)[0, 0]
    np.testing.assert_array_equal(env.reset(seed=11)[0][pose], single)


@pytest.mark.parametrize("episodes", [1, 15, 64, 100])
def test_memory_bound_does_not_change_the_result(monkeypatch, episodes):
    usual = searched()
    monkeypatch.setattr(batch_module, "BATCH", episodes)
    searched.cache_clear()
    bounded = searched()
    assert bounded.to_json() == usual.to_json()
    for name, array in usual.history.items():
        assert array.tobytes() == bounded.history[name].tobytes()


def test_memory_bound_is_not_exceeded(monkeypatch):
    monkeypatch.setattr(batch_module, "BATCH", 10)
    spy = Spy()
    evaluate_dlcc(spy, SPATIAL_ID, trajectory=HANG, uncertainty="table6", draws=3, payload_max=0.5)
    assert {len(start) for start in spy.starts} == {9}
    assert len(spy.starts) == math.ceil(SCAN_POINTS / 3) + 1


def test_default_number_of_draws_is_not_one_where_it_is_random_nor_many_where_it_is_not(monkeypatch):
    monkeypatch.setattr(batch_module, "BATCH", 1)
    keywords = {"trajectory": {"name": "dwell-spatial", "duration": 0.002}, "payload_max": 0.1}
    assert DEFAULT_DRAWS == 256
    monkeypatch.setattr(batch_module, "DEFAULT_DRAWS", 7)
    for unknown, draws in ((None, 1), ("none", 1), ({"delay": 2}, 1), ("table6", 7), ("sensors", 7)):
        result = evaluate_dlcc("fl", SPATIAL_ID, uncertainty=unknown, **keywords)
        assert result.draws == draws
        assert (result.probability is None) == (result.confidence is None) == (draws == 1)
        assert (result.success == ()) == (draws == 1)


def test_resolution_over_draws_is_not_that_of_one():
    drawn = pulled(spread(platform_mass=0.1), draws=2, resolution=None).resolution
    assert 1e-3 < drawn <= 0.01
    assert pulled(None, resolution=None).resolution <= 1e-3
    assert DRAWN_RESOLUTION == 0.01


# --- the lower bound --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("draws", [2, 10, 58, 59, 100, 256])
@pytest.mark.parametrize("probability", [0.5, 0.9, 0.95])
@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_assured_number_is_not_another_than_scipys_exact_interval(draws, probability, confidence):
    lows = [
        binomtest(carried, draws, alternative="greater").proportion_ci(confidence, method="exact").low
        for carried in range(draws + 1)
    ]
    enough = [carried for carried, low in enumerate(lows) if low >= probability]
    needed = RequiredDraws.of(draws, probability, confidence)
    assert needed.assured == (enough[0] if enough else None)
    assert needed.assured is None or needed.fraction <= needed.assured


def test_fifty_eight_draws_are_not_enough_and_fifty_nine_are():
    assert RequiredDraws.of(58, 0.95, 0.95).assured is None
    assert RequiredDraws.of(59, 0.95, 0.95).assured == 59


@pytest.mark.parametrize("seed", range(4))
def test_assured_payload_is_not_above_the_payload_nor_another_order_statistic(seed):
    unknown = spread(platform_mass=0.1)
    result = pulled(unknown, draws=12, probability=0.6, confidence=0.9, resolution=1e-3, seed=seed)
    needed = RequiredDraws.of(12, 0.6, 0.9).assured
    assert 8 < needed <= 12
    masses = sorted(truth["platform_mass"] for truth in truths(unknown, seed, 12))
    expected = nominal_capacity() + 10 - masses[needed - 1]
    assert result.assured_payload - 1e-6 <= expected <= result.assured_payload + 1e-3 + 1e-6
    assert result.assured_payload < result.payload
    few = pulled(unknown, draws=12, probability=0.95, confidence=0.95)
    assert few.payload > 0
    assert few.assured_payload is None
    assert "assured payload none (95/95 lower tolerance bound)" in str(few)


# --- bad input --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"draws": 0}, "draws must be an integer of at least 1, not 0"),
        ({"draws": -1}, "draws must be an integer of at least 1, not -1"),
        ({"draws": 2.5}, "draws must be an integer of at least 1, not 2.5"),
        ({"draws": True}, "draws must be an integer of at least 1, not True"),
        ({"draws": 2, "uncertainty": None}, "all 2 draws would be equal: choose a random uncertainty"),
        ({"draws": 2, "uncertainty": {"delay": 3}}, "all 2 draws would be equal: choose a random uncertainty"),
        ({"probability": 0.0}, "probability must lie between 0 and 1, not 0"),
        ({"probability": 1.0}, "probability must lie between 0 and 1, not 1"),
        ({"probability": math.nan}, "probability must lie between 0 and 1, not nan"),
        ({"confidence": 0}, "confidence must lie between 0.5 and 1, not 0"),
        ({"confidence": 1.5}, "confidence must lie between 0.5 and 1, not 1.5"),
        ({"uncertainty": ["table6"] * SCAN_POINTS}, "uncertainty must be one value for all episodes"),
        ({"uncertainty": "table7"}, "unknown uncertainty 'table7'; choose one of none, table6"),
        ({"uncertainty": 0.1}, "0.1 is not an uncertainty"),
        ({"uncertainty": spread(stiffness=0.1)}, "has no parameter stiffness"),
        ({"uncertainty": spread(platform_mass=1.0)}, "platform_mass of 'spatial' can reach 0"),
    ],
    ids=lambda value: str(value)[:40] if isinstance(value, dict) else "",
)
def test_bad_argument_is_not_found_out_after_the_work(arguments, message):
    def work(*_):
        pytest.fail("found out after the work")

    keywords = {"uncertainty": "table6", "draws": 3, "trajectory": HANG} | arguments
    with pytest.raises(ValueError, match=message) as caught:
        evaluate_dlcc("fl", SPATIAL_ID, progress=work, **keywords)
    assert "\n" not in str(caught.value)


def test_random_start_is_not_refused_its_draws():
    keywords = {"trajectory": HANG, "payload_max": 0.5, "initial_error_range": [0.004, 0, 0, 0, 0, 0]}
    result = evaluate_dlcc("fl", SPATIAL_ID, draws=4, **keywords)
    assert (result.draws, result.payload, result.uncertainty) == (4, 0.5, None)


def test_policy_that_forgets_is_not_reported_over_draws():
    class Moody(FeedbackLinearization):
        rounds = 0

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            self.rounds += bool(np.all(episode_start))
            action, state = super().predict(observation, state)
            if self.rounds > 1:
                action[1::3] = 0.0  # the second of three draws
            return action, state

    motion = {"name": "dwell-spatial", "duration": 0.06}
    with pytest.raises(
        PolicyError, match=r"'moody' is not reproducible: it carried 1 kg in 3 of 3 .* in 2 of the same"
    ):
        evaluate_dlcc(
            Moody(SPATIAL), SPATIAL_ID, trajectory=motion, payload_max=1.0, uncertainty="table6", draws=3, name="moody"
        )


# --- progress ---------------------------------------------------------------------------------------------------------

SETTINGS = {
    "scan end": {"payload_max": 1.0},
    "refined": {"resolution": 1e-3},
    "two gaps": {"draws": 12, "probability": 0.6, "confidence": 0.9, "resolution": 1e-4},
    "nothing carried": {"error_bounds": {"position": 1e-6}},
}


@pytest.mark.parametrize("name", SETTINGS)
def test_progress_neither_runs_backwards_nor_stops_before_its_end(name):
    seen = []
    keywords = {"draws": 4, "resolution": 1e-2} | SETTINGS[name]
    pulled(spread(platform_mass=0.1), progress=lambda done, expected: seen.append((done, expected)), **keywords)
    done = [step for step, _ in seen]
    fractions = [step / expected for step, expected in seen]
    assert done == sorted(done)
    assert fractions == sorted(fractions)
    assert max(fractions) == fractions[-1] == 1.0
    assert done[0] in (0, 1)


@pytest.mark.parametrize("after", [1, 12])
def test_interrupt_does_not_leave_the_environment_open(monkeypatch, after):
    made, closed = gym.make_vec, []

    def make_vec(*arguments, **keywords):
        env = made(*arguments, **keywords)
        close = env.close
        env.close = lambda *_, **__: (closed.append(1), close())
        return env

    def progress(done, expected):
        if done >= after:
            raise KeyboardInterrupt

    monkeypatch.setattr(gym, "make_vec", make_vec)
    with pytest.raises(KeyboardInterrupt):
        pulled(spread(platform_mass=0.1), draws=2, progress=progress)
    assert closed == [1]


# --- the result -------------------------------------------------------------------------------------------------------


def test_success_curve_is_neither_unsorted_nor_beyond_its_range():
    result = searched()
    payloads, fractions = np.array(result.success).T
    assert np.all(np.diff(payloads) > 0)
    assert (payloads[0], payloads[-1]) == (0, 8)
    assert len(payloads) > SCAN_POINTS, "with those of the refinement"
    assert np.all((fractions >= 0) & (fractions <= 1))
    assert np.all(fractions[payloads <= result.payload] >= 0.6)
    assert fractions[np.searchsorted(payloads, result.payload) + 1] < 0.6


def test_json_does_not_lack_the_uncertainty_or_the_draws():
    data = json.loads(searched().to_json(), parse_constant=refuse)
    assert (data["draws"], data["probability"], data["confidence"], data["seed"]) == (6, 0.6, 0.97, 5)
    assert (data["uncertainty"], data["assured_payload"]) == ("custom", None)
    resolved = data["environment"]["uncertainty"]
    assert resolved["delay"] == 1
    assert resolved["parameters"]["payload"]["high"] == 0.2
    assert resolved["parameters"]["payload"]["distribution"] == "uniform"
    assert resolved["wrench"]["correlation_time"] == 0.01
    assert resolved["sensors"]["position"] == 1e-4
    assert data["success"] == [list(pair) for pair in searched().success]


def test_name_of_the_uncertainty_is_not_without_its_numbers():
    keywords = {"trajectory": HANG, "payload_max": 0.5, "draws": 2}
    result = evaluate_dlcc("fl", SPATIAL_ID, uncertainty="table6", **keywords)
    data = json.loads(result.to_json(), parse_constant=refuse)
    assert data["uncertainty"] == "table6"
    assert data["environment"]["uncertainty"]["parameters"]["platform_mass"]["low"] == -0.1
    # What the file says makes the same evaluation again, and so does the object.
    for unknown in (data["environment"]["uncertainty"], find_uncertainty("table6", SPATIAL)):
        other = evaluate_dlcc("fl", SPATIAL_ID, uncertainty=unknown, **keywords)
        assert other.uncertainty == "custom"
        assert other.success == result.success
        assert other.margins == result.margins


def test_printed_result_does_not_keep_draws_and_probability_to_itself():
    text = str(searched())
    assert "payload known, custom: " in text
    assert (
        " in at least 60% of 6 draws, assured payload none (60/97 lower tolerance bound); limiting violation: " in text
    )
    assured = pulled(spread(platform_mass=0.1), draws=12, probability=0.6, confidence=0.9, resolution=0.1)
    assert f"assured payload {assured.assured_payload:.3f} kg (60/90 lower tolerance bound)" in str(assured)
    assert "draws" not in str(pulled(None, resolution=0.1))


def test_failing_at_zero_is_not_zero_kilograms_in_silence():
    # Light platforms are pulled up beyond the bound, whatever the payload below 1 kg.
    unknown = {"parameters": {"platform_mass": {"low": -0.35, "high": 0.0}}}
    result = pulled(unknown, draws=8, probability=0.9, payload_max=1.0, resolution=0.1)
    carried = result.success[0][1]
    assert 0 < carried < 0.9
    assert (result.payload, result.total_mass, result.score, result.resolution) == (None, None, 0.0, 0.0)
    assert (result.margins, result.feasible, result.assured_payload) == ({}, (), None)
    assert result.failures == {"position": round(8 * (1 - carried))}
    assert "fails unloaded: position at t = 0.0" in str(result)
    assert json.loads(result.to_json(), parse_constant=refuse)["failures"] == result.failures
