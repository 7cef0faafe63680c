"""Fixtures of the tests with torch."""

import pytest


@pytest.fixture(scope="module")
def one_thread():
    """Limits torch to one thread: several threads wait for each other on busy cores."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
