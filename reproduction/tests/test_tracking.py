"""Figs. 1 to 3 and 5 to 9: robots of the plant, limits of the interpretation, and effect of the
robust law."""

import pickle
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from cablebot_baselines.classical import PD, Robust, RobustComposite, RobustPD
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_reproduction.contents import PARTS
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.parts import drawings, robust, tracking
from cablebot_reproduction.parts.plotting import MOTORS

pytest.importorskip("matplotlib.figure")

DEFAULT = Interpretation()
SPATIAL = "CableBot-Spatial-v0"
FLEXIBLE = "CableBot-FlexSpatial-v0"


@pytest.fixture(scope="module")
def planar_loop():
    return tracking.planar_jobs(DEFAULT)["loop"].compute()


def test_jobs_can_be_sent_to_other_processes():
    for part in PARTS:
        for job in part.jobs(DEFAULT).values():
            assert repr(pickle.loads(pickle.dumps(job))) == repr(job)


@pytest.mark.parametrize("triangles", ["inverted", "turned"])
def test_drawn_spatial_cables_end_at_the_corners_of_the_plant(triangles):
    interpretation = Interpretation(triangles=triangles)
    robot = interpretation.spatial("control")
    start = drawings.path(robot)[1].position[0]
    corners = start[:3] + Rotation.from_euler("xyz", start[3:]).apply(robot.platform.copy())
    _, below, _ = drawings.draw_spatial(interpretation, {}).axes
    for cable, colour in enumerate(MOTORS):
        lines = [line.get_xydata() for line in below.get_lines() if line.get_color() == colour]
        (line,) = [points for points in lines if len(points) == 2]
        assert_allclose(line[0], robot.base[cable, :2])
        assert_allclose(line[1], corners[cable, :2])


def test_wind_up_is_that_at_the_start_of_an_episode():
    robot = DEFAULT.flexible("control")
    env = gym.make(FLEXIBLE, robot=robot, trajectory="paper-spatial")
    blocks = env.get_wrapper_attr("layout").split(env.reset(seed=0)[0])
    wound = blocks["motor_angle"] - textbook.pulley_angle(robot, blocks["pose"])
    numbers = drawings.joint_outcome(DEFAULT, {}).numbers
    assert numbers["wind_up_max_rad"] == pytest.approx(wound.max())
    assert numbers["mode_high_Hz"] == pytest.approx(textbook.highest_frequency(robot) / (2 * np.pi))


@pytest.mark.parametrize(
    ("line", "factor"), [("physical", 1.0), ("flat", 0.0), ("reversed", -1.0), ("cable", -0.05)]
)
def test_drawn_limits_are_those_of_the_line(planar_loop, line, factor):
    figure = tracking.draw_planar(Interpretation(line=line), {"loop": planar_loop})
    expected = 5 - factor * DEFAULT.planar.speed_slope * planar_loop.arrays["motor_speeds"]
    for motor, axes in enumerate(figure.axes[:3]):
        drawn = axes.get_lines()[0].get_xydata()
        assert_allclose(drawn[[0, -1], 1], expected[[0, -1], motor])
    assert ("the loop uses the physical line" in figure.get_suptitle()) == (
        line in ("reversed", "cable")
    )


@pytest.mark.parametrize("line", ["flat", "reversed"])
def test_closed_loop_uses_a_line_that_a_motor_can_have(line):
    interpretation = Interpretation(line=line)
    for jobs, robot in (
        (tracking.planar_jobs, interpretation.planar),
        (tracking.spatial_jobs, interpretation.spatial("control")),
        (tracking.flexible_jobs, interpretation.flexible("control")),
    ):
        simulated = jobs(interpretation)["loop"].compute.keywords["robot"]
        assert (simulated == robot) == (line == "reversed")


def test_minimum_tension_reaches_the_law():
    loop = tracking.planar_jobs(Interpretation(minimum_tension=2.0))["loop"].compute()
    numbers = tracking.loop_outcome(DEFAULT, {"loop": loop}).numbers
    assert numbers["least_tension_N"] == pytest.approx(2.0, abs=1e-6)


class Recording(RobustPD):
    """Records the robust term."""

    def __call__(self, blocks):
        v = super().__call__(blocks)
        self.terms.append(v - PD(gains=self.gains)(blocks))
        return v


@pytest.mark.parametrize(("env_id", "law_class"), [(SPATIAL, Robust), (FLEXIBLE, RobustComposite)])
def test_added_input_is_the_term_of_the_same_instant(env_id, law_class):
    robot = DEFAULT.spatial("control") if env_id == SPATIAL else DEFAULT.flexible("control")
    law = law_class(robot)
    law.outer = Recording(gains=law.outer.gains)
    object.__setattr__(law.outer, "terms", [])
    loop = record_rollout(
        law, env_id, robot=robot, trajectory="paper-spatial", uncertainty="table6"
    )
    added = robust.added_input(law.outer, loop, robot)
    recorded = np.concatenate(law.outer.terms)[1:500]  # the first instant is not recorded
    assert_allclose(added.term, recorded, atol=1e-9)
    assert_allclose(added.times, np.arange(1, 500) / 500)


def test_episodes_of_one_draw_differ_in_the_law_only():
    jobs = robust.tracking_jobs(DEFAULT)
    plain = jobs[f"{SPATIAL} plain"]
    better = jobs[f"{SPATIAL} robust"]
    assert plain.compute.keywords | {"law": None} == better.compute.keywords | {"law": None}
    for env_id, job in robust.term_jobs(DEFAULT).items():
        assert job.key == jobs[f"{env_id} robust"].key
    lost = SimpleNamespace(reason="slack")
    assert robust.reduced(lost, lost, "tracking_error") is None
