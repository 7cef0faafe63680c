"""Uncertainty as data: what a spread draws, which sets are impossible for a robot, and how a set is written down."""

from __future__ import annotations

import itertools
import json
import math
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from cablebot_gym.robots import FLEX_PLANAR, FLEX_SPATIAL, PLANAR, ROBOTS, SPATIAL, Transmission
from cablebot_gym.task import to_jsonable
from cablebot_gym.uncertainty import (
    LONGEST_DELAY,
    PARAMETERS,
    UNCERTAINTIES,
    ExternalWrench,
    ParameterDistribution,
    SensorNoise,
    Uncertainty,
    draw_size,
    find_uncertainty,
)

each_robot = pytest.mark.parametrize("robot", ROBOTS.values(), ids=list(ROBOTS))


def refused(*words, call, **arguments):
    """One line of a ValueError that says all the words."""
    with pytest.raises(ValueError, match=r"\w") as caught:
        call(**arguments)
    message = str(caught.value)
    for word in words:
        assert word in message
    assert "\n" not in message
    assert len(message) < 400


def has(robot, name):
    """Whether a robot has a parameter."""
    return not ((PARAMETERS[name].flexible and not robot.flexible) or (PARAMETERS[name].spatial and robot.planar))


each_parameter = pytest.mark.parametrize(
    ("robot", "name"),
    [
        pytest.param(robot, name, id=f"{robot.name}-{name}")
        for robot in ROBOTS.values()
        for name in PARAMETERS
        if has(robot, name)
    ],
)


def spread_of(name, width=0.1):
    """A spread that any robot can bear."""
    if PARAMETERS[name].position:
        return ParameterDistribution(low=-0.01, high=0.01, relative=False)
    if name == "platform_inertia":
        return ParameterDistribution(low=-width, high=width, each=False)
    return ParameterDistribution(low=-width, high=width)


def numbers(robot, count=200, seed=0):
    """Uniform numbers for ``count`` episodes."""
    return np.random.default_rng(seed).random((count, draw_size(robot)))


def drawn(robot, parameters, count=200, payload=0.0, seed=0):
    uncertainty = Uncertainty(parameters=parameters)
    uncertainty.check(robot)
    return uncertainty.draw(robot, np.full(count, payload), numbers(robot, count, seed))


# ------------------------------------------------------------------------------------------------------- a spread


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    low=st.floats(-3, 3),
    width=st.floats(0, 3),
    mean=st.floats(-1, 1),
    std=st.floats(0.6, 3),
    normal=st.booleans(),
    seed=st.integers(0, 2**32),
)
def test_no_deviation_is_outside_the_bounds(low, width, mean, std, normal, seed):
    law = {"distribution": "normal", "mean": mean, "std": std} if normal else {}
    spread = ParameterDistribution(low=low, high=low + width, **law)
    uniform = np.append(np.random.default_rng(seed).random(200), [0.0, 1 - 2.0**-53])
    deviation = spread.deviation(uniform)
    assert np.all((deviation >= spread.low) & (deviation <= spread.high))
    order = np.argsort(uniform)
    assert np.all(np.diff(deviation[order]) >= -1e-12)  # an inverse: more in, more out


def test_a_uniform_spread_is_uniform_and_not_normal():
    deviation = ParameterDistribution(low=-0.1, high=0.3).deviation(np.random.default_rng(1).random(20_000))
    assert stats.kstest(deviation, stats.uniform(-0.1, 0.4).cdf).pvalue > 0.01


@pytest.mark.parametrize(
    ("low", "high", "mean", "std"), [(-0.3, 0.2, 0.05, 0.1), (-1.0, 1.0, 0.0, 0.1), (0.1, 0.15, 0.0, 0.05)]
)
def test_a_normal_spread_is_cut_off_and_neither_clipped_nor_scaled(low, high, mean, std):
    """Clipping would pile draws up on the bounds; a std after the cut would be another law."""
    spread = ParameterDistribution(low=low, high=high, distribution="normal", mean=mean, std=std)
    deviation = spread.deviation(np.random.default_rng(2).random(20_000))
    law = stats.truncnorm((low - mean) / std, (high - mean) / std, loc=mean, scale=std)
    assert stats.kstest(deviation, law.cdf).pvalue > 0.01
    assert len(set(deviation)) > 19_900


