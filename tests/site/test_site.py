"""The built site in a real browser: search, phones, width of code, dark theme.

``CABLEBOT_SITE`` names the folder of the site, ``site`` by default; without a site the tests are
skipped.
"""

import functools
import os
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

SITE = Path(os.environ.get("CABLEBOT_SITE", Path(__file__).parents[2] / "site"))

pytestmark = [
    pytest.mark.landing,
    pytest.mark.skipif(not (SITE / "index.html").is_file(), reason="the site is not built"),
]

PAGES = (
    *("index", "getting-started", "environments", "policies", "dlcc", "leaderboard", "reference"),
    *("uncertainty", "training", "scale", "your-own/robot", "your-own/policy", "paper"),
    *(
        "generated/environments/CableBot-Spatial-v0",
        "generated/policies/fl",
        "generated/robots/cogiro",
        "generated/clients/sb3",
        "generated/api/gym/cablebot_gym.robots.record",
    ),
)
"""One page of every kind, and those with much code."""

FOUND = {
    "VecNormalize": "your-own/policy",
    "8 cables": "your-own/robot",
    "custom robot": "your-own/robot",
    "Ctrl-C": "training",
    "GPU": "training",
    "TensorBoard": "training",
    "headless": "getting-started",
    "payload": "dlcc",
    "trajopt": "generated/policies/trajopt",
    "install": "index",
    "resume": "training",
}
"""Words that users have, and a page that has to be among the first results."""

FIRST = 5


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        """Prints nothing."""


@pytest.fixture(scope="module")
def address():
    """Address of a local server: the search reads pages, which a browser refuses for files."""
    with ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(_Quiet, directory=SITE)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


@pytest.fixture
def opened(browser, address):
    contexts = []

    def load(page, width=1280, scheme="light"):
        contexts.append(
            browser.new_context(viewport={"width": width, "height": 800}, color_scheme=scheme)
        )
        window = contexts[-1].new_page()
        window.goto(f"{address}/{page}")
        return window

    yield load
    for context in contexts:
        context.close()


@pytest.mark.parametrize("word", FOUND)
def test_search_finds_the_words_of_users(opened, word):
    page = opened(f"search.html?q={word}")
    page.wait_for_selector("#search-results .search-summary:not(:empty)")
    page.wait_for_selector("#search-results li a")
    results = page.eval_on_selector_all(
        "#search-results li > a", "all => all.map(one => one.getAttribute('href'))"
    )
    assert any(address.split(".html")[0].endswith(FOUND[word]) for address in results[:FIRST]), (
        results[:FIRST]
    )


@pytest.mark.parametrize("page", PAGES)
def test_page_fits_a_phone(opened, page):
    """Wide tables and code scroll in their own boxes."""
    assert opened(f"{page}.html", width=390).evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("page", PAGES)
def test_code_fits_on_a_laptop(opened, page):
    wide = (
        "all => all.filter(one => one.scrollWidth > one.clientWidth + 1).map(one => one.innerText)"
    )
    assert opened(f"{page}.html").eval_on_selector_all("article pre", wide) == []


@pytest.mark.parametrize("page", ["dlcc", "paper", "index"])
def test_figures_follow_the_theme(opened, page):
    filters = "all => [...new Set(all.map(one => getComputedStyle(one).filter))]"
    light = opened(f"{page}.html", scheme="light").eval_on_selector_all("article img", filters)
    dark = opened(f"{page}.html", scheme="dark").eval_on_selector_all("article img", filters)
    assert light == ["none"]
    assert dark == ["invert(0.92) hue-rotate(180deg)"]
