"""The receding-horizon controller: what it plans, what it passes on, what it does when no plan can be had."""

from __future__ import annotations

import builtins
import logging
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("casadi")

from cablebot_baselines.optimal.horizon import HORIZON, HorizonProgram, PlanningError
from cablebot_baselines.optimal.nmpc import NMPC, STEPS_PER_PLAN, TUNING, NonlinearMPC
from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_PLANAR, PLANAR, SPATIAL
from cablebot_gym.task import ErrorBounds

PLANAR_ID, SPATIAL_ID = "CableBot-Planar-v0", "CableBot-Spatial-v0"
ROBOTS = {PLANAR_ID: PLANAR, SPATIAL_ID: SPATIAL}


@pytest.fixture(scope="module")
def policies():
    """Made once: CasADi takes its time."""
    return {env_id: NMPC.factory(robot) for env_id, robot in ROBOTS.items()}


def rollout(policy, env, *, steps=None, seed=0):
    """Whether each episode kept its limits, all commands, and the last state."""
    observation, _ = env.reset(seed=seed)
    policy.reset(env.unwrapped.tasks)
    state, start, actions = None, np.ones(env.num_envs, np.bool_), []
    kept = np.ones(env.num_envs, np.bool_)
    for _ in range(steps or env.unwrapped.tasks[0].steps):
        action, state = policy.predict(observation, state=state, episode_start=start)
        actions.append(action)
        observation, _, ended, _, info = env.step(action)
        start = np.zeros(env.num_envs, np.bool_)
        kept &= ~ended & ~info["slack"].any(axis=1)
        kept &= (info["tracking_error_peak"] <= 0.01) & (info["rotation_error_peak"] <= 0.01)
    return kept, np.array(actions), state


def vector(env_id, count, **keywords):
    return gym.make_vec(env_id, num_envs=count, max_episode_steps=None, **keywords)


# --- what it carries --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("env_id", "payload"), [(PLANAR_ID, 2.7), (SPATIAL_ID, 6.4)])
@pytest.mark.parametrize("known", [True, False])
def test_payload_far_beyond_adaptive_is_carried_known_or_not(policies, env_id, payload, known):
    """``adaptive`` carries 1.9 kg and 5.0 kg; an ignored mass estimate, or a plan that no law follows, less."""
    env = vector(env_id, 2, payload=np.array([0.0, payload]), payload_known=known)
    kept, actions, _ = rollout(policies[env_id], env)
    assert kept.all()
    assert policies[env_id].fallbacks == 0
    assert np.abs(actions).max() < 1.5


def test_same_episode_is_not_driven_differently_the_second_time(policies):
    """A solver's or a policy's memory of the last episode would show."""
    env = vector(PLANAR_ID, 1, payload=2.5)
    runs = [rollout(policies[PLANAR_ID], env, steps=60)[1] for _ in range(2)]
    np.testing.assert_array_equal(*runs)


# --- observation, batch and state -------------------------------------------------------------------------------------


@pytest.mark.parametrize("env_id", ROBOTS)
def test_batch_is_not_driven_otherwise_than_each_observation_alone(policies, env_id):
    policy, env = policies[env_id], vector(env_id, 3, payload=np.array([0.0, 1.0, 2.0]))
    observation, _ = env.reset(seed=0)
    policy.reset(env.unwrapped.tasks)
    together, alone = None, [None] * 3
    for _ in range(2 * STEPS_PER_PLAN + 1):
        action, together = policy.predict(observation, state=together)
        for index in range(3):
            single, alone[index] = policy.predict(observation[index], state=alone[index])
            assert single.shape == (policy.robot.cables,)
            np.testing.assert_allclose(single, action[index], rtol=0, atol=1e-12)
        observation, *_ = env.step(action)


