"""The page of the random motions follows from the stored results."""

import json

import motion_family


def test_page_follows_from_the_stored_results():
    anew = motion_family.page(motion_family.stored_records(), motion_family.stored_laws())
    assert motion_family.PAGE.read_text() == anew, "run python scripts/motion_family.py page"
    for path in (motion_family.RESULTS, motion_family.LAW_RESULTS):
        assert path.stat().st_size < 300_000
        assert set(json.loads(path.read_text())) <= set(motion_family.ORDER)
