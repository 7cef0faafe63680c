"""Uncertainty as data: the distributions, the drawn robots, impossible uncertainties, and the forms
of the data."""

import dataclasses
import json
import pickle

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles.plants import each_of, with_transmission
from scipy import stats

from cablebot_gym.robots import FLEX_SPATIAL, PLANAR, SPATIAL
from cablebot_gym.task import to_jsonable
from cablebot_gym.uncertainty import (
    PARAMETERS,
    ParameterDistribution,
    Uncertainty,
    draw_size,
    find_uncertainty,
)

rigid_and_flexible = each_of(PLANAR, FLEX_SPATIAL)
JOINTED = with_transmission(FLEX_SPATIAL, load_friction=0.05)
STRETCHING = with_transmission(SPATIAL, axial_stiffness=5e4, load_friction=0.05).replace(
    name="elastic"
)
each_flexible = each_of(JOINTED, STRETCHING)
"""Together they have all parameters."""


def names_of(robot):
    return [name for name in PARAMETERS if PARAMETERS[name].belongs_to(robot)]


@pytest.mark.parametrize(("low", "high"), [(-0.1, 0.3), (0.2, 0.2)])
def test_distribution_is_uniform(low, high):
    distribution = ParameterDistribution(low=low, high=high)
    numbers = np.append(np.random.default_rng(2).random(20_000), [0.0, 1 - 2.0**-53])
    deviation = distribution.deviation(numbers)
    assert np.all((deviation >= low) & (deviation <= high))
    if low < high:
        assert stats.kstest(deviation, stats.uniform(low, high - low).cdf).pvalue > 0.01


def tenth_of(name, width=0.1):
    """A distribution that is possible for every robot."""
    if PARAMETERS[name].position:
        return ParameterDistribution(low=-0.01, high=0.01, relative=False)
    return ParameterDistribution(low=-width, high=width, each=name != "platform_inertia")


def drawn(robot, parameters, count=200, payload=0.0):
    uncertainty = Uncertainty(parameters=parameters)
    uncertainty.check(robot)
    numbers = np.random.default_rng(0).random((count, draw_size(robot)))
    return uncertainty.draw(robot, np.full(count, payload), numbers)


def values_of(draws, name):
    """Draws of a parameter, a row each."""
    values = np.asarray(getattr(draws, PARAMETERS[name].attribute))
    return values.reshape(len(values), -1)


# --- drawn robots -------------------------------------------------------------------------------------------------


@each_flexible
def test_all_values_of_a_parameter_can_deviate_by_one_number(robot):
    distribution = ParameterDistribution(low=1e-3, high=2e-3, relative=False, each=False)
    nominal = drawn(robot, {}, payload=2.0)
    for name in names_of(robot):
        changed = drawn(robot, {name: distribution}, payload=2.0)
        deviation = values_of(changed, name) - values_of(nominal, name)
        assert_allclose(deviation, deviation[:, :1] + 0 * deviation, atol=1e-14, err_msg=name)
        assert np.ptp(deviation[:, 0]) > 9e-4, name


@each_flexible
def test_each_value_has_a_number_of_its_own(robot):
    """Whatever else is uncertain. One number for all moments: of the paper's flat platform, none
    can be drawn alone."""
    parameters = {}
    for name in names_of(robot):
        parameters[name] = ParameterDistribution(
            low=0.1, high=0.9, relative=False, each=name != "platform_inertia"
        )
    together = drawn(robot, parameters, 400)
    reverse = drawn(robot, dict(reversed(parameters.items())), 400)
    columns = []
    for name, distribution in parameters.items():
        values = values_of(together, name)
        assert_array_equal(values, values_of(drawn(robot, {name: distribution}, 400), name))
        assert_array_equal(values, values_of(reverse, name))
        columns.append(values[:, :1] if name == "platform_inertia" else values)
    numbers = np.concatenate(columns, axis=1)
    assert np.abs(np.corrcoef(numbers.T) - np.eye(numbers.shape[1])).max() < 0.3
    ranges = np.ptp(numbers, axis=0)
    assert np.all((ranges > 0.76) & (ranges <= 0.8 + 1e-12))


def test_payload_is_drawn_around_the_nominal_one():
    for relative, least, largest in ((False, 0.0, 1.5), (True, 0.05, 1.0)):
        around = ParameterDistribution(low=-1.0, high=1.0, relative=relative)
        payload = drawn(SPATIAL, {"payload": around}, payload=0.5).payload
        assert 0 <= payload.min() <= least
        assert 0.95 * largest < payload.max() <= largest
        # the quarter of the draws that is below zero
        assert 0.2 < np.mean(payload == 0) < 0.3 or relative
    assert not drawn(SPATIAL, {"payload": around}, payload=0.0).payload.any()


@each_flexible
def test_fastest_robot_bounds_every_drawn_one(robot):
    before = robot.to_dict()
    parameters = {name: tenth_of(name, 0.3) for name in names_of(robot) if name != "payload"}
    fastest = Uncertainty(parameters=parameters).fastest(robot)
    draws = drawn(robot, parameters)
    smallest = ("mass", "moments", "pulley_inertia", "motor_inertia")
    largest = ("stiffness", "stall_torque", "motor_damping", "damping", "speed_slope")
    largest += ("coulomb_friction", "load_friction")
    attributes = {PARAMETERS[name].attribute for name in parameters} | {"speed_slope"}
    for attribute in attributes & {*smallest, *largest}:
        margin = getattr(draws, attribute) - getattr(fastest, attribute)
        assert np.all(margin >= 0 if attribute in smallest else margin <= 0), attribute
    assert robot.to_dict() == before


