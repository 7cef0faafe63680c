"""The judge on hand-made episodes, and the monitor on live ones."""

from __future__ import annotations

import math
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from cablebot_baselines.classical import FeedbackLinearization
from cablebot_gym.evaluation import DLCCMonitor, ErrorBounds, Verdict, evaluate_dlcc
from cablebot_gym.evaluation.constraints import Judge
from cablebot_gym.robots import PLANAR, SPATIAL

ROBOTS = {"planar": PLANAR, "spatial": SPATIAL}
IDS = {"planar": "CableBot-Planar-v0", "spatial": "CableBot-Spatial-v0"}
STALL = np.array([5.0, 6.0, 7.0])
"""τ_s of the hand-made robot [N·m]: all different, so that no motor's can stand for another's."""
PERIOD = 0.002
LIMITS = ErrorBounds(position=0.01, rotation=0.02)

each_criterion = pytest.mark.parametrize("criterion", ["task", "paper"])


class Scripted(gym.Env):
    """An environment whose ``info`` is written down: one dict of what differs from an uneventful step, per step."""

    def __init__(self, script, *, start=None, steps=None):
        self.action_space = gym.spaces.Box(-1, 1, (3,))
        self.observation_space = gym.spaces.Box(-1, 1, (1,), dtype=np.float64)
        self.script, self.start = script, start or {}
        self.task = SimpleNamespace(
            error_bounds=LIMITS, robot=SimpleNamespace(cables=3), steps=len(script) if steps is None else steps
        )

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.step_ = 0
        return np.zeros(1), info_of(0, **self.start)

    def step(self, action):
        change = dict(self.script[self.step_])
        self.step_ += 1
        terminated, truncated = change.pop("terminated", False), change.pop("truncated", False)
        return np.zeros(1), 0.0, terminated, truncated, info_of(self.step_, **change)


def info_of(step, *, payload=1.5, position=0.001, rotation=0.001, action=(0.1, -0.2, 0.3), slack=(), tension=(9, 8, 7)):
    """One step's info as a single environment gives it."""
    return {
        "time": step * PERIOD,
        "action_time": max(step - 1, 0) * PERIOD,
        "payload": payload,
        "tracking_error": position / 2,
        "rotation_error": rotation / 2,
        "tracking_error_peak": position,
        "rotation_error_peak": rotation,
        "commanded_action": np.array(action),
        "torque_margin": STALL * (1 - np.abs(action)),
        "slack": np.array([cable in slack for cable in (1, 2, 3)]),
        "tensions": np.array(tension, float),
        "termination_reason": "",
    }


def judged(script, criterion="task", **keywords):
    """The verdict on a hand-made episode."""
    env = DLCCMonitor(Scripted(script, **keywords), criterion=criterion)
    env.reset()
    for _ in script:
        env.step(np.zeros(3))
    return env.verdict


def bad(**change):
    """Five steps, the third of which is eventful."""
    return [{}, {}, change, {}, {}]


# --- what is detected -------------------------------------------------------------------------------------------------


@each_criterion
def test_uneventful_motion_does_not_fail(criterion):
    verdict = judged([{}] * 5, criterion)
    assert verdict == Verdict(
        carried=True,
        complete=True,
        violation=None,
        payload=1.5,
        peak_action=(0.1, 0.2, 0.3),
        position_peak=0.001,
        rotation_peak=0.001,
        least_tension=7.0,
    )


@pytest.mark.parametrize(
    ("action", "motor", "excess"),
    [
        ((1.1, 0.0, 0.0), 1, 0.5),
        ((0.0, -1.1, 0.0), 2, 0.6),
        ((0.0, 0.0, 1.1), 3, 0.7),
        ((1.1, -1.3, 1.2), 2, 1.8),
        ((-1.3, 1.1, 1.2), 1, 1.5),
    ],
)
def test_motor_beyond_its_line_is_not_another_one_nor_counted_from_0(action, motor, excess):
    violation = judged(bad(action=action), "paper").violation
    assert (violation.kind, violation.index) == ("torque", motor)
    assert violation.excess == pytest.approx(excess)
    assert violation.time == pytest.approx(2 * PERIOD), "the instant of the command, not the end of its period"


