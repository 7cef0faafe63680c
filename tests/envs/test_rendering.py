"""``render()`` of both environments."""

from __future__ import annotations

import os

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from cablebot_gym.rendering.moment import Moment
from cablebot_gym.rendering.painter import import_pygame
from cablebot_gym.rendering.window import Window

pygame = import_pygame()
PLANAR, SPATIAL = "CableBot-Planar-v0", "CableBot-Spatial-v0"


@pytest.fixture
def without_display(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)


def test_gymnasium_check_env_passes_without_display(without_display):
    """It makes the environment again in every render mode, including ``human``."""
    env = gym.make("CableBot-FlexPlanar-v0", render_mode="human")
    check_env(env.unwrapped)
    env.close()
    assert not pygame.display.get_init()


def test_rendering_does_not_change_the_episode():
    plain, painted = gym.make(SPATIAL).unwrapped, gym.make(SPATIAL, render_mode="rgb_array").unwrapped
    for env in (plain, painted):
        env.reset(seed=3)
    for action in np.random.default_rng(5).uniform(-0.6, 1.3, (6, 6)):
        painted.render()
        one, other = plain.step(action), painted.step(action)
        assert np.array_equal(one[0], other[0])
        assert all(np.array_equal(one[-1][name], other[-1][name]) for name in one[-1])


@pytest.mark.parametrize("env_id", [PLANAR, "CableBot-FlexSpatial-v0"])
def test_moment_has_the_true_state_and_the_torque_limits_of_the_true_motors(env_id):
    """At |a| ≥ 1 the torque is U± at the present motor speed."""
    weak = {"parameters": {"motor_strength": {"low": -0.4, "high": -0.2}}, "sensors": {"position": 1e-3}}
    env = gym.make(env_id, uncertainty=weak, termination_radius=10.0, payload=3.0).unwrapped
    env.reset(seed=1)
    robot, stall = env.settings.robot, env.truth["motor_strength"]
    for sign in (1.0, -1.0, 1.0):
        info = env.step(np.full(robot.cables, 1.5 * sign))[4]
        moment = Moment.from_info(robot, stall, env.pose, info)
        assert moment.torques == pytest.approx(moment.torque_limits[int(sign > 0)], rel=1e-12)
    assert np.ptp(moment.torque_limits[1] / robot.stall_torque) > 0.01
    assert (moment.payload, moment.time, moment.position_error) == (3.0, 0.006, info["tracking_error"])


def test_vector_environment_paints_the_pictures_of_single_environments():
    """Also the trail after an autoreset."""
    envs = gym.make_vec(SPATIAL, num_envs=2, render_mode="rgb_array", payload=[1.0, 6.0], max_episode_steps=20)
    envs.reset(seed=7)
    action = np.full((2, 6), 0.4)
    envs.step(action)
    singles = [gym.make(SPATIAL, render_mode="rgb_array", payload=payload) for payload in (1.0, 6.0)]
    for single, picture in zip(singles, envs.render(), strict=True):
        single.reset()
        single.step(action[0])
        assert np.array_equal(single.render(), picture)
        single.reset()
    for _ in range(20):
        envs.step(action)
    for single, picture in zip(singles, envs.render(), strict=True):
        assert np.array_equal(single.render(), picture)
    assert not np.array_equal(*envs.render())


def test_picture_shows_the_trajectory_and_the_termination_of_the_episode():
    env = gym.make(SPATIAL, render_mode="rgb_array", termination_radius=1e-3).unwrapped
    env.reset(seed=3)
    circle = env.render()
    env.reset(seed=3, options={"trajectory": "line-spatial"})
    assert np.mean(env.render() != circle) > 0.01
    ended = False
    while not ended:
        _, _, ended, _, _ = env.step(np.full(6, -1.0))
    assert np.any(np.all(env.render()[26:40] == (0xD5, 0x5E, 0x00), axis=-1))


def test_human_shows_fifty_pictures_per_second_of_episode_time(monkeypatch):
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


def test_render_needs_a_reset_and_pygame(monkeypatch):
    with pytest.raises(ResetNeeded):
        gym.make(PLANAR, render_mode="rgb_array").unwrapped.render()
    with pytest.raises(ResetNeeded):
        gym.make_vec(PLANAR, num_envs=2, render_mode="rgb_array").render()
    monkeypatch.setitem(__import__("sys").modules, "pygame", None)
    gym.make(PLANAR)
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[render\]'"):
        gym.make(PLANAR, render_mode="rgb_array")
