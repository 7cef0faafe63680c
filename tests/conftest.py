"""Fixtures of all tests."""

import os
import shutil
import signal
import sys

import pytest
from hypothesis import HealthCheck, settings

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


VARIABLES = (
    *(
        "COLUMNS",
        "LINES",
        "NO_COLOR",
        "FORCE_COLOR",
        "CLICOLOR_FORCE",
        "TTY_COMPATIBLE",
    ),
    *(
        "TTY_INTERACTIVE",
        "TERM",
        "TERMINAL_WIDTH",
        "PY_COLORS",
        "GITHUB_ACTIONS",
        "MPLBACKEND",
        "RAY_ADDRESS",
    ),
)
"""Environment variables that change what commands print, and where policies and cells run."""


def pytest_configure():
    """The tests are the same on every machine, however they are started.

    Ctrl-C interrupts, here and in the processes that tests start, even if the run was started with
    SIGINT ignored. Shells start background jobs so: ``nohup pytest &``.
    """
    for name in VARIABLES:
        os.environ.pop(name, None)
    # Other programs may use the cores: no example is too slow.
    settings.register_profile(
        "any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow]
    )
    settings.load_profile("any machine")
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="session")
def _own_cache(tmp_path_factory):
    """The tests neither read nor write the user's cache of plans."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CABLEBOT_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(autouse=True, scope="session")
def _shared_compilation(request, tmp_path_factory):
    """Test processes do not compile the same kernel at the same time."""
    if hasattr(request.config, "workerinput"):
        from compiling import share

        share(tmp_path_factory.getbasetemp().parent / "compiling")


@pytest.fixture(autouse=True)
def _no_foreign_policies():
    """Results do not name the policies of other tests."""
    batch = sys.modules.get("cablebot_gym.evaluation.batch")
    if batch is not None:
        batch._FOREIGN.clear()


@pytest.fixture(autouse=True)
def _no_screen(monkeypatch):
    """Windows open without a display."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache for one test."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("CABLEBOT_CACHE", str(folder))
    return folder


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
    """The cells of a benchmark load their policies in this process: starts of processes are most of
    their time."""
    from inline import InlinePolicy

    monkeypatch.setattr("cablebot_gym.benchmark.cells.IsolatedPolicy", InlinePolicy)


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
