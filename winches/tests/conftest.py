"""Fixtures of the tests of cablebot_winches."""

from cli.conftest import cablebot  # noqa: F401
