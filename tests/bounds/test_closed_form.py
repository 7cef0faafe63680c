"""The closed form of the payload against hand calculation, independent runs, and bisection."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from oracles.platforms import CRANE
from scipy.optimize import bisect, linprog

from cablebot_gym.bounds.closed_form import control_instants, exact_payload
from cablebot_gym.motions import Dwell, PointToPoint, find_trajectory
from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, RPM, SPATIAL, Motors

HOME_RISE = 0.1 / math.sqrt(0.1**2 + 0.47**2 + ((2 * 0.148 - 0.47) / math.sqrt(3)) ** 2)
"""Vertical part of each cable's direction in the spatial home pose, from A1 (-a, -a/√3, 0) to P1
(0, -2b/√3, 0.1)."""


# --- by hand ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("minimum", [0.0, 5.0, 70.0])
def test_static_hang_is_limited_by_the_weakest_motor(minimum):
    """And a minimum tension needs ballast."""
    motors = SPATIAL.motors.replace(stall_torque=(10.0, 10.0, 10.0, 5.0, 10.0, 10.0))
    robot = SPATIAL.replace(motors=motors)
    result = exact_payload(robot, find_trajectory("dwell-spatial", 6), minimum_tension=minimum)
    assert result.payload == pytest.approx(6 * (5 / 0.05) * HOME_RISE / 9.81 - 10, rel=1e-12)
    assert result.total_mass == pytest.approx(result.payload + 10)
    assert (result.time, result.motor, result.kind, result.line) == (0.0, 4, "torque", "upper")
    assert result.lowest == pytest.approx(6 * minimum * HOME_RISE / 9.81 - 10, rel=1e-12)


@pytest.mark.parametrize(
    ("robot", "motion", "minimum", "interval", "kind", "line"),
    [
        (PLANAR, "dwell-planar", 40.0, (-1, math.inf), None, None),
        # τ_s / r is 200 and 100 N
        (SPATIAL, "dwell-spatial", 200.1, (math.inf, -math.inf), "torque", "upper"),
        (PLANAR, "dwell-planar", 100.1, (math.inf, -math.inf), "torque", "upper"),
        # The platform does not turn, so all tensions are proportional to the mass.
        (SPATIAL, "smooth-circle-spatial", 0.0, (math.inf, -math.inf), "tension", "lower"),
    ],
)
def test_payload_is_unlimited_or_infeasible(robot, motion, minimum, interval, kind, line):
    trajectory = find_trajectory({"name": motion, "duration": 0.97}, robot.coordinates)
    result = exact_payload(robot, trajectory, minimum_tension=minimum)
    assert (result.lowest, result.payload) == interval
    assert result.total_mass == result.payload
    assert (result.kind, result.line) == (kind, line)
    assert (result.time is None) == (result.motor is None) == (kind is None)


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
def test_acceleration_matches_the_triangle_of_forces(at):
    # Towards −x cables 1 (210°) and 3 (90°) pull: T_1 cos 30° = M a and T_3 = T_1 / 2. The pulley
    # of cable 1 needs J a cos 30° / r too.
    a = 20.0
    result = exact_payload(PLANAR, Jolted(at=at, acceleration=-a))
    tension = (5.0 - 8e-4 * a * math.cos(math.pi / 6) / 0.05) / 0.05
    assert result.total_mass == pytest.approx(tension * math.cos(math.pi / 6) / a, rel=1e-12)
    assert (result.motor, result.line) == (1, "upper")
    assert result.time == pytest.approx(at)


def test_lower_torque_limit_counts():
    # Towards +x pulley 1 runs out with −J a cos 30° / r, against which its slack cable does
    # nothing.
    heavy = PLANAR.transmission.replace(pulley_inertia=(0.1, 1e-9, 1e-9))
    result = exact_payload(PLANAR.replace(transmission=heavy), Jolted(at=0.5, acceleration=3.0))
    assert 0.1 * 3.0 * math.cos(math.pi / 6) / 0.05 > 5
    assert result.payload == -math.inf
    assert (result.motor, result.time, result.line) == (1, 0.5, "lower")


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
        assert (result.motor, result.time, result.line) == (2, 0.5, "upper")
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
    assert result.total_mass == pytest.approx(total, abs=0.006)
    assert result.motor == 2
    assert result.kind == "torque"
    assert result.line == "upper"
    assert result.time == pytest.approx(0.5, abs=1e-6)


# --- bisection ----------------------------------------------------------------------------------------------------

FREQUENCY = 40.0


def random_case(kind, rng):
    """A robot with random anchors, mass and drives, a circle, and a minimum tension."""
    if kind == "spatial":
        robot = SPATIAL
        trajectory = "smooth-circle-spatial"
        base = SPATIAL.base + rng.uniform(-0.03, 0.03, (6, 3))
    else:
        robot = PLANAR
        trajectory = "paper-planar"
        cables = int(kind[-1])
        turns = (np.arange(cables) + rng.uniform(-0.25, 0.25, cables)) / cables
        angles = 2 * np.pi * turns + rng.uniform(0, 6)
        base = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        base = rng.uniform(0.7, 1.0, (cables, 1)) * base
    torques = robot.stall_torque.max() * rng.uniform(0.8, 1.8, len(base))
    drums = robot.transmission.replace(
        pulley_inertia=rng.uniform(0, 2e-3, len(base)),
        damping=rng.uniform(0, 0.02),
        load_friction=np.linspace(0.0, 0.1, len(base)),
    )
    robot = robot.replace(
        base_anchors=base,
        mass=robot.mass * rng.uniform(0.6, 1.2),
        motors=Motors(stall_torque=torques, free_speed=rng.uniform(800, 2000) * RPM),
        transmission=drums,
    )
    fields = {"radius": rng.uniform(0.04, 0.1), "duration": rng.uniform(1.0, 2.0)}
    motion = find_trajectory({"name": trajectory, **fields}, robot.coordinates)
    return robot, motion, rng.choice([0.0, rng.uniform(0, 40)])


def feasible(robot, trajectory, minimum, total_masses):
    """Whether exact tracking respects the limits with each total mass."""
    x = trajectory(np.arange(round(trajectory.duration * FREQUENCY)) / FREQUENCY)
    shape = (len(total_masses), *x.position.shape)
    motion = [np.broadcast_to(a, shape) for a in (x.position, x.velocity, x.acceleration)]
    masses = np.broadcast_to(total_masses[:, None], shape[:2])
    tension = textbook.required_tensions(robot, masses, *motion, minimum=minimum)
    torque = textbook.required_torques(robot, tension, *motion)
    speed = textbook.pulley_speed(robot, *motion[:2])
    action = torque / robot.stall_torque + speed / robot.motors.free_speed
    return np.all((np.abs(action) <= 1) & (tension >= minimum), axis=(1, 2))


def bisected(robot, trajectory, minimum):
    """Ends (lowest, largest) of the interval of feasible payloads at or nearest to zero, from a
    scan up to 60 kg."""
    scan = np.linspace(1e-9, 60, 401)
    good = feasible(robot, trajectory, minimum, scan)
    if not np.any(good):
        return math.inf, -math.inf

    def excess(total_mass):
        return 0.5 - feasible(robot, trajectory, minimum, np.array([total_mass]))[0]

    def edge(index, step, at_end):
        while 0 <= index + step < len(scan) and good[index + step]:
            index += step
        if not 0 <= index + step < len(scan):
            return at_end
        return bisect(excess, scan[index], scan[index + step]) - robot.mass

    nearest = int(np.argmin(np.where(good, np.abs(scan - robot.mass), np.inf)))
    return edge(nearest, -1, -robot.mass), edge(nearest, 1, math.inf)


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
def test_closed_form_matches_bisection(kind, seed):
    robot, trajectory, minimum = random_case(kind, np.random.default_rng(seed))
    result = exact_payload(robot, trajectory, minimum_tension=minimum, frequency=FREQUENCY)
    expected = bisected(robot, trajectory, minimum)
    assert (result.lowest, result.payload) == pytest.approx(expected, abs=1e-6)


# --- arguments ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "named"),
    [({"minimum_tension": math.nan}, "minimum_tension"), ({"frequency": 0.2}, "frequency")],
)
def test_bad_argument_is_rejected(arguments, named):
    with pytest.raises(ValueError, match=named):
        exact_payload(PLANAR, find_trajectory("paper-planar", 2), **arguments)
    with pytest.raises(ValueError, match="6 coordinates"):
        exact_payload(PLANAR, find_trajectory("paper-spatial", 6))


@pytest.mark.landing
def test_redundant_cables_have_the_best_tensions():
    """A linear program finds tensions within both limits just below the payload, and none just
    above it."""
    start = (0.2, 0.1, 4.0, 0.0, 0.0, 0.0)
    end = (1.5, -0.8, 3.0, 0.1, 0.0, 0.2)
    trajectory = PointToPoint(name="line", start=start, end=end, duration=2.0)
    result = exact_payload(CRANE, trajectory, minimum_tension=20.0, frequency=100.0)
    times, reference = control_instants(CRANE, trajectory, 100.0)
    motion = reference.position, reference.velocity, reference.acceleration
    limits = textbook.torque_limits(CRANE, textbook.pulley_speed(CRANE, *motion[:2]))
    idle = textbook.required_torques(CRANE, np.zeros((len(times), 8)), *motion)
    low, high = (np.array(limits) - idle) / CRANE.pulley_radius
    bounds = np.stack([np.maximum(low, 20.0), high], axis=-1)
    structure = textbook.jacobian(CRANE, reference.position)

    def held(payload):
        load = textbook.load(CRANE, CRANE.mass + payload, *motion)
        programs = zip(structure, load, bounds, strict=True)
        return [
            linprog(np.zeros(8), A_eq=-matrix.T, b_eq=wrench, bounds=limits).success
            for matrix, wrench, limits in programs
        ]

    assert all(held(result.payload - 0.01))
    assert times[held(result.payload + 0.01).index(False)] == pytest.approx(result.time, abs=0.05)
    assert (result.kind, result.line) == ("torque", "upper")
