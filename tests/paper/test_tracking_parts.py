"""Figs. 1 to 3 and 5 to 9: that they show the plant's robots, the reading's limits, and what the robust law did."""

from __future__ import annotations

import pickle
from functools import partial
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from cablebot_baselines.classical import FeedbackLinearization, Robust, RobustComposite, RobustPD
from cablebot_baselines.paper.exact import Profile
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.parts import drawings, robust, tracking
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.physics import textbook

pytest.importorskip("matplotlib.figure")

PARTS = {part.name: part for module in (drawings, tracking, robust) for part in module.PARTS}
SPATIAL, FLEXIBLE = "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"


def lines(axes, colour):
    """Ends of the straight lines of a colour."""
    found = [line.get_xydata() for line in axes.get_lines() if line.get_color() == colour]
    return [points for points in found if len(points) == 2]


def numbers(name, interpretation, found=None):
    return PARTS[name].outcome(interpretation, {} if found is None else found).numbers


@pytest.fixture(scope="module")
def planar_loop():
    return PARTS["fig5"].cells(Interpretation())["loop"]()


def test_no_part_of_these_figures_is_missing_and_cells_reach_other_processes():
    assert list(PARTS) == ["fig1", "fig2", "fig3", "fig5", "fig6", "fig7", "fig8", "fig9"]
    for part in PARTS.values():
        for cell in part.cells(Interpretation()).values():
            assert repr(pickle.loads(pickle.dumps(cell))) == repr(cell)


@pytest.mark.parametrize("apex", ["up", "left", "down", "right"])
def test_planar_drawing_is_not_of_another_triangle(apex):
    interpretation = Interpretation(planar_apex=apex)
    robot = interpretation.planar
    axes = PARTS["fig1"].draw(interpretation, {}).axes[0]
    start = drawings.path(robot)[1].position[0]
    for cable, anchor in enumerate(robot.base):
        (drawn,) = lines(axes, drawings.MOTORS[cable])
        np.testing.assert_allclose(drawn, [anchor, start])
    assert numbers("fig1", interpretation)["side_m"] == pytest.approx(1.0)


@pytest.mark.parametrize("triangles", ["inverted", "turned"])
def test_spatial_drawing_does_not_turn_the_platform_otherwise_than_the_plant(triangles):
    interpretation = Interpretation(triangles=triangles)
    robot = interpretation.spatial("control")
    _, below, _ = PARTS["fig2"].draw(interpretation, {}).axes
    start = drawings.path(robot)[1].position[0]
    depths = platform_points(robot, start)[:, 2]
    for cable, anchor in enumerate(robot.base):
        (drawn,) = lines(below, drawings.MOTORS[cable])
        np.testing.assert_allclose(drawn[0], anchor[:2])
        length = np.hypot(np.linalg.norm(drawn[1] - drawn[0]), depths[cable])
        assert length == pytest.approx(cable_lengths(robot.base, robot.platform, start)[cable])


def platform_points(robot, pose):
    """Written out from ψ, θ, φ about x, y and z, one after the other."""
    psi, theta, phi = pose[3:]
    points = robot.platform.copy()
    for angle, i, j in ((psi, 1, 2), (theta, 2, 0), (phi, 0, 1)):
        turned = points.copy()
        turned[:, i] = np.cos(angle) * points[:, i] - np.sin(angle) * points[:, j]
        turned[:, j] = np.sin(angle) * points[:, i] + np.cos(angle) * points[:, j]
        points = turned
    return pose[:3] + points


def test_oblique_view_is_not_mirrored():
    """From above, with z pointing away, the turn from x to y is clockwise; and what is deeper is drawn lower."""
    (xx, xy), (yx, yy), (zx, zy) = drawings.oblique(np.eye(3))
    assert xx * yy - xy * yx < 0
    assert zy < 0
    assert abs(zx) < 1e-12


def test_sides_are_not_drawn_at_another_scale_than_read():
    half, circum = (numbers("fig2", Interpretation(sides=sides)) for sides in ("half-side", "circumradius"))
    assert (half["half_side_base_m"], half["half_side_platform_m"]) == pytest.approx((0.47, 0.148))
    assert circum["half_side_base_m"] == pytest.approx(0.47 * np.sqrt(3) / 2)
    assert half["shortest_cable_m"] < half["longest_cable_m"]


