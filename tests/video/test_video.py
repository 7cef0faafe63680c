"""Videos: pictures and files. The commands have tests in tests/cli."""

import imageio_ffmpeg
import numpy as np
import pytest

from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.video.recording import VideoPainter, write_video

SPATIAL = "CableBot-Spatial-v0"
SMALL = (320, 240)


@pytest.fixture(scope="module")
def carried():
    return "carried", record_rollout("fl", SPATIAL, payload=1.0)


@pytest.fixture(scope="module")
def lost():
    return "lost", record_rollout("fl", SPATIAL, payload=12.0)


def test_pictures_are_side_by_side_at_the_same_time(carried, lost):
    side_by_side = VideoPainter([carried, lost], SMALL)
    first_painter = VideoPainter([carried], SMALL)
    second_painter = VideoPainter([lost], SMALL)
    assert side_by_side.size == (640, 240)
    assert side_by_side.duration == pytest.approx(1.6)
    alone = [first_painter.array(0.8), second_painter.array(0.8)]
    assert np.array_equal(side_by_side.array(0.8), np.concatenate(alone, axis=1))
    assert np.array_equal(first_painter.array(0.8), first_painter.array(0.8019)), (
        "the last moment that is not later"
    )
    assert not np.array_equal(first_painter.array(0.8), first_painter.array(0.802))


# imageio_ffmpeg leaves read pipes open
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.landing
def test_file_contains_every_picture(tmp_path, lost):
    path = tmp_path / "lost.mp4"
    progress = []
    write_video(
        str(path), [lost, lost], speed=1.0, size=SMALL, progress=lambda *done: progress.append(done)
    )
    painter = VideoPainter([lost, lost], SMALL)
    count = len(painter.times(1.0, 30))
    assert progress == [(done, count) for done in range(1, count + 1)]
    assert list(tmp_path.iterdir()) == [path]
    meta, *frames = imageio_ffmpeg.read_frames(str(path))
    assert (meta["size"], meta["codec"]) == ((640, 240), "h264")
    assert len(frames) / meta["fps"] == pytest.approx(count / 30)
    pictures = [np.frombuffer(frame, np.uint8).reshape(240, 640, 3) for frame in frames]
    end = painter.array(9.0)
    assert np.mean(np.abs(pictures[-1].astype(int) - end)) < 4  # the format is lossy
    assert np.mean(np.abs(pictures[0].astype(int) - end)) > 4


def test_interrupt_keeps_the_old_file(tmp_path, lost):
    path = tmp_path / "video.mp4"
    path.write_bytes(b"older")

    def interrupt(done, expected):
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(path, [lost], size=SMALL, progress=interrupt)
    assert [(file.name, file.read_bytes()) for file in tmp_path.iterdir()] == [
        ("video.mp4", b"older")
    ]
