"""The figures against the history that they draw, and what an interrupt or a missing matplotlib leaves."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest
from scipy.stats import binomtest

from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.robots import PLANAR

figure_module = pytest.importorskip("matplotlib.figure")

from cablebot_gym.plotting import figures  # noqa: E402

SMALL = {"payload_max": 1.0, "resolution": 0.5}
FOUR_CABLES = PLANAR.replace(name="four", base_anchors=((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)))


def idle(observation):
    return np.zeros(3)


def violent(observation):
    return np.array([-3.0, 2.0, 1.0])


@pytest.fixture(scope="module")
def results():
    """FL within its limits; FL beyond the motors'; a policy that carries nothing, with an episode cut short."""
    return {
        "planar": evaluate_dlcc("fl", "CableBot-Planar-v0", criterion="paper", **SMALL),
        "spatial": evaluate_dlcc("fl", "CableBot-Spatial-v0", criterion="paper", **SMALL),
        "beyond": evaluate_dlcc("fl", "CableBot-Planar-v0", payload_max=1.9, resolution=1.0),
        "violent": evaluate_dlcc(violent, "CableBot-Planar-v0", **SMALL),
    }


@pytest.fixture(params=["planar", "spatial", "beyond", "violent"])
def result(request, results):
    return results[request.param]


def panels(figure):
    return [axes for axes in figure.axes if axes.get_title().startswith("motor")]


def lines(axes):
    """Lines by label; limits by their order, upper first."""
    upper, lower, demanded, applied, *dots = axes.get_lines()
    return {"upper": upper, "lower": lower, "demanded": demanded, "applied": applied, "dots": dots}


def test_no_motor_is_left_out_and_none_is_counted_from_zero(result):
    motors = range(1, result.task.robot.cables + 1)
    assert [axes.get_title() for axes in panels(figures.draw_torques(result))] == [f"motor {i}" for i in motors]


def test_torques_and_limits_are_not_those_of_another_motor_or_instant(result):
    robot, history = result.task.robot, result.history
    for motor, axes in enumerate(panels(figures.draw_torques(result))):
        drawn = lines(axes)
        slowed = robot.speed_slope[motor] * history["motor_speeds"][:, motor]
        expected = {
            "applied": history["torques"][:, motor],
            "upper": robot.stall_torque[motor] - slowed,
            "lower": -robot.stall_torque[motor] - slowed,
            "demanded": robot.stall_torque[motor] * history["commanded_action"][:, motor] - slowed,
        }
        for name, values in expected.items():
            np.testing.assert_array_equal(drawn[name].get_xdata(), history["action_time"])
            np.testing.assert_allclose(drawn[name].get_ydata(), values, rtol=1e-12, atol=1e-12)


def test_applied_torque_does_not_leave_the_limits_drawn_and_the_demand_shows_only_beyond_them(result):
    for motor, axes in enumerate(panels(figures.draw_torques(result))):
        drawn = {name: line.get_ydata() for name, line in lines(axes).items() if name != "dots"}
        assert np.all(drawn["applied"] <= drawn["upper"] + 1e-9)
        assert np.all(drawn["applied"] >= drawn["lower"] - 1e-9)
        within = np.abs(result.history["commanded_action"][:, motor]) <= 1
        np.testing.assert_allclose(drawn["demanded"][within], drawn["applied"][within], atol=1e-9)
        assert np.all(drawn["demanded"][~within] != drawn["applied"][~within])


def test_the_one_dot_is_not_elsewhere_than_at_the_least_margin(result):
    history = result.history
    dots = [
        (motor, dot) for motor, axes in enumerate(panels(figures.draw_torques(result))) for dot in lines(axes)["dots"]
    ]
    assert len(dots) == 1
    motor, dot = dots[0]
    margins = 1 - np.abs(history["commanded_action"])
    step = int(np.argmin(margins.min(axis=1)))
    assert motor == int(np.argmin(margins[step]))
    assert dot.get_xydata().tolist() == [[history["action_time"][step], history["torques"][step, motor]]]
    (note,) = panels(figures.draw_torques(result))[motor].texts
    assert f"t = {history['action_time'][step]:.3f} s" in note.get_text()
    assert ("beyond" in note.get_text()) == (margins.min() < 0)


def test_a_demand_far_beyond_does_not_flatten_the_limits(results):
    far = dataclasses.replace(
        results["planar"], history=results["planar"].history | {"commanded_action": np.full((500, 3), 1e6)}
    )
    low, high = panels(figures.draw_torques(far))[0].get_ylim()
    assert high - low < 10 * PLANAR.stall_torque.max()


