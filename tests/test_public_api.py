"""Public functions take what people type, and answer in a sentence."""

import inspect
from importlib import import_module

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import cablebot_gym
from cablebot_gym.evaluation.conditions import Conditions

ID = "CableBot-Planar-v0"
ARGUMENTS = {"policy": "fl", "policies": ["fl"], "env_id": ID, "payloads": [1.0]}
ARGUMENTS |= {"motions": ["line-planar"], "robot": "planar", "count": 1}
"""Values of the arguments that functions with keywords need."""

OF_A_ROBOT = {
    "find_robot": lambda call, robot: call(robot).stall_torque,
    "find_trajectory": lambda call, robot: call("line-point", robot).duration,
    "inverse_dynamics": lambda call, robot: call(robot, 50.0, CENTRE, 0 * CENTRE, CENTRE).tensions,
    "load_policy": lambda call, robot: call("fl", robot).robot.stall_torque,
    "normalised_action": lambda call, robot: call(robot, np.ones(4), np.ones(4)),
    "observation_layout": lambda call, robot: call(robot, "winches").per_scale,
}
"""Values of the public functions of a robot."""
CENTRE = np.array([0.0, 0.0, -12.0])


def with_keywords():
    """Public functions and classes that pass on conditions, or keywords of the environment."""
    found = {"Conditions.of": Conditions.of}
    for module in map(import_module, cablebot_gym.PUBLIC_MODULES):
        for name, value in vars(module).items():
            if not inspect.isfunction(value) and not name.startswith("CableBot"):
                continue
            if {"conditions", "keywords"} & {*inspect.signature(value).parameters}:
                found[name] = value
    return found


def test_unknown_keyword_error_lists_those_of_the_function():
    """``evaluate_dlcc(n_draws=16)`` listed the keywords of the environment alone."""
    functions = with_keywords()
    assert {"evaluate_dlcc", "record_rollout", "CableBotVectorEnv"} <= {*functions}
    for name, function in functions.items():
        parameters = inspect.signature(function).parameters
        own = [key for key, value in parameters.items() if value.kind is value.KEYWORD_ONLY]
        given = {key: value for key, value in ARGUMENTS.items() if key in parameters}
        with pytest.raises(TypeError, match="did you mean 'substeps'") as caught:
            function(**given, n_substeps=16)
        listed = str(caught.value).partition("choose one of ")[2].partition(";")[0].split(", ")
        if name != "compare_over_payloads":  # passes all on to compare_policies
            assert {*own, "trajectory"} <= {*listed}, name
    with pytest.raises(TypeError, match=r"criterion.*did you mean 'draws'"):
        cablebot_gym.evaluate_dlcc("fl", ID, n_draws=16)


def test_package_shows_only_its_public_names():
    assert dir(cablebot_gym) == sorted(cablebot_gym.__all__)


def test_functions_of_a_robot_take_its_name_and_its_environment():
    """With a Robot, find_trajectory raised an IndexError; with a name, others an AttributeError."""
    robot = cablebot_gym.find_robot("stadium-camera")
    for name in cablebot_gym.__all__:
        call = getattr(cablebot_gym, name)
        if inspect.isfunction(call) and {"robot", "kind"} & {*inspect.signature(call).parameters}:
            value = OF_A_ROBOT[name](call, robot)
            for given in ("stadium-camera", "CableBot-Point-v0"):
                assert_array_equal(OF_A_ROBOT[name](call, given), value)
            with pytest.raises(ValueError, match="did you mean 'stadium-camera'"):
                OF_A_ROBOT[name](call, "stadium-camra")
