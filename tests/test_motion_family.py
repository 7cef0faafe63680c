"""The page of the random motions: its rows follow from records and payloads of laws."""

import json
from dataclasses import replace

import motion_family
import pytest
from motion_family import MotionRecord

SPATIAL_ID = "CableBot-Spatial-v0"
RECORD = MotionRecord(
    duration=1.0,
    acceleration=2 * 9.81,
    exact=3.0,
    exact_least=-8.0,
    held_at_start=12.0,
    held_at_worst=10.0,
    best_known=8.9,
)


@pytest.mark.parametrize(
    ("changes", "is_dynamic", "is_exact"),
    [
        ({}, True, True),
        ({"best_known": 9.1}, False, True),  # close to the limit at the worst pose
        ({"held_at_start": 9.0}, False, True),
        ({"held_at_start": None, "held_at_worst": None}, True, True),
        ({"exact_least": 0.1}, True, False),  # needs ballast
    ],
)
def test_record_says_whether_motion_is_dynamic_and_exact(changes, is_dynamic, is_exact):
    record = replace(RECORD, **changes)
    assert (record.static_fraction < motion_family.STATIC_FRACTION) == is_dynamic
    assert record.is_exact == is_exact


def test_row_has_fractions_of_the_motions():
    records = [RECORD, replace(RECORD, best_known=9.5), RECORD, replace(RECORD, exact=None)]
    laws = {"fl": [8.9, None, 1.0], "robust": [4.45, 1.9, 2.67]}
    row = motion_family.row(SPATIAL_ID, records, laws)
    cells = "**75%** | 2.00 | **75%** | **67%** of 3 | 100% | 20% to 100%"
    assert row == f"| `{SPATIAL_ID}` | 4 | {cells} |"
    weightless = [replace(RECORD, held_at_start=None, held_at_worst=None)]
    row = motion_family.row("CableBot-Planar-v0", weightless, {})
    assert row == "| `CableBot-Planar-v0` | 1 | no static limit | 2.00 | 100% | – | – | – |"


def test_page_follows_from_the_stored_results():
    anew = motion_family.page(motion_family.stored_records(), motion_family.stored_laws())
    assert motion_family.PAGE.read_text() == anew, "run python scripts/motion_family.py page"
    for path in (motion_family.RESULTS, motion_family.LAW_RESULTS):
        assert path.stat().st_size < 300_000
        assert set(json.loads(path.read_text())) <= set(motion_family.ORDER)
