"""``cablebot rollout``: recorded arrays, options and files."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from cli.conftest import names

PLANAR, SPATIAL = "CableBot-Planar-v0", "CableBot-Spatial-v0"


def read_csv(path):
    with path.open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, float)


@pytest.mark.parametrize("env_id", [PLANAR, SPATIAL])
def test_both_formats_hold_the_same_numbers(cablebot, tmp_path, env_id):
    motion = json.dumps({"name": f"circle-{env_id.split('-')[1].lower()}", "duration": 1.5})
    options = ("--policy", "fl", "--payload", "0.5", "--control-frequency", "400", "--trajectory", motion)
    for suffix in ("npz", "csv"):
        ended = cablebot("rollout", env_id, *options, "--out", tmp_path / f"run.{suffix}")
        assert "0.5 kg, task criterion: carried; recorded in" in ended.out
    header, table = read_csv(tmp_path / "run.csv")
    with np.load(tmp_path / "run.npz") as file:
        arrays = {name: file[name] for name in file.files if name != "allow_pickle"}
    columns = {}
    for name, array in arrays.items():
        parts = {f"{name}_{index + 1}": array[:, index] for index in range(array.shape[-1])} if array.ndim > 1 else {}
        columns |= parts or {name: array}
    assert list(columns) == header
    assert table.shape == (840, len(columns))  # 1.5 s and two dwells of 0.3 s
    np.testing.assert_array_equal(table, np.stack([column.astype(float) for column in columns.values()], axis=1))
    np.testing.assert_array_equal(arrays["payload"], 0.5)
    np.testing.assert_allclose(arrays["action_time"], np.arange(840) / 400, atol=1e-12)
    np.testing.assert_allclose(arrays["time"], np.arange(1, 841) / 400, atol=1e-12)
    offset = np.linalg.norm((arrays["pose"] - arrays["reference_pose"])[:, :3], axis=1)
    np.testing.assert_allclose(offset, arrays["tracking_error"], atol=1e-12)  # of the same instant
    assert {"velocity", "tensions", "torques", "commanded_action", "reward"} <= set(arrays)


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
            runs[name] = {key: file[key] for key in ("commanded_action", "pose", "tracking_error_peak")}
    first = {name: run["commanded_action"][0] for name, run in runs.items()}
    np.testing.assert_array_equal(first["empty"], first["unknown"])
    assert np.all(np.abs(first["known"] - first["empty"]) > 1e-3)
    assert np.all(np.abs(first["known"] - first["scaled"]) > 1e-4)
    assert runs["known"]["tracking_error_peak"].max() < 0.01 < runs["unknown"]["tracking_error_peak"].max()
    np.testing.assert_array_equal(runs["drawn"]["pose"], runs["again"]["pose"])
    for before, after in (("empty", "drawn"), ("drawn", "other")):
        assert np.abs(runs[before]["pose"] - runs[after]["pose"]).max() > 1e-6


def test_early_end_is_stated_and_recorded(cablebot, toys, tmp_path):
    ended = cablebot("rollout", SPATIAL, "--policy", toys("limp"), "--out", tmp_path / "run.csv")
    assert "task criterion: not carried: cable 1 falls below its tension bound of 1 N at t = 0." in ended.out
    assert "(ended early: tracking_error)" in ended.out
    assert 10 < len(read_csv(tmp_path / "run.csv")[1]) < 500


@pytest.mark.usefixtures("no_work")
def test_unwritable_file_is_found_before_the_work(cablebot, tmp_path):
    run, message = ("rollout", PLANAR, "--policy", "fl", "--out"), "must end in .npz or .csv"
    for name in ("run", "run.csv.gz", "run.NPZ"):
        assert message in cablebot(*run, tmp_path / name).message(2)
    (tmp_path / "run.csv").mkdir()
    assert "it is a folder" in cablebot(*run, tmp_path / "run.csv").message(2)
    assert names(tmp_path) == ["run.csv", "work"]


@pytest.mark.parametrize(("name", "status"), [("interrupted", 130), ("nan", 1)])
def test_episode_that_does_not_finish_leaves_the_old_file(cablebot, toys, tmp_path, name, status):
    path = tmp_path / "run.csv"
    path.write_text("old", encoding="utf-8")
    line = cablebot("rollout", PLANAR, "--policy", toys(name), "--payload", "0.25", "--out", path).message(status)
    assert status == 130 or all(part in line for part in ("t = 0.020 s", "payload of 0.25 kg"))
    assert path.read_text(encoding="utf-8") == "old"