@each_criterion
@pytest.mark.parametrize(("slack", "cable"), [((1,), 1), ((2,), 2), ((3,), 3), ((3, 2), 2)])
def test_slack_cable_is_not_another_one_nor_counted_from_0(criterion, slack, cable):
    violation = judged(bad(slack=slack), criterion).violation
    assert (violation.kind, violation.index, violation.excess) == ("slack", cable, None)
    assert violation.time == pytest.approx(3 * PERIOD)


@each_criterion
def test_position_error_is_not_overlooked(criterion):
    violation = judged(bad(position=0.013), criterion).violation
    assert (violation.kind, violation.index) == ("position", None)
    assert (violation.time, violation.excess) == pytest.approx((3 * PERIOD, 0.003))


def test_rotation_error_is_not_overlooked_nor_held_against_the_bound_of_the_position():
    violation = judged(bad(rotation=0.025), "task").violation
    assert (violation.kind, violation.index) == ("rotation", None)
    assert (violation.time, violation.excess) == pytest.approx((3 * PERIOD, 0.005))
    assert judged(bad(rotation=0.015), "task").carried


@each_criterion
def test_termination_does_not_count_as_carried(criterion):
    violation = judged(bad(terminated=True), criterion).violation
    assert (violation.kind, violation.index, violation.excess) == ("terminated", None, None)
    assert violation.time == pytest.approx(3 * PERIOD)


@pytest.mark.parametrize(
    ("criterion", "change"),
    [("task", {"action": (1.5, -9.0, 0.0)}), ("paper", {"rotation": 3.0}), ("task", {"action": (1.5, 0, 0)})],
)
def test_criterion_does_not_judge_by_a_limit_of_the_other(criterion, change):
    assert judged(bad(**change), criterion).carried


@pytest.mark.parametrize(
    ("criterion", "change"),
    [
        ("paper", {"action": (1.0, -1.0, 1.0 + 1e-13)}),
        ("task", {"position": 0.01}),
        ("task", {"rotation": 0.02}),
    ],
)
def test_value_on_its_bound_does_not_fail(criterion, change):
    assert judged(bad(**change), criterion).carried


@pytest.mark.parametrize(
    ("criterion", "change", "kind"),
    [
        ("paper", {"action": (1.0, -1.0 - 1e-9, 1.0)}, "torque"),
        ("paper", {"position": math.nextafter(0.01, 1)}, "position"),
        ("task", {"rotation": math.nextafter(0.02, 1)}, "rotation"),
    ],
)
def test_value_just_beyond_its_bound_is_not_carried(criterion, change, kind):
    verdict = judged(bad(**change), criterion)
    assert not verdict.carried
    assert verdict.violation.kind == kind


EVERYTHING = {
    "torque": {"action": (0.0, 2.0, 0.0)},
    "slack": {"slack": (3,)},
    "position": {"position": 0.05},
    "rotation": {"rotation": 0.05},
    "terminated": {"terminated": True},
}
"""In the order in which they count within one step."""


@pytest.mark.parametrize("place", range(len(EVERYTHING)))
@each_criterion
def test_consequence_in_the_same_step_is_not_named_before_its_cause(criterion, place):
    together = {key: value for change in list(EVERYTHING.values())[place:] for key, value in change.items()}
    unjudged = {"task": "torque", "paper": "rotation"}[criterion]
    expected = next(kind for kind in list(EVERYTHING)[place:] if kind != unjudged)
    assert judged(bad(**together), criterion).violation.kind == expected


@each_criterion
def test_later_failure_does_not_replace_the_first(criterion):
    script = [{}, {"terminated": False, "position": 0.02}, {"slack": (1,), "action": (3.0, 0, 0)}, {"position": 0.09}]
    violation = judged(script, criterion).violation
    assert (violation.kind, violation.time, violation.excess) == (
        "position",
        pytest.approx(2 * PERIOD),
        pytest.approx(0.01),
    )


@each_criterion
def test_error_at_the_start_is_not_forgotten(criterion):
    verdict = judged([{}] * 4, criterion, start={"position": 0.011})
    assert not verdict.carried
    assert (verdict.violation.kind, verdict.violation.time) == ("position", 0.0)
    assert verdict.violation.excess == pytest.approx(0.001)


def test_rotation_at_the_start_is_not_forgotten():
    violation = judged([{}] * 4, "task", start={"rotation": 0.03}).violation
    assert (violation.kind, violation.time) == ("rotation", 0.0)
    assert judged([{}] * 4, "paper", start={"rotation": 0.03}).carried


