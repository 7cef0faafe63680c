"""The maps beyond the paper: what is varied reaches plant, law and judge, and a case that carries nothing is shown."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest

from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.part import cell_key
from cablebot_baselines.paper.parts import maps
from cablebot_baselines.paper.parts.maps import PARTS, Point, point

pytest.importorskip("matplotlib")

READINGS = Interpretation()
BY_NAME = {part.name: part for part in PARTS}
CELLS = {part.name: part.cells(READINGS) for part in PARTS}
CARRIED = Point(payload=2.0, violation="rotation", time=0.5, saturated=True)
NOTHING = Point(payload=None, violation="slack", time=0.25, saturated=False)


def test_paper_case_is_not_computed_once_for_each_map() -> None:
    for law, robot in (("fl", "rigid"), ("adaptive-composite", "K3")):
        keys = {cell_key(CELLS["map-bound"][f"{law}_R10mm"]), cell_key(CELLS["map-duration"][f"{law}_1s"])}
        keys.add(cell_key(CELLS["map-stiffness"][f"{law}_{robot}"]))
        assert len(keys) == 1
    circle = cell_key(CELLS["map-circle"]["adaptive_r0.1_z0.1"])
    assert circle == cell_key(CELLS["map-bound"]["adaptive_R10mm"])


@pytest.mark.parametrize(
    ("map_name", "cell", "payload"),
    [
        ("map-bound", "fl_R10mm", 4.03),
        ("map-bound", "composite_R10mm", 4.54),
        ("map-bound", "adaptive_R10mm", 4.97),
        ("map-bound", "adaptive-composite_R10mm", 5.35),
        ("map-bound", "fl_R3mm", 3.50),
        ("map-bound", "fl_R3mm_scaled", 2.82),
        ("map-duration", "fl_0.9s", 2.17),
        ("map-stiffness", "composite_K2", 3.69),
        ("map-stiffness", "fl_limit", 4.25),
    ],
)
def test_point_is_not_another_than_was_found(map_name: str, cell: str, payload: float) -> None:
    """The first four are the README's."""
    assert CELLS[map_name][cell]().payload == pytest.approx(payload, abs=0.015)


def test_stiff_springs_do_not_end_elsewhere_than_the_rigid_robot() -> None:
    cells = CELLS["map-stiffness"]
    stiff, rigid = cells["composite_K1000"](), cells["fl_limit"]()
    assert stiff.payload == pytest.approx(rigid.payload, abs=0.02)
    assert cells["fl_limit"].keywords["robot"].damping[0] == 0.0  # Table 5 has none; with Table 4's it is 0.2 kg less


def test_stiffness_does_not_miss_plant_or_law(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = {}

    def spy(*, law, robot, **keywords):
        seen.update(law=law(robot).robot.stiffness, plant=robot.stiffness)
        raise InterruptedError

    monkeypatch.setattr(maps, "largest_payload", spy)
    for stiffness in maps.STIFFNESSES["fl4"]:
        with pytest.raises(InterruptedError):
            CELLS["map-stiffness"][f"fl4_K{stiffness:g}"]()
        for values in seen.values():
            np.testing.assert_array_equal(values, stiffness)


def test_bounds_are_not_in_millimetres() -> None:
    for bound in maps.BOUNDS:
        scaled = CELLS["map-bound"][f"fl_R{bound:g}mm_scaled"].keywords.get("error_bounds", maps.ErrorBounds())
        fixed = CELLS["map-bound"][f"fl_R{bound:g}mm"].keywords.get("error_bounds", maps.ErrorBounds())
        assert scaled.position == fixed.position == pytest.approx(bound / 1000)
        assert scaled.rotation == pytest.approx(bound / 1000)
        assert fixed.rotation == 0.01


def test_circle_is_not_another_than_its_name() -> None:
    trajectory = CELLS["map-circle"]["adaptive_r0.05_z0.25"].keywords["trajectory"]
    start = trajectory(0.0).position
    np.testing.assert_allclose(start, [0.05, 0.0, 0.25, 0.1, 0.1, 0.1])


def test_exact_map_does_not_miss_the_papers_circle(monkeypatch: pytest.MonkeyPatch) -> None:
    """1.80 kg at the jump of the acceleration; too high motors are too weak, and too wide a cable slackens."""
    monkeypatch.setattr(maps, "FINE_RADII", (0.1, 0.2))
    monkeypatch.setattr(maps, "FINE_HEIGHTS", (0.06, 0.1, 0.2))
    payload, weak = maps._exact_arrays({"exact": CELLS["map-circle"]["exact"]()})
    assert payload[1, 0] == pytest.approx(1.80, abs=0.01)
    assert weak[0, 0]
    assert not weak[2, 1]
    assert math.isnan(payload[2, 1])


def test_case_that_carries_nothing_is_not_a_number() -> None:
    robot = READINGS.spatial("payload")
    one = point(policy="fl", robot=robot, trajectory={"name": "paper-spatial", "duration": 0.7})
    assert one.payload is None
    assert one.text().startswith("slack 0.3")


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(maps, "FINE_RADII", (0.05, 0.1, 0.15))
    monkeypatch.setattr(maps, "FINE_HEIGHTS", (0.06, 0.1, 0.2))


def made_up(name: str, interpretation: Interpretation, *, nothing: bool) -> dict[str, object]:
    """Every other case carries something, or none does."""
    cells = BY_NAME[name].cells(interpretation)
    points = {cell: NOTHING if nothing or place % 2 else CARRIED for place, cell in enumerate(cells)}
    return {cell: cells[cell]() if cell == "exact" else one for cell, one in points.items()}


@pytest.mark.filterwarnings("error")
@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("nothing", [False, True])
@pytest.mark.parametrize("name", BY_NAME)
def test_cases_that_carry_nothing_are_not_left_out(name: str, nothing: bool) -> None:
    found = made_up(name, READINGS, nothing=nothing)
    outcome, figure = BY_NAME[name].outcome(READINGS, found), BY_NAME[name].draw(READINGS, found)
    figure.savefig(io.BytesIO(), format="png")
    words = {cell for table in outcome.tables for row in table.rows for cell in row}
    assert "slack 0.25 s" in words
    numbers = {key: value for key, value in outcome.numbers.items() if key.endswith("_kg") and "exact" not in key}
    assert set(numbers.values()) == ({None} if nothing else {None, 2.0})
    assert outcome.numbers["feasible_cases"] == outcome.numbers["feasible_cases_with_saturation"]
    if name != "map-circle":
        hollow = [
            line for line in figure.axes[0].lines if line.get_markerfacecolor() == "white" and len(line.get_xdata())
        ]
        assert hollow
        assert all(line.get_ydata()[0] < 0 and line.get_marker() == "v" for line in hollow)


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("name", BY_NAME)
def test_reading_that_no_motor_has_does_not_stop_the_page(name: str) -> None:
    interpretation = Interpretation(line="reversed")
    found = made_up(name, interpretation, nothing=False)
    assert set(found) <= {"exact"}
    assert BY_NAME[name].draw(interpretation, found).axes or name != "map-circle"
    assert not BY_NAME[name].outcome(interpretation, found).tables
