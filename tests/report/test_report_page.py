"""``cablebot report``: the data of the page, the command, and the page in a real browser."""

from dataclasses import replace

import pytest
from benchmark.made_rows import asked, carries, fails, optimum

from cablebot_gym.benchmark.rows import compute
from cablebot_gym.benchmark.store import Results
from cablebot_gym.cli.report import report
from cablebot_gym.report.page import html, page_data

LOOPS = [{"name": "loop-planar", "seed": 10_000 + number} for number in range(2)]
VIOLATION = {"kind": "position", "index": None, "time": 0.532, "excess": 1e-6, "bound": 0.01}


def carried(policy, payload, **conditions):
    more = {"applicable": True, "violation": VIOLATION, "failures": {}, "fallbacks": None}
    return carries(policy, payload, more=more | {"feasible": [[0.0, payload]]}, **conditions)


ROWS = [
    optimum(2.5),
    *(optimum(4.0, motion) for motion in LOOPS),
    carried("observing", 1.7),
    carried("fl", 1.9),
    carried("fl", 1.0, uncertainty="table6", draws=512),
    *(
        carried("fl", payload, motion=motion)
        for motion, payload in zip(LOOPS, (1.0, 2.0), strict=True)
    ),
    fails("nobody</script>", "it raised <b>"),
]
"""A small benchmark with made-up payloads."""
RESULTS = Results(suite="smoke", command="cablebot benchmark", rows=ROWS)


def test_motions_of_a_family_are_one_line_with_an_episode_each():
    survey = [carried("robust", 1.0 + index, motion=motion) for index, motion in enumerate(LOOPS)]
    data = page_data([replace(RESULTS, rows=[*ROWS, *survey])], {})
    (row,) = [row for row in data["rows"] if row["policy"] == "robust"]
    assert row["payload"] == 1.5
    assert len(row["cells"]) == len(LOOPS)


def test_first_of_two_rows_with_other_seeds_counts():
    again = replace(RESULTS, rows=[carried("observing", 1.6, seed=2)])
    data = page_data([RESULTS, again], {})
    (row,) = [row for row in data["rows"] if row["policy"] == "observing"]
    assert (row["payload"], len(row["cells"])) == (1.7, 1)


def test_page_has_title_and_data_as_text(tmp_path, capsys):
    (tmp_path / "smoke.jsonl").write_text(RESULTS.to_text())
    out = tmp_path / "report.html"
    report([tmp_path, tmp_path / "smoke.jsonl"], out=out, episodes=False)
    text = out.read_text()
    assert "<title>Payloads of cable robots</title>" in text
    assert "<title>A &lt;title></title>" in html("A <title>", [RESULTS], {})
    assert "nobody\\u003c/script>" in text
    assert f"wrote {out}" in capsys.readouterr().out


# --- in a browser -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A page with episodes of true payloads."""
    folder = tmp_path_factory.mktemp("page")
    questions = [asked(policy="fl"), asked(policy="observing")]
    known = [row for question in questions for row in compute([question])]
    keys = {row.key for row in known}
    made_up = [row for row in ROWS if row.key not in keys]
    results = replace(RESULTS, rows=[*known, *made_up])
    (folder / "smoke.jsonl").write_text(results.to_text())
    report([folder], out=folder / "report.html", workers=1)
    return folder / "report.html"


@pytest.fixture
def opened(browser, written):
    """The page in a window. A complaint of the browser or a network request is an error at the
    end."""
    complaints = []
    contexts = []

    def load():
        contexts.append(browser.new_context(viewport={"width": 1200, "height": 900}))
        page = contexts[-1].new_page()
        page.on(
            "console",
            lambda message: complaints.append(message.text) if message.type != "log" else None,
        )
        page.on("pageerror", lambda error: complaints.append(str(error)))
        local = ("file:", "data:", "blob:")
        page.on(
            "request",
            lambda requested: requested.url.startswith(local) or complaints.append(requested.url),
        )
        page.goto(written.as_uri())
        page.wait_for_function(
            "document.getElementById('replay').frames || document.getElementById('replay').hidden"
        )
        return page

    yield load
    for context in contexts:
        context.close()
    assert complaints == []