def test_episode_that_starts_does_not_inherit_a_plan(policies):
    """An environment that starts anew acts like a new policy, and does not disturb the environment beside it."""
    policy, env = policies[PLANAR_ID], vector(PLANAR_ID, 2, payload=2.0)
    first, _ = env.reset(seed=0)
    policy.reset(env.unwrapped.tasks)
    observation, state = first, None
    for _ in range(STEPS_PER_PLAN + 2):
        action, state = policy.predict(observation, state=state)
        observation, *_ = env.step(action)
    mixed = np.stack([first[0], observation[1]])
    anew, _ = policy.predict(mixed, state=state, episode_start=np.array([True, False]))
    fresh, _ = policy.predict(first[:1])
    onward, _ = policy.predict(np.stack([observation[0], observation[1]]), state=state)
    np.testing.assert_array_equal(anew[0], fresh[0])
    np.testing.assert_array_equal(anew[1], onward[1])


def test_state_passed_in_is_not_written_to(policies):
    policy, env = policies[PLANAR_ID], vector(PLANAR_ID, 1)
    observation, _ = env.reset(seed=0)
    _, state = policy.predict(observation)
    for _ in range(STEPS_PER_PLAN - 1):
        _, state = policy.predict(observation, state=state)
    again = [policy.predict(observation, state=state)[0] for _ in range(2)]
    np.testing.assert_array_equal(*again)


def test_plans_are_not_solved_more_often_than_every_fifth_step(monkeypatch):
    policy, solved = NMPC.factory(PLANAR), []
    plan = policy.program.plan
    monkeypatch.setattr(policy.program, "plan", lambda *a, **k: solved.append(1) or plan(*a, **k))
    rollout(policy, vector(PLANAR_ID, 1), steps=21)
    assert len(solved) == 5


def test_trajectory_is_not_read_from_the_task(policies):
    """Without ``reset`` the commands are the same: the observation tells it all."""
    env = vector(PLANAR_ID, 1, payload=2.5)
    _, expected, _ = rollout(policies[PLANAR_ID], env, steps=30)
    silent = NMPC.factory(PLANAR)
    silent.reset = lambda tasks: None
    np.testing.assert_array_equal(rollout(silent, env, steps=30)[1], expected)


def test_limits_of_the_task_are_not_ignored():
    """Within 2 mm the platform may not go as far as within 10 mm."""
    policy, worst = NMPC.factory(PLANAR), []
    for radius in (0.002, 0.01):
        env = vector(PLANAR_ID, 1, payload=1.5, error_bounds={"position": radius})
        observation, _ = env.reset(seed=0)
        policy.reset(env.unwrapped.tasks)
        state, peak = None, 0.0
        for _ in range(300):
            action, state = policy.predict(observation, state=state)
            observation, _, _, _, info = env.step(action)
            peak = max(peak, info["tracking_error_peak"][0])
        worst.append(peak)
    assert worst[0] < 0.002 < 0.003 < worst[1] < 0.01


# --- the preview ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("env_id", "start", "later"), [(PLANAR_ID, 7e-4, 4e-5), (SPATIAL_ID, 4e-4, 2e-5)])
def test_preview_is_not_off_the_reference_across_its_jump(policies, env_id, start, later):
    """From t = 0.31 s on the horizon holds the circle's jump of acceleration, which one observation alone misses by
    2 cm; what earlier ones have previewed fills in."""
    policy, env = policies[env_id], vector(env_id, 1, termination_radius=10.0)
    observation, _ = env.reset(seed=0)
    task = env.unwrapped.tasks[0]
    ahead, state, errors = np.linspace(0.0, HORIZON, 41), None, []
    for step in range(task.steps):
        action, state = policy.predict(observation, state=state)
        if step % STEPS_PER_PLAN == 0:
            seen = policy.preview(policy.split(observation), state, 0)(ahead)
            true = task.trajectory(step / task.control_frequency + ahead).position
            errors.append(np.abs(seen - true).max())
        observation, *_ = env.step(action)
    assert max(errors) < start
    assert max(errors[10:]) < later


def test_reference_does_not_move_on_after_its_end(policies):
    policy, env = policies[PLANAR_ID], vector(PLANAR_ID, 1, trajectory={"name": "line-planar", "duration": 0.5})
    observation, _ = env.reset(seed=0)
    state = None
    for _ in range(300):
        action, state = policy.predict(observation, state=state)
        observation, _, _, _, info = env.step(action)
    assert info["tracking_error_peak"][0] < 0.01
    blocks = policy.split(observation)
    np.testing.assert_allclose(policy.preview(blocks, state, 0)(HORIZON), blocks["reference_pose"][0], atol=1e-9)


