"""The closed form of the payload against hand calculation, independent runs, and tensions of payloads beside it."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from oracles.platforms import CRANE

from cablebot_gym.bounds.closed_form import control_instants, exact_payload
from cablebot_gym.motions import Dwell, PointToPoint, find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.physics.tensions import distribution
from cablebot_gym.physics.tensions.distribution import HELD
from cablebot_gym.robots import PLANAR, RPM, SPATIAL, Motors

# --- by hand ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "motion", "minimum", "interval"),
    [
        (PLANAR, "dwell-planar", 40.0, (-1, math.inf)),
        # τ_s / r is 200 and 100 N
        (SPATIAL, "dwell-spatial", 200.1, (math.inf, -math.inf)),
        (PLANAR, "dwell-planar", 100.1, (math.inf, -math.inf)),
        # The platform does not turn, so all tensions are proportional to the mass.
        (SPATIAL, "smooth-circle-spatial", 0.0, (math.inf, -math.inf)),
    ],
)
def test_payload_is_unlimited_or_infeasible(robot, motion, minimum, interval):
    trajectory = find_trajectory({"name": motion, "duration": 0.97}, robot.coordinates)
    result = exact_payload(robot, trajectory, minimum_tension=minimum)
    assert (result.lowest, result.payload) == interval
    assert (result.time is None) == (result.motor is None) == (result.payload == math.inf)


@dataclasses.dataclass(frozen=True)
class Jolted:
    """A hold, except for an acceleration [m/s²] along the first coordinate at one instant."""

    at: float
    acceleration: float
    coordinates: int = 2
    duration: float = 1.0
    name: str = "jolted"

    def __call__(self, times):
        reference = Dwell(pose=(0.0, 0.0), duration=self.duration)(times)
        reference.acceleration[np.isclose(times, self.at, rtol=0, atol=1e-9), 0] = self.acceleration
        return reference


@pytest.mark.parametrize("at", [0.0, 0.998])
def test_lower_torque_limit_counts(at):
    # Towards +x pulley 1 runs out with −J a cos 30° / r, against which its slack cable does
    # nothing.
    heavy = PLANAR.transmission.replace(pulley_inertia=(0.1, 1e-9, 1e-9))
    result = exact_payload(PLANAR.replace(transmission=heavy), Jolted(at=at, acceleration=3.0))
    assert 0.1 * 3.0 * math.cos(math.pi / 6) / 0.05 > 5
    assert result.payload == -math.inf
    assert result.motor == 1
    assert result.time == pytest.approx(at)


@pytest.mark.parametrize(("mass", "below"), [(1.0, True), (3.0, False)])
def test_interval_around_zero_payload_is_chosen(mass, below):
    # Seven cables, at 150°, 90°, 30° and about -50°. The force left over from 10 N in each points
    # to the left; a growing mass turns it over cable 2, whose tension has a peak on the way that
    # its weak motor cannot hold.
    angles = np.radians([150, 90, 30, -40, -45, -50, -60])
    anchors = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    robot = PLANAR.replace(
        base_anchors=anchors,
        mass=mass,
        motors=Motors(stall_torque=(100.0, 0.05 * 15, *(100.0,) * 5), free_speed=100.0),
        transmission=PLANAR.transmission.replace(pulley_inertia=0.0),
    )
    force_x, force_y = -10 * anchors.sum(axis=0)
    # Between cables 1 and 2, T_2 = 10 + w_y + w_x / √3, between 2 and 3 it is 10 + w_y - w_x / √3.
    low_mass, high_mass = ((side * math.sqrt(3) * (5 - force_y) - force_x) / 10 for side in (1, -1))
    result = exact_payload(robot, Jolted(at=0.5, acceleration=10.0), minimum_tension=10.0)
    if below:
        assert (result.lowest, result.payload) == pytest.approx((-mass, low_mass - mass), abs=1e-9)
        assert (result.motor, result.time) == (2, 0.5)
    else:
        assert result.lowest == pytest.approx(high_mass - mass, abs=1e-9)
        assert result.payload > result.lowest


# --- independent runs ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robot", "minimum", "total"), [(SPATIAL, 0.0, 11.80), (PLANAR, 5.0, 2.07)]
)
def test_mass_on_the_papers_circle_matches_independent_runs(robot, minimum, total):
    # Before the jump of acceleration at 0.5 s for the planar robot, after it for the spatial:
    # control instants alone would miss one of them.
    trajectory = find_trajectory(f"paper-{robot.name}", robot.coordinates)
    result = exact_payload(robot, trajectory, minimum_tension=minimum)
    assert robot.mass + result.payload == pytest.approx(total, abs=0.006)
    assert result.motor == 2
    assert result.time == pytest.approx(0.5, abs=1e-6)


# --- random robots ----------------------------------------------------------------------------------------------------

FREQUENCY = 40.0


def random_case(kind, rng):
    """A robot with random anchors, mass and drives, a circle, and a minimum tension."""
    robot = SPATIAL
    trajectory = "smooth-circle-spatial"
    base = SPATIAL.base + rng.uniform(-0.03, 0.03, (6, 3))
    if kind != "spatial":
        robot = PLANAR
        trajectory = "paper-planar"
        cables = int(kind[-1])
        angles = (np.arange(cables) + rng.uniform(-0.25, 0.25, cables)) * 2 * np.pi / cables
        base = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    robot = robot.replace(
        base_anchors=base,
        motors=Motors(
            stall_torque=robot.stall_torque.max() * rng.uniform(0.8, 1.8, len(base)),
            free_speed=rng.uniform(800, 2000) * RPM,
        ),
        transmission=robot.transmission.replace(
            pulley_inertia=rng.uniform(0, 2e-3, len(base)),
            damping=rng.uniform(0, 0.02),
            load_friction=np.linspace(0.0, 0.1, len(base)),
        ),
    )
    motion = find_trajectory({"name": trajectory, "radius": 0.08}, robot.coordinates)
    return robot, motion, rng.choice([0.0, rng.uniform(0, 40)])


def feasible(robot, trajectory, minimum, total_masses):
    """Whether exact tracking respects the limits with each total mass."""
    x = trajectory(np.arange(round(trajectory.duration * FREQUENCY)) / FREQUENCY)
    shape = (len(total_masses), *x.position.shape)
    motion = [np.broadcast_to(a, shape) for a in (x.position, x.velocity, x.acceleration)]
    masses = np.broadcast_to(total_masses[:, None], shape[:2])
    inverse = textbook.inverse_dynamics(robot, masses, *motion, minimum=minimum)
    action = textbook.normalised_action(robot, inverse.torques, inverse.speeds)
    return np.all((np.abs(action) <= 1) & (inverse.tensions >= minimum), axis=(1, 2))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "kind",
    [
        pytest.param("spatial", marks=pytest.mark.landing),
        "planar-3",
        "planar-4",
        "planar-5",
    ],
)
def test_interval_is_that_of_the_feasible_payloads(kind, seed):
    """It is the interval at or nearest to no payload."""
    robot, trajectory, minimum = random_case(kind, np.random.default_rng(seed))
    result = exact_payload(robot, trajectory, minimum_tension=minimum, frequency=FREQUENCY)
    masses = np.linspace(1e-9, 60, 401)
    good = feasible(robot, trajectory, minimum, masses)
    ends = robot.mass + np.array([result.lowest, result.payload])
    inside = (masses >= ends[0]) & (masses <= ends[1])
    assert good[inside].all()
    nearest = min(np.abs(masses[inside] - robot.mass), default=np.inf)
    assert not good[np.abs(masses - robot.mass) < nearest].any()
    ends = ends[(ends > 0) & np.isfinite(ends)]
    beside = feasible(robot, trajectory, minimum, np.append(ends - 1e-6, ends + 1e-6))
    assert np.all(beside[: len(ends)] != beside[len(ends) :])


# --- arguments ----------------------------------------------------------------------------------------------------


def test_slow_or_unfitting_motion_is_rejected():
    circle = find_trajectory("paper-planar", 2)
    with pytest.raises(ValueError, match="frequency"):
        exact_payload(PLANAR, circle, frequency=0.2)
    with pytest.raises(ValueError, match="2 coordinates"):
        exact_payload(SPATIAL, circle)


@pytest.mark.landing
def test_redundant_cables_have_the_best_tensions():
    """Tensions within both limits exist just below the payload, and not just above it."""
    start = (0.2, 0.1, 4.0, 0.0, 0.0, 0.0)
    end = (1.5, -0.8, 3.0, 0.1, 0.0, 0.2)
    trajectory = PointToPoint(name="line", start=start, end=end, duration=2.0)
    result = exact_payload(CRANE, trajectory, minimum_tension=20.0, frequency=100.0)
    times, reference = control_instants(CRANE, trajectory, 100.0)
    motion = reference.position, reference.velocity, reference.acceleration
    limits = textbook.torque_limits(CRANE, textbook.pulley_speed(CRANE, *motion[:2]))
    idle = textbook.required_torques(CRANE, np.zeros((len(times), 8)), *motion)
    low, high = (np.array(limits) - idle) / CRANE.pulley_radius
    structure = textbook.jacobian(CRANE, reference.position)

    def held(payload):
        load = textbook.load(CRANE, CRANE.mass + payload, *motion)
        least = np.maximum(low, 20.0)
        scale = distribution.largest_scale(structure, load, 0 * load, least, high, 0.0)
        return scale.status == HELD

    assert all(held(result.payload - 0.01))
    failed = np.argmin(held(result.payload + 0.01))
    assert times[failed] == pytest.approx(result.time, abs=0.05)
