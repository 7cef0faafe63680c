"""Behaviour that all classical laws share: their robots, observations, batches, registered names
and DLCC."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import cablebot_baselines.classical
from cablebot_baselines.classical import (
    FL,
    FL_TUNED,
    Adaptive,
    Composite,
    FeedbackLinearization,
    FourthOrder,
    MotorPD,
    PaperFlexible,
    Robust,
)
from cablebot_baselines.episodes import first_steps
from cablebot_gym import ENV_IDS
from cablebot_gym.envs import PAPER_ENV_IDS, fitting_env_id
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.policies import PolicyEntry
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL

ENTRIES = [
    entry for entry in vars(cablebot_baselines.classical).values() if isinstance(entry, PolicyEntry)
]
CASES = [(entry, env_id) for entry in ENTRIES for env_id in entry.env_ids]

each_case = pytest.mark.parametrize(
    ("entry", "env_id"), CASES, ids=lambda value: getattr(value, "name", value)
)


@pytest.fixture(scope="module")
def started():
    """Tasks and observations of two environments of each id."""
    envs = {env_id: gym.make_vec(env_id, num_envs=2) for env_id in ENV_IDS}
    observations = {env_id: env.reset(seed=0)[0] for env_id, env in envs.items()}
    return {env_id: env.unwrapped.tasks for env_id, env in envs.items()}, observations


@each_case
def test_law_accepts_its_robot_and_rejects_others(started, entry, env_id):
    tasks, observations = started
    law = entry.factory(tasks[env_id][0].robot)
    law.reset(tasks[env_id])
    for other_id in set(ENV_IDS) - {env_id}:
        with pytest.raises(ValueError, match=r"was built for robot .*Build the law"):
            law.reset(tasks[other_id])
        rows = observations[other_id]
        if rows.shape == observations[env_id].shape:  # four cables, three coordinates
            continue
        for wrong in (rows, rows[0]):
            with pytest.raises(ValueError, match=r"observation of robot '.*' has \d+ components"):
                law.predict(wrong)


@pytest.mark.parametrize(
    ("law", "robot", "changes"),
    [
        (FeedbackLinearization, SPATIAL, {"base_anchors": 1.01 * SPATIAL.base}),
        (FeedbackLinearization, SPATIAL, {"platform_anchors": 1.01 * SPATIAL.platform}),
        (Composite, FLEX_SPATIAL, {"home_pose": (0, 0, 0.15, 0, 0, 0)}),
    ],
)
def test_law_rejects_a_robot_of_another_geometry(law, robot, changes):
    def task(**changes):
        changed = robot.replace(name="changed", **changes)
        return gym.make(fitting_env_id(robot), robot=changed).unwrapped.task

    built = law(robot)
    built.reset([task(mass=11.0)])
    with pytest.raises(ValueError, match="'changed' differs in kind or anchors"):
        built.reset([task(**changes)])


@each_case
def test_single_observation_gives_the_action_of_its_row(started, entry, env_id):
    """For three steps, so that a law's state matters; the second action is beyond the motors'
    limits."""
    robot = started[0][env_id][0].robot
    # from the first step on
    moving = {"trajectory": f"paper-{robot.kind}"} if env_id in PAPER_ENV_IDS else {}
    env = gym.make_vec(env_id, num_envs=3, payload=[0.0, 3.0, 8.0], **moving)
    law = entry.factory(robot)
    observation, _ = env.reset(seed=0)
    together = None
    alone = [None] * 3
    start = np.ones(3, np.bool_)
    for _ in range(3):
        before = observation.copy()
        action, together = law.predict(
            observation, state=together, episode_start=start, deterministic=True
        )
        assert action.shape == (3, env.single_action_space.shape[0])
        assert np.ptp(action, axis=0).max() > 0.01
        assert_array_equal(observation, before)
        for index in range(3):
            single, alone[index] = law.predict(
                observation[index], state=alone[index], episode_start=start[index]
            )
            assert single.shape == action[index].shape
            assert_allclose(single, action[index], rtol=1e-9, atol=1e-9)
        observation, *_ = env.step(action)
        start = np.zeros(3, np.bool_)


@each_case
def test_action_is_that_of_an_episode_alone_whatever_the_other_motions(started, entry, env_id):
    """Excludes gains or tensions for the hardest motion of a batch."""
    robot = started[0][env_id][0].robot
    alone, together = [], entry.factory(robot)
    for seed in (0, 5):
        motion = {"name": f"loop-{robot.kind}", "seed": seed, "dwell": 0.0}
        env = gym.make_vec(env_id, num_envs=1, trajectory=motion)
        law = entry.factory(robot)
        law.reset(env.unwrapped.tasks)
        alone.append([env, env.reset(seed=0)[0], law, None])
    together.reset([env.unwrapped.tasks[0] for env, *_ in alone])
    state = None
    for _ in range(20):
        actions, state = together.predict(np.concatenate([row[1] for row in alone]), state)
        for row, expected in zip(alone, actions, strict=True):
            env, observation, law, own_state = row
            action, row[3] = law.predict(observation, own_state)
            assert_allclose(action[0], expected, rtol=1e-9, atol=1e-9)
            row[1] = env.step(action)[0]


def test_episode_start_is_one_boolean_or_one_per_row():
    """Stable-Baselines3 passes an array of one for one observation."""
    for start in (True, np.array([[True]])):
        assert first_steps("a state", start, ()).item()
        assert not first_steps("a state", ~np.asarray(start), ()).item()
    assert first_steps("a state", [True, False, True], (3,)).tolist() == [True, False, True]
    with pytest.raises(ValueError, match=r"one boolean or have shape \(3,\)"):
        first_steps("a state", [True, False], (3,))


@pytest.mark.parametrize(
    ("law", "robot", "keywords", "message"),
    [
        (FeedbackLinearization, SPATIAL, {"gains": (0.0, 1.0)}, "gains must be"),
        (FeedbackLinearization, PLANAR, {"minimum_tension": -1e-9}, "must be .* at least 0 N"),
        (Adaptive, FeedbackLinearization(SPATIAL), {"estimator_prior_weight": 0.0}, "than 0 s"),
        (Robust, SPATIAL, {"boundary_layer": 0.0}, "boundary_layer must be greater than 0"),
        (Robust, SPATIAL, {"zeta": 1.0}, "zeta must be"),
        (Robust, SPATIAL, {"phi": -1.0}, "phi must be"),
        (Robust, SPATIAL, {"q": [[1.0, 0.5], [0.2, 1.0]]}, "symmetric and positive definite"),
        (Robust, SPATIAL, {"q": [1.0, 1.0]}, "q must be a positive number or a 2×2 matrix"),
        (Composite, SPATIAL, {}, "needs joint springs"),
        (Composite, FLEX_SPATIAL, {"spring_damping": -1.0}, "spring_damping must be"),
        (MotorPD, FLEX_SPATIAL, {"frequency": 0.0}, "frequency must be"),
        (MotorPD, FLEX_SPATIAL, {"damping_ratio": 0.0}, "damping_ratio must be"),
        (FourthOrder, FLEX_PLANAR, {}, "as many cables as coordinates"),
        (FourthOrder, FLEX_SPATIAL, {"poles": (-1, -2, -3)}, "four stable poles"),
        (FourthOrder, FLEX_SPATIAL, {"poles": (-1 + 1j, -2, -3, -4)}, "four stable poles"),
        (PaperFlexible, SPATIAL, {}, "PaperFlexible needs joint springs"),
        (PaperFlexible, FLEX_SPATIAL, {"motor_acceleration": "v"}, "unknown motor_acceleration"),
    ],
)
def test_invalid_arguments_raise(law, robot, keywords, message):
    with pytest.raises(ValueError, match=message):
        law(robot, **keywords)


def bare(robot):
    """The robot with tensions above 0."""
    return robot.replace(minimum_tension=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "robot", "payload_known", "payload", "tolerance"),
    [
        (FL.factory(PLANAR), bare(PLANAR), True, 1.92, 0.04),
        (FL.factory(PLANAR), bare(PLANAR), False, 0.66, 0.04),
        (FL_TUNED.factory(PLANAR), bare(PLANAR), True, 1.94, 0.04),
        (FL_TUNED.factory(PLANAR), bare(PLANAR), False, 0.79, 0.04),
        (FL.factory(SPATIAL), bare(SPATIAL), True, 4.03, 0.04),
        (FL.factory(SPATIAL), bare(SPATIAL), False, 0.39, 0.04),
        (FL_TUNED.factory(SPATIAL), bare(SPATIAL), True, 3.88, 0.04),
        (FL_TUNED.factory(SPATIAL), bare(SPATIAL), False, 4.15, 0.04),
        ("adaptive", bare(PLANAR), False, 1.93, 0.05),
        (Robust(SPATIAL, zeta=0.3, phi=3.0), SPATIAL, False, 2.85, 0.05),
        (Robust(SPATIAL, zeta=0.5, phi=5.0), SPATIAL, False, 4.58, 0.05),
        ("composite", bare(FLEX_SPATIAL), True, 4.54, 0.04),
        (MotorPD(bare(FLEX_SPATIAL), minimum_tension=5.0), bare(FLEX_SPATIAL), True, 4.10, 0.04),
        ("fl4", bare(FLEX_SPATIAL), True, 4.63, 0.04),
        ("adaptive-composite", bare(FLEX_SPATIAL), False, 5.58, 0.05),
        (MotorPD(bare(FLEX_PLANAR), minimum_tension=5.0), bare(FLEX_PLANAR), True, 1.93, 0.04),
        ("composite-tuned", bare(FLEX_PLANAR), False, 0.25, 0.04),
    ],
)
def test_dlcc_is_that_of_independent_runs(law, robot, payload_known, payload, tolerance):
    """On the circle as printed; the runs of motor-pd allocated at least 5 N."""
    result = evaluate_dlcc(
        law,
        fitting_env_id(robot),
        payload_known=payload_known,
        robot=robot,
        trajectory=f"paper-{robot.kind}",
        resolution=0.02,
    )
    assert result.payload == pytest.approx(payload, abs=tolerance)