# --- the program ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL])
def test_planned_motion_keeps_tube_and_motors(robot):
    """By the textbook's inverse dynamics, on a finer grid than the program's. Limits at its own instants would pass a
    wrong slope or a wrong unit only by luck, where the reference asks for more than the motors have."""
    tuning = TUNING["planar" if robot.planar else "spatial"]
    program, n = HorizonProgram(robot, tuning), robot.coordinates
    home = np.r_[0.1, 0.0] if robot.planar else np.r_[0.1, 0.0, 0.1, 0.1, 0.1, 0.1]
    direction = np.eye(n)[1]
    mass = robot.mass + (2.5 if robot.planar else 6.0)
    shift = 0.02 * np.sin(2 * np.pi * program.instants / HORIZON) ** 2  # asks for far too much
    reference = home + shift[:, None] * direction
    plan = program.plan(
        reference,
        home,
        np.zeros(n),
        reference,
        np.zeros(n),
        mass=mass,
        error_bounds=ErrorBounds(position=0.03),
        iterations=8,
    )
    fine = np.linspace(0.0, HORIZON, 201)
    pose, velocity, acceleration = program.basis(fine) @ plan
    needed = textbook.inverse_dynamics(
        robot, mass, pose, velocity, acceleration, minimum=tuning.margins.tension, strict=False
    )
    action = (needed.torques + robot.speed_slope * needed.speeds) / robot.stall_torque
    assert np.abs(action).max() < 1.02
    wanted = home + 0.02 * np.sin(2 * np.pi * fine / HORIZON)[:, None] ** 2 * direction
    assert np.linalg.norm((pose - wanted)[:, :3], axis=1).max() < 0.03
    np.testing.assert_allclose(pose[0], home, atol=1e-12)
    np.testing.assert_allclose(velocity[0], 0.0, atol=1e-9)


# --- when no plan can be had ------------------------------------------------------------------------------------------


def failing_from(policy, monkeypatch, first, last=10**9):
    """Lets plans number ``first`` to ``last`` fail."""
    plan, number = policy.program.plan, iter(range(10**9))

    def sometimes(*args, **keywords):
        if first <= next(number) <= last:
            raise PlanningError("made to fail")
        return plan(*args, **keywords)

    monkeypatch.setattr(policy.program, "plan", sometimes)


def test_solver_that_never_works_is_neither_silent_nor_the_end(monkeypatch, caplog):
    """The law drives on along the reference, as ``adaptive`` would; every failure counts, one line tells."""
    policy = NMPC.factory(PLANAR)
    failing_from(policy, monkeypatch, 0)
    with caplog.at_level(logging.WARNING, logger="cablebot_gym"):
        kept, _, _ = rollout(policy, vector(PLANAR_ID, 2, payload=1.0))
    assert kept.all()
    assert policy.fallbacks == 2 * 100
    assert len(caplog.records) == 1
    assert "made to fail" in caplog.text
    policy.reset(vector(PLANAR_ID, 2).unwrapped.tasks)
    assert policy.fallbacks == 0


def test_old_plan_is_not_dropped_at_the_first_failure(monkeypatch):
    """Five failures are bridged by the plan before them, with a payload beyond what the reference itself allows."""
    policy = NMPC.factory(PLANAR)
    failing_from(policy, monkeypatch, 20, 24)
    kept, _, _ = rollout(policy, vector(PLANAR_ID, 1, payload=2.5))
    assert kept.all()
    assert policy.fallbacks == 5


def test_old_plan_is_not_followed_beyond_its_end(monkeypatch):
    policy = NMPC.factory(PLANAR)
    failing_from(policy, monkeypatch, 1)
    _, _, state = rollout(policy, vector(PLANAR_ID, 1), steps=110)
    assert state.plans == (None,)
    blocks = policy.split(vector(PLANAR_ID, 1).reset(seed=0)[0])
    np.testing.assert_array_equal(policy._planned_blocks(blocks, state)["reference_pose"], blocks["reference_pose"])


