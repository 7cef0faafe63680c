"""``cablebot compare``: table, options, files and messages."""

import json

import numpy as np
import pytest
from cli.conftest import names
from scipy.stats import binomtest

from cablebot_gym.cli.compare import payload_grid, print_comparison
from cablebot_gym.evaluation import compare_policies

PLANAR = "CableBot-Planar-v0"
SPATIAL = "CableBot-Spatial-v0"
MOTION = {"name": "dwell-spatial", "duration": 0.05}
HANG = '{"name": "dwell-spatial", "duration": 0.05}'
PAIR = (
    "compare",
    SPATIAL,
    "--trajectory",
    HANG,
    "--uncertainty",
    "table6",
    "--draws",
    "3",
    "--policies",
)
"""Arguments of a comparison that takes no time, but for the policies."""


def test_json_has_every_policy(cablebot, toys):
    data = cablebot(*PAIR, f" fl , {toys('limp')},", "--json").data
    assert [policy["policy"] for policy in data["policies"]] == ["fl", "cli_toys:limp"]
    assert data["draws"] == 3
    assert data["uncertainty"] == "table6"
    assert data["env_id"] == SPATIAL
    assert data["payload"] == 0


def test_options_reach_the_comparison(cablebot):
    before = cablebot(*PAIR, "fl", "--json").data
    after = cablebot(
        *PAIR, "fl", "--payload", "2.5", "--draws", "2", "--position-bound", "20", "--json"
    ).data
    assert after["payload"] == 2.5
    assert after["draws"] == 2
    assert after["error_bounds"]["position"] == 0.02
    assert before["policies"] != after["policies"]


def test_out_has_json_and_figure(cablebot, tmp_path):
    folder = tmp_path / "new" / "results"
    ended = cablebot(*PAIR, "fl", "--out", folder, "--json")
    assert names(folder) == ["comparison.json", "comparison.png"]
    assert (folder / "comparison.json").read_text() == ended.out
    assert (folder / "comparison.png").read_bytes().startswith(b"\x89PNG")
    for name in names(folder):
        assert name in ended.err


# --- table ------------------------------------------------------------------------------------------------------------


def weak(observation):
    return 0.9 * np.ones(6)


@pytest.fixture(scope="module")
def comparison():
    options = {
        "payload": 1.25,
        "payload_known": False,
        "uncertainty": "table6",
        "draws": 3,
        "trajectory": MOTION,
    }
    return compare_policies(["fl", weak], SPATIAL, **options)


def test_table_has_the_numbers_of_the_comparison(comparison, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    print_comparison(comparison)
    text = capsys.readouterr().out
    assert text.startswith(f"{SPATIAL}, payload 1.25 kg, payload unknown, 3 draws of table6\n")
    rows = [
        [cell.strip() for cell in line.strip("│").split("│")]
        for line in text.splitlines()
        if line[0] == "│"
    ]
    scales = {
        "mean_error": 1e3,
        "rms_error": 1e3,
        "max_error": 1e3,
        "max_rotation": 1e3,
        "rms_torque": 1,
    }
    scales |= {"peak_torque": 1, "torque_margin": 100, "least_tension": 1}
    for row, metrics in zip(rows, comparison.metrics, strict=True):
        exact = binomtest(int(metrics.carried.sum()), 3).proportion_ci(0.95, method="exact")
        assert row[:2] == [
            metrics.policy,
            f"{metrics.carried.mean():.0%} [{exact.low:.0%}, {exact.high:.0%}]",
        ]
        for cell, (name, scale) in zip(row[2:], scales.items(), strict=True):
            estimate = metrics.estimate(name)
            mean, width = (float(number) for number in cell.split(" ± "))
            assert mean == pytest.approx(scale * estimate.mean, rel=6e-3)
            assert width == pytest.approx(scale * (estimate.high - estimate.low) / 2, rel=6e-2)
    fraction = comparison.reduction(1, "max_error")
    assert f"max error {-fraction.mean:+.0%} [{-fraction.high:+.0%}, {-fraction.low:+.0%}]" in text


def test_one_planar_draw_has_no_interval_and_no_rotation(capsys):
    motion = {"name": "dwell-planar", "duration": 0.02}
    print_comparison(compare_policies(["fl"], "CableBot-Planar-v0", trajectory=motion))
    text = capsys.readouterr().out
    assert "1 draw of no uncertainty" in text
    for word in ("±", "confidence", "rotation"):
        assert word not in text


def test_payloads_give_a_table_json_and_figure(cablebot, tmp_path):
    pair = PAIR[: PAIR.index("--uncertainty")]
    typed = (*pair, "--policies", "fl,robust")
    ended = cablebot(*typed, "--payloads", "0:3:1.5", "--out", tmp_path)
    rows = [line.split("│") for line in ended.out.splitlines() if "│" in line]
    labels = [(row[1].strip(), row[2].strip()) for row in rows]
    assert labels == [
        ("0", "fl"),
        ("", "robust"),
        ("1.5", "fl"),
        ("", "robust"),
        ("3", "fl"),
        ("", "robust"),
    ]
    for row in rows:
        assert len(row[4:-1]) == 4  # mean and largest error, rotation and torque
    data = json.loads((tmp_path / "comparison.json").read_text())
    assert data["payloads"] == [0.0, 1.5, 3.0]
    assert data["comparisons"][1] == cablebot(*typed, "--payload", "1.5", "--json").data
    assert (tmp_path / "comparison.png").is_file()


@pytest.mark.parametrize(
    ("text", "payloads"),
    [
        ("0:9:0.5", [0.5 * index for index in range(19)]),
        ("1:1:1", [1.0]),
        ("0:0.3:0.1", [0, 0.1, 0.2, 0.3]),
        ("2,4", [2, 4]),
    ],
)
def test_payload_grid_has_both_ends(text, payloads):
    assert payload_grid(text) == payloads


@pytest.mark.parametrize("text", ["", "0:9", "0:9:0", "9:0:1", "0:9:-1", "0:1e9:1", "a,b", "2,1"])
def test_invalid_payloads_are_refused(cablebot, no_work, text):
    cablebot("compare", PLANAR, "--policies", "fl", "--payloads", text).message(2)
