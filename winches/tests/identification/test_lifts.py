"""Identification of single winches from lifts of known masses."""

from dataclasses import replace

import numpy as np
import pytest
from identification.lifts import ROBOT, TRUTH, lift
from oracles.plants import with_transmission
from scipy import stats

from cablebot_winches.identification import identify
from cablebot_winches.identification.log import Log
from cablebot_winches.identification.regression import CONFIDENCE, TOO_WIDE, WIDEST

SEEDS = 40


def by_name(logs, robot=ROBOT):
    return {item.name: item for item in identify(robot, logs).estimates}


@pytest.mark.landing
@pytest.mark.parametrize("quantity", ["torque", "current"])
def test_intervals_cover_the_truth_as_often_as_they_say(quantity):
    """The errors of neighbouring samples are alike: intervals of independent errors would be
    several times too narrow."""
    covered = dict.fromkeys(TRUTH, 0)
    if quantity == "torque":
        del covered["torque_constant"]
    for seed in range(SEEDS):
        logs = [lift(seed, load, (3, 8, 16, 25), quantity=quantity) for load in (1.0, 5.0)]
        estimates = by_name(logs)
        assert estimates.keys() == covered.keys()
        for name, item in estimates.items():
            assert item.is_determined
            assert item.half_width < 0.45 * item.value
            covered[name] += abs(item.value - TRUTH[name]) <= item.half_width
    least = stats.binom.ppf(0.002, SEEDS, CONFIDENCE)
    assert min(covered.values()) >= least, covered


@pytest.mark.parametrize("quantity", ["torque", "current"])
@pytest.mark.parametrize(
    ("lifts", "name", "reason"),
    [
        ([(5.0, (3, 12, 25), False)], "load_friction", "have one load; add a log with another"),
        (
            [(1.0, (12,), True), (5.0, (12,), True)],
            "damping",
            "have one speed; add a log with another",
        ),
        (
            [(load, (speed,), True) for load in (1.0, 5.0) for speed in (3, 12, 25)],
            "pulley_inertia",
            f"{TOO_WIDE}; add longer logs, or a log with accelerations",
        ),
    ],
    ids=["one load", "one speed", "constant speeds"],
)
def test_undetermined_parameter_is_refused_with_its_remedy(quantity, lifts, name, reason):
    """The robot keeps its value and its range, and the message names the remedy."""
    logs = []
    for seed, (load, speeds, are_constant) in enumerate(lifts):
        logs.append(lift(seed, load, speeds, quantity=quantity, are_constant=are_constant))
    result = identify(ROBOT, logs)
    estimates = {item.name: item for item in result.estimates}
    assert not estimates[name].is_determined
    assert reason in estimates[name].reason
    assert getattr(result.robot.transmission, name) == getattr(ROBOT.transmission, name)
    assert name not in result.uncertainty.parameters
    has_range = "transmission.pulley_inertia" in result.robot.ranges
    assert has_range == (not estimates["pulley_inertia"].is_determined)
    if quantity == "current":
        assert estimates["torque_constant"].is_determined


@pytest.mark.parametrize(
    ("quantity", "lifts", "name", "given"),
    [
        ("torque", [(5.0, (3, 12, 25), False, None)], "coulomb_friction", "load_friction = 0.051"),
        ("torque", [(5.0, (3, 12, 25), False, None)], "damping", ""),
        (
            "current",
            [(5.0, (12,), True, 300)],
            "torque_constant",
            "load_friction = 0.051, damping = 0.00071, coulomb_friction = 0.027",
        ),
        ("torque", [(load, (3, 12, 25), False, None) for load in (1, 5)], "coulomb_friction", ""),
    ],
    ids=["one load", "of no effect", "one direction", "two loads"],
)
def test_values_that_an_estimate_rests_on_are_given(quantity, lifts, name, given):
    """With one load, load friction looks like Coulomb friction; in one direction, friction looks
    like another torque constant. The sources say so, too."""
    logs = []
    for load, speeds, are_constant, count in lifts:
        log = lift(0, load, speeds, quantity=quantity, are_constant=are_constant)
        logs.append(replace(log, columns={key: log.columns[key][:count] for key in log.columns}))
    result = identify(ROBOT, logs)
    item = next(item for item in result.estimates if item.name == name)
    assert item.is_determined
    assert item.given == given
    source = result.robot.sources.get(f"transmission.{name}", given)
    assert source.endswith(given) or f"given {given}; motors 2, 3, 4" in source


