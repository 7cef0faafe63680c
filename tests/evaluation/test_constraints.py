"""The judge on hand-made episodes, and the monitor on live ones."""

import math
from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from evaluation.conftest import play
from gymnasium.error import ResetNeeded

from cablebot_baselines.classical import FeedbackLinearization
from cablebot_gym.evaluation import DLCCMonitor, ErrorBounds, Verdict, evaluate_dlcc
from cablebot_gym.evaluation.constraints import KINDS, Violation
from cablebot_gym.robots import PLANAR, SPATIAL

ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
STALL = np.array([5.0, 6.0, 7.0])
"""τ_s of the hand-made robot [N·m], different for each motor."""
PERIOD = 0.002
BOUNDS = ErrorBounds(position=0.01, rotation=0.02)


@dataclass(frozen=True, eq=False)
class HandMadeTask:
    """The part of a task that the judge reads."""

    steps: int
    error_bounds: ErrorBounds = BOUNDS
    robot: SimpleNamespace = field(
        default_factory=lambda: SimpleNamespace(cables=3, minimum_tension=1.0, maximum_tension=50.0)
    )
    cable: str = "unilateral"
    starts_at_rest: bool = True


each_criterion = pytest.mark.parametrize("criterion", ["task", "paper"])


class Scripted(gym.Env):
    """An environment with a given ``info``: one dict of the changes to an uneventful step, per
    step."""

    def __init__(self, script, *, start=None, steps=None, **changes):
        self.action_space = gym.spaces.Box(-1, 1, (3,))
        self.observation_space = gym.spaces.Box(-1, 1, (1,), dtype=np.float64)
        self.script = script
        self.start = start or {}
        self.task = HandMadeTask(len(script) if steps is None else steps, **changes)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.step_ = 0
        return np.zeros(1), info_of(0, **self.start)

    def step(self, action):
        change = dict(self.script[self.step_])
        self.step_ += 1
        terminated = change.pop("terminated", False)
        return np.zeros(1), 0.0, terminated, False, info_of(self.step_, **change)


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
):
    """Info of one step of a single environment."""
    return {
        "time": step * PERIOD,
        "action_time": max(step - 1, 0) * PERIOD,
        "payload": payload,
        "tracking_error_peak": position,
        "rotation_error_peak": rotation,
        "commanded_action": np.array(action),
        "torque_margin": STALL * (1 - np.abs(action)),
        "slack": np.array([cable in slack for cable in (1, 2, 3)]),
        "least_tensions": np.array(tension, float),
        "largest_tensions": np.array(largest, float),
        "termination_reason": 0,
    }


def judged(script, criterion="task", **keywords):
    """The verdict on a hand-made episode."""
    env = DLCCMonitor(Scripted(script, **keywords), criterion=criterion)
    env.reset()
    for _ in script:
        env.step(np.zeros(3))
    return env.verdict


def third(**change):
    """Five steps with an eventful third one."""
    return [{}, {}, change, {}, {}]


# --- violations -------------------------------------------------------------------------------------------------------


@each_criterion
def test_uneventful_motion_is_carried(criterion):
    assert judged([{}] * 5, criterion) == Verdict(
        carried=True,
        violation=None,
        payload=1.5,
        peak_action=(0.1, 0.2, 0.3),
        position_peak=0.001,
        rotation_peak=0.001,
        least_tension=7.0,
        largest_tension=19.0,
    )


@pytest.mark.parametrize(
    ("action", "motor", "excess"),
    [
        ((1.1, 0.0, 0.0), 1, 0.5),
        ((0.0, -1.1, 0.0), 2, 0.6),
        ((1.1, -1.3, 1.2), 2, 1.8),
        ((-1.3, 1.1, 1.2), 1, 1.5),
    ],
)
def test_torque_violation_is_that_of_the_largest_action(action, motor, excess):
    violation = judged(third(action=action), "paper").violation
    assert violation.kind == "torque"
    assert violation.index == motor
    assert (violation.excess, violation.time) == pytest.approx((excess, 2 * PERIOD))


def of_error(fraction):
    return {"position": fraction * BOUNDS.position}


def of_rotation(fraction):
    return {"rotation": fraction * BOUNDS.rotation}


def of_tension(fraction):
    return {"tension": (9.0, 1.0 / fraction, 8.0)}


def of_largest_tension(fraction):
    return {"largest": (9.0, 50.0 * fraction, 8.0)}


def of_action(fraction):
    return {"action": (0.1, -fraction, 0.2)}


LEADS = [
    # fractions of the limit at the start and at each step, and steps of the lead
    ([0.1, 0.5, 0.89, 1.1], 0),
    ([0.1, 0.5, 0.91, 0.95, 1.1], 2),
    ([0.1, 0.95, 0.89, 0.91, 1.1], 1),
    ([0.1, 0.95, 0.95, 0.89, 1.1], 0),
]


