"""Effects of constructor keywords and reset options, and how long they last."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import (
    FLEX_SPATIAL,
    PLANAR,
    ROBOTS,
    SPATIAL,
    different_results,
    make,
    make_vector,
    rollout,
    two_ids,
)
from scipy import stats

from cablebot_gym.physics import textbook


def test_payloads_and_start_errors_are_uniform_and_independent():
    """The drawn error is added to the start pose, or to the keyword ``initial_error`` in its place."""
    widths = np.array([0.002, 0.0, 0.001, 0.003, 0.0, 0.001])
    ranges = {"payload_range": (2.0, 3.0), "initial_error_range": widths}
    env, moved = (
        make_vector(SPATIAL, 400, trajectory="dwell-spatial", **ranges, **keywords)
        for keywords in ({}, {"initial_error": np.full(6, 0.01)})
    )
    payloads = env.reset(seed=0)[1]["payload"]
    shift = env.pose - env.tasks[0].start_pose
    moved.reset(seed=0)
    start = moved.tasks[0].trajectory(0.0).position + 0.01
    assert_allclose(moved.pose - start, shift, atol=1e-15)
    drawn = np.column_stack([payloads - 2.5, shift[:, widths > 0]]) / [0.5, *widths[widths > 0]]
    assert not np.any(shift[:, widths == 0])
    for column in drawn.T:
        assert stats.kstest(column, stats.uniform(-1, 2).cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(drawn.T) - np.eye(5)).max() < 0.2
    given = {"payload": 7.0, "initial_error": 0.0}
    assert env.reset(options=given)[1]["payload"].tolist() == [7.0] * 400
    assert not np.ptp(env.pose, axis=0).any()


CASES = {
    "payload": (2.0, "start rewards payload tracking_error", ""),
    "payload_known": (False, "start", "rewards payload tracking_error"),
    "model_payload_factor": (0.5, "start", "rewards payload tracking_error tensions"),
    "trajectory": ("line-planar", "start rewards tensions", "payload"),
    "initial_error": ([0.001, 0.0], "start rewards tracking_error", "payload"),
    "uncertainty": (
        "hardware",
        "start rewards commanded_action torques tracking_error",
        "terminated",
    ),
    "error_bounds": ({"position": 0.02}, "rewards reward_position", "observations"),
}
"""A value other than the default, the results that must change with it, and those that must not."""


def episode(env, **reset):
    return rollout(env, np.full((2, *env.action_space.shape), 0.3), **reset)


@pytest.mark.parametrize("name", CASES)
def test_keyword_has_its_effect_and_an_option_has_it_for_one_episode(name):
    value, changes, keeps = CASES[name]
    value = {name: value}
    loaded = {"payload": 1.0}
    env = make(PLANAR, **loaded)
    default = episode(env, seed=0)
    changed = episode(make(PLANAR, **loaded | value), seed=0)
    different = different_results(default, changed)
    assert {*changes.split()} <= different
    assert not {*keeps.split()} & different
    assert not different_results(changed, episode(env, seed=0, options=value))
    assert not different_results(default, episode(env))


# --- random starts ------------------------------------------------------------------------------------------------


@two_ids
def test_torques_after_a_reset_hold_the_true_robot_at_rest(env_id):
    """With the true mass and anchors: in the second environment beyond what the motors can hold."""
    robot = ROBOTS[env_id]
    anchors = {"low": -0.01, "high": 0.01, "relative": False}
    parameters = {"payload": {"low": 0.2, "high": 0.3}, "base_anchors": anchors}
    env = make_vector(
        env_id,
        2,
        payload=[1.0, 5.0 if robot.planar else 14.0],
        uncertainty={"parameters": parameters},
        trajectory=f"dwell-{robot.kind}",
    )
    _, info = env.reset(seed=0)
    margin = robot.stall_torque - np.abs(info["torques"])
    assert_allclose(info["torque_margin"], margin, rtol=1e-14)
    assert (margin.min(axis=1) < 0).tolist() == [False, not robot.planar]
    start = env.pose
    for _ in range(20):
        env.step(info["torques"] / robot.stall_torque)
    moved = np.abs(env.pose - start).max(axis=1)
    assert moved[0] < 1e-9
    assert robot.planar or moved[1] > 1e-4


def test_redundant_cables_hold_each_payload_after_a_reset():
    """Torques that environments share, and keep from one reset to the next, are those of the
    present mass."""
    env = make_vector("CableBot-Point-v0", 2)
    robot = env.settings.robot
    for payload in (0.0, 5.0):
        _, info = env.reset(options={"payload": payload})
        torques = textbook.static_torque(robot, robot.mass + payload, env.pose)
        assert_array_equal(info["torques"], torques)


@pytest.mark.parametrize("payload", [1.0, 14.0])
def test_delayed_motors_start_within_the_stall_torque(payload):
    robot = ROBOTS[FLEX_SPATIAL]
    parameters = {"motor_strength": {"low": -0.1, "high": -0.05}}
    env = make(FLEX_SPATIAL, payload=payload, uncertainty={"parameters": parameters, "delay": 2})
    observation, info = env.reset(seed=0)
    stall = env.truth["motor_strength"]
    held = np.minimum(info["torques"], stall)
    assert (held < info["torques"]).any() == (payload == 14.0)
    twist = env.layout.split(observation)["motor_angle"] - textbook.pulley_angle(robot, env.pose)
    assert_allclose(robot.stiffness * twist, held, rtol=1e-9)
    commanded = rollout(env, np.zeros((3, 6)), seed=0).info["commanded_action"]
    assert_allclose(commanded[1:3], [held / stall] * 2, rtol=1e-9)
    assert not commanded[3].any()


# --- physics steps ------------------------------------------------------------------------------------------------


STIFF = {"parameters": {"stiffness": {"low": 0.0, "high": 8000.0}}}


def test_physics_step_must_suit_the_stiffest_springs():
    """The default number of substeps is sufficient."""
    with pytest.raises(ValueError, match="substeps=1 is too small") as refusal:
        make(FLEX_SPATIAL, uncertainty=STIFF, substeps=1)
    least = int(str(refusal.value).split("at least ")[1].split(",")[0])
    stiffest = make_vector(FLEX_SPATIAL, 2, uncertainty=[None, STIFF])
    assert stiffest.settings.substeps >= least
