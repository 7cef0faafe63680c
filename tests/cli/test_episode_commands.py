"""``cablebot rollout`` and ``video``: recorded arrays, options and files. Mistakes are in
test_commands."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.video import recording

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"


def test_rollout_records_the_payload_motion_and_frequency(cablebot, tmp_path):
    line = f"rollout {SPATIAL} --policy fl --payload 0.5 --control-frequency 400 --trajectory "
    motion = """'{"name": "circle-spatial", "duration": 1.5}'"""
    ended = cablebot(line + motion, "--out", tmp_path / "run.npz")
    assert "0.5 kg, task criterion: carried; recorded in" in ended.out
    with np.load(tmp_path / "run.npz") as file:
        times = np.arange(1, 841) / 400  # with two dwells of 0.3 s
        assert_allclose(file["time"], times, atol=1e-12)
        assert_array_equal(file["payload"], 0.5)


@pytest.mark.landing
def test_figure_of_an_episode_is_whole(cablebot, tmp_path):
    pytest.importorskip("matplotlib.figure")
    path = tmp_path / "run.png"
    assert cablebot(f"rollout {PLANAR} --policy fl --payload 0.5 --out {path}").status == 0
    assert path.read_bytes().endswith(b"IEND\xaeB`\x82")


def test_early_end_is_stated_and_recorded(cablebot, toys, tmp_path):
    path = tmp_path / "run.csv"
    out = cablebot(f"rollout {SPATIAL} --policy {toys('limp')} --out {path}").out
    violation = "cable 1 falls below its tension bound of 1 N at t = 0."
    assert f"task criterion: not carried: {violation}" in out
    assert "(ended early: tracking_error)" in out
    assert 10 < len(path.read_text().splitlines()) < 500


@pytest.mark.parametrize(("name", "status"), [("interrupted", 130), ("nan", 1)])
def test_unfinished_episode_leaves_the_old_file(cablebot, toys, tmp_path, name, status):
    path = tmp_path / "run.csv"
    path.write_text("old")
    line = f"rollout {PLANAR} --policy {toys(name)} --no-isolate --payload 0.25 --out {path}"
    message = cablebot(line).message(status)
    assert status == 130 or "at t = 0.020 s with a payload of 0.25 kg" in message
    assert path.read_text() == "old"


# --- pictures ---------------------------------------------------------------------------------------------------------


@pytest.mark.landing
def test_picture_shows_policies_at_a_time(cablebot, tmp_path):
    path = tmp_path / "a.png"

    def picture(options):
        ended = cablebot(
            f"video {SPATIAL} --out {path} --policy fl,robust --payload 1 --size 320x240 {options}"
        )
        assert ended.status == 0
        with Image.open(path) as image:
            return np.asarray(image), ended.out

    late, out = picture("--time 0.8")
    assert out.count("task criterion: carried") == 2
    episode = f"fl on {SPATIAL}", record_rollout("fl", SPATIAL, payload=1.0)
    assert np.array_equal(late[:, :320], recording.VideoPainter([episode], (320, 240)).array(0.8))
    at_the_end, _ = picture("")
    assert not np.array_equal(late, at_the_end)