def test_tensions_and_demands_of_the_reset_are_not_judged():
    # No control period has passed at reset; an environment gives zeros there.
    verdict = judged([{}] * 4, "paper", start={"tension": (0, 0, 0), "action": (0, 0, 0)})
    assert verdict.carried
    assert verdict.least_tension == 7.0


# --- peaks ------------------------------------------------------------------------------------------------------------


def test_peaks_do_not_go_on_after_the_failure():
    script = [
        {"action": (0.5, 0.1, 0.1), "tension": (9, 8, 6.5)},
        {"position": 0.02, "rotation": 0.004, "action": (0.1, -0.9, 0.1), "tension": (5, 9, 9)},
        {"position": 0.09, "rotation": 0.9, "action": (4.0, 4.0, 4.0), "tension": (0, 0, 0)},
    ]
    verdict = judged(script)
    assert verdict.peak_action == (0.5, 0.9, 0.1)
    assert (verdict.position_peak, verdict.rotation_peak, verdict.least_tension) == (0.02, 0.004, 5.0)


def test_failure_of_one_lane_does_not_end_the_watch_over_another():
    judge = Judge("task", LIMITS, 3, 3)
    judge.reset(stacked([info_of(0, payload=p) for p in (1.0, 2.0, 3.0)]))
    none = np.zeros(3, np.bool_)
    judge.observe(stacked([info_of(1), info_of(1, position=0.03), info_of(1)]), none)
    judge.observe(stacked([info_of(2, position=0.004), info_of(2, position=0.05), info_of(2, slack=(2,))]), none)
    judge.observe(stacked([info_of(3), info_of(3), info_of(3)]), np.array([False, True, True]))
    verdicts = [judge.verdict(index, complete=True) for index in range(3)]
    assert judge.failed.tolist() == [False, True, True]
    assert [verdict.payload for verdict in verdicts] == [1.0, 2.0, 3.0]
    assert [verdict.position_peak for verdict in verdicts] == [0.004, 0.03, 0.001]
    assert verdicts[0].carried
    assert [(v.violation.kind, v.violation.index) for v in verdicts[1:]] == [("position", None), ("slack", 2)]


def stacked(infos):
    return {name: np.array([info[name] for info in infos]) for name in infos[0]}


# --- the monitor ------------------------------------------------------------------------------------------------------


def test_half_a_motion_is_not_carried():
    env = DLCCMonitor(Scripted([{}] * 3 + [{}] * 2))
    _, info = env.reset()
    assert info["dlcc_carried"] is False
    flags = [env.step(np.zeros(3))[4]["dlcc_carried"] for _ in range(5)]
    assert flags == [False, False, False, False, True]


def test_failed_motion_is_not_carried_at_its_end():
    env = DLCCMonitor(Scripted(bad(position=0.02)))
    env.reset()
    assert [env.step(np.zeros(3))[4]["dlcc_carried"] for _ in range(5)] == [False] * 5
    assert (env.verdict.complete, env.verdict.carried) == (True, False)


def test_what_comes_after_the_motion_is_not_judged():
    env = DLCCMonitor(Scripted([{}, {}, {"position": 0.5, "slack": (1,)}], steps=2))
    env.reset()
    infos = [env.step(np.zeros(3))[4] for _ in range(3)]
    assert [info["dlcc_carried"] for info in infos] == [False, True, True]
    assert env.verdict.position_peak == 0.001


def test_verdict_is_not_that_of_the_episode_before():
    env = DLCCMonitor(Scripted(bad(slack=(2,))))
    env.reset()
    for _ in range(3):
        env.step(np.zeros(3))
    assert env.verdict.violation.kind == "slack"
    env.reset()
    assert env.verdict.violation is None
    assert (env.verdict.carried, env.verdict.complete, env.verdict.peak_action) == (False, False, (0, 0, 0))


def test_verdict_before_the_first_reset_is_not_made_up():
    env = DLCCMonitor(gym.make(IDS["planar"]))
    with pytest.raises(ResetNeeded, match=r"call reset\(\) before verdict"):
        _ = env.verdict


