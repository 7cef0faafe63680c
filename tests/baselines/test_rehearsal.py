"""Rehearsals of plans on random robots, and the margins that follow from them."""

from dataclasses import replace
from unittest.mock import Mock

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("casadi")

from cablebot_baselines.laws import Observing
from cablebot_baselines.observer.expectation import Expectation
from cablebot_baselines.planners import rehearsed
from cablebot_baselines.planners.rehearsal import (
    GROWTH,
    ROBOTS,
    TENSION_RESERVE,
    Rehearsal,
    grown_margins,
    rehearse,
    spread_margins,
)
from cablebot_baselines.planners.rehearsed import OPTIMAL, PlanSearch, find_plans, replayed_plan
from cablebot_gym.planning import Infeasible, MarginProfile, Margins
from cablebot_gym.uncertainty import Uncertainty, find_uncertainty

TASK = gym.make("CableBot-Planar-v0", payload_known=False).unwrapped.task
TIMES = np.arange(1, 201) / TASK.control_frequency


def rehearsal(payloads, **changes):
    """Episodes that follow the reference exactly and keep away from all limits, but for
    changes."""
    count = len(payloads)
    reference = TASK.trajectory(TIMES).position
    values = {
        "task": TASK,
        "payloads": np.asarray(payloads, float),
        "times": TIMES,
        "poses": np.broadcast_to(reference, (count, *reference.shape)).copy(),
        "position": np.zeros((count, 200)),
        "rotation": np.zeros((count, 200)),
        "action": np.full((count, 200, 3), 0.5),
        "tension": np.full((count, 200), 5.0),
        "largest_tension": np.full((count, 200), 90.0),
    }
    return Rehearsal(**values | changes)


def plan():
    """The reference with the least tension of the rehearsals."""
    motion = Mock(side_effect=TASK.trajectory)
    motion.minimum_tension = 5.0
    return motion


def test_payload_counts_only_with_all_smaller_ones():
    position = np.zeros((6, 200))
    position[3, 50] = 0.011  # one of two robots fails with 2 kg
    assert rehearsal([0, 0, 2, 2, 3, 3], position=position).largest_carried() == 0.0
    position[0, 50] = 0.011
    assert rehearsal([0, 0, 2, 2, 3, 3], position=position).largest_carried() == -1.0
    assert rehearsal([0, 0, 2, 2, 3, 3]).largest_carried() == 3.0


def test_overloaded_cable_fails_a_rehearsal():
    """Within the reserve below the maximum, too; a plan would claim a payload that breaks a cable."""
    for maximum, carried in ((92.0, 0.0), (91.0, -1.0)):
        task = replace(TASK, robot=TASK.robot.replace(maximum_tension=maximum))
        overloaded = rehearsal([0], task=task)
        assert overloaded.largest_carried() == carried
        assert overloaded.largest_carried(reserved=False) == 0.0


@pytest.fixture
def search(monkeypatch):
    """A function that searches among given plans; None is infeasible. The last rehearsal repeats."""

    def found(plans, *rehearsals):
        first, *others = plans
        coming = list(rehearsals)
        program = Mock(**{"resolve.side_effect": [other or Infeasible("none") for other in others]})
        planner = Mock(**{"first.return_value": (program, first)})
        monkeypatch.setattr(
            rehearsed, "rehearse", lambda *_: [coming.pop(0) if len(coming) > 1 else coming[0]]
        )
        (plan,) = find_plans([PlanSearch(planner, TASK, find_uncertainty("hardware", TASK.robot))])
        return plan

    monkeypatch.setattr(rehearsed, "tracking_law", Mock())
    monkeypatch.setattr(rehearsed, "spread_margins", lambda *_: MarginProfile.zeros(TIMES, 3))
    return found


@pytest.mark.parametrize(("error", "is_planned"), [(0.0099, True), (0.0101, False)])
def test_plan_that_misses_the_reserves_is_better_than_none(search, error, is_planned):
    """One that misses the limits themselves is not."""
    motion = Mock(payload=2.0)
    episodes = rehearsal([0, 2], position=np.full((2, 200), error))
    assert search([motion] * 4, episodes) == (motion if is_planned else None)


def test_first_plan_stays_where_larger_margins_leave_none(search):
    """Motions without a further plan had none at all, and failed unloaded."""
    first = Mock(payload=2.0)
    assert search([first, None, None, None], rehearsal([0, 2])) is first


def test_plan_with_half_the_margins_follows_one_that_is_infeasible(search):
    first, later = Mock(payload=2.0), Mock(payload=1.5)
    failed = rehearsal([0, 2], position=np.full((2, 200), 0.02))
    assert search([first, None, later], failed, rehearsal([0, 1.5])) is later