def test_normal_bounds_far_out_on_one_side_still_give_finite_draws():
    spread = ParameterDistribution(low=-100.0, high=100.0, distribution="normal", mean=0.0, std=0.1)
    deviation = spread.deviation(np.array([0.0, 1e-300, 0.5, 1 - 2.0**-53]))
    assert np.all(np.isfinite(deviation))
    assert deviation[2] == 0.0


def test_relative_is_a_share_and_absolute_an_amount():
    nominal, deviation = np.array([2.0, 4.0]), np.array([0.1, -0.5])
    np.testing.assert_allclose(
        ParameterDistribution(low=-1, high=1).applied(nominal, deviation), [2.2, 2.0], rtol=1e-15
    )
    absolute = ParameterDistribution(low=-1, high=1, relative=False).applied(nominal, deviation)
    np.testing.assert_allclose(absolute, [2.1, 3.5], rtol=1e-15)


IMPOSSIBLE_SPREADS: dict[str, tuple[dict[str, Any], tuple[str, ...]]] = {
    "bounds upside down": ({"low": 0.2, "high": -0.2}, ("low must not exceed high", "0.2", "exchange")),
    "NaN": ({"low": math.nan, "high": 1}, ("low", "finite", "nan")),
    "infinite": ({"low": 0, "high": math.inf}, ("high", "finite")),
    "bool for a bound": ({"low": True, "high": 1}, ("low", "True")),
    "bound in words": ({"low": "little", "high": 1}, ("low", "little")),
    "std without normal": ({"low": -1, "high": 1, "std": 0.1}, ("std", "normal")),
    "normal without std": ({"low": -1, "high": 1, "distribution": "normal"}, ("std", "normal")),
    "std of zero": ({"low": -1, "high": 1, "distribution": "normal", "std": 0.0}, ("std", "greater than 0")),
    "negative std": ({"low": -1, "high": 1, "distribution": "normal", "std": -1.0}, ("std", "greater than 0", "-1")),
    "NaN std": ({"low": -1, "high": 1, "distribution": "normal", "std": math.nan}, ("std", "finite")),
    "unknown law": ({"low": -1, "high": 1, "distribution": "cauchy"}, ("cauchy", "uniform", "normal")),
    "bounds far above the mean": ({"low": 9, "high": 10, "distribution": "normal", "std": 1.0}, ("eight std",)),
    "bounds far below the mean": ({"low": -10, "high": -9, "distribution": "normal", "std": 1.0}, ("eight std",)),
    "each in words": ({"low": 0, "high": 1, "each": "no"}, ("each", "True or False", "no")),
    "relative as a number": ({"low": 0, "high": 1, "relative": 0.5}, ("relative", "True or False")),
}


@pytest.mark.parametrize("name", list(IMPOSSIBLE_SPREADS))
def test_an_impossible_spread_is_refused_in_words(name):
    arguments, words = IMPOSSIBLE_SPREADS[name]
    refused(*words, call=ParameterDistribution, **arguments)


# ------------------------------------------------------------------------------------------------- drawn robots


@each_parameter
def test_each_draws_one_number_for_each_and_otherwise_one_for_all(robot, name):
    attribute = PARAMETERS[name].attribute
    absolute = ParameterDistribution(low=0.0, high=1e-3, relative=False)
    one = ParameterDistribution(low=0.0, high=1e-3, relative=False, each=False)
    nominal = np.zeros(()) if name == "payload" else np.asarray(getattr(robot, attribute))
    if name != "platform_inertia":  # of the paper's flat platform, none can be drawn alone
        found = getattr(drawn(robot, {name: absolute}), attribute) - nominal
        deviations = found.reshape(len(found), -1)
        assert deviations.min() >= -1e-15
        assert deviations.max() <= 1e-3 + 1e-15
        assert len(np.unique(deviations.round(12))) > 0.99 * deviations.size
        for first, second in itertools.combinations(deviations.T, 2):
            assert abs(np.corrcoef(first, second)[0, 1]) < 0.35
    found = getattr(drawn(robot, {name: one}), attribute) - nominal
    together = found.reshape(len(found), -1)
    np.testing.assert_allclose(together, together[:, :1] + np.zeros_like(together), atol=1e-14)
    assert np.ptp(together[:, 0]) > 9e-4


