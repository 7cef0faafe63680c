"""Fixtures of the tests of cablebot_gym and cablebot_baselines."""

import os
import shutil
import signal
from contextlib import nullcontext

import pytest

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


@pytest.fixture
def interrupted_solver(monkeypatch):
    """Ctrl-C in the third iteration of IPOPT."""
    from cablebot_gym.planning.signals import SolverInterrupt

    requested = [False]
    iterations = []

    def read(_):
        iterations.append(None)
        if len(iterations) == 3:
            signal.raise_signal(signal.SIGINT)
        return requested[-1]

    monkeypatch.setattr(
        SolverInterrupt,
        "_requested",
        property(read, lambda _, value: requested.append(value)),
        raising=False,
    )
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def inline(monkeypatch):
    """The rows of a benchmark load their policies in this process: starts of processes are most of
    their time."""
    monkeypatch.setattr(
        "cablebot_gym.benchmark.rows.policy_process", lambda row: nullcontext(row.policy)
    )


@pytest.fixture(scope="session")
def browser():
    """Chromium; without it a test is skipped, and fails in CI."""
    from playwright.sync_api import sync_playwright

    path = next((executable for name in BROWSERS if (executable := shutil.which(name))), None)
    if path is None:
        if os.environ.get("CI"):
            pytest.fail(
                "no Chromium is installed, and CI has to look at the pages: apt-get install chromium"
            )
        pytest.skip("no Chromium is installed")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield chromium
        chromium.close()
