"""Statements of pages, help and docstrings: wrong ones do not return, and what can be compared with the code is."""

from __future__ import annotations

import json
import math
import re
from io import BytesIO
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from PIL import Image

from cablebot_gym import ENV_IDS
from cablebot_gym.bounds.certificate import hold_payload
from cablebot_gym.cli.listing import tables
from cablebot_gym.envs import ENV_ROBOTS, PAPER_ENV_IDS
from cablebot_gym.envs.single import CableBotEnv
from cablebot_gym.robots import COORDINATE_NAMES, find_robot, library

ROOT = Path(__file__).parents[1]

FORBIDDEN = {
    "robots with three coordinates": r"\bn is 2\b|2 planar, 6 spatial|0 for planar robots|planar robots start at",
    "real robots": r"(?<!first four )robots are those of Korayem",
    "elastic cables": r"inextensible|nor this project has a model of elastic",
    "eight environments": r"all four robots|both robots|standard` has all|all environments, 3|circle of all env",
    "compiled once per form and use": r"once for each kind of robot",
    "robots whose motion is no circle": r"that of the robot: the paper's circle|\* \| the paper's circle",
    "bounds of robots under gravity": r"(bound:|infeasible,) for rigid planar|^\* Spatial robots and a motion",
    "tension bound, not slack": r"without a slack cable|within its bound and no slack",
    "standard gravity is 9.80665": r"STANDARD_GRAVITY",
    "a card's field that says nothing": r"--data - ",
}
"""What a statement overlooks, and a pattern of it."""

FOLDERS = ("cablebot_gym", "baselines", "docs", "paper", "scripts", "examples")
SUFFIXES = {".py", ".md", ".toml", ".html", ".ipynb", ".yaml"}
TEXTS = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in [
        ROOT / "README.md",
        ROOT / "LEADERBOARD.md",
        *(p for name in FOLDERS for p in (ROOT / name).rglob("*")),
    ]
    if path.suffix in SUFFIXES and "generated" not in path.parts
}


@pytest.mark.parametrize("overlooked", FORBIDDEN)
def test_no_text_makes_a_claim_that_overlooks(overlooked):
    pattern = re.compile(FORBIDDEN[overlooked], re.IGNORECASE | re.MULTILINE)
    assert {name: pattern.search(text)[0] for name, text in TEXTS.items() if pattern.search(text)} == {}


def test_manual_names_the_coordinates_of_every_id():
    for robot in map(find_robot, ENV_ROBOTS.values()):
        assert f"({', '.join(COORDINATE_NAMES[robot.kind])})" in CableBotEnv.__doc__


def test_list_says_what_is_elastic():
    rows = {row[0]: row[-1] for key, _, rows in tables() for row in rows if key == "ids"}
    assert rows.pop("id") == "transmission"
    assert set(rows) == set(ENV_IDS)
    for env_id, text in rows.items():
        robot = find_robot(ENV_ROBOTS[env_id])
        assert ("joint springs" in text, "elastic cables" in text) == (robot.jointed, robot.elastic)


def test_faq_names_all_robots_of_the_library_with_eight_cables():
    answer = TEXTS["docs/faq.md"].partition("use 8 cables?")[2].partition("[Real robots]")[0]
    assert {name for name in library() if f"`{name}`" in answer} == {
        name for name in library() if find_robot(name).cables == 8
    }


def test_leaderboard_begins_with_its_tables_and_names_the_ids_without_one():
    head = TEXTS["LEADERBOARD.md"].partition("\n| rank |")[0]
    assert len(head.splitlines()) < 10
    assert {env_id for env_id in ENV_IDS if f"`{env_id}`" in head} == set(ENV_IDS) - set(PAPER_ENV_IDS)
    assert all(f"\n## {env_id}\n" in TEXTS["LEADERBOARD.md"] for env_id in PAPER_ENV_IDS)


def test_notebook_shows_all_ids():
    cells = json.loads(TEXTS["examples/tour.ipynb"])["cells"]
    printed = [line for cell in cells for output in cell.get("outputs", ()) for line in output.get("text", ())]
    assert ", ".join(ENV_IDS) + "\n" in printed


@pytest.mark.parametrize("env_id", ENV_IDS)
def test_upper_bound_exists_under_gravity_as_the_page_says(env_id):
    task = gym.make(env_id).unwrapped.settings
    bound = hold_payload(task.robot, task.trajectory, task.error_bounds)
    assert math.isfinite(bound) == (not task.robot.weightless)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(
    ("style", "box"),
    [("docs/_static/site.css", "table-wrapper"), ("cablebot_gym/report/assets/style.css", "wide")],
)
def test_wide_table_on_a_phone_shows_that_it_scrolls(browser, style, box, scheme):
    """Its edge has a shadow where columns are hidden, and none at the end of the table."""
    row = "<tr>" + "<td style='min-width: 9em'>–</td>" * 8 + "</tr>"
    css = (ROOT / style).read_text(encoding="utf-8")
    page = browser.new_page(viewport={"width": 390, "height": 300}, color_scheme=scheme)
    page.set_content(
        f"<html data-theme={scheme}><style>body {{ --color-background-primary: Canvas; color-scheme: {scheme} }}"
        f"{css} .{box} {{ overflow-x: auto }}</style>"
        f"<body data-theme={scheme}><div class={box}><table>{8 * row}</table></div></body></html>"
    )

    def edges():
        with Image.open(BytesIO(page.screenshot())) as picture:
            colours = np.asarray(picture.convert("L"), int)[100]
        return [abs(int(colours[x]) - int(np.median(colours))) for x in (14, 375)]

    left, right = edges()
    assert left < 20 < right
    page.evaluate(f"document.querySelector('.{box}').scrollLeft = 1e6")
    page.evaluate("new Promise(painted => requestAnimationFrame(() => requestAnimationFrame(painted)))")
    left, right = edges()
    assert right < 20 < left
    page.close()