@pytest.mark.parametrize(("fractions", "steps"), LEADS)
@pytest.mark.parametrize(
    "change", [of_error, of_rotation, of_tension, of_largest_tension, of_action]
)
def test_lead_is_the_last_time_span_beyond_nine_tenths_of_the_limit(change, fractions, steps):
    criterion = "paper" if change is of_action else "task"
    script = [change(fraction) for fraction in fractions]
    violation = judged(script, criterion).violation
    assert violation.lead == pytest.approx(steps * PERIOD)
    # an earlier episode leaves nothing
    env = DLCCMonitor(Scripted(script), criterion=criterion)
    for _ in range(2):
        env.reset()
        for _ in script:
            env.step(np.zeros(3))
    assert env.verdict.violation == violation


def test_lead_needs_an_approach_to_the_limit():
    assert judged(third(terminated=True)).violation.lead is None
    assert judged(third(slack=(2,)), "paper").violation.lead is None


@pytest.mark.parametrize(("slack", "cable"), [((1,), 1), ((3,), 3), ((3, 2), 2)])
def test_slack_violation_names_the_first_slack_cable(slack, cable):
    violation = judged(third(slack=slack), "paper").violation
    assert violation == Violation(kind="slack", index=cable, time=3 * PERIOD, excess=None)
    assert str(violation) == f"cable {cable} is slack at t = 0.006 s"


def test_low_tension_violates_the_task_criterion_only():
    low = third(tension=(1.0, 0.4, 0.7))
    violation = judged(low).violation
    assert (violation.kind, violation.index) == ("slack", 2)
    assert (violation.bound, violation.excess) == (1.0, 0.6)
    assert str(violation) == "cable 2 falls below its tension bound of 1 N at t = 0.006 s"
    assert judged(third(tension=(1.0, 1.0, 1.0))).carried
    assert judged(low, "paper").carried
    assert judged(low, cable="bilateral").carried, "a bilateral cable may push"


def test_high_tension_violates_the_task_criterion_only():
    high = third(largest=(40.0, 50.5, 50.2))
    violation = judged(high).violation
    assert (violation.kind, violation.index) == ("overload", 2)
    assert (violation.bound, violation.excess) == (50.0, 0.5)
    assert str(violation) == "cable 2 exceeds its largest tension of 50 N at t = 0.006 s"
    assert judged(high, cable="bilateral").violation == violation
    assert judged(high, "paper").carried


def test_weak_motor_at_the_start_violates_the_task_criterion():
    start = {"action": (0.1, 0.2, 1.1)}  # margins of 4.5, 4.8 and -0.7 N·m
    violation = judged([{}] * 4, start=start).violation
    assert (violation.kind, violation.index, violation.time) == ("torque", 3, 0.0)
    assert violation.excess == pytest.approx(0.7)
    assert str(violation) == "motor 3 cannot hold the robot at rest at t = 0.000 s"
    assert judged([{}] * 4, start=start, starts_at_rest=False).carried
    assert judged([{}] * 4, "paper", start=start).carried


def test_judge_reads_the_task_only_at_the_reset():
    env = DLCCMonitor(Scripted(third(position=0.015)))
    env.reset()
    changes = {"error_bounds": ErrorBounds(position=1.0), "steps": 1}
    for name, value in changes.items():
        object.__setattr__(env.env.task, name, value)
    for _ in range(5):
        env.step(np.zeros(3))
    assert env.verdict.violation.kind == "position"


def test_error_violations_state_bound_and_time():
    for criterion in ("task", "paper"):
        position = judged(third(position=0.013), criterion).violation
        assert (position.kind, position.index, position.bound) == ("position", None, 0.01)
        assert (position.time, position.excess) == pytest.approx((3 * PERIOD, 0.003))
    rotation = judged(third(rotation=0.025)).violation
    assert (rotation.kind, rotation.bound) == ("rotation", 0.02)
    assert rotation.excess == pytest.approx(0.005)
    assert str(rotation) == "rotation error reaches its bound of 20 mrad at t = 0.006 s"


@pytest.mark.parametrize(
    ("criterion", "name", "within", "beyond", "kind"),
    [
        ("paper", "action", (1.0, -1.0, 1.0 + 1e-13), (1.0, -1.0 - 1e-9, 1.0), "torque"),
        ("paper", "position", 0.01, math.nextafter(0.01, 1), "position"),
        ("task", "rotation", 0.02, math.nextafter(0.02, 1), "rotation"),
        ("task", "largest", (9, 50.0, 9), (9, math.nextafter(50, 51), 9), "overload"),
    ],
)
def test_bound_itself_is_within_the_limit(criterion, name, within, beyond, kind):
    assert judged(third(**{name: within}), criterion).carried
    assert judged(third(**{name: beyond}), criterion).violation.kind == kind


EVENTS = {
    "torque": {"action": (0.0, 2.0, 0.0)},
    "slack": {"slack": (3,)},
    "overload": {"largest": (9, 9, 99)},
    "position": {"position": 0.05},
    "rotation": {"rotation": 0.05},
    "terminated": {"terminated": True},
}
"""Changes by kind, in the order of the checks within one step."""


