"""Reset options and constructor keywords: their effects, their duration and their checks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.episodes import (
    FLEX_SPATIAL,
    PLANAR,
    ROBOTS,
    SPATIAL,
    check_equal,
    different_results,
    make,
    make_vector,
    paper_ids,
    rigid_ids,
    rollout,
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
    assert_allclose(
        moved.pose - moved.tasks[0].trajectory(0.0).position - 0.01,
        shift,
        atol=1e-15,
    )
    drawn = np.column_stack([payloads - 2.5, shift[:, widths > 0]]) / [0.5, *widths[widths > 0]]
    assert not np.any(shift[:, widths == 0])
    for column in drawn.T:
        assert stats.kstest(column, stats.uniform(-1, 2).cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(drawn.T) - np.eye(5)).max() < 0.2
    assert env.reset(options={"payload": 7.0})[1]["payload"].tolist() == [7.0] * 400
    assert not np.intersect1d(env.reset()[1]["payload"], payloads).size  # without a seed


@dataclass(frozen=True)
class Case:
    """A value other than the default, the results that must change with it, and those that must
    not."""

    value: Any
    """A function of the robot, or the value."""
    changes: set[str]
    keeps: set[str] = field(default_factory=set)
    base: dict[str, Any] = field(default_factory=dict)
    """Keywords of both environments."""
    action: float = 0.3
    steps: int = 2

    def of(self, env_id):
        return self.value(ROBOTS[env_id]) if callable(self.value) else self.value


def millimetre(robot):
    """Initial error of one millimetre in x."""
    return [0.001] + [0.0] * (robot.coordinates - 1)


OPTIONS = {
    "payload": Case(2.0, {"start", "rewards", "payload", "tracking_error"}),
    "payload_known": Case(
        False,
        {"start"},
        {"rewards", "payload", "tracking_error"},
        {"payload": 2.0},
    ),
    "model_payload_factor": Case(
        0.5,
        {"start"},
        {"rewards", "payload", "tracking_error", "tensions"},
        {"payload": 2.0},
    ),
    "trajectory": Case(lambda robot: f"line-{robot.kind}", {"start", "rewards", "tensions"}),
    "initial_error": Case(millimetre, {"start", "rewards", "tracking_error"}),
    "uncertainty": Case(
        {
            "parameters": {"platform_mass": {"low": 0.1, "high": 0.2}},
            "wrench": {"force_std": 1.0},
            "sensors": {"position": 1e-4},
            "delay": 1,
        },
        {"start", "rewards", "commanded_action", "torques", "tracking_error"},
        {"payload", "terminated"},
    ),
    "error_bounds": Case(
        {"position": 0.02, "rotation": 0.02},
        {"rewards", "reward_position"},
        {"observations"},
        {"initial_error": 0.0},  # the bound also sets the start pose of spatial robots
    ),
}
KEYWORDS = {
    "payload_range": Case((1.0, 2.0), {"start", "payload"}),
    "initial_error_range": Case(millimetre, {"start", "tracking_error"}),
    "robot": Case(
        lambda robot: robot.replace(mass=robot.mass * 1.5),
        {"observations", "tensions"},
        {"start"},
    ),
    "cable": Case("bilateral", {"observations", "tensions"}, {"start"}, action=-0.3),
    "control_frequency": Case(250.0, {"observations", "time", "tracking_error"}),
    "substeps": Case(7, {"observations"}, {"start", "time"}, action=0.5, steps=5),
    "reward_weights": Case(
        {"position": 3.0},
        {"rewards", "reward_position"},
        {"observations", "terminated"},
    ),
}


def episode(env, case, **reset):
    return rollout(
        env,
        np.full((case.steps, *env.action_space.shape), case.action),
        **reset,
    )


@pytest.mark.parametrize("name", KEYWORDS)
def test_constructor_keyword_has_its_effect(name):
    case = KEYWORDS[name]
    default = episode(make(PLANAR, **case.base), case, seed=0)
    changed = episode(
        make(PLANAR, **case.base, **{name: case.of(PLANAR)}),
        case,
        seed=0,
    )
    different = different_results(default, changed)
    assert case.changes <= different
    assert not case.keeps & different


@rigid_ids
@pytest.mark.parametrize("name", OPTIONS)
def test_option_has_the_effect_of_its_keyword_for_one_episode(env_id, name):
    case = OPTIONS[name]
    env = make(env_id, **case.base)
    default = episode(env, case, seed=0)
    changed = episode(env, case, seed=0, options={name: case.of(env_id)})
    different = different_results(default, changed)
    assert case.changes <= different
    assert not case.keeps & different
    assert not different_results(default, episode(env, case))
    constructed = episode(
        make(env_id, **case.base, **{name: case.of(env_id)}),
        case,
        seed=0,
    )
    assert not different_results(changed, constructed)


# --- random starts ------------------------------------------------------------------------------------------------


@paper_ids
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
        minimum = textbook.allocated_minimum(robot)
        torques = textbook.static_torque(
            robot,
            robot.mass + payload,
            env.pose,
            minimum=minimum,
        )
        assert_array_equal(info["torques"], torques)


@pytest.mark.parametrize("payload", [1.0, 14.0])
def test_delayed_motors_start_within_the_stall_torque(payload):
    robot = ROBOTS[FLEX_SPATIAL]
    parameters = {"motor_strength": {"low": -0.1, "high": -0.05}}
    env = make(
        FLEX_SPATIAL,
        payload=payload,
        uncertainty={"parameters": parameters, "delay": 2},
    )
    observation, info = env.reset(seed=0)
    stall = env.truth["motor_strength"]
    held = np.minimum(info["torques"], stall)
    assert (held < info["torques"]).any() == (payload == 14.0)
    twist = env.layout.split(observation)["motor_angle"] - textbook.pulley_angle(robot, env.pose)
    assert_allclose(robot.stiffness * twist, held, rtol=1e-9)
    commanded = rollout(env, np.zeros((3, 6)), seed=0).info["commanded_action"]
    assert_allclose(commanded[1:3], [held / stall] * 2, rtol=1e-9)
    assert not commanded[3].any()


# --- payload and its model ----------------------------------------------------------------------------------------


def test_model_payload_factor_applies_to_the_nominal_payload():
    """To a drawn one, too, and not to what uncertainty adds."""
    env = make(PLANAR, payload_range=(1.0, 5.0), model_payload_factor=0.9)
    observation, info = env.reset(seed=1)
    assert env.task.model_payload == 0.9 * info["payload"]
    assert env.layout.split(observation)["model_payload"][0] == env.task.model_payload
    heavier = {"parameters": {"payload": {"low": 0.5, "high": 0.5}}}
    env = make(PLANAR, payload=2.0, uncertainty=heavier, model_payload_factor=0.9)
    assert (env.reset(seed=0)[1]["payload"], env.task.model_payload) == (
        3.0,
        0.9 * 2.0,
    )


def test_values_per_environment():
    options = {
        "payload": [1.0, 2.0, 3.0, 4.0],
        "payload_known": [True, True, True, False],
        "model_payload_factor": [0.5, 1.0, 2.0, 3.0],
        "initial_error": np.linspace(-0.01, 0.01, 8).reshape(4, 2),
    }
    by_option = make_vector(PLANAR, 4)
    by_keyword = make_vector(PLANAR, 4, **options)
    results = by_keyword.reset(seed=0)
    check_equal(results, by_option.reset(seed=0, options=options))
    assert results[1]["payload"].tolist() == options["payload"]
    blocks = by_keyword.layout.split(results[0])
    model_payloads = [task.model_payload for task in by_keyword.tasks]
    assert blocks["model_payload"][:, 0].tolist() == model_payloads == [0.5, 2.0, 6.0, 0.0]
    errors = blocks["pose"] - blocks["reference_pose"]
    assert_allclose(errors, options["initial_error"], atol=1e-15)
    changed = {"model_payload_factor": 0.25, "payload_known": True}
    by_keyword.reset(options=changed | {"reset_mask": np.array([False, True, False, True])})
    assert [task.model_payload for task in by_keyword.tasks] == [0.5, 0.5, 6.0, 1.0]


STIFF = {"parameters": {"stiffness": {"low": 0.0, "high": 8000.0}}}
MASS_ONLY = {"parameters": {"platform_mass": {"low": 0.1, "high": 0.2}}}


def test_uncertainty_per_environment():
    lighter = {"parameters": {"platform_mass": {"low": -0.5, "high": -0.4}}}
    forms = ["table6", None, MASS_ONLY, lighter, "table6"]
    low, high = np.array([(0.9, 1.1), (1.0, 1.0), (1.1, 1.2), (0.5, 0.6), (0.9, 1.1)]).T
    nominal = ROBOTS[SPATIAL].mass
    env = make_vector(SPATIAL, 5, uncertainty=forms)
    env.reset(seed=0)
    env.truth["platform_mass"][...] = 99.0  # a copy
    before = env.truth["platform_mass"] / nominal
    assert np.all((before >= low) & (before <= high))
    mask = np.array([False, True, False, False, True])
    env.reset(options={"reset_mask": mask})
    after = env.truth["platform_mass"] / nominal
    assert_array_equal(after[~mask], before[~mask])
    assert after[1] == 1.0
    assert 0.9 <= after[4] <= 1.1
    assert after[4] != before[4]


# --- physics steps ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("frequency", "substeps"), [(500.0, 2), (333.0, 4), (2000.0, 1)])
def test_default_physics_step_is_at_most_a_millisecond(frequency, substeps):
    env = make(PLANAR, control_frequency=frequency)
    assert env.settings.substeps == substeps
    assert env.settings.physics_step == pytest.approx(1 / frequency / substeps)


def test_physics_step_must_suit_the_stiffest_springs():
    """By option, keyword or robot; the default number of substeps is sufficient."""
    env = make(FLEX_SPATIAL)
    env.reset(seed=0)
    substeps = env.settings.substeps
    assert make(FLEX_SPATIAL, uncertainty="table6").settings.substeps == substeps
    with pytest.raises(ValueError, match=f"substeps={substeps} is too small") as refusal:
        env.reset(options={"uncertainty": STIFF})
    least = int(str(refusal.value).split("at least ")[1].split(",")[0])
    make(FLEX_SPATIAL, uncertainty=STIFF, substeps=least)
    with pytest.raises(ValueError, match="is too small"):
        make(FLEX_SPATIAL, uncertainty=STIFF, substeps=least - 1)
    assert (
        make_vector(
            FLEX_SPATIAL,
            2,
            uncertainty=[None, STIFF],
        ).settings.substeps
        >= least
    )


# --- bad input ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"paylaod": 1.0}, "paylaod"),
        ({"payload": [1.0, 2.0]}, "payload"),
        ({"payload_known": 0.5}, "payload_known"),
        ({"model_payload_factor": float("nan")}, "model_payload_factor"),
        ({"trajectory": "paper-planar"}, "paper-planar"),
        ({"initial_error": 0.01}, "initial_error"),
        ({"uncertainty": STIFF}, "substeps"),
        # no tensions hold it
        ({"uncertainty": "table6", "initial_error": [0, 0, -0.1, 0, 0, 0]}, "start pose"),
    ],
)
def test_bad_option_raises_and_leaves_the_episode(options, named):
    """Truth, task, seed, wrench, delay, noise and random streams."""
    keywords = {
        "uncertainty": MASS_ONLY | {"delay": 2},
        "trajectory": "dwell-spatial",
        "payload_range": (0.0, 2.0),
        "initial_error_range": [1e-3] * 6,
    }
    env, twin = (make(FLEX_SPATIAL, **keywords) for _ in range(2))
    start = {"seed": 0, "options": {"uncertainty": "table6+sensors"}}
    check_equal(env.reset(**start), twin.reset(**start))
    for step in range(12):
        if step % 5 == 0:
            with pytest.raises(ValueError, match=named):
                env.reset(seed=99, options={"error_bounds": {"position": 0.5}} | options)
            check_equal(env.truth, twin.truth)
            assert env.np_random_seed == 0
            assert repr(env.task) == repr(twin.task)
        action = np.full(6, 0.5 + 0.01 * step)
        check_equal(env.step(action), twin.step(action))
    check_equal(env.reset(), twin.reset())


@pytest.mark.parametrize(
    "action", [np.zeros(2), np.zeros((1, 3)), 0.5, [0.0, np.nan, 0.0], [0.0, 0.0, 1e308]]
)
def test_bad_action_raises_and_leaves_the_episode(action):
    env, twin = make(PLANAR), make(PLANAR)
    check_equal(env.reset(seed=0), twin.reset(seed=0))
    with pytest.raises(ValueError, match="action"):
        env.step(action)
    large = np.full(3, 9e5)
    result = env.step(large)
    check_equal(result, twin.step(large))
    assert_array_equal(result[4]["commanded_action"], large)


@pytest.mark.parametrize(
    ("keywords", "named"),
    [
        ({"reward_weights": {"energy": 1.0}}, "energy"),
        ({"cable": "rope"}, "unilateral, bilateral"),
        ({"substeps": 1.5}, "substeps"),
        ({"observation_dtype": "float16"}, "float64, float32"),
        ({"control_frequency": 0.0}, "control_frequency"),
        ({"payload_range": (2.0, 1.0)}, "payload_range"),
        ({"payload": 1.0, "payload_range": (0.0, 2.0)}, "exclude each other"),
        (
            {"error_bounds": {"position": 10}},
            r"at most 1\.32 m, .* a bound of 10 mm is 0\.01",
        ),
        ({"initial_error_range": [-0.1, 0.0]}, "initial_error_range"),
        ({"normalised_observation": 1}, "must be True or False"),
        ({"terminate_on_violation": None}, "must be True or False"),
    ],
)
def test_bad_keyword_raises(keywords, named):
    with pytest.raises(ValueError, match=named):
        make(PLANAR, **keywords)


@pytest.mark.parametrize("construct", [gym.make, gym.make_vec])
def test_unknown_keyword_raises_type_error(construct):
    """TorchRL tries ``frameskip`` first, and looks for Python's own words."""
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'"):
        construct(PLANAR, frameskip=1)
    with pytest.raises(
        TypeError,
        match=r"choose one of robot, payload, .*; did you mean 'payload'",
    ):
        construct(PLANAR, paylaod=1.0)


def test_step_before_a_successful_reset_raises():
    env = make(PLANAR)
    with pytest.raises(ValueError, match="paylaod"):
        env.reset(options={"paylaod": 1.0})
    with pytest.raises(gym.error.ResetNeeded, match=r"reset\(\)"):
        env.step(np.zeros(3))