@each_parameter
def test_a_parameter_changes_its_own_value_and_no_other(robot, name):
    usual = drawn(robot, {}, payload=2.0)
    spread = ParameterDistribution(low=1e-3, high=2e-3, relative=False, each=False)
    changed = drawn(robot, {name: spread}, payload=2.0)
    fields = {item.attribute for key, item in PARAMETERS.items() if has(robot, key)}
    different = {field for field in fields if not np.array_equal(getattr(usual, field), getattr(changed, field))}
    assert different == {PARAMETERS[name].attribute}
    speed = changed.stall_torque / changed.speed_slope
    np.testing.assert_allclose(speed, np.broadcast_to(robot.stall_torque / robot.speed_slope, speed.shape), rtol=1e-14)


@each_parameter
def test_another_uncertain_parameter_does_not_change_a_draw(robot, name):
    attribute = PARAMETERS[name].attribute
    alone = getattr(drawn(robot, {name: spread_of(name)}, payload=2.0), attribute)
    everything = {other: spread_of(other) for other in PARAMETERS if has(robot, other)}
    for parameters in (everything, dict(reversed(everything.items()))):
        np.testing.assert_array_equal(getattr(drawn(robot, parameters, payload=2.0), attribute), alone)


@each_robot
def test_two_parameters_do_not_read_the_same_number(robot):
    names = [name for name in PARAMETERS if has(robot, name)]
    uncertainty = Uncertainty(
        parameters={
            name: ParameterDistribution(low=1, high=2, relative=False, each=name != "platform_inertia")
            for name in names
        }
    )
    found = uncertainty.draw(robot, np.zeros(400), numbers(robot, 400))
    columns = np.concatenate(
        [np.asarray(getattr(found, PARAMETERS[name].attribute)).reshape(400, -1) for name in names], axis=1
    )
    if not robot.planar:  # one deviation for all three moments
        place = sum(np.size(getattr(found, PARAMETERS[name].attribute)[0]) for name in ("platform_mass", "payload"))
        columns = np.delete(columns, [place + 1, place + 2], axis=1)
    correlation = np.corrcoef(columns.T) - np.eye(columns.shape[1])
    assert np.abs(correlation).max() < 0.3


def test_a_payload_is_drawn_around_the_told_one_and_never_below_zero():
    absolute = ParameterDistribution(low=-1.0, high=1.0, relative=False)
    found = drawn(SPATIAL, {"payload": absolute}, payload=0.5).payload
    assert found.min() == 0.0
    assert 0.2 < np.mean(found == 0) < 0.3  # the quarter of the draws that is below zero, put on zero
    assert found.max() > 1.4
    relative = drawn(SPATIAL, {"payload": ParameterDistribution(low=-1.0, high=1.0)}, payload=0.5).payload
    assert 0 <= relative.min() < 0.05
    assert 0.95 < relative.max() <= 1.0
    assert not drawn(SPATIAL, {"payload": ParameterDistribution(low=-1.0, high=1.0)}, payload=0.0).payload.any()


def test_drawing_does_not_change_the_nominal_robot():
    before = FLEX_SPATIAL.to_dict()
    drawn(FLEX_SPATIAL, {name: spread_of(name) for name in PARAMETERS})
    assert FLEX_SPATIAL.to_dict() == before


def test_the_fastest_robot_bounds_every_drawn_one():
    parameters = {name: spread_of(name, 0.3) for name in PARAMETERS if name != "payload"}
    fastest = Uncertainty(parameters=parameters).fastest(FLEX_SPATIAL)
    found = drawn(FLEX_SPATIAL, parameters)
    for attribute in ("mass", "inertia", "pulley_inertia", "motor_inertia"):
        assert np.all(getattr(found, attribute) >= getattr(fastest, attribute)), attribute
    for attribute in ("stiffness", "stall_torque", "motor_damping", "damping", "speed_slope"):
        assert np.all(getattr(found, attribute) <= getattr(fastest, attribute)), attribute


# ----------------------------------------------------------------------------------------------- impossible sets


def spread(low=-0.1, high=0.1, **more):
    return {"low": low, "high": high, **more}


