"""Fixtures of the tests of cablebot_winches: those of the core, and its command line."""

from cli.conftest import cablebot  # noqa: F401
from fixtures import (  # noqa: F401
    _no_screen,
    _own_cache,
    _shared_compilation,
    cache,
    pytest_configure,
)
