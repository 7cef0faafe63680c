"""The figures against the episodes that they draw, and their files."""

import dataclasses
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from cablebot_gym.bounds.robot_check import check_model
from cablebot_gym.envs import fitting_env_id
from cablebot_gym.evaluation import compare_policies, evaluate_dlcc
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.rendering.projection import points_in_space
from cablebot_gym.robots import PLANAR, find_robot

pytest.importorskip("matplotlib.figure")

from cablebot_gym.plotting import comparison, draw_robot, figures

PLANAR_ID = "CableBot-Planar-v0"
SPATIAL_ID = "CableBot-Spatial-v0"
SMALL = {"payload_max": 1.0, "resolution": 0.5}


@pytest.fixture(scope="module")
def results():
    """FL within and beyond the motor limits, and a policy that fails unloaded after one step."""
    return {
        "planar": evaluate_dlcc("fl", PLANAR_ID, criterion="paper", **SMALL),
        "spatial": evaluate_dlcc("fl", SPATIAL_ID, payload_max=4.0, resolution=4.0),
        "violent": evaluate_dlcc(lambda _: np.array([-3.0, 2.0, 1.0]), PLANAR_ID, **SMALL),
    }


@pytest.fixture(params=["planar", "spatial", "violent"])
def result(request, results):
    return results[request.param]


def panels(figure):
    return [axes for axes in figure.axes if axes.get_title().startswith("motor")]


def test_mark_is_at_the_least_torque_margin(result):
    arrays = result.rollout.arrays
    margins = 1 - np.abs(arrays["commanded_action"])
    step, motor = np.unravel_index(np.argmin(margins), margins.shape)
    for index, axes in enumerate(panels(figures.draw_torques(result))):
        marks = axes.get_lines()[4:]
        assert len(marks) == (index == motor)
        if marks:
            time = arrays["action_time"][step]
            assert marks[0].get_xydata().tolist() == [[time, arrays["torques"][step, motor]]]
            (note,) = axes.texts
            assert f"t = {time:.3f} s" in note.get_text()
            assert ("saturates" in note.get_text()) == (margins.min() < 0)


def test_errors_are_drawn_with_their_bounds(result):
    robot = result.rollout.task.robot
    _, *errors = figures.draw_result(result).axes[robot.cables :]
    assert len(errors) == (1 if robot.planar else 2)
    times, millimetres = errors[0].get_lines()[0].get_data()
    offset = result.rollout.arrays["true_pose"] - result.rollout.task.trajectory(times).position
    distance = 1e3 * np.linalg.norm(offset[:, : robot.dimensions], axis=1)
    assert_allclose(millimetres, distance, atol=1e-9)
    for axes in errors:
        assert axes.get_lines()[1].get_ydata()[0] == 10.0


@pytest.mark.parametrize(("name", "downwards"), [("planar", False), ("gch-klaus", True)])
def test_y_points_as_in_the_pictures_of_the_robot(name, downwards):
    """Downwards only where gravity does; the drawing of a robot had it so in every plane."""
    robot = find_robot(name)
    motion = {"name": f"dwell-{robot.kind}", "duration": 0.02}
    episode = record_rollout("fl", fitting_env_id(robot), robot=robot, trajectory=motion)
    (path, *_) = figures.draw_rollout(episode).axes[robot.cables :]
    for axes in (path, draw_robot(check_model(robot)).axes[0]):
        assert axes.yaxis_inverted() == downwards
    pictured = points_in_space(robot, np.array([0.0, 1.0]))
    assert (pictured[1] > 0) == downwards


@pytest.mark.landing
def test_notebook_shows_the_figure_of_a_result_if_matplotlib_is_there(results, monkeypatch):
    result = results["planar"]
    for item in (result, result.rollout, check_model(PLANAR)):
        assert item._repr_png_().startswith(b"\x89PNG")
    assert result.conditions._repr_png_() is None
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert result._repr_png_() is None


@pytest.mark.landing
def test_limits_are_those_of_the_true_motors():
    strong = {"parameters": {"motor_strength": {"low": 0.5, "high": 0.5}}}
    result = evaluate_dlcc("fl", PLANAR_ID, uncertainty=strong, **SMALL)
    upper, lower, *_ = panels(figures.draw_torques(result))[0].get_lines()
    assert_allclose((upper.get_ydata() - lower.get_ydata()) / 2, 1.5 * PLANAR.stall_torque[0])


@pytest.mark.landing
def test_files_of_both_criteria_without_pyplot(results, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    folder = tmp_path / "new"
    odd_name = dataclasses.replace(
        results["violent"], policy="runs/$a_{/" + "long/" * 30 + "model_$.zip"
    )
    task = figures.save_result(odd_name, folder)
    paper = figures.save_result(results["planar"], str(folder))
    assert [task.name, paper.name] == ["result-task.png", "result-paper.png"]
    assert sorted(folder.iterdir()) == sorted([task, paper])
    for path in (task, paper):
        assert path.read_bytes().endswith(b"IEND\xaeB`\x82")


def test_comparison_shows_errors_and_their_distribution():
    motion = {"name": "dwell-spatial", "duration": 0.05}
    compared = compare_policies(
        ["fl", "robust"], SPATIAL_ID, uncertainty="table6", draws=4, trajectory=motion
    )
    over_time, distribution, *rotation = comparison.draw_comparison(compared).axes
    assert len(rotation) == 2
    for index, metrics in enumerate(compared.metrics):
        line = over_time.get_lines()[index]
        assert line.get_label().strip() == metrics.policy
        assert_allclose(line.get_ydata(), 1e3 * metrics.error.mean(axis=1), rtol=1e-12)
        largest = distribution.get_lines()[index].get_xdata()
        assert largest.max() == pytest.approx(1e3 * metrics.max_error.max())
