"""Laws, claims, scan and map of the reproduction against independent calculations."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from cablebot_baselines.classical import Composite, FeedbackLinearization, PaperFlexible
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.physics import textbook
from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_reproduction import linearised
from cablebot_reproduction.exact import exact_limit
from cablebot_reproduction.interpretation import Interpretation
from cablebot_reproduction.laws import FeedForward
from cablebot_reproduction.parts import maps, scan

DEFAULT = Interpretation()

# --- scan of geometries and map of circles ----------------------------------------------------------------------------


@pytest.fixture
def narrow(monkeypatch):
    """Restricts the scan to few geometries."""
    all_sizes = dict(scan.SIZES)

    def narrowed(*, base_turn=0.0, sizes=("half side",)):
        monkeypatch.setattr(scan, "BASE_TURNS", np.array([base_turn]))
        monkeypatch.setattr(scan, "PLATFORM_TURNS", np.zeros(1))
        monkeypatch.setattr(scan, "SIZES", {size: all_sizes[size] for size in sizes})

    return narrowed


@pytest.mark.parametrize("line", ["physical", "flat"])
def test_scan_contains_the_robots_of_the_interpretations(narrow, line):
    turned = {"sides": "circumradius", "triangles": "turned"}
    for changes, turn, sizes in (
        ({}, 0.0, ("half side",)),
        (turned, np.pi, ("half side", "circumradius")),
    ):
        interpretation = Interpretation(line=line, **changes)
        narrow(base_turn=turn, sizes=sizes)
        geometry = scan.geometries(interpretation=interpretation, base_size=sizes[-1])[-1]
        limit = exact_limit(interpretation, interpretation.spatial("payload"))
        assert geometry == (pytest.approx(limit.payload, abs=0.01), limit.motor)


@pytest.mark.parametrize(("lowest", "payload"), [(0.5, -np.inf), (0.0, 1.0)])
def test_platform_that_needs_ballast_has_no_payload(narrow, monkeypatch, lowest, payload):
    narrow()
    limit = SimpleNamespace(payload=1.0, lowest=lowest, motor=3)
    monkeypatch.setattr(scan, "exact_payload", lambda *_, **__: limit)
    assert scan.geometries(interpretation=DEFAULT, base_size="half side") == [(payload, 3)]


@pytest.mark.parametrize("line", ["physical", "reversed"])
def test_map_has_paper_circle_weak_motors_and_slack_cables(monkeypatch, line):
    monkeypatch.setattr(maps, "RADII", (0.1, 0.2))
    monkeypatch.setattr(maps, "HEIGHTS", (0.06, 0.1, 0.2))
    interpretation = Interpretation(line=line)
    results = {name: job.compute() for name, job in maps.jobs(interpretation).items()}
    payload, weak = maps.payloads(results)
    limit = exact_limit(interpretation, interpretation.spatial("payload"))
    assert payload[1, 0] == pytest.approx(limit.payload, abs=0.01)
    assert weak[0, 0]
    assert not weak[2, 1]
    assert math.isnan(payload[2, 1])
    assert maps.outcome(interpretation, results).numbers["exact_largest_kg"] == np.nanmax(payload)
    maps.draw(interpretation, results)


# --- claims of the text -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL])
def test_open_loop_torques_depend_on_the_reference_only(robot):
    rng = np.random.default_rng(3)
    pose = robot.home + 0.02 * rng.standard_normal(robot.coordinates)
    velocity, acceleration = rng.standard_normal((2, robot.coordinates))
    blocks = {
        "pose": pose,
        "velocity": velocity,
        "reference_pose": pose,
        "reference_velocity": velocity,
        "reference_acceleration": acceleration,
    }
    mass = np.array(robot.mass + 0.3)
    exact, _ = FeedbackLinearization(robot, minimum_tension=2.0).torques(blocks, mass)
    law = FeedForward(robot, minimum_tension=2.0)
    for offset in (0.0, 0.01):
        state = {"pose": pose + offset, "velocity": velocity - offset}
        torques, speeds = law.torques(blocks | state, mass)
        assert torques == pytest.approx(exact, rel=1e-9)
        assert speeds == pytest.approx(textbook.pulley_speed(robot, *state.values()), rel=1e-9)


# --- controllability --------------------------------------------------------------------------------------------------


def test_motors_control_all_states_of_the_flexible_robot():
    """As by the test of Hautus in tests/errata."""
    assert linearised.controllable_states(DEFAULT.flexible("control")) == 24


def test_fewer_motors_control_fewer_states_in_four_samples(monkeypatch):
    """[B, AB, A²B, A³B] has four columns for each independent motor."""
    mixing = np.random.default_rng(1).standard_normal((6, 3))
    common = mixing @ np.linalg.pinv(mixing)

    class Shared(linearised.Plant):
        def set_action(self, action):
            nominal = action.mean(axis=0)
            super().set_action(nominal + (action - nominal) @ common)

    monkeypatch.setattr(linearised, "Plant", Shared)
    assert linearised.controllable_states(DEFAULT.flexible("control")) == 12


# --- Eq. 22 -----------------------------------------------------------------------------------------------------------


def robot(stiffness, *, friction=0.0, unsaturated_actions=False):
    """The paper's robot at 11 kg; unsaturated motors have a very large stall torque and the same
    slope."""
    springs = FLEX_SPATIAL.transmission.replace(stiffness=stiffness, motor_damping=friction)
    paper_robot = FLEX_SPATIAL.replace(mass=11.0, transmission=springs)
    if unsaturated_actions:
        return linearised.unsaturated_actions(paper_robot)
    return paper_robot


def peaks(law, plant_robot, **keywords):
    """Largest position error in each tenth of a second on Table 3's circle [m]; infinite after a
    termination."""
    conditions = {"trajectory": "paper-spatial", "error_bounds": {"position": 0.1}}
    loop = record_rollout(
        law, "CableBot-FlexSpatial-v0", robot=plant_robot, **conditions, **keywords
    )
    errors = np.full(500, np.inf)
    errors[: len(loop) - 1] = loop.arrays["tracking_error_peak"]
    return errors.reshape(10, 50).max(axis=1)


def test_errors_grow_at_the_rate_of_the_linearised_loop():
    """Also with saturated motors and slack cables the circle is lost."""
    unsaturated = robot(2.0, unsaturated_actions=True)
    law = PaperFlexible(unsaturated)
    rate = 9.5
    assert linearised.growth_rate(law, unsaturated) == pytest.approx(rate, rel=0.02)
    error = peaks(law, unsaturated, cable="bilateral")
    assert np.log(error[3] / error[1]) / 0.2 == pytest.approx(rate, rel=0.1)
    assert error[5] == np.inf
    saturated = robot(2.0)
    assert peaks(PaperFlexible(saturated), saturated).max() > 0.02


def test_linearised_loop_of_stable_laws_decays():
    nominal = robot(3.0, unsaturated_actions=True)
    assert (
        -2 < linearised.growth_rate(Composite(nominal), nominal) < -1
    )  # the slow pole of (30, 20): −1.6
    with_friction = robot(3.0, friction=0.01, unsaturated_actions=True)
    assert linearised.growth_rate(PaperFlexible(with_friction), with_friction) < -1
