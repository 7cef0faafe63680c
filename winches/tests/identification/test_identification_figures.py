"""Figures of an identification."""

import numpy as np
import pytest
from identification.lifts import lift
from numpy.testing import assert_allclose

from cablebot_gym.robots import find_robot
from cablebot_winches.identification import identify
from cablebot_winches.identification.log import Log

pytest.importorskip("matplotlib")

from cablebot_winches.identification.figures import draw_identification


def test_logs_follow_one_another_and_the_band_has_its_fraction_of_the_residuals():
    """Clocks that start anywhere do not leave a hole, and no line joins two logs."""
    logs = []
    for load, start in ((1.0, 1e5), (5.0, 0.0)):
        columns = dict(lift(0, load).columns)
        columns["time"] = columns["time"] + start
        logs.append(Log(name="a.csv", columns=columns))
    result = identify(find_robot("ttk4900"), logs)
    figure = draw_identification(result)["torques"]
    response, residual = figure.axes
    lines = {line.get_label(): line for line in response.get_lines()}
    measured, modelled = lines["measured"], lines["modelled"]
    time = measured.get_xdata()
    assert np.nanmin(time) == pytest.approx(0.0)
    assert np.nanmax(time) == pytest.approx(2 * np.nanmax(time[: len(time) // 2]), rel=0.02)
    errors = residual.get_lines()[0].get_ydata()
    assert_allclose(measured.get_ydata() - modelled.get_ydata(), errors, atol=1e-12)
    bound = float(residual.texts[0].get_text().split()[1])
    inside = np.mean(np.abs(errors[np.isfinite(errors)]) <= bound)
    assert inside == pytest.approx(0.95, abs=0.03)