# --- impossible uncertainties -------------------------------------------------------------------------------------


def tenth(low=-0.1, high=0.1, **more):
    return {"low": low, "high": high, **more}


LOADED = with_transmission(SPATIAL, load_friction=0.05)
IMPOSSIBLE_PARAMETERS = [
    (PLANAR, "damping", {"low": 0.2, "high": -0.2}, "low must not exceed high"),
    (
        SPATIAL,
        "platform_mass",
        tenth(-1.0),
        "smallest platform_mass of 'spatial' must be .* greater than 0 kg, not 0",
    ),
    (
        SPATIAL,
        "damping",
        tenth(-0.02, 0.02, relative=False),
        "smallest damping .* at least 0 .* not -0.01",
    ),
    (PLANAR, "base_anchors", tenth(), "base_anchors: a position has no relative deviation"),
    (
        SPATIAL,
        "platform_inertia",
        tenth(-0.2, 0.0, relative=False, each=False),
        "platform_inertia: one moment",
    ),
    (SPATIAL, "stiffness", tenth(), "'spatial' has no parameter stiffness"),
    (LOADED, "load_friction", tenth(0.0, 30.0), "largest load_friction must be .* less than 1"),
]
IMPOSSIBLE = [
    ({"delay": [0, 1, 2]}, "delay must be one number of control steps or .low, high."),
    ("table6+noise", "unknown uncertainty 'noise'; choose one of none, table6, .*, or join"),
    ("table6+table6", "'table6.table6' defines parameters twice"),
    ({"wrench": {"force_mean": [1, 2, 3]}}, "force_mean needs 2 components for 'planar'"),
    ({"wrench": {"factor": [1.1, 0.9]}}, "factor must be .low, high. with low ≤ high"),
]


@pytest.mark.parametrize(("robot", "name", "value", "message"), IMPOSSIBLE_PARAMETERS)
def test_impossible_parameter_raises(robot, name, value, message):
    with pytest.raises(ValueError, match=message):
        find_uncertainty({"parameters": {name: value}}, robot)


@pytest.mark.parametrize(("data", "message"), IMPOSSIBLE)
def test_impossible_uncertainty_raises(data, message):
    with pytest.raises(ValueError, match=message):
        find_uncertainty(data, PLANAR)


# --- its forms ----------------------------------------------------------------------------------------------------


@rigid_and_flexible
def test_table_6_is_that_of_the_paper(robot):
    table = find_uncertainty("table6", robot)
    tenth_of_all = ParameterDistribution(low=-0.1, high=0.1, relative=True, each=False)
    names = ["platform_mass", *(["stiffness"] if robot.flexible else [])]
    assert dict(table.parameters) == dict.fromkeys(names, tenth_of_all)
    mean, std = table.wrench.statistics(robot)
    forces = np.arange(len(mean)) < robot.dimensions  # no moments
    assert_allclose(mean, np.where(forces, 0.5, 0.0))
    assert_allclose(std**2, np.where(forces, 0.2, 0.0), rtol=1e-14)  # the table gives the variance
    assert (table.wrench.correlation_time, table.wrench.factor) == (0.01, (0.9, 1.1))
    assert (table.sensors, table.delay, table.random) == (None, 0, True)
    with_load = dict(table.parameters) | {"payload": tenth_of_all}
    loaded = dataclasses.replace(table, parameters=with_load)
    assert find_uncertainty("table6-load", robot) == loaded
    sensors = find_uncertainty("sensors", robot).sensors
    both = dataclasses.replace(table, sensors=sensors)
    assert find_uncertainty("sensors+table6+none", robot) == both


@rigid_and_flexible
def test_hardware_varies_every_part(robot):
    """Lag and friction too, which are zero in the nominal robot: a relative deviation would change
    nothing."""
    hardware = find_uncertainty("hardware", robot)
    present = {name for name in PARAMETERS if PARAMETERS[name].belongs_to(robot)}
    # The friction of the motors of flexible robots varies.
    assert present - {*hardware.parameters} == ({"damping"} if robot.flexible else set())
    draws = drawn(robot, hardware.parameters, 50, payload=2.0)
    for name in hardware.parameters:
        assert np.all(np.ptp(values_of(draws, name), axis=0) > 0), name
    assert hardware.wrench.random
    assert hardware.wrench.force_std <= 0.5 * robot.mass  # light platforms are not blown away
    assert None not in (hardware.sensors, hardware.sensor_bias)
    assert hardware.delay_range[0] < hardware.delay_range[1]


@pytest.mark.parametrize("name", ["hardware", "table6"])
def test_uncertainty_survives_json_and_pickle(name):
    uncertainty = find_uncertainty(name, JOINTED)
    data = json.loads(json.dumps(to_jsonable(uncertainty)))
    for again in (find_uncertainty(data, JOINTED), pickle.loads(pickle.dumps(uncertainty))):
        assert (again, hash(again)) == (uncertainty, hash(uncertainty))
    parameters = dict(uncertainty.parameters)
    protected = Uncertainty(parameters=parameters)
    parameters.clear()
    assert protected.parameters  # the caller cannot change it through the dict
