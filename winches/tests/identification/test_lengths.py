"""Identification of cable lengths: drum radius, offset and axial stiffness."""

import numpy as np
import pytest
from identification.lifts import by_motor
from identification.platforms import noisy_log, smooth_motion
from oracles.plants import with_transmission
from scipy import stats

from cablebot_gym.physics import textbook
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_winches.identification import identify
from cablebot_winches.identification.log import Log
from cablebot_winches.identification.regression import CONFIDENCE

SEEDS = 30
OFFSET = -0.01
RADIUS = 0.053
STIFFNESS = 2400.0
ELASTIC = {"axial_stiffness": 2e3, "extra_length": 0.3}


def slow_log(robot, seed, payload, *, still=False):
    """Log of a slow motion, or of a dwell, with angles and tensions of an elastic robot. Redundant
    cables have another pretension with another payload."""
    rng = np.random.default_rng((seed, int(10 * payload)))
    time, pose, velocity, acceleration = smooth_motion(robot, rng, period=0.02, samples=2000)
    if still:
        pose = np.tile(robot.home, (len(time), 1))
        velocity = acceleration = np.zeros_like(pose)
    mass = robot.mass + payload
    pretension = 5 + 10 * payload
    tensions = textbook.required_tensions(
        robot, mass, pose, velocity, acceleration, minimum=pretension
    )
    angle = textbook.rest_angles(robot, tensions, pose)
    angle = angle + OFFSET / robot.pulley_radius
    signals = {"angle": (angle, 1e-4), "tension": (tensions, 0.1)}
    return noisy_log(robot, time, pose, signals, rng, payload=payload)


def without(log, quantity):
    columns = {}
    for name, values in log.columns.items():
        if not name.startswith(quantity):
            columns[name] = values
    return Log(name=log.name, columns=columns)


@pytest.mark.landing
@pytest.mark.parametrize(
    ("nominal", "has_cells"), [(PLANAR, True), (SPATIAL, False)], ids=["load cells", "dynamics"]
)
def test_intervals_of_elastic_cables_cover_the_truth_as_often_as_they_say(nominal, has_cells):
    """Also those of the radius, which a stretch that grows with the length would bias."""
    robot = with_transmission(nominal, **ELASTIC)
    true = with_transmission(robot, axial_stiffness=STIFFNESS, pulley_radius=RADIUS)
    truth = {"axial_stiffness": STIFFNESS, "pulley_radius": RADIUS, "length_offset": OFFSET}
    covered = {name: np.zeros(robot.cables) for name in truth}
    for seed in range(SEEDS):
        logs = [slow_log(true, seed, payload) for payload in (0.0, 2.0)]
        if not has_cells:
            logs = [without(log, "tension") for log in logs]
        for name, items in by_motor(identify(robot, logs)).items():
            for item in items:
                assert item.is_determined
                assert item.half_width < 0.1 * abs(truth[name])
                error = abs(item.value - truth[name])
                covered[name][item.motors[0]] += error <= item.half_width
    least = stats.binom.ppf(0.002, SEEDS, CONFIDENCE)
    for name, counts in covered.items():
        assert counts.min() >= least, (name, counts)


def test_dwells_with_two_payloads_determine_the_stiffness_by_the_known_radius():
    robot = with_transmission(SPATIAL, **ELASTIC)
    true = with_transmission(robot, axial_stiffness=STIFFNESS)
    logs = [slow_log(true, 0, payload, still=True) for payload in (0.0, 2.0)]
    estimates = by_motor(identify(robot, logs))
    for item in estimates["axial_stiffness"]:
        assert item.value == pytest.approx(STIFFNESS, abs=1.5 * item.half_width)
        assert item.half_width < 0.05 * STIFFNESS
    for item in estimates["pulley_radius"]:
        assert item.reason == "the logs have one length; add a longer motion"


def test_uncertainty_has_the_axial_stiffness():
    robot = with_transmission(SPATIAL, **ELASTIC)
    true = with_transmission(robot, axial_stiffness=STIFFNESS)
    result = identify(robot, [slow_log(true, 0, payload) for payload in (0.0, 2.0)])
    assert result.robot.axial_stiffness == pytest.approx(STIFFNESS, rel=0.02)
    assert 0 < result.uncertainty.parameters["axial_stiffness"].high < 0.05
    result.uncertainty.check(result.robot)


def constant_tension(log):
    """Load cells that show nearly the same tension all the time."""
    columns = dict(log.columns)
    for motor in (1, 2, 3):
        columns[f"tension_{motor}"] = 20 + 0.1 * np.sin(columns["time"])
    return Log(name=log.name, columns=columns)


def unchanged(log):
    return log


def without_tensions(log):
    return without(log, "tension")


@pytest.mark.parametrize(
    ("changes", "edit", "reason"),
    [
        (
            ELASTIC,
            constant_tension,
            "one tension at each length; add a log with another payload or pretension",
        ),
        (ELASTIC, without_tensions, "redundant cables are unknown; add the columns tension_1"),
        ({}, unchanged, "do not stretch; write axial_stiffness = 2e+03 under [transmission]"),
    ],
    ids=["constant tension", "unknown tensions", "rigid robot"],
)
def test_undetermined_axial_stiffness_is_refused_with_its_remedy(changes, edit, reason):
    true = with_transmission(PLANAR, axial_stiffness=2e3)
    logs = [edit(slow_log(true, 0, payload)) for payload in (0.0, 2.0)]
    robot = with_transmission(PLANAR, **changes)
    result = identify(robot, logs)
    items = by_motor(result)["axial_stiffness"]
    assert len(items) == robot.cables
    for item in items:
        assert reason in item.reason
    assert result.robot.transmission.axial_stiffness == robot.transmission.axial_stiffness


def test_radius_and_offset_of_a_rigid_drive_follow_from_poses_and_angles():
    nominal = with_transmission(SPATIAL, pulley_radius=0.05)
    true = with_transmission(nominal, pulley_radius=RADIUS)
    time, pose, *_ = smooth_motion(true, np.random.default_rng(0), period=0.02, samples=2000)
    angle = textbook.pulley_angle(true, pose) + OFFSET / RADIUS
    log = noisy_log(true, time, pose, {"angle": (angle, 1e-4)}, np.random.default_rng(0))
    result = identify(nominal, [log])
    estimates = by_motor(result)
    assert estimates.keys() == {"pulley_radius", "length_offset"}
    for name, truth in {"pulley_radius": RADIUS, "length_offset": OFFSET}.items():
        for item in estimates[name]:
            assert item.value == pytest.approx(truth, abs=1.5 * item.half_width), name
            assert item.half_width < 0.01 * abs(truth)
    assert result.robot.pulley_radius == pytest.approx(RADIUS, rel=1e-3)


def test_log_of_motions_alone_names_both_remedies():
    log = Log(name="a.csv", columns={"time": np.arange(99.0), "angle_1": np.arange(99.0)})
    with pytest.raises(
        ValueError, match=r"no .* torque_1 .* nor angle_1 \[rad\] with the pose x, y"
    ):
        identify(PLANAR, [log])
