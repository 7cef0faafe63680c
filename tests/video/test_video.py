"""Films: what is in them, what they are written to, and the two commands."""

from __future__ import annotations

import re

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

import cablebot_gym.video.recording as videos
from cablebot_gym.cli import app as cli
from cablebot_gym.rendering.painter import import_pygame
from cablebot_gym.rendering.window import Window
from cablebot_gym.video.recording import VideoPainter, play, record_video, write_video

pygame = import_pygame()
PLANAR, SPATIAL = "CableBot-Planar-v0", "CableBot-Spatial-v0"
SMALL = (320, 240)


@pytest.fixture(scope="module")
def carried():
    return record_video("fl", SPATIAL, payload=1.0)


@pytest.fixture(scope="module")
def lost():
    return record_video("fl", SPATIAL, payload=9.0)


def test_video_has_every_control_step_and_the_start(carried):
    times = [moment.time for moment in carried.moments]
    assert times == pytest.approx(np.arange(501) * 0.002)
    assert carried.scene.title == f"fl on {SPATIAL}"
    assert carried.trail.shape == (501, 6)
    assert np.ptp(carried.trail[:, 0]) > 0.1


def test_instants_are_those_not_later(carried):
    assert [carried.at(time) for time in (0.0, 0.0019, 0.002, 0.5, 1.0, 7.0)] == [0, 0, 1, 250, 500, 500]


def test_nothing_is_said_before_it_is_known(carried, lost):
    assert [carried.note(place) for place in (0, 499, 500)] == ["", "", "carried"]
    first = next(place for place, _ in enumerate(lost.moments) if lost.note(place))
    violation = lost.verdict.violation
    assert lost.moments[first].time == pytest.approx(violation.time)
    assert lost.note(first) == lost.note(len(lost.moments) - 1) == f"not carried: {violation}"


def test_pictures_stand_side_by_side_in_the_order_of_the_videos(carried, lost):
    alone = [VideoPainter([one], SMALL).array(0.3) for one in (carried, lost)]
    both = VideoPainter([carried, lost], SMALL)
    assert both.size == (640, 240)
    assert np.array_equal(both.array(0.3), np.concatenate(alone, axis=1))


def test_a_quarter_of_the_speed_takes_four_times_as_long_and_the_end_stays(carried):
    projector = VideoPainter([carried], SMALL)
    slow, real = projector.times(0.25, 30), projector.times(1.0, 30)
    assert (len(slow), len(real)) == (121 + 30, 31 + 30)
    assert slow[:3] == pytest.approx([0, 0.25 / 30, 0.5 / 30])
    assert np.all(slow[120:] == 1.0)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # imageio_ffmpeg leaves read pipes open
@pytest.mark.parametrize(("suffix", "rate"), [(".mp4", 30), (".gif", 25)])
def test_file_holds_every_picture_in_its_size_and_time(tmp_path, lost, suffix, rate):
    path, progress = tmp_path / f"lost{suffix}", []
    write_video(path, [lost, lost], speed=1.0, size=SMALL, progress=lambda *done: progress.append(done))
    count = len(VideoPainter([lost], SMALL).times(1.0, rate))
    assert progress == [(done, count) for done in range(1, count + 1)]
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    if suffix == ".mp4":
        pictures = imageio_ffmpeg.read_frames(str(path))
        about = next(pictures)
        assert (about["size"], about["fps"], about["codec"]) == ((640, 240), rate, "h264")
        read = [np.frombuffer(picture, np.uint8).reshape(240, 640, 3) for picture in pictures]
        assert len(read) == count
    else:
        with Image.open(path) as image:
            assert image.size == (640, 240)
            assert image.info["loop"] == 0
            read, lasting = [], 0
            for place in range(image.n_frames):  # pictures that are alike are one that lasts longer
                image.seek(place)
                read.append(np.asarray(image.convert("RGB")))
                lasting += image.info["duration"]
            assert lasting == pytest.approx(1000 * count / rate)
    last = VideoPainter([lost, lost], SMALL).array(9.0)
    assert np.mean(np.abs(read[-1].astype(int) - last)) < 4  # both formats lose a little
    assert np.mean(np.abs(read[0].astype(int) - last)) > 1.2 * np.mean(np.abs(read[-1].astype(int) - last))


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_interrupt_leaves_what_was_there(tmp_path, lost, suffix):
    path = tmp_path / f"video{suffix}"
    path.write_bytes(b"older")

    def interrupt(done, expected):
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(path, [lost], size=SMALL, progress=interrupt)
    assert path.read_bytes() == b"older"
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    ("name", "keywords", "words"),
    [
        ("video.avi", {}, r"video.avi'.*end in .mp4 or .gif"),
        ("video.mp4", {"speed": 0.0}, "speed must lie between 0.01 and 10"),
        ("video.mp4", {"speed": float("nan")}, "speed must lie between 0.01 and 10"),
        ("video.mp4", {"size": (641, 480)}, "even numbers of pixels, not 641 × 480"),
        ("video.gif", {"size": (64, 48)}, "at least 320 × 240"),
    ],
)
def test_bad_input_is_refused_in_words_and_nothing_is_written(tmp_path, lost, name, keywords, words):
    with pytest.raises(ValueError, match=words):
        write_video(tmp_path / name, [lost], **keywords)
    assert list(tmp_path.iterdir()) == []


