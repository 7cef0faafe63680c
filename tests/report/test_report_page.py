"""``cablebot report``: the data of the page, the command, and the page in a real browser."""

from dataclasses import replace

import pytest

from cablebot_gym.benchmark.cells import BestKnownCell, PolicyCell, SurveyCell
from cablebot_gym.benchmark.leaderboard import Results
from cablebot_gym.benchmark.records import Record, compute
from cablebot_gym.cli.report import report
from cablebot_gym.report.page import html, page_data

PLANAR = "CableBot-Planar-v0"
CIRCLE = {"name": "circle-planar"}
LOOPS = [{"name": "loop-planar", "seed": 10_000 + number} for number in range(2)]


def record(cell, **result):
    return Record(
        cell=cell, source="a" * 16, versions={"python": "3.11"}, result=result, seconds=1.0
    )


def best(motion, payload, **more):
    result = {"payload": payload, "total_mass": payload + 1, "verified": True}
    return record(BestKnownCell(env_id=PLANAR, trajectory=motion, **more), **result)


def carried(cell, payload, **more):
    violation = {"kind": "position", "index": None, "time": 0.532, "excess": 1e-6, "bound": 0.01}
    defaults = {"applicable": True, "violation": violation, "failures": {}, "fallbacks": None}
    return record(cell, payload=payload, feasible=[[0.0, payload]], **(defaults | more))


def policy(name="fl", **more):
    return PolicyCell(**({"env_id": PLANAR, "trajectory": CIRCLE, "policy": name} | more))


RECORDS = [
    best(CIRCLE, 2.5),
    *(best(motion, 4.0) for motion in LOOPS),
    carried(policy("adaptive"), 1.7),
    carried(policy(), 1.9),
    carried(policy(uncertainty="table6", draws=512), 1.0),
    *(
        carried(policy(trajectory=motion), payload)
        for motion, payload in zip(LOOPS, (1.0, 2.0), strict=True)
    ),
    record(policy("nobody</script>"), error="it raised <b>"),
]
"""A small benchmark with made-up payloads."""
RESULTS = Results(suite="smoke", command="cablebot benchmark", records=RECORDS)


@pytest.fixture
def results(tmp_path):
    text = RESULTS.to_json()
    (tmp_path / "results.json").write_text(text)
    return tmp_path


def test_page_opens_on_the_largest_payload_of_the_first_table():
    data = page_data([RESULTS], {})
    start = data["rows"][data["start"]]
    assert start["policy"] == "fl"
    assert start["payload"] == 1.9
    assert start["condition"] == "payload known"


@pytest.mark.parametrize(
    ("kind", "bound", "sentence", "name"),
    [
        ("position", 0.02, "position error reaches its bound of 20 mm", "position error"),
        ("slack", 1.0, "cable 2 falls below its tension bound of 1 N", "least tension"),
        ("slack", None, "cable 2 is slack", "least tension"),
        ("overload", 60.0, "cable 2 exceeds its largest tension of 60 N", "largest tension"),
    ],
)
def test_violations_are_named_as_in_other_results(kind, bound, sentence, name):
    violation = {"kind": kind, "index": 2, "time": 0.532, "excess": 1e-6, "bound": bound}
    cells = [policy(), *(policy(trajectory=motion) for motion in LOOPS)]
    records = [carried(cell, 1.9, violation=violation, failures={kind: 3}) for cell in cells]
    data = page_data([replace(RESULTS, records=records)], {})
    sentence += " at t = 0.532 s"
    assert {row["violation"] for row in data["rows"]} == {sentence, f"{name} 2 ×"}
    facts = dict(data["cells"][0]["facts"])
    assert facts["Limiting violation"] == sentence
    assert facts["Violations of the draws at a larger payload"] == f"{name}: 3"
    (limits,) = data["limits"]
    assert limits["policy"] == "fl"
    assert [(strip["limit"], strip["count"]) for strip in limits["strips"]] == [(name, 3)]


def test_survey_has_a_cell_for_each_motion():
    seeds = [motion["seed"] for motion in LOOPS]
    violation = {"kind": "slack", "index": 0, "time": 0.5, "excess": 0.1}
    survey = record(
        SurveyCell(env_id=PLANAR, policy="robust", trajectory=LOOPS[0] | {"seed": seeds}),
        payloads=[1.0, 2.0],
        failed_payloads=[1.1, 2.1],
        violations=[violation, violation],
        resolutions=[0.01, 0.01],
        stochastic=False,
    )
    data = page_data([replace(RESULTS, records=[*RECORDS, survey])], {})
    (row,) = [row for row in data["rows"] if row["policy"] == "robust"]
    assert row["payload"] == 1.5
    assert len(row["cells"]) == len(LOOPS)


def test_first_of_two_runs_of_one_cell_counts():
    again = replace(RESULTS, records=[carried(policy("adaptive", seed=2), 1.6)])
    data = page_data([RESULTS, again], {})
    (row,) = [row for row in data["rows"] if row["policy"] == "adaptive"]
    assert (row["payload"], len(row["cells"])) == (1.7, 1)


def test_page_has_title_and_data_as_text(results, capsys):
    out = results / "report.html"
    report([results, results / "results.json"], out=out, episodes=False)
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
    known = [
        compute(cell)
        for cell in (BestKnownCell(env_id=PLANAR, trajectory=CIRCLE), policy(), policy("adaptive"))
    ]
    made_up = [
        stored for stored in RECORDS[1:] if stored.cell not in (policy(), policy("adaptive"))
    ]
    text = replace(RESULTS, records=[*known, *made_up]).to_json()
    (folder / "results.json").write_text(text)
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
    assert policies(page) == ["best known payload", "fl", "adaptive", "nobody</script>"]
    fraction = page.locator("#leaderboard-table th", has_text="fraction")
    fraction.locator("button").click()
    # an error counts as zero
    assert policies(page) == ["nobody</script>", "adaptive", "fl", "best known payload"]
    assert fraction.get_attribute("aria-sort") == "ascending"
    page.select_option("#filter-condition", "payload known, table6, 512 draws")
    assert policies(page) == ["fl"]
    page.select_option("#filter-condition", "")
    page.select_option("#filter-motion", "2 held-out motions")
    assert page.locator("#leaderboard-table .text").nth(0).get_attribute("title") == "38%"
    page.select_option("#filter-motion", "")
    assert page.inner_text("#count") == "7 of 7 rows"
    page.fill("#filter-policy", "ADAP")
    assert policies(page) == ["adaptive"]


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
    assert "% of its bound" in page.inner_text("#verdict")
    assert page.locator("#chart-position line.bound").count() == 2


@pytest.mark.landing
@pytest.mark.parametrize(("row", "payload"), [("fl", 1.91), ("best known payload", 2.85)])
def test_recipe_computes_the_number(opened, row, payload):
    page = opened()
    page.locator("#leaderboard-table tbody button", has_text=row).click()
    page.wait_for_function(
        f"document.getElementById('verdict').textContent === '{payload} kg: carried'"
    )
    page.click("summary:has-text('How this number is computed')")
    results = []
    exec(page.inner_text("#recipe pre"), {"print": results.append})
    assert results[0].payload == pytest.approx(payload, abs=5e-3)
