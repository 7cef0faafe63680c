"""The fourth-order law for joint springs: its error dynamics, and its arguments."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablebot_baselines.paper.fourth_order import FourthOrder
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL


def test_error_decays_with_the_given_poles():
    """On a dwell an initial error follows the fourth-order linear equation in all coordinates."""
    poles = (-8.0, -9.0, -10.0, -11.0)
    error = np.array([2e-3, -1e-3, 1e-3, 2e-3, 1e-3, -2e-3])
    law = FourthOrder(FLEX_SPATIAL, poles=poles)
    conditions = {"trajectory": "dwell-spatial", "initial_error": error}
    loop = record_rollout(law, "CableBot-FlexSpatial-v0", control_frequency=2000.0, **conditions)
    arrays = loop.arrays
    # From rest: e = Σ c_i exp(p_i t) with e(0) = 1 and three derivatives zero.
    coefficients = np.linalg.solve(np.vander(poles, increasing=True).T, [1.0, 0.0, 0.0, 0.0])
    expected = float(coefficients @ np.exp(np.array(poles) * arrays["time"][400]))
    remaining = arrays["true_pose"][400] - arrays["reference_pose"][400]
    assert 0.5 < expected < 0.9
    assert_allclose(remaining / error, expected, atol=0.01)


@pytest.mark.parametrize(
    ("robot", "keywords", "message"),
    [
        (FLEX_PLANAR, {}, "as many cables as coordinates"),
        (FLEX_SPATIAL, {"poles": (-1, -2, -3)}, "four stable poles"),
        (FLEX_SPATIAL, {"poles": (-1 + 1j, -2, -3, -4)}, "four stable poles"),
    ],
)
def test_invalid_arguments_raise(robot, keywords, message):
    with pytest.raises(ValueError, match=message):
        FourthOrder(robot, **keywords)