def policies(page):
    return page.locator("#leaderboard-table tbody tr td:first-child").all_inner_texts()


@pytest.mark.landing
def test_table_sorts_and_filters(opened):
    page = opened()
    assert policies(page) == ["fl", "observing", "nobody</script>"]
    fraction = page.locator("#leaderboard-table th", has_text="fraction")
    fraction.locator("button").click()
    # an error counts as zero
    assert policies(page) == ["nobody</script>", "observing", "fl"]
    assert fraction.get_attribute("aria-sort") == "ascending"
    page.select_option("#filter-condition", "payload known, table6, 512 robots")
    assert policies(page) == ["fl"]
    page.select_option("#filter-condition", "")
    page.select_option("#filter-motion", "2 held-out motions")
    assert page.locator("#leaderboard-table .text").nth(0).get_attribute("title") == "38%"
    page.select_option("#filter-motion", "")
    assert page.inner_text("#count") == "5 of 5 rows"
    page.fill("#filter-policy", "OBSERV")
    assert policies(page) == ["observing"]


@pytest.mark.landing
def test_third_motor_is_at_the_top_as_in_other_pictures(opened):
    heights = opened().evaluate(
        """() => {
            const heights = {}, context = CanvasRenderingContext2D.prototype;
            context.fillText = (text, x, y) => { heights[text] = y; };
            document.getElementById('time').dispatchEvent(new Event('input'));
            return heights;
        }"""
    )
    assert heights["3"] < min(heights["1"], heights["2"])


@pytest.mark.landing
def test_episode_plays_and_moves_with_the_slider(opened):
    page = opened()
    assert page.inner_text("#episode-title").startswith("fl on CableBot-Planar-v0")
    assert page.inner_text("#verdict").endswith(" kg: carried")
    # actions, error, tensions
    assert page.locator("figure:visible svg path.curve").count() == 3 + 1 + 3
    picture = "document.getElementById('scene').toDataURL()"
    before = page.evaluate(picture)
    cursor = page.locator("#chart-action .cursor").get_attribute("x1")
    page.focus("#time")
    page.keyboard.press("End")
    assert page.inner_text("#clock") == "1.60 s"
    moved = page.evaluate(picture)
    assert moved != before
    assert page.locator("#chart-action .cursor").get_attribute("x1") != cursor
    page.focus("#scene")
    page.keyboard.press("ArrowLeft")
    assert page.evaluate(picture) != moved
    page.select_option("#speed", "1")
    page.click("#play")
    assert page.get_attribute("#play", "aria-pressed") == "true"
    page.wait_for_function(
        "document.getElementById('play').getAttribute('aria-pressed') === 'false'"
    )


@pytest.mark.landing
def test_larger_payload_shows_the_violation_and_marks_its_time(opened):
    page = opened()
    page.locator("#leaderboard-table tbody button", has_text="fl").click()
    page.wait_for_function("document.getElementById('verdict').textContent === '1.91 kg: carried'")
    assert page.locator("#chart-position line.bound").count() == 1
    page.get_by_label("above the DLCC").check()
    page.wait_for_function("document.getElementById('verdict').className === 'bad'")
    assert page.inner_text("#verdict").startswith(
        "2.01 kg: position error reaches its bound of 10 mm at t = "
    )
    assert page.locator("#chart-position line.bound").count() == 2


@pytest.mark.landing
def test_recipe_computes_the_number(opened):
    page = opened()
    page.locator("#leaderboard-table tbody button", has_text="fl").click()
    page.wait_for_function("document.getElementById('verdict').textContent === '1.91 kg: carried'")
    page.click("summary:has-text('How this number is computed')")
    results = []
    exec(page.inner_text("#recipe pre"), {"print": results.append})
    assert results[0].payload == pytest.approx(1.91, abs=5e-3)
