"""``cablebot compare``: table, options, files and messages."""

import csv
import json

import numpy as np
import pytest
from cli.conftest import read_json
from scipy.stats import binomtest

from cablebot_gym.cli.compare import payload_grid, print_comparisons
from cablebot_gym.evaluation import compare_policies

SPATIAL = "CableBot-Spatial-v0"
MOTION = {"name": "dwell-spatial", "duration": 0.05}
HANG = f"compare {SPATIAL} --trajectory '{json.dumps(MOTION)}' "


# --- table ------------------------------------------------------------------------------------------------------------


SCALES = dict.fromkeys(("mean_error", "max_error", "max_rotation"), 1e3)
SCALES |= {"rms_torque": 1, "torque_margin": 100}
"""Columns of the table, and how they are scaled."""


def test_table_has_the_numbers_of_the_comparison(capsys, monkeypatch):
    options = {"payload": 1.25, "payload_known": False, "uncertainty": "table6", "draws": 3}
    comparison = compare_policies(
        ["fl", lambda observation: 0.9 * np.ones(6)], SPATIAL, trajectory=MOTION, **options
    )
    monkeypatch.setenv("COLUMNS", "300")
    print_comparisons([comparison])
    text = capsys.readouterr().out
    assert text.startswith(f"{SPATIAL}, payload unknown, 3 draws of table6\n")
    lines = [line.strip("│") for line in text.splitlines() if line[0] == "│"]
    for line, metrics in zip(lines, comparison.metrics, strict=True):
        _, policy, success, *cells = map(str.strip, line.split("│"))
        exact = binomtest(int(metrics.carried.sum()), 3).proportion_ci(0.95, method="exact")
        assert policy == metrics.policy
        assert success == f"{metrics.carried.mean():.0%} [{exact.low:.0%}, {exact.high:.0%}]"
        for cell, (name, scale) in zip(cells, SCALES.items(), strict=True):
            estimate = metrics.estimate(name)
            mean, width = map(float, cell.split(" ± "))
            assert mean == pytest.approx(scale * estimate.mean, rel=6e-3)
            assert width == pytest.approx(scale * (estimate.high - estimate.low) / 2, rel=6e-2)
    fraction = comparison.reduction(1, "max_error")
    assert f"max error {-fraction.mean:+.0%} [{-fraction.high:+.0%}, {-fraction.low:+.0%}]" in text


@pytest.mark.landing
def test_payloads_give_a_table_json_and_figure(cablebot, tmp_path):
    line = f"{HANG} --policies fl,robust"
    ended = cablebot(f"{line} --payload 0:3:1.5 --position-bound 20 --out {tmp_path}")
    rows = [line.split("│") for line in ended.out.splitlines() if "│" in line]
    labels = [row[1].strip() + row[2].strip() for row in rows]
    assert labels == ["0fl", "robust", "1.5fl", "robust", "3fl", "robust"]
    data = read_json(tmp_path / "comparison.json")
    assert data["payloads"] == [0.0, 1.5, 3.0]
    assert data["comparisons"][1]["error_bounds"]["position"] == 0.02
    assert (
        data["comparisons"][1] == cablebot(f"{line} --payload 1.5 --position-bound 20 --json").data
    )
    assert (tmp_path / "comparison.png").is_file()
    with (tmp_path / "draws.csv").open(encoding="utf-8") as file:
        draws = list(csv.DictReader(file))
    row = draws[3]
    assert (row["payload [kg]"], row["policy"]) == ("1.5", "robust")
    values = data["comparisons"][1]["policies"][1]["per_draw"]
    for name, column in (("max_error", "max_error [m]"), ("carried", "carried")):
        assert float(row[column]) == values[name][0]


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
