"""Fixtures of the tests of policies."""

import pytest


@pytest.fixture(scope="module")
def one_thread():
    """Limits torch to one thread: several threads wait for each other on busy cores."""
    from cablebot_baselines.learned import training

    with training.one_thread():
        yield


@pytest.fixture
def exact_plans_only(monkeypatch):
    """Rehearsals of a plan take seconds of each motion."""
    from cablebot_baselines.planners.rehearsed import Planner

    monkeypatch.setattr(Planner, "rehearsed", lambda self, tasks, uncertainty: [None] * len(tasks))
