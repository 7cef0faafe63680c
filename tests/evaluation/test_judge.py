"""The judge on hand-made episodes, and the monitor on live ones."""

import math
from types import SimpleNamespace
from typing import get_args

import gymnasium as gym
import numpy as np
import pytest
from evaluation.conftest import play

from cablebot_baselines.laws import FeedbackLinearization
from cablebot_gym.evaluation import DLCCMonitor, ErrorBounds, Verdict
from cablebot_gym.evaluation.judge import Judge, ViolationKind
from cablebot_gym.robots import PLANAR

STALL = np.array([5.0, 6.0, 7.0])
"""τ_s of the hand-made robot [N·m], different for each motor."""
PERIOD = 0.002
BOUNDS = ErrorBounds(position=0.01, rotation=0.02)


def task_of(steps, **changes):
    """The part of a task that the judge reads."""
    values = {
        "steps": steps,
        "error_bounds": BOUNDS,
        "robot": SimpleNamespace(minimum_tension=1.0, maximum_tension=50.0),
        "cable": "unilateral",
        "starts_at_rest": True,
    }
    return SimpleNamespace(**values | changes)


def info_of(
    step,
    *,
    payload=1.5,
    position=0.001,
    rotation=0.001,
    action=(0.1, -0.2, 0.3),
    slack=(),
    tension=(9, 8, 7),
    largest=(19, 18, 17),
    terminated=False,
):
    """Info of one step of one episode, arrays (1, …)."""
    values = {
        "time": step * PERIOD,
        "action_time": max(step - 1, 0) * PERIOD,
        "payload": payload,
        "tracking_error_peak": position,
        "rotation_error_peak": rotation,
        "commanded_action": action,
        "torque_margin": STALL * (1 - np.abs(action)),
        "slack": [cable in slack for cable in (1, 2, 3)],
        "least_tensions": tension,
        "largest_tensions": largest,
        "termination_reason": 0,
        "terminated": terminated,
    }
    return {name: np.array([value]) for name, value in values.items()}


def judged(script, criterion="task", start=None, **task):
    """The verdict on the second of two hand-made episodes: the first one leaves nothing. A script
    has the changes to each uneventful step."""
    judge = Judge(criterion, cables=3, count=1)
    for _ in range(2):
        judge.reset(info_of(0, **(start or {})), task_of(len(script), **task))
        for step, change in enumerate(script, 1):
            info = info_of(step, **change)
            judge.observe(info, info["terminated"])
    return judge.verdict(0)


def third(**change):
    """Five steps with an eventful third one."""
    return [{}, {}, change, {}, {}]


each_criterion = pytest.mark.parametrize("criterion", ["task", "paper"])


# --- violations -------------------------------------------------------------------------------------------------------


@each_criterion
def test_uneventful_motion_is_carried(criterion):
    """At the reset, where an environment returns zeros, no control period has passed."""
    assert judged(
        [{}] * 5, criterion, start={"tension": (0, 0, 0), "action": (0, 0, 0)}
    ) == Verdict(
        carried=True,
        violation=None,
        payload=1.5,
        peak_action=(0.1, 0.2, 0.3),
        position_peak=0.001,
        rotation_peak=0.001,
        least_tension=7.0,
        largest_tension=19.0,
    )


def event(kind, index, step, excess, bound=None):
    """Kind, motor or cable, time and excess of a violation, and its bound."""
    return kind, index, pytest.approx(step * PERIOD), pytest.approx(excess), bound


OVERLOAD = {"largest": (40.0, 50.5, 50.2)}
SLACKENING = {"tension": (1.0, 0.4, 0.7)}
VIOLATIONS = [
    ("paper", {"action": (1.1, -1.3, 1.2)}, event("torque", 2, 2, 1.8)),
    ("paper", {"slack": (3, 2)}, event("slack", 2, 3, None)),
    ("task", {"position": 0.013}, event("position", None, 3, 0.003, 0.01)),
    ("task", {"rotation": 0.025}, event("rotation", None, 3, 0.005, 0.02)),
    ("task", SLACKENING, event("slack", 2, 3, 0.6, 1.0)),
    ("task", OVERLOAD, event("overload", 2, 3, 0.5, 50.0)),
    # just beyond the bound
    ("paper", {"action": (1.0, -1.0 - 1e-9, 1.0)}, event("torque", 2, 2, 6e-9)),
    ("paper", {"position": math.nextafter(0.01, 1)}, event("position", None, 3, 0.0, 0.01)),
]


def facts(violation):
    return violation.kind, violation.index, violation.time, violation.excess, violation.bound