@pytest.mark.parametrize(
    ("carried", "best"),
    [([False, True], 1), ([False, False, False], 0)],
    ids=["margins help", "none helps"],
)
def test_exact_plan_is_the_first_whose_replays_keep_all_limits(monkeypatch, carried, best):
    """Between the instants of its program a plan exceeded the bound of the rotation."""
    plans = [Mock(payload=2.0 - 0.1 * index) for index in range(4)]
    replays = []
    for plan, is_carried in zip(plans, carried, strict=False):
        error = 0.005 if is_carried else 0.02
        payloads = [0.0, plan.payload]
        position = np.array([[0.005], [error]]) * np.ones(200)
        replays.append([rehearsal(payloads, position=position)])
    monkeypatch.setattr(rehearsed, "rehearse", Mock(side_effect=replays))
    program = Mock(**{"resolve.side_effect": plans})
    assert replayed_plan(program, Margins(), TASK, Mock()) is plans[best]
    used = [call.args[1] for call in program.resolve.call_args_list[1:]]
    assert all(profile.position.max() > 0.01 for profile in used)


def test_jump_that_comes_a_period_later_needs_no_margin():
    """The delay of a robot moves its actions and tensions in time."""
    tension = np.full((2, 200), 5.0)
    tension[0, 100:] = tension[1, 101:] = 50.0
    action = np.full((2, 200, 3), 0.5)
    action[0, 100:] = action[1, 101:] = 0.7
    margins = spread_margins(rehearsal([0.0, 0.0], tension=tension, action=action), plan())
    assert margins.tension.max() < 1.0
    assert margins.action.max() < 1e-9
    assert margins.position.max() == margins.rotation.max() == 0.0


def test_margin_of_redundant_cables_follows_the_spread_at_the_least_tension():
    """Their law keeps a least tension, so the margin to it is the same all the time: a jump at which
    the tensions are high must not raise it."""
    tension = np.full((2, 200), 5.0)
    tension[0, 100:] = 50.0
    tension[1, 100:] = 40.0
    tension[0, 50] = 4.0
    margins = spread_margins(rehearsal([0.0, 0.0], tension=tension), plan())
    assert 0.5 < margins.tension.max() < 5.0


def test_first_plan_of_redundant_cables_has_the_least_tension_of_observing():
    """With less, cables go slack in the rehearsal, and its spread has no meaning."""
    planner = Mock()
    planner.first.side_effect = Infeasible("stop")
    task = gym.make("CableBot-Point-v0", payload_known=False).unwrapped.task
    assert find_plans([PlanSearch(planner, task, find_uncertainty("hardware", task.robot))]) == [
        None
    ]
    margins = planner.first.call_args.args[2]
    assert margins.tension > 20.0


@pytest.mark.parametrize(
    ("env_id", "stiffness"), [("CableBot-FlexSpatial-v0", 20.0), ("CableBot-FlexPoint-v0", 5.0)]
)
def test_soft_springs_get_lower_gains(monkeypatch, env_id, stiffness):
    """With those of the paper's robots, heavy payloads on long cables resonate."""
    task = gym.make(env_id, payload_known=False).unwrapped.task
    law = Mock(side_effect=RuntimeError("stop"))
    monkeypatch.setattr(rehearsed, "PlanLaw", law)
    expectation = Expectation.of(task.robot, find_uncertainty("hardware", task.robot))
    with pytest.raises(RuntimeError, match="stop"):
        rehearsed.tracking_law([Mock(payload=5.0)], expectation, [task])
    assert law.call_args.kwargs["gains"] == pytest.approx((stiffness**2, 2 * stiffness), rel=0.02)


def test_exceeded_limits_get_larger_margins_at_their_times():
    tension = np.full((1, 200), 5.0)
    tension[0, 100] = TASK.robot.minimum_tension + TENSION_RESERVE - 0.5
    margins = grown_margins(MarginProfile.zeros(TIMES, 3), rehearsal([0.0], tension=tension))
    assert margins.tension[100] == pytest.approx(0.5 * GROWTH)
    assert margins.tension[50] == margins.position.max() == margins.action.max() == 0.0


def test_expected_robot_is_rehearsed_with_each_payload():
    """It once failed unloaded by a hair with a plan that all random robots carry."""
    motion = {"name": "line-planar", "duration": 0.05, "dwell": 0.0}
    task = gym.make("CableBot-Planar-v0", trajectory=motion, payload_known=False).unwrapped.task
    payloads = [0.0, 1.0]
    rehearsals = []
    for uncertainty in (find_uncertainty("hardware", task.robot), Uncertainty()):
        law = Observing(task.robot)
        rehearsals += rehearse(law, [task], uncertainty, [payloads])
    drawn, exact = (rehearsal.tension.reshape(2, ROBOTS, -1) for rehearsal in rehearsals)
    np.testing.assert_array_equal(drawn[:, -1], exact[:, -1])
    assert (drawn[:, :-1] != exact[:, :-1]).any(axis=-1).all()


@pytest.mark.landing
def test_motion_rehearsed_beside_a_longer_one_has_the_same_plan():
    """A longer motion beside it once would have rehearsed a motion beyond its end."""
    searches = []
    for duration in (0.4, 0.7):
        motion = {"name": "line-planar", "duration": duration}
        env = gym.make("CableBot-Planar-v0", trajectory=motion, payload_known=False)
        task = env.unwrapped.task
        searches.append(PlanSearch(OPTIMAL, task, find_uncertainty("hardware", task.robot)))
    together = find_plans(searches)
    for search, plan in zip(searches, together, strict=True):
        (alone,) = find_plans([search])
        assert plan.payload == alone.payload > 0
        np.testing.assert_array_equal(plan.poses, alone.poses)
