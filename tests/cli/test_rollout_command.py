"""``cablebot rollout``: recorded arrays, options and files."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

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
def test_options_reach_the_episode(cablebot, tmp_path):
    def run(options):
        path = tmp_path / "run.npz"
        assert cablebot(f"rollout {SPATIAL} --policy fl --out {path} {options}").status == 0
        with np.load(path) as file:
            return file["commanded_action"][0], file["pose"]

    empty, plain = run("")
    known, _ = run("--payload 3")
    unknown, _ = run("--payload 3 --payload-unknown")
    scaled, _ = run("--payload 3 --model-payload-factor 0.9")
    assert_array_equal(empty, unknown)
    assert np.all(np.abs(known - empty) > 1e-3)
    assert np.all(np.abs(known - scaled) > 1e-4)
    _, drawn = run("--uncertainty table6")
    _, again = run("--uncertainty table6 --seed 0")
    _, reseeded = run("--uncertainty table6 --seed 1")
    assert_array_equal(drawn, again)
    for before, after in ((plain, drawn), (drawn, reseeded)):
        assert np.abs(before - after).max() > 1e-6


@pytest.mark.landing
def test_figure_of_an_episode_has_its_sentence(cablebot, tmp_path):
    pytest.importorskip("matplotlib.figure")
    path = tmp_path / "run.png"
    printed = cablebot(f"rollout {PLANAR} --policy fl --payload 0.5 --out {path}").out
    assert f"0.5 kg, task criterion: carried; recorded in {path}" in printed
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