def test_an_episode_of_one_step_is_not_invisible(results):
    violent = results["violent"]
    assert len(violent.history["action_time"]) == 1
    drawn = [*panels(figures.draw_torques(violent)), figures.draw_path(violent).axes[1]]
    for axes in drawn:
        line = axes.get_lines()[0]
        low, high = axes.get_xlim()
        assert line.get_marker() == "."
        assert low < line.get_xdata()[0] < high


def test_path_is_not_shifted_by_a_step_against_its_reference(result):
    figure = figures.draw_path(result)
    plane, position = figure.axes[:2]
    travelled, reference = plane.get_lines()
    np.testing.assert_array_equal(travelled.get_xydata(), result.history["pose"][:, :2])
    times, millimetres = position.get_lines()[0].get_data()
    end = result.task.trajectory(times).position
    away = 1e3 * np.linalg.norm((result.history["pose"] - end)[:, : 2 if result.task.robot.planar else 3], axis=1)
    np.testing.assert_allclose(millimetres, away, atol=1e-9)
    assert plane.get_aspect() == 1
    (tube,) = plane.collections
    np.testing.assert_allclose([tube.get_widths(), tube.get_heights()], 2 * result.error_bounds["position"])
    assert tube.get_linewidth() == 0  # the edge would add to the radius
    np.testing.assert_array_equal(tube.get_offsets(), reference.get_xydata())


def test_bounds_drawn_are_not_others_than_the_criterions(results):
    for criterion, bounds in {"paper": [[10.0], []], "task": [[10.0], [10.0]]}.items():
        error_bounds = {"position": 0.01, "rotation": 0.01 if criterion == "task" else None}
        drawn = figures.draw_path(
            dataclasses.replace(results["spatial"], criterion=criterion, error_bounds=error_bounds)
        ).axes[1:]
        assert [[line.get_ydata()[0] for line in axes.get_lines()[1:]] for axes in drawn] == bounds


def test_a_planar_robot_does_not_get_a_rotation_panel(results):
    assert [axes.get_ylabel() for axes in figures.draw_path(results["planar"]).axes] == ["y [m]", "position error [mm]"]


def test_titles_do_not_hide_what_was_found(result):
    for figure in (figures.draw_torques(result), figures.draw_path(result), figures.draw_result(result)):
        title = " ".join(figure.get_suptitle().split())  # lines are wrapped
        for part in (result.env_id, result.policy, f"{result.criterion} criterion", result.violation_text):
            assert part in title
        if result.payload is None:
            assert "fails unloaded" in title
        else:
            assert f"payload {result.payload:.3f} kg, total mass {result.total_mass:.3f} kg" in title


def test_both_together_do_not_differ_from_each_alone(result):
    together = [axes.get_ylabel() for axes in figures.draw_result(result).axes]
    alone = [*figures.draw_torques(result).axes, *figures.draw_path(result).axes]
    assert together == [axes.get_ylabel() for axes in alone]


def test_saved_figures_do_not_leave_temporary_files_or_overwrite_the_other_criterion(results, tmp_path):
    folder = tmp_path / "new" / "folder"
    written = figures.save_figures(results["violent"], folder) + figures.save_figures(results["planar"], folder)
    names = ["torques-task.png", "path-task.png", "torques-paper.png", "path-paper.png"]
    assert [path.name for path in written] == names
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    assert all(path.read_bytes().endswith(b"IEND\xaeB`\x82") for path in written)


@pytest.mark.parametrize("before", [None, b"old"], ids=["new", "replaced"])
def test_interrupt_does_not_leave_half_a_file(results, tmp_path, monkeypatch, before):
    path = tmp_path / "torques-paper.png"
    if before is not None:
        path.write_bytes(before)

    def savefig(self, target, **keywords):
        target.write_bytes(b"\x89PNG half")
        raise KeyboardInterrupt

    monkeypatch.setattr(figure_module.Figure, "savefig", savefig)
    with pytest.raises(KeyboardInterrupt):
        figures.save_figures(results["planar"], tmp_path)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == ({path.name: before} if before else {})


