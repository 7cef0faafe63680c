"""``render()`` of both environments."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_array_equal
from oracles.episodes import FLEX_SPATIAL, PLANAR, SPATIAL, make, make_vector

from cablebot_gym.rendering.moment import Moment
from cablebot_gym.rendering.painter import import_pygame

pygame = import_pygame()


@pytest.mark.landing
def test_gymnasium_check_env_passes_on_a_headless_machine(monkeypatch):
    """It makes the environment again in every render mode, including ``human``."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    env = gym.make("CableBot-FlexPlanar-v0", render_mode="human")
    check_env(env.unwrapped)
    env.close()
    assert not pygame.display.get_init()


@pytest.mark.parametrize("env_id", [PLANAR, FLEX_SPATIAL])
def test_moment_has_the_limits_of_the_true_motors(env_id):
    """At |a| ≥ 1 the torque is U± at the present motor speed."""
    weak = {"parameters": {"motor_strength": {"low": -0.4, "high": -0.2}}}
    weak["sensors"] = {"position": 1e-3}
    env = make(env_id, uncertainty=weak, payload=3.0)
    env.reset(seed=1)
    robot = env.settings.robot
    for sign in (1.0, -1.0, 1.0):
        info = env.step(np.full(robot.cables, 1.5 * sign))[4]
        moment = Moment.from_info(robot, env.truth["motor_strength"], env.pose, info)
        assert moment.torques == pytest.approx(moment.torque_limits[int(sign > 0)], rel=1e-12)
    assert np.ptp(moment.torque_limits[1] / robot.stall_torque) > 0.01
    shown = moment.payload, moment.time, moment.position_error
    assert shown == (3.0, 0.006, info["tracking_error"])


def test_vector_environment_paints_the_pictures_of_single_ones():
    """Also the trail after an autoreset. Pictures do not change the episode."""
    payloads = [1.0, 6.0]
    painted = {"render_mode": "rgb_array"}
    envs = make_vector(SPATIAL, 2, payload=payloads, max_episode_steps=2, **painted)
    singles = [make(SPATIAL, payload=payload, **painted) for payload in payloads]
    action = np.full((2, 6), 0.4)
    envs.reset(seed=7)
    for single in singles:
        single.reset()
    for step in range(3):
        observations = envs.step(action)[0]
        for single, observation in zip(singles, observations, strict=True):
            single.render()
            result = single.step(action[0]) if step < 2 else single.reset()
            assert_array_equal(result[0], observation)
    assert_array_equal(envs.render(), [single.render() for single in singles])
    assert not np.array_equal(*envs.render())