IMPOSSIBLE_SETS: dict[str, tuple[Any, Any, tuple[str, ...]]] = {
    "no mass left": (
        SPATIAL,
        {"parameters": {"platform_mass": spread(-1.0)}},
        ("platform_mass", "greater than 0", "low"),
    ),
    "less than no mass": (
        SPATIAL,
        {"parameters": {"platform_mass": spread(-1.5)}},
        ("platform_mass", "greater than 0"),
    ),
    "absolute mass reaches zero": (
        PLANAR,
        {"parameters": {"platform_mass": spread(-1.0, 1.0, relative=False)}},
        ("platform_mass", "can reach 0", "raise low"),
    ),
    "no strength left": (
        PLANAR,
        {"parameters": {"motor_strength": spread(-1.0)}},
        ("motor_strength", "greater than 0"),
    ),
    "no stiffness left": (FLEX_PLANAR, {"parameters": {"stiffness": spread(-3.0, 0, relative=False)}}, ("stiffness",)),
    "no motor inertia left": (FLEX_PLANAR, {"parameters": {"motor_inertia": spread(-1.0, 0)}}, ("motor_inertia",)),
    "negative damping": (
        SPATIAL,
        {"parameters": {"damping": spread(-0.02, 0.02, relative=False)}},
        ("damping", "at least 0", "-0.01"),
    ),
    "negative pulley inertia": (PLANAR, {"parameters": {"pulley_inertia": spread(-1.1)}}, ("pulley_inertia",)),
    "less than no payload": (PLANAR, {"parameters": {"payload": spread(-1.1)}}, ("payload", "at least -1")),
    "relative position": (PLANAR, {"parameters": {"base_anchors": spread()}}, ("base_anchors", "relative=False")),
    "moments that no body has": (
        SPATIAL,
        {"parameters": {"platform_inertia": spread()}},
        ("platform_inertia", "each=False"),
    ),
    "shifted moments that no body has": (
        SPATIAL,
        {"parameters": {"platform_inertia": spread(-0.2, 0.0, relative=False, each=False)}},
        ("platform_inertia", "relative"),
    ),
    "unknown parameter": (PLANAR, {"parameters": {"colour": spread()}}, ("colour", *PARAMETERS)),
    "stiffness of a rigid robot": (SPATIAL, {"parameters": {"stiffness": spread()}}, ("spatial", "stiffness")),
    "motor inertia of a rigid robot": (PLANAR, {"parameters": {"motor_inertia": spread()}}, ("motor_inertia",)),
    "motor damping of a rigid robot": (PLANAR, {"parameters": {"motor_damping": spread()}}, ("motor_damping",)),
    "inertia of a point": (FLEX_PLANAR, {"parameters": {"platform_inertia": spread()}}, ("platform_inertia",)),
    "anchors of a point": (
        PLANAR,
        {"parameters": {"platform_anchors": spread(relative=False)}},
        ("platform_anchors", "leave it out"),
    ),
    "spread as a number": (PLANAR, {"parameters": {"platform_mass": 0.1}}, ("platform_mass", "low", "high", "0.1")),
    "spread without an end": (PLANAR, {"parameters": {"platform_mass": {"low": 0.1}}}, ("platform_mass", "high")),
    "spread field unknown": (PLANAR, {"parameters": {"platform_mass": spread(width=3)}}, ("width", "distribution")),
    "bad spread inside a set": (PLANAR, {"parameters": {"platform_mass": spread(1, 0)}}, ("low must not exceed high",)),
    "parameters as a list": (PLANAR, {"parameters": ["platform_mass"]}, ("parameters", "dict", "platform_mass")),
    "negative delay": (PLANAR, {"delay": -1}, ("delay", "whole", "-1")),
    "half a step of delay": (PLANAR, {"delay": 1.5}, ("delay", "whole", "1.5")),
    "a float of delay": (PLANAR, {"delay": 2.0}, ("delay", "whole", "2.0")),
    "True delay": (PLANAR, {"delay": True}, ("delay", "whole", "True")),
    "endless delay": (PLANAR, {"delay": LONGEST_DELAY + 1}, ("delay", str(LONGEST_DELAY))),
    "unknown field": (PLANAR, {"noise": 1.0}, ("noise", "parameters", "wrench", "sensors", "delay")),
    "unknown name": (PLANAR, "table7", ("table7", "table6", "sensors")),
    "unknown joined name": (PLANAR, "table6+noise", ("noise", "table6", "sensors")),
    "a name twice": (PLANAR, "table6+table6", ("table6+table6", "twice", "leave one name out")),
    "no name": (PLANAR, "", ("table6", "sensors")),
    "a number": (PLANAR, 6, ("6", "table6", "parameters")),
    "wrench of three on a plane": (PLANAR, {"wrench": {"force_mean": [1, 2, 3]}}, ("force_mean", "2", "planar")),
    "wrench of two in space": (SPATIAL, {"wrench": {"moment_std": [1, 2]}}, ("moment_std", "3", "spatial")),
    "wrench of four": (SPATIAL, {"wrench": {"force_mean": [1, 2, 3, 4]}}, ("force_mean", "per axis")),
    "negative force std": (PLANAR, {"wrench": {"force_std": -1.0}}, ("force_std", "at least 0", "-1")),
    "NaN force": (PLANAR, {"wrench": {"force_mean": math.nan}}, ("force_mean", "finite")),
    "force in words": (PLANAR, {"wrench": {"force_mean": "strong"}}, ("force_mean", "strong")),
    "no correlation time": (PLANAR, {"wrench": {"correlation_time": 0.0}}, ("correlation_time", "greater than 0")),
    "NaN correlation time": (PLANAR, {"wrench": {"correlation_time": math.nan}}, ("correlation_time", "finite")),
    "factor upside down": (PLANAR, {"wrench": {"factor": [1.1, 0.9]}}, ("factor", "low ≤ high")),
    "factor as a number": (PLANAR, {"wrench": {"factor": 1.1}}, ("factor", "low")),
    "wrench field unknown": (PLANAR, {"wrench": {"force": 1.0}}, ("wrench", "force_mean", "correlation_time")),
    "negative noise": (PLANAR, {"sensors": {"position": -1e-3}}, ("sensors", "position", "at least 0")),
    "NaN noise": (PLANAR, {"sensors": {"velocity": math.nan}}, ("velocity", "finite")),
    "sensors field unknown": (PLANAR, {"sensors": {"tension": 1.0}}, ("sensors", "position", "motor_angle")),
}