def test_missing_matplotlib_does_not_go_without_the_command_that_installs_it(results, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for draw in (figures.draw_torques, figures.draw_path, figures.draw_result):
        with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[plot\]'"):
            draw(results["planar"])
    with pytest.raises(ImportError, match=r"pip install 'cablebot-gym\[plot\]'"):
        figures.save_figures(results["planar"], tmp_path / "folder")
    assert list(tmp_path.iterdir()) == []


def test_drawing_does_not_need_pyplot(results, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    figures.save_figures(results["planar"], tmp_path)


def test_a_policy_name_is_not_read_as_mathematics_and_four_cables_find_room(results, tmp_path):
    named = dataclasses.replace(results["planar"], policy="runs/$a_{/" + "long/" * 30 + "model_$.zip")
    figures.save_figures(named, tmp_path)
    four = evaluate_dlcc(lambda _: np.zeros(4), "CableBot-Planar-v0", robot=FOUR_CABLES, **SMALL)
    assert len(panels(figures.draw_torques(four))) == len(figures.draw_torques(four).axes) == 4
    figures.save_figures(four, tmp_path)
    hold = evaluate_dlcc(idle, "CableBot-Planar-v0", trajectory="dwell-planar", **SMALL)
    figures.save_figures(hold, tmp_path)
    figures.draw_result(hold).savefig(tmp_path / "both.png")


def test_title_over_draws_does_not_claim_what_no_draw_carried(results, tmp_path):
    drawn = {"draws": 60, "probability": 0.9, "confidence": 0.95, "uncertainty": "table6"}
    carried = dataclasses.replace(results["planar"], **drawn)
    assert "carried in at least 90% of 60 draws of table6" in figures.draw_path(carried).get_suptitle()
    failed = figures.draw_torques(dataclasses.replace(results["violent"], **drawn)).get_suptitle()
    assert "carried in at least" not in failed
    assert "60 draws of table6; shown: the draw with this violation" in failed
    assert "draws" not in figures.draw_path(results["planar"]).get_suptitle()


def test_success_over_draws_is_not_drawn_at_other_payloads_or_shares(results, tmp_path):
    drawn = evaluate_dlcc("fl", "CableBot-Spatial-v0", uncertainty="table6", draws=60, probability=0.3, **SMALL)
    figure = figures.draw_success(drawn)
    (axes,) = figure.axes
    named = {line.get_label(): line for line in axes.get_lines()}
    np.testing.assert_array_equal(named["fraction of draws that carry it"].get_xydata(), drawn.success)
    bound = named["lower bound, 95% confidence"]
    carried = round(60 * drawn.success[0][1])
    lowest = binomtest(carried, 60, alternative="greater").proportion_ci(0.95, method="exact").low
    assert bound.get_ydata()[0] == pytest.approx(lowest)
    assert named["required: 30%"].get_ydata()[0] == 0.3
    assert named[f"payload: {drawn.payload:.2f} kg"].get_xdata()[0] == drawn.payload
    assert "shown:" not in figure.get_suptitle()
    assert [path.name for path in figures.save_figures(drawn, tmp_path)][-1] == "success-task.png"
    with pytest.raises(ValueError, match="several draws"):
        figures.draw_success(results["spatial"])


def test_limits_of_a_stronger_motor_are_not_drawn_as_the_nominal_ones():
    strong = {"parameters": {"motor_strength": {"low": 0.5, "high": 0.5}}}
    result = evaluate_dlcc("fl", "CableBot-Planar-v0", criterion="task", uncertainty=strong, **SMALL)
    lower, upper = figures.torque_limits(result)
    np.testing.assert_allclose((upper - lower) / 2, 1.5 * PLANAR.stall_torque[0])
    within = np.abs(result.history["commanded_action"]) <= 1
    np.testing.assert_allclose(figures.requested_torque(result)[within], result.history["torques"][within], atol=1e-12)


def test_label_of_a_bound_is_not_crossed_by_the_curve(results):
    for axes in figures.draw_path(results["beyond"]).axes[1:]:
        (label,) = axes.texts
        assert label.get_text() == "bound 10 mm"
        assert label.get_bbox_patch().get_facecolor()[:3] == (1, 1, 1)


def test_torques_that_nothing_clips_do_not_get_a_demand_or_a_mark():
    times, torques = np.linspace(0.0, 1.0, 50), np.zeros((50, 3))
    profile = figures.TorqueProfile(times=times, torques=torques, lower=torques - 5, upper=torques + 5, end=1.0)
    figure = figures.new_figure(figures.torques_height(3))
    figures.torque_panels(figure, profile)
    assert [line.get_label() for line in panels(figure)[0].get_lines() if line.get_label()[0] != "_"] == [
        "limits U±",
        "applied torque",
    ]
    assert not any(axes.texts for axes in panels(figure))


def test_several_motions_do_not_share_a_curve_or_their_shortest_time(results):
    history, trajectory = results["planar"].history, results["planar"].task.trajectory
    whole = figures.TravelledPath(
        times=history["action_time"],
        pose=history["pose"],
        position_error=history["tracking_error"],
        rotation_error=None,
    )
    cut = dataclasses.replace(
        whole, times=whole.times[:30], pose=whole.pose[:30], position_error=whole.position_error[:30], name="cut"
    )
    figure = figures.new_figure(4.0)
    figures.path_panels(figure, trajectory, [cut, whole], position=0.01, rotation=None)
    plane, position = figure.axes
    assert [len(line.get_xdata()) for line in plane.get_lines()][:2] == [30, len(whole.times)]
    assert position.get_xlim() == (0.0, whole.times[-1])