@pytest.mark.parametrize("start", range(len(EVENTS)))
@each_criterion
def test_violations_of_one_step_have_a_fixed_order(criterion, start):
    assert tuple(EVENTS) == KINDS
    together = {}
    for kind in KINDS[start:]:
        together |= EVENTS[kind]
    unchecked = {"task": ("torque",), "paper": ("overload", "rotation")}[criterion]
    expected = next(kind for kind in KINDS[start:] if kind not in unchecked)
    violation = judged(third(**together), criterion).violation
    assert violation.kind == expected
    assert violation.time == pytest.approx((2 if expected == "torque" else 3) * PERIOD)


def test_later_violation_does_not_replace_the_first():
    before = {"action": (0.5, 0.1, 0.1), "tension": (9, 8, 6.5)}
    violation = {"position": 0.02, "rotation": 0.004, "action": (0.1, -0.9, 0.1)}
    later = {"position": 0.09, "rotation": 0.9, "action": (4.0, 4.0, 4.0)}
    later |= {"tension": (0, 0, 0), "slack": (1,)}
    verdict = judged([before, violation | {"tension": (5, 9, 9)}, later])
    assert (verdict.violation.kind, verdict.violation.time) == ("position", 2 * PERIOD)
    assert verdict.violation.excess == pytest.approx(0.01)
    assert verdict.peak_action == (0.5, 0.9, 0.1)
    peaks = (verdict.position_peak, verdict.rotation_peak, verdict.least_tension)
    assert peaks == (0.02, 0.004, 5.0)


def test_errors_at_the_start_count():
    for criterion in ("task", "paper"):
        position = judged([{}] * 4, criterion, start={"position": 0.011}).violation
        assert (position.kind, position.time) == ("position", 0.0)
        assert position.excess == pytest.approx(0.001)
    start = {"rotation": 0.03}
    rotation = judged([{}] * 4, start=start).violation
    assert (rotation.kind, rotation.time) == ("rotation", 0.0)
    assert judged([{}] * 4, "paper", start=start).carried


def test_tensions_and_actions_of_the_reset_do_not_count():
    """No control period has passed at the reset, where an environment returns zeros."""
    verdict = judged([{}] * 4, "paper", start={"tension": (0, 0, 0), "action": (0, 0, 0)})
    assert verdict.carried
    assert verdict.least_tension == 7.0


# --- the monitor ------------------------------------------------------------------------------------------------------


def test_payload_is_carried_at_the_end_of_the_motion_only():
    env = DLCCMonitor(Scripted([{}, {}, {"position": 0.5, "slack": (1,)}], steps=2))
    _, info = env.reset()
    assert info["dlcc_carried"] is False
    assert [env.step(np.zeros(3))[4]["dlcc_carried"] for _ in range(3)] == [False, True, True]
    assert env.verdict.position_peak == 0.001, "steps after the motion do not count"


def test_reset_starts_a_new_verdict():
    env = DLCCMonitor(Scripted(third(slack=(2,))))
    with pytest.raises(ResetNeeded, match=r"call reset\(\) before verdict"):
        _ = env.verdict
    env.reset()
    assert [env.step(np.zeros(3))[4]["dlcc_carried"] for _ in range(5)] == [False] * 5
    assert env.verdict.violation.kind == "slack"
    env.reset()
    assert not env.verdict.carried
    assert env.verdict.violation is None
    assert env.verdict.peak_action == (0, 0, 0)


def test_bounds_of_the_reset_option_reach_the_monitor():
    env = DLCCMonitor(gym.make(IDS["planar"]))
    short = {"trajectory": {"name": "line-planar", "duration": 0.7}}
    for options, carried in (({}, True), ({"error_bounds": {"position": 1e-5}}, False), ({}, True)):
        verdict = play(env, FeedbackLinearization(PLANAR), short | options)
        assert verdict.carried is carried


@pytest.mark.parametrize(
    ("kind", "criterion"), [("planar", "task"), ("spatial", "paper"), ("spatial", "task")]
)
def test_monitor_agrees_with_the_evaluator(kind, criterion):
    motion = {"trajectory": {"name": f"paper-{kind}", "duration": 1.0}}
    fl = FeedbackLinearization(ROBOTS[kind])
    result = evaluate_dlcc(fl, IDS[kind], criterion=criterion, resolution=0.01, **motion)
    assert 0 < result.resolution <= 0.01
    env = DLCCMonitor(gym.make(IDS[kind], **motion), criterion=criterion)
    below = play(env, fl, {"payload": result.payload})
    above = play(env, fl, {"payload": result.failed_payload})
    assert (below.carried, above.carried) == (True, False)
    excess = pytest.approx(result.violation.excess, rel=1e-6)
    assert above.violation == replace(result.violation, excess=excess)
    margins = result.details.margins
    assert 1 - max(below.peak_action) == pytest.approx(margins["torque"], abs=1e-12)
    assert 1 - below.position_peak / 0.01 == pytest.approx(margins["position"], abs=1e-9)
    assert below.least_tension == pytest.approx(margins["tension"])
