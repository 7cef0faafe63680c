"""Fixtures of all tests, those of other distributions of this repository included."""

import os

# Before NumPy and torch are imported: more threads than cores would wait for each other.
os.environ["OMP_NUM_THREADS"] = "1"

import signal

import processor_time
import pytest
from hypothesis import HealthCheck, settings

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


def pytest_addoption(parser):
    """Adds what a machine with all extras asks for."""
    parser.addoption(
        "--no-skips",
        action="store_true",
        help="fail if a test is skipped, as one without its extra",
    )


class NoSkips:
    """Fails a run in which a test was skipped."""

    def __init__(self):
        self.skipped = []

    def pytest_runtest_logreport(self, report):
        """Notes a skipped test."""
        if report.skipped and not hasattr(report, "wasxfail"):
            self.skipped.append(f"{report.nodeid}: {report.longrepr[2]}")

    def pytest_collectreport(self, report):
        """Notes a skipped file."""
        self.pytest_runtest_logreport(report)

    def pytest_sessionfinish(self, session):
        """The run fails."""
        if self.skipped and session.exitstatus == 0:
            session.exitstatus = 1

    def pytest_terminal_summary(self, terminalreporter):
        """Names the skipped tests."""
        for line in self.skipped:
            terminalreporter.write_line(f"must not be skipped here: {line}", red=True)


def pytest_configure(config):
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
    processor_time.install(config)
    if config.option.no_skips and not hasattr(config, "workerinput"):
        config.pluginmanager.register(NoSkips())


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
def _no_screen(monkeypatch):
    """Windows open without a display."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache for one test."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("CABLEBOT_CACHE", str(folder))
    return folder