@pytest.mark.parametrize("name", list(IMPOSSIBLE_SETS))
def test_an_impossible_uncertainty_is_refused_in_words(name):
    robot, data, words = IMPOSSIBLE_SETS[name]
    refused(*words, call=find_uncertainty, uncertainty=data, robot=robot)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"parameters": {"platform_mass": {"low": -0.1, "high": 0.1}}}, ("platform_mass", "ParameterDistribution")),
        ({"parameters": [1]}, ("parameters", "dict")),
        ({"wrench": {"force_std": 1.0}}, ("wrench", "ExternalWrench")),
        ({"sensors": {"position": 1.0}}, ("sensors", "SensorNoise")),
    ],
)
def test_raw_data_in_an_uncertainty_object_is_no_late_attribute_error(arguments, words):
    refused(*words, call=Uncertainty, **arguments)


def test_what_is_just_possible_is_not_refused():
    find_uncertainty({"parameters": {"payload": spread(-1.0), "damping": spread(-1.0)}}, SPATIAL)
    find_uncertainty({"parameters": {"payload": spread(-5.0, relative=False)}}, SPATIAL)
    find_uncertainty({"parameters": {"platform_mass": spread(-0.999)}}, SPATIAL)
    find_uncertainty({"parameters": {"platform_inertia": spread(-0.9, 3.0, each=False)}}, SPATIAL)
    find_uncertainty({"parameters": {"platform_inertia": spread(0.0, 0.5, each=False, relative=False)}}, SPATIAL)
    ball = SPATIAL.replace(inertia=(0.5, 0.5, 0.5))
    find_uncertainty({"parameters": {"platform_inertia": spread(-0.3, 0.3)}}, ball)
    refused(
        "platform_inertia",
        call=find_uncertainty,
        uncertainty={"parameters": {"platform_inertia": spread(-0.4, 0.4)}},
        robot=ball,
    )
    find_uncertainty({"delay": LONGEST_DELAY}, PLANAR)
    find_uncertainty({"delay": np.int64(3)}, PLANAR)


def test_the_least_of_several_motors_decides_what_is_possible():
    uneven = SPATIAL.replace(
        transmission=Transmission(pulley_radius=0.05, pulley_inertia=8e-4, damping=(0.01,) * 5 + (0.001,))
    )
    refused(
        "damping",
        call=find_uncertainty,
        uncertainty={"parameters": {"damping": spread(-0.005, 0.0, relative=False)}},
        robot=uneven,
    )


