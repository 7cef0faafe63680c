"""The built site in a real browser: phones and width of code.

``CABLEBOT_SITE`` names the folder of the site, ``site`` by default; without a site the tests are
skipped.
"""

import os
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


@pytest.fixture
def opened(browser):
    contexts = []

    def load(page, width=1280):
        contexts.append(browser.new_context(viewport={"width": width, "height": 800}))
        window = contexts[-1].new_page()
        window.goto((SITE / f"{page}.html").resolve().as_uri())
        return window

    yield load
    for context in contexts:
        context.close()


@pytest.mark.parametrize("page", PAGES)
def test_page_fits_a_phone(opened, page):
    """Wide tables and code scroll in their own boxes."""
    assert opened(page, width=390).evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("page", PAGES)
def test_code_fits_on_a_laptop(opened, page):
    wide = (
        "all => all.filter(one => one.scrollWidth > one.clientWidth + 1).map(one => one.innerText)"
    )
    assert opened(page).eval_on_selector_all("article pre", wide) == []
