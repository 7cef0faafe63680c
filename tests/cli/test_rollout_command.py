"""``cablebot rollout``: recorded arrays, options and files."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"


def test_rollout_records_the_payload_motion_and_frequency(cablebot, tmp_path):
    motion = '{"name": "circle-spatial", "duration": 1.5}'
    options = (
        "--policy",
        "fl",
        "--payload",
        "0.5",
        "--control-frequency",
        "400",
        "--trajectory",
        motion,
    )
    ended = cablebot("rollout", SPATIAL, *options, "--out", tmp_path / "run.npz")
    assert "0.5 kg, task criterion: carried; recorded in" in ended.out
    with np.load(tmp_path / "run.npz") as file:
        times = file["time"]
        payloads = file["payload"]
    assert_allclose(times, np.arange(1, 841) / 400, atol=1e-12)  # with two dwells of 0.3 s
    assert_array_equal(payloads, 0.5)


@pytest.mark.usefixtures("no_work")
def test_unwritable_file_is_refused_before_the_work(cablebot, tmp_path):
    rollout = ("rollout", PLANAR, "--policy", "fl", "--out")
    for name in ("run", "run.csv.gz", "run.NPZ"):
        assert "must end in .npz or .csv" in cablebot(*rollout, tmp_path / name).message(2)
    (tmp_path / "run.csv").mkdir()
    assert "it is a folder" in cablebot(*rollout, tmp_path / "run.csv").message(2)


def test_options_reach_the_episode(cablebot, tmp_path):
    runs = {}
    for name, options in {
        "empty": (),
        "known": ("--payload", "3"),
        "unknown": ("--payload", "3", "--payload-unknown"),
        "scaled": ("--payload", "3", "--model-payload-factor", "0.9"),
        "drawn": ("--uncertainty", "table6"),
        "again": ("--uncertainty", "table6"),
        "other": ("--uncertainty", "table6", "--seed", "1"),
    }.items():
        path = tmp_path / f"{name}.npz"
        assert cablebot("rollout", SPATIAL, "--policy", "fl", *options, "--out", path).status == 0
        with np.load(path) as file:
            runs[name] = {
                key: file[key] for key in ("commanded_action", "pose", "tracking_error_peak")
            }
    start_action = {name: run["commanded_action"][0] for name, run in runs.items()}
    assert_array_equal(start_action["empty"], start_action["unknown"])
    assert np.all(np.abs(start_action["known"] - start_action["empty"]) > 1e-3)
    assert np.all(np.abs(start_action["known"] - start_action["scaled"]) > 1e-4)
    assert (
        runs["known"]["tracking_error_peak"].max()
        < 0.01
        < runs["unknown"]["tracking_error_peak"].max()
    )
    assert_array_equal(runs["drawn"]["pose"], runs["again"]["pose"])
    for before, after in (("empty", "drawn"), ("drawn", "other")):
        assert np.abs(runs[before]["pose"] - runs[after]["pose"]).max() > 1e-6


def test_early_end_is_stated_and_recorded(cablebot, toys, tmp_path):
    ended = cablebot("rollout", SPATIAL, "--policy", toys("limp"), "--out", tmp_path / "run.csv")
    assert (
        "task criterion: not carried: cable 1 falls below its tension bound of 1 N at t = 0."
        in ended.out
    )
    assert "(ended early: tracking_error)" in ended.out
    assert 10 < len((tmp_path / "run.csv").read_text().splitlines()) < 500


@pytest.mark.parametrize(("name", "status"), [("interrupted", 130), ("nan", 1)])
def test_unfinished_episode_leaves_the_old_file(cablebot, toys, tmp_path, name, status):
    path = tmp_path / "run.csv"
    path.write_text("old")
    line = cablebot(
        "rollout", PLANAR, "--policy", toys(name), "--payload", "0.25", "--out", path
    ).message(status)
    assert status == 130 or "at t = 0.020 s with a payload of 0.25 kg" in line
    assert path.read_text() == "old"