# ------------------------------------------------------------------------------------------------------ its forms


@each_robot
def test_none_and_the_name_none_are_no_uncertainty(robot):
    for form in (None, "none", {}, Uncertainty(), {"parameters": {}, "wrench": None, "sensors": None, "delay": 0}):
        found = find_uncertainty(form, robot)
        assert found == Uncertainty()
        assert not found.random
    assert find_uncertainty("none+table6", robot) == find_uncertainty("table6", robot)


@each_robot
def test_table_6_is_the_papers_table_and_nothing_else(robot):
    found = find_uncertainty("table6", robot)
    tenth = ParameterDistribution(low=-0.1, high=0.1, relative=True, each=False)
    assert dict(found.parameters) == {"platform_mass": tenth} | ({"stiffness": tenth} if robot.flexible else {})
    mean, std = found.wrench.statistics(robot)
    forces = 2 if robot.planar else 3
    np.testing.assert_allclose(mean[:forces], 0.5)
    np.testing.assert_allclose(std[:forces] ** 2, 0.2, rtol=1e-14)  # the table gives the variance
    assert not mean[forces:].any()  # no moments
    assert not std[forces:].any()
    assert (found.wrench.correlation_time, found.wrench.factor) == (0.01, (0.9, 1.1))
    assert (found.sensors, found.delay, found.random) == (None, 0, True)


@each_robot
def test_sensors_are_the_contracts_and_nothing_else(robot):
    found = find_uncertainty("sensors", robot)
    assert found == Uncertainty(sensors=found.sensors)
    places, turns = (2, 0) if robot.planar else (3, 3)
    m = robot.cables if robot.flexible else 0
    expected = [1e-4] * places + [2e-4] * turns + [2e-3] * places + [4e-3] * turns + [1e-3] * m + [1e-2] * m
    assert found.sensors.deviations(robot).tolist() == expected


@each_robot
def test_joined_names_are_both_and_their_order_is_no_matter(robot):
    both = find_uncertainty("table6+sensors", robot)
    assert both == find_uncertainty("sensors+table6", robot)
    table6, sensors = (find_uncertainty(name, robot) for name in ("table6", "sensors"))
    assert both == Uncertainty(parameters=table6.parameters, wrench=table6.wrench, sensors=sensors.sensors)


def everything(robot):
    """An uncertainty with every field away from its default."""
    parameters = {name: spread_of(name) for name in PARAMETERS if has(robot, name)}
    parameters["damping"] = ParameterDistribution(
        low=0.0, high=0.1, distribution="normal", mean=0.02, std=0.03, relative=False
    )
    axes = 2 if robot.planar else 3
    wrench = ExternalWrench(
        force_mean=tuple(range(axes)), force_std=0.3, moment_std=0.1, correlation_time=0.05, factor=(0.5, 2.0)
    )
    return Uncertainty(parameters=parameters, wrench=wrench, sensors=SensorNoise(position=1e-3), delay=3)


@each_robot
@pytest.mark.parametrize("form", [*UNCERTAINTIES, "table6+sensors", "everything"])
def test_an_uncertainty_survives_json_and_pickle(robot, form):
    found = everything(robot) if form == "everything" else find_uncertainty(form, robot)
    text = json.dumps(to_jsonable(found))
    for again in (find_uncertainty(json.loads(text), robot), pickle.loads(pickle.dumps(found))):
        assert again == found
        assert hash(again) == hash(found)
        uniform = numbers(robot, 3)
        ours, theirs = (one.draw(robot, np.ones(3), uniform) for one in (found, again))
        for attribute in {parameter.attribute for name, parameter in PARAMETERS.items() if has(robot, name)}:
            np.testing.assert_array_equal(getattr(ours, attribute), getattr(theirs, attribute))


def test_the_caller_cannot_change_an_uncertainty_through_its_dict():
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
        {"delay": 4},
    ],
)
def test_uncertainties_that_differ_in_one_field_are_not_equal(change):
    """The vector environment draws for all lanes of equal uncertainties at once."""
    usual = everything(SPATIAL)
    fields = {name: getattr(usual, name) for name in ("parameters", "wrench", "sensors", "delay")}
    assert Uncertainty(**fields) == usual
    assert Uncertainty(**fields | change) != usual