def test_wind_up_is_not_another_than_an_episode_starts_with():
    interpretation = Interpretation()
    robot = interpretation.flexible("control")
    env = gym.make(FLEXIBLE, robot=robot)
    observation, _ = env.reset(seed=0)
    part = env.get_wrapper_attr("layout").split(observation)
    wound = part["motor_angle"] - textbook.pulley_angle(robot, part["pose"])
    assert numbers("fig3", interpretation)["wind_up_max_rad"] == pytest.approx(wound.max())
    assert numbers("fig3", interpretation)["mode_high_Hz"] == pytest.approx(
        textbook.highest_frequency(robot) / (2 * np.pi)
    )


def test_limits_drawn_are_not_those_of_another_line(planar_loop):
    robot, found = Interpretation().planar, {"loop": planar_loop}
    speeds = planar_loop.arrays["motor_speeds"]
    slope = robot.speed_slope
    expected = {"physical": 5 - slope * speeds, "flat": np.full_like(speeds, 5.0), "reversed": 5 + slope * speeds}
    expected["cable"] = 5 + slope * robot.pulley_radius * speeds
    for line, upper in expected.items():
        figure = PARTS["fig5"].draw(Interpretation(line=line), found)
        for motor, axes in enumerate(figure.axes[:3]):
            drawn = axes.get_lines()[0].get_xydata()
            np.testing.assert_allclose(drawn[[0, -1], 1], upper[[0, -1], motor])
            np.testing.assert_allclose(drawn[-1, 0], planar_loop.arrays["action_time"][-1])


@pytest.mark.parametrize("line", ["flat", "reversed", "cable"])
def test_a_line_that_no_motor_has_is_not_run_and_the_title_says_so(line, planar_loop):
    interpretation = Interpretation(line=line)
    robots = {name: PARTS[name].cells(interpretation)["loop"].keywords["robot"] for name in ("fig5", "fig6", "fig7")}
    plain = {
        "fig5": interpretation.planar,
        "fig6": interpretation.spatial("control"),
        "fig7": interpretation.flexible("control"),
    }
    for name, robot in robots.items():
        assert (robot == plain[name]) == (line != "flat")
    title = PARTS["fig5"].draw(interpretation, {"loop": planar_loop}).get_suptitle()
    assert ("the loop uses the physical line" in title) == (line != "flat")


def test_minimum_tension_is_not_read_and_then_left_out():
    cell = PARTS["fig5"].cells(Interpretation(minimum_tension=2.0))["loop"]
    assert numbers("fig5", Interpretation(), {"loop": cell()})["least_tension_N"] == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize(("stiffness", "expected"), [("as-printed", 2.0), ("3", 3.0)])
def test_springs_of_fig_7_to_9_are_not_those_of_the_payload_section(stiffness, expected):
    interpretation = Interpretation(stiffness=stiffness)
    for name in ("fig7", "fig8", "fig9"):
        robots = [cell.keywords["robot"] for cell in PARTS[name].cells(interpretation).values()]
        springs = {float(robot.stiffness[0]) for robot in robots if robot.flexible}
        assert springs == {expected}
        assert {robot.mass for robot in robots} == {11.0}  # Tables 4 and 5


def test_ripple_before_the_jump_is_not_mixed_with_that_after():
    times = np.linspace(0, 1, 1001)
    rigid = np.zeros((1001, 6))
    ringing = np.where(times > 0.5, 2.0, 0.5)[:, None] * np.ones(6)
    profiles = [Profile(times=times, torques=torques, lower=rigid, upper=rigid) for torques in (ringing, rigid)]
    assert tracking.ripple(*profiles, tracking.JUMP - tracking.WINDOW) == pytest.approx(0.5)
    assert tracking.ripple(*profiles, tracking.JUMP) == pytest.approx(2.0)


class Recording(RobustPD):
    """Keeps what it added."""

    def __call__(self, part):
        v = super().__call__(part)
        self.seen.append(v - robust.PD(gains=self.gains)(part))
        return v


