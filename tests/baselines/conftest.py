"""Fixtures of the tests with torch."""

import pytest


@pytest.fixture(scope="module")
def one_thread():
    """Limits torch to one thread: several threads wait for each other on busy cores."""
    from cablebot_baselines.learned import training

    with training.one_thread():
        yield
