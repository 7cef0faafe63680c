"""``cablebot video``, ``watch`` and ``picture``; their mistakes are in test_commands."""

import re
from unittest.mock import Mock

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

import cablebot_gym.video.recording as videos
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.video.recording import VideoPainter

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"


@pytest.mark.nightly
def test_video_shows_two_policies(cablebot, tmp_path):
    path = tmp_path / "new" / "both.mp4"
    options = "--policy 'fl, robust' --payload 3 --speed 4 --size 320x240"
    ended = cablebot(f"video {SPATIAL} {path} {options}")
    assert ended.status == 0
    assert imageio_ffmpeg.count_frames_and_secs(str(path))[0] == 13 + 30
    row = rf"(fl|robust) on {SPATIAL}, 3 kg, task criterion: .*carried.*"
    assert re.fullmatch(row, ended.out.splitlines()[1])
    assert f"wrote {path}" in ended.err.replace("\n", "")


def test_watch_plays_in_a_window(cablebot, monkeypatch):
    play = Mock()
    monkeypatch.setattr(videos, "play", play)
    line = f"watch {PLANAR} --policy fl --payload 1.5 --speed 0.5"
    assert cablebot(line).status == 0
    [([(title, rollout)],), keywords] = play.call_args
    assert (title, rollout.payload) == (f"fl on {PLANAR}", 1.5)
    assert keywords == {"speed": 0.5}


@pytest.mark.landing
def test_picture_shows_policies_at_a_time(cablebot, tmp_path):
    path = tmp_path / "a.png"

    def picture(options=""):
        ended = cablebot(f"picture {SPATIAL} {path} --payload 1 --size 320x240 {options}")
        assert ended.status == 0
        with Image.open(path) as image:
            return np.asarray(image), ended.out

    late, out = picture("--policy fl,robust --time 0.8")
    assert out.count("task criterion: carried") == 2
    episode = f"fl on {SPATIAL}", record_rollout("fl", SPATIAL, payload=1.0)
    assert np.array_equal(late[:, :320], VideoPainter([episode], (320, 240)).array(0.8))
    at_the_end, _ = picture("--policy fl,robust")
    assert not np.array_equal(late, at_the_end)
    start_pose, _ = picture()
    assert start_pose.shape == (240, 320, 3)
