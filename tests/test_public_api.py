"""Public functions take what people type, and answer in a sentence."""

import inspect
import re
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import cablebot_gym
from cablebot_gym.evaluation.comparison import compare_over_payloads
from cablebot_gym.evaluation.conditions import Conditions

ID = "CableBot-Planar-v0"
PUBLIC_MODULES = Path(__file__).parents[1] / "docs" / "public_modules.txt"
ARGUMENTS = {"policy": "fl", "policies": ["fl"], "env_id": ID, "robot": "planar"}
ARGUMENTS |= {"motions": ["line-planar"], "count": 1}
"""Values of the arguments that functions with keywords need."""

BEFORE = {"find_trajectory": ["line-point"], "load_policy": ["fl"]}
AFTER = {
    "inverse_dynamics": [50.0, *np.full((3, 3), -9.0)],
    "normalised_action": [1.0, 1.0],
    "observation_layout": ["winches"],
}
"""Arguments of the public functions of a robot, before and after the robot."""


def test_unknown_keyword_error_lists_those_of_the_function():
    """``evaluate_dlcc(n_draws=16)`` listed the keywords of the environment alone."""
    functions = {Conditions.of}
    for module in map(import_module, PUBLIC_MODULES.read_text(encoding="utf-8").split()):
        for name, value in vars(module).items():
            if inspect.isfunction(value) or name.startswith("CableBot"):
                functions.add(value)
    functions.remove(compare_over_payloads)  # passes all on to compare_policies
    for function in functions:
        parameters = inspect.signature(function).parameters
        passed_on = [name for name, value in parameters.items() if value.kind is value.VAR_KEYWORD]
        if {"conditions", "keywords"} & {*passed_on}:
            arguments = {name: ARGUMENTS[name] for name in {*parameters} & {*ARGUMENTS}}
            with pytest.raises(TypeError, match="did you mean 'substeps'") as caught:
                function(**arguments, n_substeps=16)
            names = {name for name, value in parameters.items() if value.kind is value.KEYWORD_ONLY}
            assert names <= {*re.findall(r"\w+", str(caught.value))}


def test_functions_of_a_robot_take_its_name_and_its_environment():
    """With a Robot, find_trajectory raised an IndexError; with a name, others an AttributeError."""
    robot = cablebot_gym.find_robot("stadium-camera")
    for name in cablebot_gym.__all__:
        call = getattr(cablebot_gym, name)
        if inspect.isfunction(call) and {"robot", "kind"} & {*inspect.signature(call).parameters}:
            values = set()
            for given in (robot, "stadium-camera", "CableBot-Point-v0"):
                value = call(*BEFORE.get(name, ()), given, *AFTER.get(name, ()))
                values.add(str(getattr(value, "robot", value)))
            assert len(values) == 1, name
