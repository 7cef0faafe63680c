"""Public functions take what people type, and answer in a sentence."""

import inspect
import re
from importlib import import_module

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import cablebot_gym
from cablebot_gym.evaluation.comparison import compare_over_payloads
from cablebot_gym.evaluation.conditions import Conditions

ID = "CableBot-Planar-v0"
ARGUMENTS = {"policy": "fl", "policies": ["fl"], "env_id": ID, "robot": "planar"}
ARGUMENTS |= {"motions": ["line-planar"], "count": 1}
"""Values of the arguments that functions with keywords need."""

OF_A_ROBOT = {
    "find_robot": lambda call, robot: call(robot).stall_torque,
    "find_trajectory": lambda call, robot: call("line-point", robot).duration,
    "inverse_dynamics": lambda call, robot: call(robot, 50.0, *np.full((3, 3), -9.0)).tensions,
    "load_policy": lambda call, robot: call("fl", robot).robot.stall_torque,
    "normalised_action": lambda call, robot: call(robot, np.ones(4), np.ones(4)),
    "observation_layout": lambda call, robot: call(robot, "winches").per_scale,
}
"""Values of the public functions of a robot."""


def test_unknown_keyword_error_lists_those_of_the_function():
    """``evaluate_dlcc(n_draws=16)`` listed the keywords of the environment alone."""
    functions = {Conditions.of}
    for module in map(import_module, cablebot_gym.PUBLIC_MODULES):
        for name, value in vars(module).items():
            if inspect.isfunction(value) or name.startswith("CableBot"):
                functions.add(value)
    functions.remove(compare_over_payloads)  # passes all on to compare_policies
    for function in functions:
        parameters = inspect.signature(function).parameters
        if {"conditions", "keywords"} & {*parameters}:
            arguments = {name: ARGUMENTS[name] for name in {*parameters} & {*ARGUMENTS}}
            with pytest.raises(TypeError, match="did you mean 'substeps'") as caught:
                function(**arguments, n_substeps=16)
            names = {name for name, value in parameters.items() if value.kind is value.KEYWORD_ONLY}
            assert names <= {*re.findall(r"\w+", str(caught.value))}


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


def test_repr_of_a_result_is_its_sentence():
    """That of a rollout had 118,000 characters."""
    motion = {"name": "line-planar", "duration": 0.2, "dwell": 0.0}
    result = cablebot_gym.evaluate_dlcc("fl", ID, search="bisection", trajectory=motion)
    several = compare_over_payloads(["fl"], ID, payloads=[0.0], trajectory=motion)
    layout = cablebot_gym.observation_layout("spatial")
    for item in (result, result.rollout, several, several.comparisons[0], layout):
        assert repr(item) == str(item)
        assert len(str(item)) < 300