@pytest.mark.parametrize(("criterion", "change", "expected"), VIOLATIONS)
def test_violation_has_kind_index_time_and_excess(criterion, change, expected):
    assert facts(judged(third(**change), criterion).violation) == expected


@pytest.mark.parametrize(
    ("criterion", "start", "expected"),
    [
        ("task", {"position": 0.011}, event("position", None, 0, 0.001, 0.01)),
        ("task", {"rotation": 0.03}, event("rotation", None, 0, 0.01, 0.02)),
        # margins of 4.5, 4.8 and -0.7 N·m
        ("task", {"action": (0.1, 0.2, 1.1)}, event("torque", 3, 0, 0.7)),
    ],
)
def test_start_counts(criterion, start, expected):
    assert facts(judged([{}] * 4, criterion, start=start).violation) == expected


@pytest.mark.parametrize(
    ("criterion", "script", "keywords"),
    [
        # the bound itself
        ("paper", third(action=(1.0, -1.0, 1.0 + 1e-13)), {}),
        ("paper", third(position=0.01), {}),
        ("task", third(tension=(1.0, 1.0, 1.0)), {}),
        # limits of the other criterion
        ("paper", third(**SLACKENING), {}),
        ("paper", third(**OVERLOAD), {}),
        ("paper", [{}] * 4, {"start": {"rotation": 0.03}}),
        ("paper", [{}] * 4, {"start": {"action": (0.1, 0.2, 1.1)}}),
        # a bilateral cable may push, and a moving start needs no rest
        ("task", third(**SLACKENING), {"cable": "bilateral"}),
        ("task", [{}] * 4, {"start": {"action": (0.1, 0.2, 1.1)}, "starts_at_rest": False}),
    ],
)
def test_within_the_limits_a_payload_is_carried(criterion, script, keywords):
    assert judged(script, criterion, **keywords).carried


KINDS = get_args(ViolationKind)
EVENTS = {
    "torque": {"action": (0.0, 2.0, 0.0)},
    "slack": {"slack": (3,)},
    "overload": {"largest": (9, 9, 99)},
    "position": {"position": 0.05},
    "rotation": {"rotation": 0.05},
    "terminated": {"terminated": True},
}
"""Changes by kind, in the order of the checks within one step."""


@each_criterion
def test_violations_of_one_step_have_a_fixed_order(criterion):
    assert tuple(EVENTS) == KINDS
    unchecked = {"task": ("torque",), "paper": ("overload", "rotation")}[criterion]
    for start in range(len(KINDS)):
        together = {}
        for kind in KINDS[start:]:
            together |= EVENTS[kind]
        expected = next(kind for kind in KINDS[start:] if kind not in unchecked)
        assert judged(third(**together), criterion).violation.kind == expected


def test_later_violation_does_not_replace_the_first():
    before = {"action": (0.5, 0.1, 0.1), "tension": (9, 8, 6.5)}
    violation = {"position": 0.02, "rotation": 0.004, "action": (0.1, -0.9, 0.1)}
    later = {"position": 0.09, "rotation": 0.9, "action": (4.0, 4.0, 4.0), "slack": (1,)}
    verdict = judged([before, violation | {"tension": (5, 9, 9)}, later | {"tension": (0, 0, 0)}])
    assert (verdict.violation.kind, verdict.violation.time) == ("position", 2 * PERIOD)
    assert verdict.peak_action == (0.5, 0.9, 0.1)
    peaks = (verdict.position_peak, verdict.rotation_peak, verdict.least_tension)
    assert peaks == (0.02, 0.004, 5.0)


def test_payload_is_carried_at_the_end_of_the_motion_only():
    judge = Judge("task", cables=3, count=1)
    judge.reset(info_of(0), task_of(2))
    carried = [judge.carried.item()]
    for step, change in enumerate([{}, {}, {"position": 0.5}], 1):
        judge.observe(info_of(step, **change), np.array([False]))
        carried.append(judge.carried.item())
    assert carried == [False, False, True, True]
    assert judge.verdict(0).position_peak == 0.001, "steps after the motion do not count"


# --- the monitor ------------------------------------------------------------------------------------------------------


def test_bounds_of_the_reset_option_reach_the_monitor():
    """In its episode only, which also leaves no violation to the next one."""
    env = DLCCMonitor(gym.make("CableBot-Planar-v0"))
    short = {"trajectory": {"name": "line-planar", "duration": 0.4, "dwell": 0.0}}
    narrow = {"error_bounds": {"position": 1e-5}}
    for options, carried in ((narrow, False), ({}, True)):
        verdict = play(env, FeedbackLinearization(PLANAR), short | options)
        assert verdict.carried is carried
        assert (verdict.violation is None) is carried
