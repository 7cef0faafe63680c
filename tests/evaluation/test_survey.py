"""A survey gives each motion the payload that all of its robots carry."""

import numpy as np
import pytest
from evaluation.conftest import Dropping, Law, verdict_of

from cablebot_baselines.laws import FeedbackLinearization
from cablebot_gym import evaluate_dlcc, find_robot, find_trajectory
from cablebot_gym.evaluation.batch import Batch
from cablebot_gym.evaluation.judge import Violation
from cablebot_gym.evaluation.survey import motion_seeds, survey
from cablebot_gym.policies import PolicyError

PLANAR = "CableBot-Planar-v0"
MOTIONS = [
    find_trajectory({"name": "line-planar", "duration": duration, "dwell": dwell}, "planar")
    for duration, dwell in ((0.25, 0.0), (0.3, 0.05))
]
"""Short motions of different payloads: 0.6 and 1.6 kg with feedback linearization."""
MASSES = {"parameters": {"platform_mass": {"low": -0.3, "high": 0.3}}}
UNEQUAL = {"uncertainty": MASSES, "payload_known": False}
"""Robots of different payloads."""


@pytest.mark.landing
def test_nominal_payload_is_the_dlcc_of_each_motion():
    found = survey("fl", PLANAR, MOTIONS)
    for motion, searched in zip(MOTIONS, found.motions, strict=True):
        dlcc = evaluate_dlcc("fl", PLANAR, trajectory=motion)
        tolerance = searched.resolution + dlcc.resolution
        assert searched.payload == pytest.approx(dlcc.payload, abs=tolerance)


@pytest.mark.landing
def test_all_robots_carry_the_payload_and_one_fails_above():
    drawn = survey("robust", PLANAR, MOTIONS, robots=4, seed=7, **UNEQUAL)
    for motion, seed, found in zip(MOTIONS, motion_seeds(7, 2), drawn.motions, strict=True):
        dlcc = evaluate_dlcc(
            "robust", PLANAR, trajectory=motion, seed=seed, draws=4, resolution=0.01, **UNEQUAL
        )
        assert set(found.below.seeds) == set(dlcc.draw_seeds)
        assert found.payload == pytest.approx(dlcc.payload, abs=0.03)
        assert found.below.carried == 4
        assert found.above.carried < len(found.above.verdicts)
        assert found.violation is not None


def test_motion_keeps_its_robots_and_payloads_when_more_motions_follow(monkeypatch):
    """A random payload below the result may find a failure: the company of a motion must not decide
    which ones it tries."""
    tried = []

    def fail_at_half_a_kilogram(self, rows, **keywords):
        tried.extend(rows)
        verdicts = []
        for row in rows:
            violation = None
            if row.payload >= 0.5:
                violation = Violation(kind="position", index=None, time=0.0, excess=0.0)
            verdicts.append(verdict_of(violation))
        return verdicts

    monkeypatch.setattr(Batch, "run", fail_at_half_a_kilogram)
    survey("fl", PLANAR, MOTIONS[:1], robots=4, **UNEQUAL)
    alone = set(tried)
    tried.clear()
    survey("fl", PLANAR, MOTIONS, robots=4, **UNEQUAL)
    assert alone == {row for row in tried if row.motion == 0}


def test_policy_that_fails_unloaded_gets_zero():
    found = survey(lambda observation: np.zeros(3), PLANAR, MOTIONS)
    assert [motion.payload for motion in found.motions] == [None, None]
    assert found.payloads.tolist() == [0.0, 0.0]


def test_payload_is_below_the_first_hole():
    policy = Dropping(lambda payload: (payload > 0.3) & (payload < 0.5), find_robot("planar"))
    found = survey(policy, PLANAR, MOTIONS)
    assert found.payloads == pytest.approx(0.3, abs=found.motions[0].resolution)


class SharesRows(Law):
    """Fails in small batches."""

    def act(self, observation):
        return super().act(observation) * (0.5 if len(observation) < 4 else 1.0)


@pytest.mark.landing
def test_policy_that_needs_other_rows_is_refused():
    with pytest.raises(PolicyError, match="depends on the other episodes of its batch"):
        survey(SharesRows(find_robot("planar")), PLANAR, 2 * MOTIONS)


@pytest.mark.landing
def test_stochastic_policy_that_needs_other_rows_is_refused():
    noisy = {"robots": 8, "uncertainty": "sensors"}
    policy = FeedbackLinearization(find_robot("planar"))
    policy.stochastic = True
    assert survey(policy, PLANAR, MOTIONS, **noisy).stochastic
    policy = SharesRows(find_robot("planar"))
    policy.stochastic = True
    with pytest.raises(PolicyError, match="depends on the other episodes of its batch"):
        survey(policy, PLANAR, MOTIONS, **noisy)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"trajectory": "circle-planar"}, "its own trajectory"),
        ({"motions": []}, "at least one"),
        ({"robots": 3}, "all 3 robots would be equal"),
    ],
)
def test_invalid_survey_is_refused(keywords, message):
    with pytest.raises(ValueError, match=message):
        survey("fl", PLANAR, **{"motions": MOTIONS, **keywords})