def test_keys_stop_step_and_end(monkeypatch, lost):
    """Which picture is shown after which key."""
    shown, typed = [], iter([[], [], ["space"], [], ["right"], ["left"], ["r"], ["space"], [], ["q"]])
    monkeypatch.setattr(VideoPainter, "surfaces", lambda self, time: shown.append(time) or iter([]))
    monkeypatch.setattr(Window, "show", lambda self, picture, rate: next(typed))
    play([lost], speed=1.0, size=SMALL)
    times = VideoPainter([lost], SMALL).times(1.0, 30)
    assert [int(np.searchsorted(times, time)) for time in shown] == [0, 1, 2, 2, 2, 3, 2, 0, 0, 1]


def test_video_begins_again_until_the_window_is_closed(monkeypatch, lost):
    shown = []
    monkeypatch.setattr(VideoPainter, "surfaces", lambda self, time: shown.append(time) or iter([]))
    times = VideoPainter([lost], SMALL).times(10.0, 30)

    def show(window, picture, rate):
        window.closed = len(shown) == len(times) + 2
        return []

    monkeypatch.setattr(Window, "show", show)
    play([lost], speed=10.0, size=SMALL)
    assert shown == [*times, *times[:2]]


# ---------------------------------------------------------------------------------------------------------- commands


@pytest.fixture
def cablebot(monkeypatch, capsys):
    def run(*arguments):
        monkeypatch.setattr("sys.argv", ["cablebot", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capsys.readouterr()
        return ended.value.code or 0, out, err

    return run


def test_failure_in_a_video_names_the_policy_as_it_was_typed(cablebot, tmp_path, monkeypatch):
    (tmp_path / "video_toys.py").write_text(
        "def broken(robot):\n    return lambda observation: None\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    status, _, err = cablebot("video", PLANAR, tmp_path / "video.gif", "--policy", "video_toys:broken")
    assert status == 1
    assert "policy 'video_toys:broken' failed at t = 0.000 s" in " ".join(err.split())
    assert not (tmp_path / "video.gif").exists()


def test_video_of_two_policies(cablebot, tmp_path):
    out = tmp_path / "new" / "both.mp4"
    arguments = ("--policies", "fl, robust", "--payload", "3", "--speed", "4", "--size", "320x240")
    status, said, err = cablebot("video", SPATIAL, out, *arguments)
    assert (status, imageio_ffmpeg.count_frames_and_secs(str(out))[0]) == (0, 9 + 30)
    assert re.fullmatch(rf"(fl|robust) on {SPATIAL}, 3 kg, task criterion: .*carried.*", said.splitlines()[1])
    assert err.replace("\n", "") == f"wrote {out}"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("video.mp4",), "give either --policy with one name, or --policies with several"),
        (("video.mp4", "--policy", "fl", "--policies", "fl"), "give either --policy"),
        (("video.mp4", "--policies", " , "), "give either --policy"),
        (("video.webm", "--policy", "fl"), "has to end in .mp4 or .gif"),
        (("video.mp4", "--policy", "fl", "--size", "large"), "such as 640x480, not 'large'"),
        (("video.mp4", "--policy", "fl", "--size", "642x481"), "even number"),
        (("video.gif", "--policy", "fl", "--size", "100000x100000"), "at most 7680 × 4320 pixels"),
        (("video.mp4", "--policy", "fl", "--speed", "-1"), "speed must lie between"),
        (("video.mp4", "--policy", "flying"), "flying"),
        (("video.mp4", "--policy", "fl", "--trajectory", "spiral"), "spiral"),
    ],
)
def test_mistakes_are_told_in_one_line(cablebot, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    status, said, err = cablebot("video", SPATIAL, *arguments)
    assert (status, said) == (2, "")
    assert words in err
    assert len(err.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_watch_plays_what_was_asked_for(cablebot, monkeypatch):
    asked = []
    monkeypatch.setattr(videos, "play", lambda shown, **keywords: asked.append((shown, keywords)))
    status, _, _ = cablebot(
        "watch", PLANAR, "--policy", "fl", "--payload", "1.5", "--speed", "0.5", "--size", "400x300"
    )
    assert status == 0
    [(shown, keywords)] = asked
    assert keywords == {"speed": 0.5, "size": (400, 300)}
    assert [one.moments[0].payload for one in shown] == [1.5]


def test_watch_without_a_display_ends_with_one_sentence(cablebot, monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    status, _, err = cablebot("watch", PLANAR, "--policy", "fl")
    assert status == 2
    assert (
        f"no display for a window. Write a video instead, with the same options: cablebot video {PLANAR}"
        in " ".join(err.split())
    )
    assert "Traceback" not in err