@pytest.mark.parametrize("criterion", ["Task", "", "both", "papers"])
def test_unknown_criterion_is_not_accepted(criterion):
    with pytest.raises(ValueError, match="choose one of task, paper"):
        DLCCMonitor(gym.make(IDS["planar"]), criterion=criterion)


def test_limits_of_the_monitor_are_not_those_of_the_episode_unless_none():
    script = bad(position=0.015)
    for error_bounds, carried in (
        (None, False),
        (ErrorBounds(position=0.02), True),
        (ErrorBounds(position=0.0005), False),
    ):
        env = DLCCMonitor(Scripted(script), error_bounds=error_bounds)
        env.reset()
        for _ in script:
            env.step(np.zeros(3))
        assert env.verdict.carried is carried


def test_limits_of_the_option_are_not_those_of_the_constructor():
    env = DLCCMonitor(gym.make(IDS["planar"], error_bounds={"position": 0.01}))
    fl = FeedbackLinearization(PLANAR)
    for options, carried in (({}, True), ({"error_bounds": {"position": 1e-5}}, False), ({}, True)):
        verdict = play(env, fl, options)
        assert verdict.carried is carried
    assert verdict.violation is None


def test_monitor_does_not_change_what_the_loop_sees():
    plain, watched = gym.make(IDS["spatial"]), DLCCMonitor(gym.make(IDS["spatial"]))
    pairs = [(plain.reset(seed=3), watched.reset(seed=3))]
    action = np.full(6, 0.4)
    pairs += [(plain.step(action), watched.step(action)) for _ in range(3)]
    for one, other in pairs:
        np.testing.assert_array_equal(one[0], other[0])
        assert one[1:-1] == other[1:-1]
        assert set(other[-1]) - set(one[-1]) == {"dlcc_carried"}


def test_time_limit_is_not_taken_for_the_end_of_the_motion():
    env = DLCCMonitor(
        gym.make(IDS["planar"], trajectory={"name": "circle-planar", "duration": 1.0}, max_episode_steps=90)
    )
    observation, _ = env.reset(seed=0)
    fl, truncated = FeedbackLinearization(PLANAR), False
    while not truncated:
        observation, _, terminated, truncated, info = env.step(fl.predict(observation)[0])
        assert not terminated
    assert (info["dlcc_carried"], env.verdict.complete, env.verdict.violation) == (False, False, None)


def test_initial_error_beyond_the_bound_is_not_forgiven():
    env = DLCCMonitor(gym.make(IDS["planar"]))
    env.reset(options={"initial_error": [0.006, 0.0085]})
    violation = env.verdict.violation
    assert (violation.kind, violation.time) == ("position", 0.0)
    assert violation.excess == pytest.approx(math.hypot(0.006, 0.0085) - 0.01)
    env.reset(options={"initial_error": [0.006, 0.0075]})
    assert env.verdict.violation is None


def play(env, policy, options):
    """The verdict on a whole motion, or until it ends."""
    observation, _ = env.reset(seed=0, options=options)
    terminated = False
    while not (env.verdict.complete or terminated):
        observation, _, terminated, _, _ = env.step(policy.predict(observation)[0])
    return env.verdict


@pytest.mark.parametrize("criterion", ["task", "paper"])
@pytest.mark.parametrize("kind", ["planar", "spatial"])
def test_monitor_does_not_contradict_the_evaluator(kind, criterion):
    trajectory = {"name": f"paper-{kind}", "duration": 1.0}
    fl = FeedbackLinearization(ROBOTS[kind])
    result = evaluate_dlcc(fl, IDS[kind], criterion=criterion, trajectory=trajectory, resolution=0.01)
    assert 0 < result.resolution <= 0.01
    env = DLCCMonitor(gym.make(IDS[kind], trajectory=trajectory), criterion=criterion)
    below = play(env, fl, {"payload": result.payload})
    above = play(env, fl, {"payload": result.payload + result.resolution})
    assert (below.carried, above.carried) == (True, False)
    assert (below.payload, above.payload) == (result.payload, result.payload + result.resolution)
    assert (above.violation.kind, above.violation.index, above.violation.time) == (
        result.violation.kind,
        result.violation.index,
        result.violation.time,
    )
    assert above.violation.excess == pytest.approx(result.violation.excess, rel=1e-6)
    assert 1 - max(below.peak_action) == pytest.approx(result.margins["torque"], abs=1e-12)