def test_casadi_that_raises_does_not_end_the_episode(monkeypatch):
    policy = NMPC.factory(PLANAR)

    def broken():
        raise RuntimeError("an assertion of CasADi's")

    monkeypatch.setattr(policy.program._quadratic, "_evaluate", broken)
    kept, _, _ = rollout(policy, vector(PLANAR_ID, 1), steps=20)
    assert kept.all()
    assert policy.fallbacks == 4


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL])
def test_state_from_which_no_limit_can_be_kept_is_no_failure(robot):
    """Outside the tube, leaving it, and so fast that braking would take slack cables and several times the torque."""
    program, n = HorizonProgram(robot, TUNING["planar" if robot.planar else "spatial"]), robot.coordinates
    home, away = np.array(robot.home), np.eye(n)[min(n, 3) - 1]
    still = np.tile(home, (len(program.instants), 1))
    plan = program.plan(
        still, home - 0.015 * away, -2.0 * away, still, np.zeros(n), mass=20.0, error_bounds=ErrorBounds()
    )
    assert np.isfinite(plan).all()


@pytest.mark.parametrize("env_id", ROBOTS)
def test_platform_far_away_is_not_planned_for_and_counts_once(env_id, monkeypatch):
    policy = NMPC.factory(ROBOTS[env_id])
    plan, solved = policy.program.plan, []
    monkeypatch.setattr(policy.program, "plan", lambda *a, **k: solved.append(1) or plan(*a, **k))
    env = vector(env_id, 1)
    observation, _ = env.reset(seed=0)
    policy.reset(env.unwrapped.tasks)
    observation[:, observation_layout(policy.robot).slices()["pose"].start] += 0.05
    state = None
    for _ in range(3 * STEPS_PER_PLAN):
        action, state = policy.predict(observation, state=state)
        assert np.isfinite(action).all()
    assert not solved
    assert policy.fallbacks == 1
    policy.predict(observation, state=state, episode_start=np.array([True]))  # another episode, as far away
    assert policy.fallbacks == 2


def test_pose_without_equations_is_no_exception(policies):
    """In an anchor a cable has no direction: nothing can be linearised."""
    program = HorizonProgram(PLANAR, TUNING["planar"])
    anchor = np.array(PLANAR.base[0])
    assert cable_lengths(PLANAR.base, PLANAR.platform, anchor).min() == 0.0
    still = np.tile(anchor, (len(program.instants), 1))
    with pytest.raises(PlanningError):
        program.plan(still, anchor, np.zeros(2), still, np.zeros(2), mass=1.0, error_bounds=ErrorBounds())


def test_missing_casadi_is_named_with_its_command(monkeypatch):
    real = builtins.__import__

    def without(name, *args, **keywords):
        if name == "casadi":
            raise ImportError(name)
        return real(name, *args, **keywords)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[optimal\]'"):
        NonlinearMPC(PLANAR)


def test_other_robot_is_refused(policies):
    with pytest.raises(ValueError, match="built for robot"):
        policies[PLANAR_ID].reset(vector(SPATIAL_ID, 1).unwrapped.tasks)


def test_springs_are_not_planned_for_as_if_rigid():
    with pytest.raises(ValueError, match="joint springs"):
        NonlinearMPC(FLEX_PLANAR)


def test_tuning_is_not_ignored():
    """A plan that weighs errors alone stays on the reference."""
    tuning = replace(TUNING["planar"], error_weight=1e4)
    policy = NonlinearMPC(PLANAR, tuning=tuning)
    env = vector(PLANAR_ID, 1, payload=1.0)
    observation, _ = env.reset(seed=0)
    state, peak = None, 0.0
    for _ in range(200):
        action, state = policy.predict(observation, state=state)
        observation, _, _, _, info = env.step(action)
        peak = max(peak, info["tracking_error_peak"][0])
    assert peak < 2e-3
