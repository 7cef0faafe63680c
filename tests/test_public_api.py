"""Public functions take what people type, and answer in a sentence."""

import inspect
from importlib import import_module

import pytest

import cablebot_gym
from cablebot_gym.evaluation.conditions import Conditions

ID = "CableBot-Planar-v0"
ARGUMENTS = {"policy": "fl", "policies": ["fl"], "env_id": ID, "payloads": [1.0]}
ARGUMENTS |= {"motions": ["line-planar"], "robot": "planar", "count": 1}
"""Values of the arguments that functions with keywords need."""


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
