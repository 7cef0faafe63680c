"""Uncertainty as data: the distributions, the drawn robots, impossible uncertainties, and the forms of the data."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.plants import each_of
from scipy import stats

from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.task import to_jsonable
from cablebot_gym.uncertainty import (
    LONGEST_DELAY,
    PARAMETERS,
    ExternalWrench,
    ParameterDistribution,
    SensorNoise,
    Uncertainty,
    draw_size,
    find_uncertainty,
)

rigid_and_flexible = each_of(PLANAR, FLEX_SPATIAL)


def has(robot, name):
    """Whether a robot has a parameter."""
    return PARAMETERS[name].belongs_to(robot)


each_parameter = pytest.mark.parametrize("name", PARAMETERS)
"""The flexible spatial robot with elastic cables has them all."""

ELASTIC = FLEX_SPATIAL.replace(transmission=FLEX_SPATIAL.transmission.replace(axial_stiffness=5e4))


def tenth_of(name, width=0.1):
    """A distribution that is possible for every robot."""
    if PARAMETERS[name].position:
        return ParameterDistribution(low=-0.01, high=0.01, relative=False)
    return ParameterDistribution(low=-width, high=width, each=name != "platform_inertia")


def numbers(robot, count=200, seed=0):
    """Uniform numbers for ``count`` episodes."""
    return np.random.default_rng(seed).random((count, draw_size(robot)))


def drawn(robot, parameters, count=200, payload=0.0, seed=0):
    uncertainty = Uncertainty(parameters=parameters)
    uncertainty.check(robot)
    return uncertainty.draw(robot, np.full(count, payload), numbers(robot, count, seed))


# ------------------------------------------------------------------------------------------------- a distribution


@settings(max_examples=60, derandomize=True)
@given(
    low=st.floats(-3, 3),
    width=st.floats(0, 3),
    mean=st.floats(-1, 1),
    std=st.floats(0.6, 3),
    normal=st.booleans(),
    seed=st.integers(0, 2**32),
)
def test_deviations_stay_within_the_bounds_and_rise_with_the_numbers(low, width, mean, std, normal, seed):
    law = {"distribution": "normal", "mean": mean, "std": std} if normal else {}
    distribution = ParameterDistribution(low=low, high=low + width, **law)
    uniform = np.sort(np.append(np.random.default_rng(seed).random(200), [0.0, 1 - 2.0**-53]))
    deviation = distribution.deviation(uniform)
    assert np.all((deviation >= distribution.low) & (deviation <= distribution.high))
    assert np.all(np.diff(deviation) >= -1e-12)


def test_uniform_distribution_is_uniform():
    deviation = ParameterDistribution(low=-0.1, high=0.3).deviation(np.random.default_rng(1).random(20_000))
    assert stats.kstest(deviation, stats.uniform(-0.1, 0.4).cdf).pvalue > 0.01


@pytest.mark.parametrize(
    ("low", "high", "mean", "std"), [(-0.3, 0.2, 0.05, 0.1), (0.1, 0.15, 0.0, 0.05), (0.37, 0.4, 0.0, 0.05)]
)
def test_normal_distribution_is_truncated_and_neither_clipped_nor_scaled(low, high, mean, std):
    """Clipping would pile draws up on the bounds; a std after the truncation would be another law."""
    distribution = ParameterDistribution(low=low, high=high, distribution="normal", mean=mean, std=std)
    deviation = distribution.deviation(np.random.default_rng(2).random(20_000))
    law = stats.truncnorm((low - mean) / std, (high - mean) / std, loc=mean, scale=std)
    assert stats.kstest(deviation, law.cdf).pvalue > 0.01
    assert len(set(deviation)) > 19_900


def test_wide_normal_bounds_give_finite_draws():
    distribution = ParameterDistribution(low=-100.0, high=100.0, distribution="normal", mean=0.0, std=0.1)
    deviation = distribution.deviation(np.array([0.0, 1e-300, 0.5, 1 - 2.0**-53]))
    assert np.all(np.isfinite(deviation))
    assert deviation[2] == 0.0


def test_deviation_is_a_fraction_or_an_amount():
    nominal, deviation = np.array([2.0, 4.0]), np.array([0.1, -0.5])
    for relative, expected in ((True, [2.2, 2.0]), (False, [2.1, 3.5])):
        distribution = ParameterDistribution(low=-1, high=1, relative=relative)
        np.testing.assert_allclose(distribution.applied(nominal, deviation), expected, rtol=1e-15)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"low": 0.2, "high": -0.2}, "low must not exceed high"),
        ({"low": math.nan, "high": 1}, "low must be a finite number, not nan"),
        ({"low": -1, "high": 1, "std": 0.1}, "a uniform one has none"),
        ({"low": -1, "high": 1, "distribution": "normal"}, "a normal distribution needs std"),
        ({"low": -1, "high": 1, "distribution": "cauchy"}, "unknown distribution 'cauchy'; choose one of uniform"),
        ({"low": 9, "high": 10, "distribution": "normal", "std": 1.0}, "eight std"),
    ],
)
def test_impossible_distribution_raises(fields, message):
    with pytest.raises(ValueError, match=message):
        ParameterDistribution(**fields)


# ------------------------------------------------------------------------------------------------- drawn robots


@each_parameter
def test_each_draws_one_number_for_each_and_otherwise_one_for_all(name):
    attribute = PARAMETERS[name].attribute
    nominal = np.zeros(()) if name == "payload" else np.asarray(getattr(ELASTIC, attribute))

    def deviations(each):
        distribution = ParameterDistribution(low=0.0, high=1e-3, relative=False, each=each)
        found = getattr(drawn(ELASTIC, {name: distribution}), attribute) - nominal
        return found.reshape(len(found), -1)

    if name != "platform_inertia":  # of the paper's flat platform, none can be drawn alone
        found = deviations(each=True)
        assert -1e-15 <= found.min() < found.max() <= 1e-3 + 1e-15
        assert len(np.unique(found.round(12))) > 0.99 * found.size
        for first, second in itertools.combinations(found.T, 2):
            assert abs(np.corrcoef(first, second)[0, 1]) < 0.35
    together = deviations(each=False)
    np.testing.assert_allclose(together, together[:, :1] + np.zeros_like(together), atol=1e-14)
    assert np.ptp(together[:, 0]) > 9e-4


@each_parameter
def test_parameter_changes_its_own_value_and_no_other(name):
    robot = ELASTIC
    usual = drawn(robot, {}, payload=2.0)
    distribution = ParameterDistribution(low=1e-3, high=2e-3, relative=False, each=False)
    changed = drawn(robot, {name: distribution}, payload=2.0)
    attributes = {item.attribute for item in PARAMETERS.values()}
    different = {item for item in attributes if not np.array_equal(getattr(usual, item), getattr(changed, item))}
    assert different == {PARAMETERS[name].attribute}
    speed = changed.stall_torque / changed.speed_slope  # the free speed stays
    np.testing.assert_allclose(speed, np.broadcast_to(robot.stall_torque / robot.speed_slope, speed.shape), rtol=1e-14)


@each_parameter
def test_another_uncertain_parameter_does_not_change_a_draw(name):
    attribute = PARAMETERS[name].attribute
    alone = getattr(drawn(ELASTIC, {name: tenth_of(name)}, payload=2.0), attribute)
    everything = {other: tenth_of(other) for other in PARAMETERS}
    for parameters in (everything, dict(reversed(everything.items()))):
        found = getattr(drawn(ELASTIC, parameters, payload=2.0), attribute)
        np.testing.assert_array_equal(found, alone)


@rigid_and_flexible
def test_two_parameters_do_not_read_the_same_number(robot):
    names = [name for name in PARAMETERS if has(robot, name)]
    one_to_two = {"low": 1, "high": 2, "relative": False}
    parameters = {name: ParameterDistribution(**one_to_two, each=name != "platform_inertia") for name in names}
    found = Uncertainty(parameters=parameters).draw(robot, np.zeros(400), numbers(robot, 400))
    values = {name: np.asarray(getattr(found, PARAMETERS[name].attribute)).reshape(400, -1) for name in names}
    if not robot.planar:  # one deviation for all three moments
        values["platform_inertia"] = values["platform_inertia"][:, :1]
    columns = np.concatenate(list(values.values()), axis=1)
    assert np.abs(np.corrcoef(columns.T) - np.eye(columns.shape[1])).max() < 0.3


def test_payload_is_drawn_around_the_nominal_one_and_never_below_zero():
    absolute = ParameterDistribution(low=-1.0, high=1.0, relative=False)
    found = drawn(SPATIAL, {"payload": absolute}, payload=0.5).payload
    assert found.min() == 0.0
    assert 0.2 < np.mean(found == 0) < 0.3  # the quarter of the draws that is below zero
    assert found.max() > 1.4
    relative = {"payload": ParameterDistribution(low=-1.0, high=1.0)}
    found = drawn(SPATIAL, relative, payload=0.5).payload
    assert 0 <= found.min() < 0.05
    assert 0.95 < found.max() <= 1.0
    assert not drawn(SPATIAL, relative, payload=0.0).payload.any()


def test_fastest_robot_bounds_every_drawn_one():
    before = ELASTIC.to_dict()
    parameters = {name: tenth_of(name, 0.3) for name in PARAMETERS if name != "payload"}
    fastest = Uncertainty(parameters=parameters).fastest(ELASTIC)
    found = drawn(ELASTIC, parameters)
    for attribute in ("mass", "moments", "pulley_inertia", "motor_inertia"):
        assert np.all(getattr(found, attribute) >= getattr(fastest, attribute)), attribute
    for attribute in ("stiffness", "stall_torque", "motor_damping", "damping", "coulomb_friction", "speed_slope"):
        assert np.all(getattr(found, attribute) <= getattr(fastest, attribute)), attribute
    assert ELASTIC.to_dict() == before


# ------------------------------------------------------------------------------------------- impossible uncertainties


def tenth(low=-0.1, high=0.1, **more):
    return {"low": low, "high": high, **more}


FLAT_BALL = SPATIAL.replace(inertia=(0.5, 0.5, 0.5))
IMPOSSIBLE_PARAMETERS: list[tuple[Any, str, Any, str]] = [
    (SPATIAL, "platform_mass", tenth(-1.0), "smallest platform_mass of 'spatial' must be .* greater than 0 kg, not 0"),
    (FLEX_PLANAR, "stiffness", tenth(-3.0, 0, relative=False), "smallest stiffness"),
    (SPATIAL, "damping", tenth(-0.02, 0.02, relative=False), "smallest damping .* at least 0 .* not -0.01"),
    (PLANAR, "payload", tenth(-1.1), "low of payload must be a finite number at least -1"),
    (PLANAR, "base_anchors", tenth(), "base_anchors: a position has no relative deviation"),
    (SPATIAL, "platform_inertia", tenth(-0.2, 0.0, relative=False, each=False), "platform_inertia: one moment"),
    (FLAT_BALL, "platform_inertia", tenth(-0.4, 0.4), "platform_inertia: one moment can exceed"),
    (SPATIAL, "stiffness", tenth(), "'spatial' has no parameter stiffness"),
    (PLANAR, "platform_mass", 0.1, "distribution of platform_mass must be a dict with the keys low, high"),
]
IMPOSSIBLE: list[tuple[Any, Any, str]] = [
    *((robot, {"parameters": {name: value}}, message) for robot, name, value, message in IMPOSSIBLE_PARAMETERS),
    (PLANAR, {"delay": LONGEST_DELAY + 1}, f"delay must be an integer of at least 0 and at most {LONGEST_DELAY}"),
    (PLANAR, {"delay": [2, 1]}, "high of delay must be an integer of at least 2"),
    (PLANAR, {"delay": [0, 1, 2]}, "delay must be one number of control steps or .low, high."),
    (PLANAR, {"noise": 1.0}, "unknown key of uncertainty 'noise'; choose one of parameters, wrench, sensors, "),
    (PLANAR, "table6+noise", "unknown uncertainty 'noise'; choose one of none, table6, .*sensors, or join"),
    (PLANAR, "table6+table6", "'table6.table6' defines parameters twice"),
    (PLANAR, {"wrench": {"force_mean": [1, 2, 3]}}, "force_mean needs 2 components for 'planar'"),
    (PLANAR, {"wrench": {"force_std": -1.0}}, "force_std must be finite and at least 0"),
    (PLANAR, {"wrench": {"correlation_time": 0.0}}, "correlation_time must be a finite number greater than 0 s"),
    (PLANAR, {"wrench": {"factor": [1.1, 0.9]}}, "factor must be .low, high. with low ≤ high"),
    (PLANAR, {"sensors": {"position": -1e-3}}, "sensors.position must be a finite number at least 0"),
    (PLANAR, {"sensor_bias": {"position": -1e-3}}, "position must be a finite number at least 0"),
]


@pytest.mark.parametrize(("robot", "data", "message"), IMPOSSIBLE)
def test_impossible_uncertainty_raises(robot, data, message):
    with pytest.raises(ValueError, match=message):
        find_uncertainty(data, robot)


@pytest.mark.parametrize(
    ("robot", "name", "distribution"),
    [
        (SPATIAL, "payload", tenth(-1.0)),
        (SPATIAL, "platform_mass", tenth(-0.999)),
        (SPATIAL, "platform_inertia", tenth(-0.9, 3.0, each=False)),
        (FLAT_BALL, "platform_inertia", tenth(-0.3, 0.3)),
    ],
)
def test_just_possible_distribution_is_accepted(robot, name, distribution):
    found = find_uncertainty({"parameters": {name: distribution}, "delay": LONGEST_DELAY}, robot)
    assert found == Uncertainty(parameters={name: ParameterDistribution(**distribution)}, delay=np.int64(LONGEST_DELAY))


# ------------------------------------------------------------------------------------------------------ its forms


@rigid_and_flexible
def test_none_is_no_uncertainty(robot):
    for form in (None, "none", {}, Uncertainty(), {"parameters": {}, "wrench": None, "sensors": None, "delay": 0}):
        found = find_uncertainty(form, robot)
        assert (found, found.random) == (Uncertainty(), False)


@rigid_and_flexible
def test_table_6_is_that_of_the_paper(robot):
    found = find_uncertainty("table6", robot)
    both = ParameterDistribution(low=-0.1, high=0.1, relative=True, each=False)
    assert dict(found.parameters) == {"platform_mass": both} | ({"stiffness": both} if robot.flexible else {})
    mean, std = found.wrench.statistics(robot)
    forces = 2 if robot.planar else 3
    np.testing.assert_allclose(mean[:forces], 0.5)
    np.testing.assert_allclose(std[:forces] ** 2, 0.2, rtol=1e-14)  # the table gives the variance
    assert not np.any([mean[forces:], std[forces:]])  # no moments
    assert (found.wrench.correlation_time, found.wrench.factor) == (0.01, (0.9, 1.1))
    assert (found.sensors, found.delay, found.random) == (None, 0, True)


@each_of(PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL)
def test_table_6_with_load_varies_the_payload_too(robot):
    paper, found = find_uncertainty("table6", robot), find_uncertainty("table6-load", robot)
    load = {"payload": ParameterDistribution(low=-0.1, high=0.1, each=False)}
    assert found == dataclasses.replace(paper, parameters=dict(paper.parameters) | load)


@each_of(PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL)
def test_hardware_varies_every_part_of_the_robot(robot):
    """Lag and friction too, which are zero in the nominal robot: a relative deviation would change nothing."""
    found = find_uncertainty("hardware", robot)
    missing = {name for name in PARAMETERS if has(robot, name)} - set(found.parameters)
    assert missing == ({"damping"} if robot.flexible else set())  # the friction of its motors varies
    draws = found.draw(robot, np.full(50, 2.0), numbers(robot, 50))
    for name in found.parameters:
        assert np.all(np.ptp(getattr(draws, PARAMETERS[name].attribute), axis=0) > 0), name
    assert found.wrench.random
    assert None not in (found.sensors, found.sensor_bias)
    assert found.delay_range[0] < found.delay_range[1]


@each_of(PLANAR, SPATIAL, FLEX_PLANAR, FLEX_SPATIAL)
def test_manual_names_a_source_or_an_assumption_for_every_part_of_hardware(robot):
    text = (Path(__file__).parents[1] / "docs" / "uncertainty.md").read_text(encoding="utf-8")
    rows = text.partition("### Sources of `hardware`")[2].partition("\n## ")[0]
    named = re.findall(r"`(\w+)`", " ".join(re.findall(r"^\|([^|]*)\|", rows, re.MULTILINE)))
    found = find_uncertainty("hardware", robot)
    assert {*found.parameters, "wrench", "sensors", "sensor_bias", "delay"} <= {*named}


@rigid_and_flexible
def test_joined_names_are_both_in_any_order(robot):
    both = find_uncertainty("table6+sensors", robot)
    assert both == find_uncertainty("sensors+table6+none", robot)
    table6, sensors = (find_uncertainty(name, robot) for name in ("table6", "sensors"))
    assert both == Uncertainty(parameters=table6.parameters, wrench=table6.wrench, sensors=sensors.sensors)


NORMAL = ParameterDistribution(low=0.0, high=0.1, distribution="normal", mean=0.02, std=0.03, relative=False)
WRENCH = ExternalWrench(force_mean=(0, 1, 2), force_std=0.3, moment_std=0.1, correlation_time=0.05, factor=(0.5, 2.0))
EVERYTHING = {
    "parameters": {name: tenth_of(name) for name in PARAMETERS} | {"damping": NORMAL},
    "wrench": WRENCH,
    "sensors": SensorNoise(position=1e-3),
    "sensor_bias": SensorNoise(rotation=1e-3),
    "delay": (1, 3),
}
"""Every field differs from its default."""


def test_uncertainty_survives_json_and_pickle():
    found = Uncertainty(**EVERYTHING)
    uniform = numbers(ELASTIC, 3)
    data = json.loads(json.dumps(to_jsonable(found)))
    for again in (find_uncertainty(data, ELASTIC), pickle.loads(pickle.dumps(found))):
        assert (again, hash(again)) == (found, hash(found))
        ours, theirs = (one.draw(ELASTIC, np.ones(3), uniform) for one in (found, again))
        for parameter in PARAMETERS.values():
            np.testing.assert_array_equal(getattr(ours, parameter.attribute), getattr(theirs, parameter.attribute))


def test_caller_cannot_change_an_uncertainty_through_its_dict():
    mine = {"platform_mass": ParameterDistribution(low=-0.1, high=0.1)}
    made = Uncertainty(parameters=mine)
    mine["payload"] = ParameterDistribution(low=0, high=1)
    assert list(made.parameters) == ["platform_mass"]


@pytest.mark.parametrize(
    "change",
    [
        {"parameters": {"platform_mass": ParameterDistribution(low=-0.1, high=0.2)}},
        {"wrench": ExternalWrench(force_std=1.0)},
        {"sensors": SensorNoise(position=2e-3)},
        {"sensor_bias": SensorNoise(position=2e-3)},
        {"delay": 3},
    ],
)
def test_uncertainties_that_differ_in_one_field_are_not_equal(change):
    """The vector environment draws at once for all environments with equal uncertainties."""
    assert Uncertainty(**EVERYTHING) == Uncertainty(**EVERYTHING)
    assert Uncertainty(**EVERYTHING | change) != Uncertainty(**EVERYTHING)
