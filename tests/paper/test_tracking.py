"""Figs. 1 to 3 and 5 to 9: robots of the plant, limits of the interpretation, and effect of the robust law."""

from __future__ import annotations

import pickle
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest

from cablebot_baselines.classical import PD, FeedbackLinearization, Robust, RobustComposite, RobustPD
from cablebot_baselines.paper.contents import PARTS
from cablebot_baselines.paper.exact import Profile
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.parts import drawings, robust, tracking
from cablebot_baselines.paper.parts.plotting import MOTORS
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.kinematics import cable_lengths
from cablebot_gym.physics import textbook

pytest.importorskip("matplotlib.figure")

BY_NAME = {part.name: part for part in PARTS}
SPATIAL, FLEXIBLE = "CableBot-Spatial-v0", "CableBot-FlexSpatial-v0"


def lines(axes, colour):
    """End points of the straight lines of a colour."""
    found = [line.get_xydata() for line in axes.get_lines() if line.get_color() == colour]
    return [points for points in found if len(points) == 2]


def numbers(name, interpretation, results=None):
    return BY_NAME[name].outcome(interpretation, results or {}).numbers


def keywords(name, interpretation):
    return {key: job.compute.keywords for key, job in BY_NAME[name].jobs(interpretation).items()}


@pytest.fixture(scope="module")
def planar_loop():
    return BY_NAME["fig5"].jobs(Interpretation())["loop"].compute()


def test_jobs_can_be_sent_to_other_processes():
    for part in PARTS:
        for job in part.jobs(Interpretation()).values():
            assert repr(pickle.loads(pickle.dumps(job))) == repr(job)


@pytest.mark.parametrize("triangles", ["inverted", "turned"])
def test_drawn_spatial_cables_have_the_lengths_of_the_plant(triangles):
    interpretation = Interpretation(triangles=triangles)
    robot = interpretation.spatial("control")
    _, below, _ = BY_NAME["fig2"].draw(interpretation, {}).axes
    start = drawings.path(robot)[1].position[0]
    depths = platform_points(robot, start)[:, 2]
    for cable, anchor in enumerate(robot.base):
        (drawn,) = lines(below, MOTORS[cable])
        np.testing.assert_allclose(drawn[0], anchor[:2])
        length = np.hypot(np.linalg.norm(drawn[1] - drawn[0]), depths[cable])
        assert length == pytest.approx(cable_lengths(robot.base, robot.platform, start)[cable])


def platform_points(robot, pose):
    """Rotations by ψ, θ, φ about x, y and z, one after the other."""
    psi, theta, phi = pose[3:]
    points = robot.platform.copy()
    for angle, i, j in ((psi, 1, 2), (theta, 2, 0), (phi, 0, 1)):
        turned = points.copy()
        turned[:, i] = np.cos(angle) * points[:, i] - np.sin(angle) * points[:, j]
        turned[:, j] = np.sin(angle) * points[:, i] + np.cos(angle) * points[:, j]
        points = turned
    return pose[:3] + points


def test_wind_up_is_that_at_the_start_of_an_episode():
    robot = Interpretation().flexible("control")
    env = gym.make(FLEXIBLE, robot=robot, trajectory="paper-spatial")
    blocks = env.get_wrapper_attr("layout").split(env.reset(seed=0)[0])
    wound = blocks["motor_angle"] - textbook.pulley_angle(robot, blocks["pose"])
    found = numbers("fig3", Interpretation())
    assert found["wind_up_max_rad"] == pytest.approx(wound.max())
    assert found["mode_high_Hz"] == pytest.approx(textbook.highest_frequency(robot) / (2 * np.pi))


