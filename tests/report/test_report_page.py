"""The page in a real browser: it loads without errors, sorts, filters, and its slider moves the robot."""

from __future__ import annotations

import json
import os
import shutil
import sys
from types import SimpleNamespace

import pytest

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, Record, compute
from cablebot_gym.benchmark.leaderboard import results_json
from cablebot_gym.benchmark.maps import AXES
from cablebot_gym.cli import app as cli
from cablebot_gym.report import recording
from cablebot_gym.report.page import Source, html

PLANAR = "CableBot-Planar-v0"
CIRCLE = {"name": "paper-planar"}
LOOPS = [{"name": "loop-planar", "seed": 10_000 + number} for number in range(2)]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


def record(cell, **result):
    return Record(cell=cell, source="a" * 16, versions={"python": "3.11"}, result=result, seconds=1.0)


def best(motion, payload, **more):
    result = {"payload": payload, "total_mass": payload + 1, "verified": True}
    return record(BestKnownCell(env_id=PLANAR, trajectory=motion, **more), **result)


def carried(cell, payload, **more):
    rest = {
        "assured_payload": None,
        "applicable": True,
        "total_mass": 2.0,
        "resolution": 1e-3,
        "violation": {"kind": "position", "index": None, "time": 0.5, "excess": 1e-6, "reason": ""},
        "failures": {},
        "fallbacks": None,
    }
    return record(cell, payload=payload, feasible=[[0.0, payload]], **(rest | more))


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A small benchmark: true payloads on the circle, made-up ones elsewhere."""
    folder = tmp_path_factory.mktemp("results")
    fl, adaptive = (PolicyCell(env_id=PLANAR, trajectory=CIRCLE, policy=name) for name in ("fl", "adaptive"))
    wide = AXES["position"].with_value(fl, 0.02)
    drawn = PolicyCell(env_id=PLANAR, trajectory=CIRCLE, policy="fl", uncertainty="table6", draws=4)
    records = [
        compute(BestKnownCell(env_id=PLANAR, trajectory=CIRCLE)),
        best(CIRCLE, 3.5, error_bounds=dict(wide.error_bounds)),
        *(best(motion, 4.0) for motion in LOOPS),
        *(compute(cell) for cell in (fl, adaptive)),
        carried(wide, 2.5),
        carried(drawn, 1.0, assured_payload=0.5),
        *(
            carried(PolicyCell(env_id=PLANAR, trajectory=motion, policy="fl"), payload)
            for motion, payload in zip(LOOPS, (1.0, 2.0), strict=True)
        ),
        record(PolicyCell(env_id=PLANAR, trajectory=CIRCLE, policy="nobody</script>"), error="it raised <b>"),
    ]
    (folder / "results.json").write_text(results_json("smoke", "cablebot benchmark", records), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def command(tmp_path_factory):
    def run(*arguments, capsys=None):
        before, sys.argv = sys.argv, ["cablebot", "report", *map(str, arguments)]
        try:
            cli.main()
            status = 0
        except SystemExit as ended:
            status = ended.code or 0
        finally:
            sys.argv = before
        said = capsys.readouterr() if capsys else SimpleNamespace(out="", err="")
        return SimpleNamespace(status=status, out=said.out, err=said.err)

    return run


@pytest.fixture(scope="module")
def written(results, command, tmp_path_factory):
    out = tmp_path_factory.mktemp("page") / "report.html"
    assert command(results, "--out", out, "--workers", 1).status == 0
    return out


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    path = next((found for name in BROWSERS if (found := shutil.which(name))), None)
    if path is None:
        if os.environ.get("CI"):
            pytest.fail("no Chromium is installed, and CI has to look at the page: apt-get install chromium")
        pytest.skip("no Chromium is installed")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser, written):
    """The page, in a window of a size; a complaint of the browser is an error at the end."""
    complaints, contexts = [], []

    def load(width=1200, height=900, scheme="light", at="", file=written):
        contexts.append(browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme))
        page = contexts[-1].new_page()
        page.on("console", lambda message: complaints.append(message.text) if message.type != "log" else None)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "request", lambda asked: asked.url.startswith(("file:", "data:", "blob:")) or complaints.append(asked.url)
        )
        page.goto(file.as_uri() + at)
        page.wait_for_function("document.getElementById('replay').frames || document.getElementById('replay').hidden")
        return page

    yield load
    for context in contexts:
        context.close()
    assert complaints == []


def policies(page):
    return page.locator("#leaderboard-table tbody tr td:first-child").all_inner_texts()


def picture(page):
    return page.evaluate("document.getElementById('scene').toDataURL()")


def test_page_loads_without_complaint_or_network(opened):
    page = opened()
    assert "fl on CableBot-Planar-v0" in page.inner_text("#episode-title")
    assert page.inner_text("#verdict") == "1.92 kg: carried"
    assert page.locator("figure:visible svg path.curve").count() == 3 + 1 + 3 + 2  # actions, error, tensions, the map


def test_sorting_sorts_either_way_and_says_so(opened):
    page = opened()
    assert policies(page) == ["best known payload", "adaptive", "fl", "nobody</script>"]
    head = page.locator("#leaderboard-table th", has_text="policy")
    head.locator("button").click()
    assert policies(page) == ["adaptive", "best known payload", "fl", "nobody</script>"]
    assert head.get_attribute("aria-sort") == "ascending"
    head.locator("button").click()
    assert policies(page) == ["nobody</script>", "fl", "best known payload", "adaptive"]
    assert head.get_attribute("aria-sort") == "descending"
    fraction = page.locator("#leaderboard-table th", has_text="fraction")
    fraction.locator("button").click()
    assert policies(page)[:2] == ["best known payload", "adaptive"]
    fraction.locator("button").click()
    assert policies(page) == [
        "fl",
        "adaptive",
        "best known payload",
        "nobody</script>",
    ]  # what has no fraction is last either way


def test_filters_leave_what_is_asked_for(opened):
    page = opened()
    page.select_option("#filter-condition", "")
    page.select_option("#filter-motion", "")
    assert page.inner_text("#count") == "7 of 7 rows"
    page.fill("#filter-policy", "ADAP")
    assert policies(page) == ["adaptive"]
    page.fill("#filter-policy", "")
    page.select_option("#filter-condition", "payload known, table6")
    assert policies(page) == ["fl"]
    assert page.locator("#leaderboard-table .text").get_attribute("title") == "35%, 17% to 35%"


def test_slider_moves_the_robot_and_the_cursors(opened):
    page = opened()
    before, cursor = picture(page), page.locator("#chart-action .cursor").get_attribute("x1")
    page.focus("#time")
    page.keyboard.press("End")
    assert page.inner_text("#clock") == "1.00 s"
    assert picture(page) != before
    assert page.locator("#chart-action .cursor").get_attribute("x1") != cursor
    page.keyboard.press("Home")
    assert page.inner_text("#clock") == "0.00 s"
    assert picture(page) == before


def test_robot_is_turned_by_keys_and_by_the_mouse(opened):
    page = opened()
    before = picture(page)
    page.focus("#scene")
    page.keyboard.press("ArrowLeft")
    turned = picture(page)
    assert turned != before
    page.keyboard.press("+")
    near = picture(page)
    assert near != turned
    scene = page.locator("#scene")
    scene.hover(position={"x": 100, "y": 100})  # brings it into the window first
    page.mouse.down()
    scene.hover(position={"x": 160, "y": 100})
    page.mouse.up()
    page.wait_for_function("near => document.getElementById('scene').toDataURL() !== near", arg=near)


def test_playing_ends_at_the_end(opened):
    page = opened()
    page.select_option("#speed", "1")
    page.click("#play")
    assert page.get_attribute("#play", "aria-pressed") == "true"
    page.wait_for_function("document.getElementById('clock').textContent === '1.00 s'")
    page.wait_for_function("document.getElementById('play').getAttribute('aria-pressed') === 'false'")


def test_more_than_is_carried_shows_the_limiting_violation(opened):
    page = opened()
    page.get_by_label("above the DLCC").check()
    page.wait_for_function("document.getElementById('verdict').className === 'bad'")
    assert page.inner_text("#verdict").startswith("2.02 kg: position at t = ")


def test_row_is_chosen_by_keyboard_and_linked(opened):
    page = opened()
    page.locator("#leaderboard-table tbody button", has_text="adaptive").focus()
    page.keyboard.press("Enter")
    page.wait_for_function("document.getElementById('episode-title').textContent.startsWith('adaptive')")
    assert page.locator("tr[aria-current=true]").inner_text().startswith("adaptive")
    again = opened(at=page.evaluate("location.hash"))
    assert again.inner_text("#episode-title").startswith("adaptive")


def test_every_motion_of_a_family_can_be_seen(opened):
    page = opened()
    page.select_option("#filter-motion", "")
    page.locator("#leaderboard-table tbody tr", has_text="2 held-out").filter(has_text="fl").locator("button").click()
    assert page.locator("#motion option").count() == 2
    page.select_option("#motion", index=1)
    page.wait_for_function("document.getElementById('payloads').textContent.includes('2.00 kg')")


def test_policy_that_failed_says_why_and_is_no_markup(opened):
    page = opened()
    page.locator("#leaderboard-table tbody button", has_text="nobody").click()
    assert page.locator("#replay").is_hidden()
    page.click("summary:has-text('How this number is computed')")
    assert "it raised <b>" in page.inner_text("#recipe")


def test_recipe_computes_the_number(opened):
    page = opened()
    page.click("summary:has-text('How this number is computed')")
    code = page.inner_text("#recipe pre")
    results = []
    exec(code, {"print": lambda result: results.append(result)})
    assert results[0].payload == pytest.approx(1.92, abs=5e-3)


def test_best_known_payload_is_carried_by_its_own_inputs_and_its_recipe_finds_it(opened):
    page = opened()
    page.locator("#leaderboard-table tbody button", has_text="best known payload").click()
    page.wait_for_function("document.getElementById('verdict').textContent === '2.87 kg: carried'")
    assert page.locator("#payloads input").count() == 1, "inputs are of one payload"
    page.focus("#time")
    page.keyboard.press("End")
    assert page.inner_text("#clock") == "1.00 s"
    page.click("summary:has-text('How this number is computed')")
    results = []
    exec(page.inner_text("#recipe pre"), {"print": lambda result: results.append(result)})
    assert results[0].payload == pytest.approx(2.87, abs=5e-3)


def test_best_known_payload_whose_inputs_are_lost_says_how_to_find_them(opened):
    page = opened()
    page.select_option("#filter-motion", "")
    page.locator("#leaderboard-table tbody tr", has_text="2 held-out").filter(has_text="best").locator("button").click()
    assert page.locator("#replay").is_hidden()
    assert "not in the cache" in page.inner_text("#verdict")
    page.click("summary:has-text('How this number is computed')")
    assert "find_best_known(" in page.inner_text("#recipe pre")


def test_map_has_both_bounds_and_its_numbers(opened):
    page = opened()
    page.click("#maps summary")
    assert [row.split() for row in page.locator("#maps tr").all_inner_texts()][-2:] == [
        ["best", "known", "payload", "2.87", "3.50"],
        ["fl", "1.92", "2.50"],
    ]


def test_policy_looks_the_same_in_every_map(opened, tmp_path):
    asked = {PLANAR: ("fl", "apg-loops"), "CableBot-Spatial-v0": ("adaptive", "fl", "apg-loops")}
    records = [
        carried(AXES["position"].with_value(PolicyCell(env_id=env_id, trajectory=motion, policy=name), bound), 1.0)
        for (env_id, names), motion in zip(asked.items(), (CIRCLE, {"name": "paper-spatial"}), strict=True)
        for name in names
        for bound in (0.005, 0.01)
    ]
    file = tmp_path / "maps.html"
    file.write_text(html("maps", [Source("maps", "cablebot benchmark", records)], {}), encoding="utf-8")
    legends = opened(file=file).evaluate(
        """[...document.querySelectorAll("#maps .legend li")].map((item) => {
          const line = item.querySelector("line");
          return [item.textContent.trim(), line.getAttribute("stroke") + line.getAttribute("stroke-dasharray")];
        })"""
    )
    assert [name for name, _ in legends] == [name for names in asked.values() for name in names]
    looks = {name: {look for other, look in legends if other == name} for name, _ in legends}
    assert all(len(found) == 1 for found in looks.values())
    assert len(set.union(*looks.values())) == 3


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_phone_needs_no_sideways_scrolling_and_colours_follow_the_system(opened, scheme):
    page = opened(360, 740, scheme)
    assert page.evaluate("document.documentElement.scrollWidth") <= 360
    assert page.evaluate("document.documentElement.dataset.theme") == scheme
    page.click("#theme")
    assert page.evaluate("document.documentElement.dataset.theme") == "light"


def test_page_without_episodes_has_the_table(results, command, browser, tmp_path, capsys):
    out = tmp_path / "bare.html"
    assert command(results, "--out", out, "--no-episodes", capsys=capsys).status == 0
    page = browser.new_page()
    page.goto(out.as_uri())
    assert page.locator("#leaderboard-table tbody tr").count() == 4
    assert page.locator("#replay").is_hidden()
    page.close()


def test_without_a_best_known_payload_payloads_give_the_order(results, command, browser, tmp_path):
    data = json.loads((results / "results.json").read_text(encoding="utf-8"))
    data["cells"] = [entry for entry in data["cells"] if entry["cell"]["kind"] == "policy"]
    (tmp_path / "results.json").write_text(json.dumps(data), encoding="utf-8")
    out = tmp_path / "unknown.html"
    assert command(tmp_path, "--out", out, "--no-episodes").status == 0
    page = browser.new_page()
    page.goto(out.as_uri())
    assert policies(page) == ["adaptive", "fl", "nobody</script>"]
    rows = page.locator("#leaderboard-table tbody tr").all_inner_texts()
    assert ["no best known payload" in row for row in rows] == [True, True, False], "what failed says so beside it"
    page.locator("#leaderboard-table th", has_text="fraction").locator("button").click()
    assert policies(page) == ["fl", "adaptive", "nobody</script>"]
    page.close()


def test_second_report_records_nothing_anew_and_is_the_same(results, command, written, tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "replays", None)  # of a policy; lost inputs are looked for each time
    out = tmp_path / "again.html"
    assert command(results, "--out", out, "--workers", 1).status == 0
    assert out.read_bytes() == written.read_bytes()


def test_broken_episode_is_recorded_anew(results, command, written, tmp_path):
    file = min((results / recording.FOLDER).glob("*.json"))
    whole = file.read_text(encoding="utf-8")
    file.write_text(whole[:100], encoding="utf-8")
    assert command(results, "--out", tmp_path / "again.html", "--workers", 1).status == 0
    assert file.read_text(encoding="utf-8") == whole


def test_policy_that_is_gone_costs_its_episode_and_says_so(results, command, tmp_path, capsys):
    data = json.loads((results / "results.json").read_text(encoding="utf-8"))
    data["cells"] = [entry for entry in data["cells"] if entry["cell"].get("policy") == "adaptive"]
    data["cells"][0]["cell"]["policy"] = "gone"
    (tmp_path / "results.json").write_text(json.dumps(data), encoding="utf-8")
    ended = command(tmp_path, "--out", tmp_path / "x.html", "--workers", 1, capsys=capsys)
    assert ended.status == 0
    assert "1 cell: No episode: unknown policy 'gone'" in ended.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "cannot read 'nowhere'"),
        (["wrong.json"], "'wrong.json' does not hold benchmark results"),
        (["results.json", "--out", "page.pdf"], "--out must end in .html, such as report.html, not 'page.pdf'"),
        (["results.json", "--out", "folder.html"], "cannot write 'folder.html': it is a folder"),
        (["results.json", "--workers", "0"], "workers must be at least 1, not 0"),
    ],
)
def test_mistake_is_one_sentence(results, command, tmp_path, capsys, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wrong.json").write_text('{"a": 1}')
    (tmp_path / "folder.html").mkdir()
    (tmp_path / "results.json").write_bytes((results / "results.json").read_bytes())
    ended = command(*arguments, capsys=capsys)
    assert ended.status == 2
    assert message in " ".join(ended.err.split())
    assert "Traceback" not in ended.err
