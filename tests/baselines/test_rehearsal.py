"""Rehearsals of plans on random robots, and the margins that follow from them."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("casadi")

from cablebot_baselines.planners.rehearsal import (
    GROWTH,
    TENSION_RESERVE,
    Rehearsal,
    grown_margins,
    spread_margins,
)
from cablebot_baselines.planners.rehearsed import with_lighter_payload
from cablebot_gym.motions import find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.planning import MarginProfile, MotionProgram
from cablebot_gym.robots import FLEX_PLANAR
from cablebot_gym.task import ErrorBounds

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


def test_payload_counts_only_with_all_smaller_ones():
    position = np.zeros((6, 200))
    position[3, 50] = 0.011  # one of two robots fails with 2 kg
    assert rehearsal([0, 0, 2, 2, 3, 3], position=position).largest_carried() == 0.0
    position[0, 50] = 0.011
    assert rehearsal([0, 0, 2, 2, 3, 3], position=position).largest_carried() == -1.0
    assert rehearsal([0, 0, 2, 2, 3, 3]).largest_carried() == 3.0


def test_overloaded_cable_fails_a_rehearsal():
    """Within the reserve below the maximum, too; a plan would claim a payload that breaks a cable."""
    for maximum, carried in ((92.0, True), (91.0, False)):
        task = replace(TASK, robot=TASK.robot.replace(maximum_tension=maximum))
        assert rehearsal([0], task=task).carried.tolist() == [carried]


def test_jump_that_comes_a_period_later_needs_no_margin():
    """The delay of a robot moves its actions and tensions in time."""
    tension = np.full((2, 200), 5.0)
    tension[0, 100:] = tension[1, 101:] = 50.0
    action = np.full((2, 200, 3), 0.5)
    action[0, 100:] = action[1, 101:] = 0.7
    margins = spread_margins(rehearsal([0.0, 0.0], tension=tension, action=action), TASK.trajectory)
    assert margins.tension.max() < 1.0
    assert margins.action.max() < 1e-9
    assert margins.position.max() == margins.rotation.max() == 0.0


def test_exceeded_limits_get_larger_margins_at_their_times():
    tension = np.full((1, 200), 5.0)
    tension[0, 100] = TASK.robot.minimum_tension + TENSION_RESERVE - 0.5
    margins = grown_margins(MarginProfile.zeros(TIMES, 3), rehearsal([0.0], tension=tension))
    assert margins.tension[100] == pytest.approx(0.5 * GROWTH)
    assert margins.tension[50] == margins.position.max() == margins.action.max() == 0.0


@pytest.mark.landing
def test_motor_angles_balance_a_lighter_payload_on_a_plan():
    """A program with both payloads then starts near its solution."""
    motion = find_trajectory({"name": "line-planar", "duration": 0.4, "dwell": 0.1}, "planar")
    plan = MotionProgram(FLEX_PLANAR, motion, ErrorBounds(), intervals=20, period=2e-3).solve()
    both = with_lighter_payload(plan, FLEX_PLANAR, 0.0)
    times = np.linspace(0.0, motion.duration, 50)
    angle, _, _ = both.motor_motion(times, np.zeros(50))
    planned = both(times)
    pulley = textbook.pulley_angle(FLEX_PLANAR, planned.position)
    tensions = FLEX_PLANAR.stiffness * (angle - pulley) / FLEX_PLANAR.pulley_radius
    structure = textbook.jacobian(FLEX_PLANAR, planned.position)
    wrench = -np.einsum("tmn,tm->tn", structure, tensions)
    assert_allclose(wrench, FLEX_PLANAR.mass * planned.acceleration, atol=1.0)