def test_drawn_limits_are_those_of_the_line(planar_loop):
    robot, speeds = Interpretation().planar, planar_loop.arrays["motor_speeds"]
    factors = {"physical": 1.0, "flat": 0.0, "reversed": -1.0, "cable": -robot.pulley_radius}
    for line, factor in factors.items():
        figure = BY_NAME["fig5"].draw(Interpretation(line=line), {"loop": planar_loop})
        expected = 5 - factor * robot.speed_slope * speeds
        for motor, axes in enumerate(figure.axes[:3]):
            drawn = axes.get_lines()[0].get_xydata()
            np.testing.assert_allclose(drawn[[0, -1], 1], expected[[0, -1], motor])
            np.testing.assert_allclose(drawn[-1, 0], planar_loop.arrays["action_time"][-1])
        assert ("the loop uses the physical line" in figure.get_suptitle()) == (line in ("reversed", "cable"))


@pytest.mark.parametrize("line", ["flat", "reversed"])
def test_closed_loop_uses_the_line_of_the_interpretation_if_a_motor_can_have_it(line):
    interpretation = Interpretation(line=line)
    plain = (interpretation.planar, interpretation.spatial("control"), interpretation.flexible("control"))
    for name, robot in zip(("fig5", "fig6", "fig7"), plain, strict=True):
        assert (keywords(name, interpretation)["loop"]["robot"] == robot) == (line != "flat")


def test_minimum_tension_reaches_the_law():
    job = BY_NAME["fig5"].jobs(Interpretation(minimum_tension=2.0))["loop"]
    found = numbers("fig5", Interpretation(), {"loop": job.compute()})
    assert found["least_tension_N"] == pytest.approx(2.0, abs=1e-6)


def test_ripple_separates_before_and_after_the_jump():
    times = np.linspace(0, 1, 1001)
    rigid = np.zeros((1001, 6))
    ringing = np.where(times > 0.5, 2.0, 0.5)[:, None] * np.ones(6)
    profiles = [Profile(times=times, torques=torques, lower=rigid, upper=rigid) for torques in (ringing, rigid)]
    assert tracking.ripple(*profiles, tracking.JUMP - tracking.WINDOW) == pytest.approx(0.5)
    assert tracking.ripple(*profiles, tracking.JUMP) == pytest.approx(2.0)


class Recording(RobustPD):
    """Records the robust term."""

    def __call__(self, blocks):
        v = super().__call__(blocks)
        self.seen.append(v - PD(gains=self.gains)(blocks))
        return v


@pytest.mark.parametrize("flexible", [False, True])
def test_added_input_is_the_term_of_the_same_instant(flexible):
    robot = Interpretation().flexible("control") if flexible else Interpretation().spatial("control")
    law = (RobustComposite if flexible else Robust)(robot)
    law.outer = Recording(gains=law.outer.gains)
    object.__setattr__(law.outer, "seen", [])
    env_id, keywords = FLEXIBLE if flexible else SPATIAL, {"trajectory": "paper-spatial", "uncertainty": "table6"}
    loop = record_rollout(law, env_id, robot=robot, **keywords)
    added = robust.added_input(law.outer, loop, robot)
    expected = np.concatenate(law.outer.seen)[1:500]  # the first instant is not recorded
    np.testing.assert_allclose(added.term, expected, atol=1e-9)
    np.testing.assert_allclose(added.times, np.arange(1, 500) / 500)


@pytest.mark.parametrize("layer", [1e-6, 1e3])
def test_norm_of_the_robust_term_is_rho_outside_the_boundary_layer(layer):
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


def test_episodes_of_one_draw_differ_in_the_law_only():
    chosen, jobs = keywords("fig9", Interpretation()), BY_NAME["fig9"].jobs(Interpretation())
    plain, better = (f"{SPATIAL} {law}" for law in ("plain", "robust"))
    assert {**chosen[plain], "law": None} == {**chosen[better], "law": None}
    assert chosen[plain]["law"] is FeedbackLinearization
    for env_id, job in BY_NAME["fig8"].jobs(Interpretation()).items():
        assert job.key == jobs[f"{env_id} robust"].key
    loops = jobs[plain].compute(), jobs[better].compute()
    assert 0.5 < robust.reduced(*loops, "tracking_error") < 0.8
    assert robust.reduced(*loops[::-1], "tracking_error") < 0
    lost = SimpleNamespace(arrays=loops[0].arrays, reason="slack")
    assert robust.reduced(lost, loops[1], "tracking_error") is None
