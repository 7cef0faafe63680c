"""The policy that plans a motion within the error bounds and tracks it."""

import logging
from dataclasses import replace
from unittest.mock import Mock

import gymnasium as gym
import numpy as np
import pytest
from driving import drive, keeps_limits

pytest.importorskip("casadi")

from cablebot_baselines.planners.rehearsed import Planner
from cablebot_baselines.planners.trajopt import TrajOpt, exact_margins
from cablebot_gym.envs import ENV_IDS, env_robot
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.motions import random_loop
from cablebot_gym.physics.textbook import allocated_minimum
from cablebot_gym.planning import Infeasible
from cablebot_gym.robots import PLANAR, SPATIAL, find_robot
from cablebot_gym.task import ErrorBounds

PLANAR_ID = "CableBot-Planar-v0"

PLANAR_BEST = 2.85
"""Best known payload on the planar circle [kg], from ``cablebot best-known``."""

LINE = {"name": "line-planar", "duration": 0.4, "dwell": 0.0}
"""A motion that is planned within 0.1 s."""


def carried(policy, env_id, payload, known, **keywords):
    """Whether each of N episodes keeps the limits."""
    env = gym.make_vec(
        env_id, num_envs=len(payload), payload=payload, payload_known=known, **keywords
    )
    return np.all([keeps_limits(step.info) for step in drive(policy, env)], axis=0).tolist()


# --- payload ----------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("exact_plans_only")
@pytest.mark.landing
def test_short_motion_is_tracked_with_every_known_payload():
    """fl fails with 5 kg. Without dwells the plan accelerates at once."""
    policy = TrajOpt(PLANAR)
    payload = np.array([0.0, 6.0])
    assert carried(policy, PLANAR_ID, payload, True, trajectory=LINE) == [True] * 2
    assert policy.fallbacks == 0


@pytest.mark.nightly
@pytest.mark.parametrize(("known", "fraction"), [(True, 0.97), (False, 0.88)])
def test_planar_dlcc_is_near_the_best_known_payload(known, fraction):
    """A robot with an unknown payload may be any of `hardware`."""
    result = evaluate_dlcc(TrajOpt(PLANAR), PLANAR_ID, payload_known=known, resolution=0.02)
    assert fraction * PLANAR_BEST <= result.payload <= PLANAR_BEST


@pytest.mark.usefixtures("exact_plans_only")
@pytest.mark.nightly
@pytest.mark.parametrize("env_id", ENV_IDS)
def test_random_motion_of_each_environment_has_an_exact_plan(env_id):
    """On meshes as fine as those of fast motions, IPOPT found none for slow motions on springs."""
    robot = find_robot(env_robot(env_id))
    task = gym.make(env_id, trajectory=random_loop(robot.kind, 0)).unwrapped.task
    policy = TrajOpt(robot)
    policy.reset([replace(task, payload_known=True)])
    assert policy.fallbacks == 0


def test_margins_follow_error_bounds_and_friction():
    """The friction of a motor that turns around changes the tension of its cable within a control
    period."""
    bounds = ErrorBounds(position=0.02, rotation=0.03)
    margins = exact_margins(SPATIAL, bounds)
    assert (margins.position, margins.rotation) == pytest.approx((0.02 * 0.02, 0.02 * 0.03))
    assert margins.action == 0.005
    assert margins.tension == 1.0
    friction = {"coulomb_friction": 0.2, "pulley_radius": 0.05}
    rubbing = SPATIAL.replace(transmission=SPATIAL.transmission.replace(**friction))
    assert exact_margins(rubbing, bounds).tension == pytest.approx(1.0 + 4.0)


def test_margins_leave_tensions():
    """Of springs those at the start, else half of those below the maximum tension."""
    robot = find_robot("flex-gch-klaus")
    margins = exact_margins(robot, ErrorBounds())
    assert robot.minimum_tension + margins.tension <= allocated_minimum(robot)
    weak = find_robot("ttk4900").replace(maximum_tension=3.0)
    assert exact_margins(weak, ErrorBounds()).tension == 0.5


@pytest.mark.landing
def test_rehearsed_plan_serves_robots_that_are_not_exactly_known():
    """The exact plan fails them unloaded. A known payload that is heavier than the rehearsed one has
    the exact plan."""
    policy = TrajOpt(PLANAR)
    motion = {"name": "loop-planar", "seed": 0}
    payloads = np.array([0.0, 2.0, 3.4, 3.4])
    unknown = [False, False, False, True]
    keywords = {"trajectory": motion, "uncertainty": "hardware"}
    assert carried(policy, PLANAR_ID, payloads, unknown, **keywords) == [True] * 4
    assert carried(policy, PLANAR_ID, np.array([4.3]), [True], trajectory=motion) == [True]


# --- fallbacks --------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("exact_plans_only")
def test_infeasible_plan_is_tried_once(caplog):
    first = Mock(side_effect=Infeasible("Restoration_Failed"))
    policy = TrajOpt(PLANAR, Planner(name="mine", first=first, module=__name__))
    with caplog.at_level(logging.WARNING, "cablebot_gym"):
        assert carried(policy, PLANAR_ID, np.array([1.5, 1.0]), [True, True]) == [True, True]
    assert policy.fallbacks == 2
    assert "mine tracks trajectory 'circle-planar' without a plan in 2 episodes" in caplog.text
    policy.reset([replace(gym.make(PLANAR_ID).unwrapped.task, payload_known=True)])
    assert policy.fallbacks == 1
    first.assert_called_once()


@pytest.mark.usefixtures("exact_plans_only")
def test_unknown_payload_follows_the_reference_where_rehearsals_fail():
    """The exact plan is tracked with a known payload."""
    first = Mock()
    policy = TrajOpt(PLANAR, Planner(name="mine", first=first, module=__name__))
    policy.reset([gym.make(PLANAR_ID, payload_known=False).unwrapped.task])
    assert policy.fallbacks == 1
    first.assert_not_called()


# --- invalid input ----------------------------------------------------------------------------------------------------


def test_motor_lag_raises():
    with pytest.raises(ValueError, match="motors without lag"):
        TrajOpt(PLANAR.replace(motors=PLANAR.motors.replace(lag=0.01)))
