"""Episodes of the report page: compressed and in batches."""

import base64
import zlib

import numpy as np
import pytest
from benchmark.made_rows import carries

from cablebot_gym.evaluation.batch import draw_seeds
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.report.replay import LEVELS, RATE, record_row, replays

PLANAR = "CableBot-Planar-v0"
SPATIAL_ID = "CableBot-Spatial-v0"
STILL = {"name": "dwell-planar", "duration": 0.1}


def row(payload=4.0, policy="fl", env_id=SPATIAL_ID, motion="paper-spatial", **conditions):
    if isinstance(motion, str):
        motion = {"name": motion}
    return carries(policy, payload, motion, env_id=env_id, **conditions)


def unpack_channels(replay):
    """The channels of a replay as arrays (frames, components)."""
    steps = np.frombuffer(zlib.decompress(base64.b64decode(replay.data)), "<i2").reshape(
        -1, replay.frames
    )
    low = np.array(replay.low)
    high = np.array(replay.high)
    values = low + np.cumsum(steps.astype(np.int64), axis=1).T / LEVELS * (high - low)
    return dict(
        zip(
            replay.channels,
            np.split(values, np.cumsum([*replay.channels.values()])[:-1], axis=1),
            strict=True,
        )
    )


@pytest.fixture(scope="module")
def episodes():
    """Two episodes of a row."""
    return replays(row())


def test_frames_are_those_of_the_rollout(episodes):
    rollout = record_rollout("fl", SPATIAL_ID, payload=4.0, trajectory="paper-spatial")
    every = 500 // RATE
    frames = unpack_channels(episodes[0])
    assert episodes[0].frames == 101
    assert episodes[0].end == pytest.approx(1.0)
    positions = np.array([rollout.moment(index).pose[:3] for index in range(0, 501, every)])
    assert frames["position"] == pytest.approx(positions, abs=1e-5)
    peaks = rollout.arrays["tracking_error_peak"].reshape(-1, every).max(axis=1)
    assert frames["position_error"][1:, 0] == pytest.approx(peaks, abs=1e-6)
    actions = np.abs(rollout.arrays["commanded_action"].reshape(-1, every, 6)).max(axis=1)
    assert np.abs(frames["action"][1:]) == pytest.approx(actions, abs=1e-3)


def test_episode_has_the_conditions_of_its_row():
    motion = {"name": "loop-spatial", "seed": 10000}
    given = {"payload_known": False, "uncertainty": "table6"}
    replay, _ = replays(row(motion=motion, draws=3, **given))
    given |= {"trajectory": motion, "seed": draw_seeds(0, 3)[0]}
    rollout = record_rollout("fl", SPATIAL_ID, payload=4.0, **given)
    assert replay.carried == rollout.verdict.carried
    end = unpack_channels(replay)["position"][-1]
    assert end == pytest.approx(rollout.moment(-1).pose[:3], abs=1e-5)


def test_second_episode_has_the_violation(episodes):
    carried, beyond = episodes
    assert carried.payload == 4.0
    assert carried.carried
    assert carried.violation == ""
    assert carried.violation_time is None
    assert beyond.payload == pytest.approx(4.2)
    assert not beyond.carried
    violation = record_rollout(
        "fl", SPATIAL_ID, payload=4.2, trajectory="paper-spatial"
    ).verdict.violation
    assert beyond.violation_time == violation.time
    assert beyond.violation == str(violation)


def test_row_that_cannot_be_recorded_has_the_reason():
    assert record_row(row(1.0, "nobody")).startswith("No episode: unknown policy 'nobody'")


def test_constant_channels_are_finite():
    for values in unpack_channels(replays(row(0.0, env_id=PLANAR, motion=STILL))[0]).values():
        assert np.isfinite(values).all()
