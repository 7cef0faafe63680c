"""What a page shows of an episode is the episode."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest

from cablebot_gym.benchmark.cells import PolicyCell
from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.policies import load_policy
from cablebot_gym.report.replay import RATE, frame_times, platform_points, replays, unpack_channels
from cablebot_gym.robots import SPATIAL
from cablebot_gym.trajectories import find_trajectory

PLANAR, SPATIAL_ID = "CableBot-Planar-v0", "CableBot-Spatial-v0"


def cell(env_id=SPATIAL_ID, policy="fl", **more):
    kind = "planar" if "Planar" in env_id else "spatial"
    return PolicyCell(env_id=env_id, trajectory={"name": f"paper-{kind}"}, policy=policy, **more)


@pytest.fixture(scope="module")
def four():
    return replays(cell(), 4.0)


def test_frames_are_not_those_of_another_episode(four):
    env = gym.make(SPATIAL_ID, payload=4.0, max_episode_steps=-1)
    observation, info = env.reset(seed=0)
    policy, layout = load_policy("fl", SPATIAL), env.get_wrapper_attr("layout")
    peaks, actions, poses = [], [], [layout.split(observation)["pose"].copy()]
    for _ in range(500):
        observation, _, _, _, info = env.step(policy.predict(observation)[0])
        peaks.append(info["tracking_error_peak"])
        actions.append(info["commanded_action"])
        poses.append(layout.split(observation)["pose"].copy())
    env.close()
    seen, every = unpack_channels(four[0]), 500 // RATE
    assert frame_times(four[0]) == pytest.approx(np.arange(101) / RATE)
    assert seen["position"] == pytest.approx(np.array(poses)[::every, :3], abs=1e-5)
    assert seen["position_error"][1:, 0] == pytest.approx(np.array(peaks).reshape(-1, every).max(1), abs=1e-6)
    windows = np.array(actions).reshape(-1, every, 6)
    assert np.abs(seen["action"][1:]) == pytest.approx(np.abs(windows).max(1), abs=1e-3)


def test_cables_do_not_end_beside_the_platform(four):
    seen, (points, places) = unpack_channels(four[0]), platform_points(SPATIAL)
    anchors = seen["anchors"].reshape(-1, len(points), 3)[:, places]
    drawn = np.linalg.norm(anchors - SPATIAL.base, axis=-1)
    start = find_trajectory("paper-spatial", 6)(np.zeros(1)).position[0]
    assert drawn[0] == pytest.approx(cable_lengths(SPATIAL.base, SPATIAL.platform, start), abs=1e-4)
    across = [np.linalg.norm(anchors[:, one] - anchors[:, other], axis=-1) for one, other in ((0, 2), (1, 4))]
    for distances in across:  # a rigid body
        assert np.ptp(distances) < 1e-4


def test_second_episode_shows_the_limiting_violation(four):
    carried, beyond = four
    assert (carried.payload, carried.carried, carried.violation) == (4.0, True, "")
    assert beyond.payload == pytest.approx(4.2)
    assert not beyond.carried
    assert beyond.violation.startswith("rotation")


def test_payload_that_is_told_wrong_is_not_the_one_on_the_platform():
    one = replays(cell(policy="adaptive", model_payload_factor=1.1), 2.0)[0]
    assert one.payload == pytest.approx(2.0)


def test_nothing_carried_is_shown_empty_and_once():
    (only,) = replays(cell(PLANAR), None)
    assert (only.payload, only.radius) == (0.0, 0.0)


def test_springs_of_a_map_are_not_forgotten():
    stiff = replays(cell("CableBot-FlexPlanar-v0", "motor-pd", stiffness=100.0), 1.0)[0]
    soft = replays(cell("CableBot-FlexPlanar-v0", "motor-pd", stiffness=1.0), 1.0)[0]
    assert unpack_channels(stiff)["position_error"].max() < 0.5 * unpack_channels(soft)["position_error"].max()


def test_channels_without_motion_are_not_a_division_by_zero():
    still = PolicyCell(env_id=PLANAR, trajectory={"name": "dwell-planar", "duration": 0.1}, policy="fl")
    seen = unpack_channels(replays(still, 0.0)[0])
    assert all(np.isfinite(values).all() for values in seen.values())
