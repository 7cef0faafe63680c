"""Margins over time: where and by how much the excesses of replays raise them."""

from types import SimpleNamespace

import numpy as np
import pytest

from cablebot_gym.bounds.tightening import Tightening
from cablebot_gym.planning import MarginProfile
from cablebot_gym.robots import SPATIAL
from cablebot_gym.task import ErrorBounds

TIMES = np.arange(5) * 0.1
ROBOT = SPATIAL.replace(maximum_tension=150.0)
RULE = Tightening(robot=ROBOT, error_bounds=ErrorBounds(), times=TIMES)
KEPT = {
    "position": 0.0,
    "rotation": 0.0,
    "tension": SPATIAL.minimum_tension,
    "largest_tension": 150.0,
}


def replay(steps=5, **peaks):
    """An episode that reaches a peak of each limit at step 2 only."""
    values = {name: np.full(steps, KEPT[name]) for name in KEPT}
    for name, peak in peaks.items():
        values[name][2] = peak
    arrays = {
        "tracking_error_peak": values["position"],
        "rotation_error_peak": values["rotation"],
        "least_tensions": np.repeat(values["tension"][:, None], SPATIAL.cables, axis=1),
        "largest_tensions": np.repeat(values["largest_tension"][:, None], SPATIAL.cables, axis=1),
    }
    return SimpleNamespace(arrays=arrays)


def action_excess(value=-0.1):
    """Excess of motor 4 at step 2."""
    excess = np.full((5, SPATIAL.cables), -0.1)
    excess[2, 3] = value
    return excess


@pytest.mark.parametrize(
    ("name", "peaks", "excess"),
    [
        ("position", {"position": RULE.error_bounds.position + 1e-3}, 1e-3),
        ("rotation", {"rotation": RULE.error_bounds.rotation + 1e-3}, 1e-3),
        ("tension", {"tension": SPATIAL.minimum_tension - 0.4}, 0.4),
        # a larger margin to the minimum alone would never mend it
        ("tension", {"largest_tension": 150.4}, 0.4),
    ],
)
def test_margin_grows_where_a_replay_exceeds_the_limit(name, peaks, excess):
    replays = [replay(), replay(steps=3, **peaks)]
    profile = RULE.grown(RULE.no_profile(), replays, action_excess())
    margin = getattr(profile, name)
    assert excess < margin[2] < 1.5 * excess
    assert np.all(np.delete(margin, 2) == 0)
    for kept in {"position", "rotation", "tension", "action"} - {name}:
        assert not np.any(getattr(profile, kept))
    again = RULE.grown(profile, replays, action_excess())
    assert getattr(again, name)[2] == pytest.approx(2 * margin[2])


def test_errors_after_saturated_actions_change_the_action_margin_only():
    replays = [replay(position=1.0, rotation=1.0)]
    profile = RULE.grown(RULE.no_profile(), replays, action_excess(0.02))
    assert 0.02 < profile.action[2, 3] < 0.03
    assert np.count_nonzero(profile.action) == 1
    assert not np.any(profile.position)
    assert not np.any(profile.rotation)
    assert RULE.least_margins.action + profile.action.max() == pytest.approx(
        profile.highest(RULE.least_margins).action
    )


def test_profile_covers_the_instants_next_to_an_excess():
    profile = MarginProfile.zeros(TIMES, cables=2)
    profile.tension[2] = 3.0
    profile.action[2, 1] = 0.5
    instants = np.array([0.0, 0.14, 0.24, 0.5])
    np.testing.assert_array_equal(profile.largest("tension", instants, 0.07), [0, 3, 3, 0])
    np.testing.assert_array_equal(
        profile.largest("action", instants, 0.07), [[0, 0], [0, 0.5], [0, 0.5], [0, 0]]
    )