def test_sources_are_those_of_each_motor():
    """A log of winch 1 does not make a robot with friction in one winch look identified."""
    robot = with_transmission(ROBOT, damping=0.0)
    result = identify(robot, [lift(0, load) for load in (1.0, 5.0)])
    source = result.robot.sources["transmission.damping"]
    assert source.startswith("motor 1: identified by")
    assert "; motors 2, 3, 4: fitted to the currents" in source
    assert result.unknown_motors == (1, 2, 3)
    assert repr(result) == str(result)
    assert str(result).endswith("determined from 1kg.csv, 5kg.csv. No log of motors 2, 3, 4.")


def test_same_winches_have_the_parameters_of_the_one_with_a_log():
    logs = [lift(0, load) for load in (1.0, 5.0)]
    result = identify(ROBOT, logs, same_winches=True)
    assert not result.unknown_motors
    for item in result.estimates:
        assert item.motors == (0, 1, 2, 3)
    assert result.robot.damping == pytest.approx([TRUTH["damping"]] * 4, rel=0.4)
    assert "motor" not in result.robot.sources["transmission.damping"]
    assert not result.uncertainty.parameters["damping"].each


def test_motors_share_a_parameter_that_needs_all_of_them():
    """Motor 2 has one load only."""
    logs = [lift(0, 1.0), lift(1, 5.0), lift(2, 5.0, motors=(2,))]
    motors = {}
    for item in identify(ROBOT, logs).estimates:
        motors.setdefault(item.name, []).append(item.motors)
    assert motors["load_friction"] == [(0, 1)]
    assert motors["coulomb_friction"] == motors["pulley_inertia"] == [(0,), (1,)]


def test_uncertainty_allows_zero_load_friction_of_some_motors():
    """Only motor 1 has a log; the other motors keep the zero of their robot."""
    robot = with_transmission(ROBOT, load_friction=0.0)
    result = identify(robot, [lift(0, load) for load in (1.0, 5.0)])
    assert result.robot.load_friction[0] > 0 == result.robot.load_friction[1]
    result.uncertainty.check(result.robot)


def test_robot_and_uncertainty_have_value_and_interval():
    logs = [lift(0, load, motors=(1, 2, 3, 4)) for load in (1.0, 5.0)]
    result = identify(ROBOT, logs)
    for name in TRUTH.keys() - {"torque_constant"}:
        items = [item for item in result.estimates if item.name == name]
        values = [item.value for item in items]
        assert getattr(result.robot, name) == pytest.approx(values, rel=1e-5)
        distribution = result.uncertainty.parameters[name]
        width = max(item.half_width / item.value for item in items)
        assert (-distribution.low, distribution.high) == pytest.approx((width, width), rel=1e-5)
        assert distribution.each
        assert distribution.relative
        assert 0 < width < WIDEST
        assert "1kg.csv, 5kg.csv" in result.robot.sources[f"transmission.{name}"]
    result.uncertainty.check(result.robot)


def test_torque_with_the_wrong_sign_raises():
    log = lift(0, 5.0)
    wrong = dict(log.columns) | {"torque_1": -log.columns["torque_1"]}
    with pytest.raises(ValueError, match="multiply torque_1 by −1"):
        identify(ROBOT, [Log(name="a.csv", columns=wrong)])


def test_gaps_empty_cells_and_missing_speeds_are_allowed():
    """The second half of the log is a minute later, every tenth torque is missing, and the angle
    replaces the speed."""
    logs = []
    for load in (1.0, 5.0):
        columns = dict(lift(0, load).columns)
        time, speed = columns["time"].copy(), columns.pop("speed_1")
        columns["angle_1"] = np.cumsum(speed) * (time[1] - time[0])
        time[len(time) // 2 :] += 60.0
        torque = columns["torque_1"].copy()
        torque[::10] = np.nan
        logs.append(Log(name="a.csv", columns=columns | {"time": time, "torque_1": torque}))
        assert len([*logs[-1].segments(["torque_1"])]) == 2
    for name, item in by_name(logs).items():
        assert item.value == pytest.approx(TRUTH[name], abs=1.5 * item.half_width)
        assert item.is_determined
