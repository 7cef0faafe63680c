"""``render()`` of both environments: Gymnasium's contract, and that looking changes nothing."""

from __future__ import annotations

import os
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import cablebot_gym
from cablebot_gym.rendering.painter import import_pygame
from cablebot_gym.rendering.window import Window

pygame = import_pygame()
PLANAR, SPATIAL = "CableBot-Planar-v0", "CableBot-Spatial-v0"
each_id = pytest.mark.parametrize("env_id", cablebot_gym.ENV_IDS)


def run(env, steps, *, render=False, payload=2.0):
    """Observations and infos of an episode under commands that differ from step to step."""
    draws = np.random.default_rng(5).uniform(-0.6, 1.3, (steps, *env.action_space.shape))
    seen = [env.reset(seed=3, options={"payload": payload})]
    for action in draws:
        if render:
            env.render()
        seen.append(env.step(action))
    return seen


@pytest.fixture
def without_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)


@each_id
@pytest.mark.parametrize("mode", [None, "human"])
def test_gymnasium_check_env_passes_without_display(env_id, mode, without_display):
    """It makes the environment again in every render mode, "human" included."""
    env = gym.make(env_id, render_mode=mode)
    check_env(env.unwrapped)
    env.close()
    assert not pygame.display.get_init()


@each_id
def test_looking_changes_nothing(env_id):
    plain, watched = gym.make(env_id).unwrapped, gym.make(env_id, render_mode="rgb_array").unwrapped
    for one, other in zip(run(plain, 12), run(watched, 12, render=True), strict=True):
        assert np.array_equal(one[0], other[0])
        assert one[-1].keys() == other[-1].keys()
        assert all(np.array_equal(one[-1][name], other[-1][name]) for name in one[-1])


@each_id
def test_torque_limits_are_those_at_which_the_motors_clip(env_id):
    """At |a| ≥ 1 the torque is U±, whatever the speed: and a weaker motor's, not the nominal one's."""
    weak = {"parameters": {"motor_strength": {"low": -0.4, "high": -0.2}}}
    env = gym.make(env_id, uncertainty=weak, termination_radius=10.0).unwrapped
    env.reset(seed=1)
    cables = env.action_space.shape[0]
    for sign in (1.0, -1.0, 1.0, 1.0):
        env.step(np.full(cables, 1.5 * sign))
        moment = env.moment
        assert moment.torques == pytest.approx(moment.torque_limits[int(sign > 0)], rel=1e-12)
    assert np.ptp(moment.torque_limits[1] / env.settings.robot.stall_torque) > 0.01


def test_moment_is_the_truth_not_what_sensors_say():
    env = gym.make(SPATIAL, uncertainty="sensors", payload=3.0).unwrapped
    observation, _ = env.reset(seed=1)
    env.step(np.zeros(6))
    moment = env.moment
    assert np.array_equal(moment.pose, env.pose)
    assert not np.array_equal(moment.pose, env.layout.split(observation)["pose"])
    assert (moment.payload, moment.time) == (3.0, 0.002)


def test_vector_environment_paints_each_lane_as_the_single_one_does():
    lanes = gym.make_vec(SPATIAL, num_envs=2, render_mode="rgb_array", payload=[1.0, 6.0])
    lanes.reset(seed=7)
    action = np.full((2, 6), 0.4)
    lanes.step(action)
    frames = lanes.render()
    for lane, payload in enumerate((1.0, 6.0)):
        env = gym.make(SPATIAL, render_mode="rgb_array", payload=payload)
        env.reset(seed=7 + lane)
        env.step(action[lane])
        assert np.array_equal(env.render(), frames[lane])
    assert not np.array_equal(*frames)


def test_trail_does_not_go_on_from_the_episode_before():
    env = gym.make(SPATIAL, render_mode="rgb_array").unwrapped
    run(env, 40)
    env.reset(seed=3, options={"payload": 2.0})
    again = env.render()
    fresh = gym.make(SPATIAL, render_mode="rgb_array").unwrapped
    fresh.reset(seed=3, options={"payload": 2.0})
    assert np.array_equal(again, fresh.render())


def test_vector_trail_does_not_go_on_after_an_autoreset():
    lanes = gym.make_vec(SPATIAL, num_envs=2, render_mode="rgb_array", max_episode_steps=20)
    lanes.reset(seed=7)
    for _ in range(20):
        lanes.step(np.full((2, 6), 0.5))
    lanes.step(np.full((2, 6), 0.5))  # next-step autoreset
    fresh = gym.make(SPATIAL, render_mode="rgb_array")
    fresh.reset(seed=0)
    assert np.array_equal(lanes.render()[0], fresh.render())


def test_picture_follows_the_episodes_own_trajectory():
    env = gym.make(SPATIAL, render_mode="rgb_array").unwrapped
    env.reset(seed=3)
    circle = env.render()
    env.reset(seed=3, options={"trajectory": "line-spatial"})
    assert env.scene.trajectory.name == "line-spatial"
    assert np.mean(env.render() != circle) > 0.01


def test_the_end_of_an_episode_is_said():
    env = gym.make(SPATIAL, render_mode="rgb_array", termination_radius=1e-3).unwrapped
    env.reset(seed=3)
    ended = False
    while not ended:
        _, _, ended, _, _ = env.step(np.full(6, -1.0))
    assert np.any(np.all(env.render()[26:40] == (0xD5, 0x5E, 0x00), axis=-1))


def test_human_shows_fifty_pictures_in_a_second_of_the_episode(monkeypatch):
    env = gym.make(PLANAR, render_mode="human").unwrapped
    shown = []
    monkeypatch.setattr(Window, "show", lambda self, picture, rate: shown.append(rate) or [])
    env.reset(seed=1)
    for _ in range(100):
        env.step(np.zeros(3))
    env.close()
    assert shown == [50] * 11
    assert env.metadata["render_fps"] == 50


def test_human_without_display_logs_it_once(monkeypatch, without_display, caplog):
    monkeypatch.setattr("sys.platform", "linux")
    env = gym.make(PLANAR, render_mode="human").unwrapped
    env.reset()
    for _ in range(20):
        env.step(np.zeros(3))
    env.close()
    assert [record.getMessage()[:10] for record in caplog.records] == ["No display"]
    assert "SDL_VIDEODRIVER" not in os.environ


def test_rendering_before_the_first_reset_is_refused():
    with pytest.raises(ResetNeeded):
        gym.make(PLANAR, render_mode="rgb_array").unwrapped.render()
    with pytest.raises(ResetNeeded):
        gym.make_vec(PLANAR, num_envs=2, render_mode="rgb_array").render()


def test_rendering_without_a_mode_warns_and_shows_nothing():
    env = gym.make(PLANAR).unwrapped
    env.reset()
    with pytest.warns(UserWarning, match="rgb_array"):
        assert env.render() is None


def test_modes_that_there_are_not_are_refused_with_those_that_there_are():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Gymnasium's own words come first
        with pytest.raises(ValueError, match="unknown render_mode 'ansi': choose one of human, rgb_array"):
            gym.make(PLANAR, render_mode="ansi")
    with pytest.raises(ValueError, match="unknown render_mode 'human': choose one of rgb_array"):
        gym.make_vec(PLANAR, num_envs=2, render_mode="human")


def test_pygame_is_not_needed_unless_pictures_are(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pygame", None)
    gym.make(PLANAR)
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[render\]'"):
        gym.make(PLANAR, render_mode="rgb_array")