@pytest.mark.parametrize("flexible", [False, True])
def test_added_input_is_not_that_of_another_instant(flexible):
    robot = Interpretation().flexible("control") if flexible else Interpretation().spatial("control")
    law = (RobustComposite if flexible else Robust)(robot)
    law.outer = Recording(gains=law.outer.gains)
    object.__setattr__(law.outer, "seen", [])
    loop = record_rollout(law, FLEXIBLE if flexible else SPATIAL, robot=robot, uncertainty="table6")
    added = robust.added_input(law.outer, loop, robot)
    commanded = np.concatenate(law.outer.seen)[1:500]  # the first is at the start, where nothing is recorded
    np.testing.assert_allclose(added.term, commanded, atol=1e-9)
    np.testing.assert_allclose(added.times, np.arange(1, 500) / 500)


@pytest.mark.parametrize("layer", [1e-6, 1e3])
def test_norm_of_the_term_is_not_another_than_rho_outside_the_layer(layer):
    rng, robot = np.random.default_rng(0), Interpretation().spatial("control")
    times = np.arange(1, 11) / 10
    reference = robust.paper_circle(robot)(times)
    e, rate = rng.normal(scale=0.01, size=(2, 10, 6))
    arrays = {"time": times, "pose": reference.position - e, "velocity": reference.velocity - rate}
    outer = RobustPD(gains=(30.0, 20.0), boundary_layer=layer)
    added = robust.added_input(outer, SimpleNamespace(arrays=arrays), robot)
    drift = np.sqrt(np.sum(rate**2 + (30 * e + 20 * rate) ** 2, axis=1))
    rho = (0.12 * (np.linalg.norm(reference.acceleration, axis=1) + drift) + 1.2) / 0.88
    norm = np.linalg.norm(added.term, axis=1)
    if layer < 1:
        assert added.outside.all()
        np.testing.assert_allclose(norm, rho[:-1], rtol=1e-9)
    else:
        assert not added.outside.any()
        assert np.all(norm < 1e-3 * rho[:-1])


def plain_whatever(robot, boundary_layer):
    return FeedbackLinearization(robot)


def test_reduction_is_not_of_the_ordinary_law_against_the_robust_one():
    keywords = {"env_id": SPATIAL, "robot": Interpretation().spatial("control"), "layers": (1e-3,), "draws": 2}
    (better,) = robust.reductions(plain=FeedbackLinearization, robust=Robust, **keywords)
    (worse,) = robust.reductions(plain=Robust, robust=plain_whatever, **keywords)
    for name in ("total", "largest"):
        assert 0.5 < getattr(better, name).mean < 0.8
        assert 1 - getattr(worse, name).mean == pytest.approx(1 / (1 - getattr(better, name).mean))


def test_one_draw_is_not_another_for_the_two_laws_and_its_reduction_has_the_right_sign():
    cells = PARTS["fig9"].cells(Interpretation())
    plain, better = (cells[f"{SPATIAL} {law}"] for law in ("plain", "robust"))
    assert {**plain.keywords, "law": None} == {**better.keywords, "law": None}
    assert plain.keywords["law"] is FeedbackLinearization
    loops = plain(), better()
    assert 0.5 < robust._reduced(*loops, "tracking_error") < 0.8
    assert robust._reduced(*loops[::-1], "tracking_error") < 0
    lost = SimpleNamespace(arrays=loops[0].arrays, reason="slack")
    assert robust._reduced(lost, loops[1], "tracking_error") is None


def test_layers_are_not_named_twice_and_the_decades_are_among_them():
    names = [robust._named(layer) for layer in robust.LAYERS]
    assert len(set(names)) == len(names)
    assert {"1e-2", "1e-3", "1e-4"} <= set(names)


def test_fig_8_shows_the_very_episodes_of_fig_9():
    ours, theirs = (PARTS[name].cells(Interpretation()) for name in ("fig8", "fig9"))
    for env_id, cell in ours.items():
        assert isinstance(cell, partial)
        assert repr(cell) == repr(theirs[f"{env_id} robust"])


def test_robust_term_is_not_left_out_of_the_papers_law_on_springs():
    cells = PARTS["fig9"].cells(Interpretation())
    plain, better = (cells[f"eq22 {law}"]() for law in ("plain", "robust"))
    peaks = [loop.arrays["tracking_error_peak"].max() for loop in (plain, better)]
    assert peaks[1] != pytest.approx(peaks[0])
    assert not plain.verdict.carried
    assert not better.verdict.carried
