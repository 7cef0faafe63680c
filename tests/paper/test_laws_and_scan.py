"""Laws, claims, scan and map of the reproduction against independent calculations."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from cablebot_baselines.paper import linearised
from cablebot_baselines.paper.exact import exact_limit
from cablebot_baselines.paper.interpretation import Interpretation
from cablebot_baselines.paper.laws import FeedForward
from cablebot_baselines.paper.parts import claims, maps, scan
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL

DEFAULT = Interpretation()

# --- scan of geometries and map of circles ----------------------------------------------------------------------------


@pytest.fixture
def narrow(monkeypatch):
    """Restricts the scan to few geometries."""
    all_sizes = dict(scan.SIZES)

    def narrowed(*, base_turn=0.0, platform_turn=0.0, sizes=("half side",)):
        monkeypatch.setattr(scan, "BASE_TURNS", np.array([base_turn]))
        monkeypatch.setattr(scan, "PLATFORM_TURNS", np.array([platform_turn]))
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


def released(stiffness, damping):
    """Recorded arrays of a loop with an initial error of 1 mm that satisfies ë + K_D ė + K_P e =
    0."""
    time = np.arange(5001) / 10_000
    decay = damping / 2
    root = np.sqrt(complex(damping**2 / 4 - stiffness))
    error = (
        1e-3
        * np.exp(-decay * time)
        * np.real(np.cosh(root * time) + decay / root * np.sinh(root * time))
    )
    pose = np.stack([0.3 + error, np.full_like(error, -0.2)], axis=1)
    reference = np.broadcast_to([0.3, -0.2], pose.shape)
    return SimpleNamespace(arrays={"time": time, "pose": pose, "reference_pose": reference})


@pytest.mark.parametrize("gains", [(2000.0, 10.0), (30.0, 20.0)])
def test_decay_error_is_zero_for_the_given_poles_only(gains):
    stiffness, damping = gains
    assert claims.decay_error(released(stiffness, damping), gains) < 1e-9
    assert claims.decay_error(released(stiffness, 2 * damping), gains) > 0.05
    assert claims.decay_error(released(2 * stiffness, damping), gains) > 0.05


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL])
def test_open_loop_torques_depend_on_the_reference_only(robot):
    rng = np.random.default_rng(3)
    shape = (4, robot.coordinates)
    mass = np.full(4, robot.mass + 0.3)
    reference = robot.home + 0.02 * rng.standard_normal(shape)
    velocity, acceleration = rng.standard_normal((2, *shape))
    law = FeedForward(robot, minimum_tension=2.0)
    tensions = textbook.required_tensions(
        robot, mass, reference, velocity, acceleration, minimum=2.0
    )
    required = textbook.required_torques(robot, tensions, reference, velocity, acceleration)
    for offset in (0.0, 0.01):
        blocks = {
            "pose": reference + offset,
            "velocity": 0.1 * velocity - offset,
            "reference_pose": reference,
            "reference_velocity": velocity,
            "reference_acceleration": acceleration,
        }
        torques, speeds = law.torques(blocks, mass)
        assert torques == pytest.approx(required, rel=1e-9)
        assert speeds == pytest.approx(
            textbook.pulley_speed(robot, blocks["pose"], blocks["velocity"]), rel=1e-9
        )


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
