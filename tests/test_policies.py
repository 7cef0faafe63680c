"""How a name, a file or ``package.module:factory`` becomes a policy, and what is said when it does not."""

from __future__ import annotations

import sys
import zipfile

import numpy as np
import pytest

from baselines.classical import FL, FeedbackLinearization
from cablebot_gym import ENV_IDS, policies
from cablebot_gym.policies import (
    ENTRY_POINT_GROUP,
    CallablePolicy,
    LaneError,
    Policy,
    PolicyEntry,
    as_policy,
    load_policy,
    policy_entries,
)
from cablebot_gym.robots import PLANAR, SPATIAL


class Constant:
    """A third party's policy, which remembers the robot that it was made for."""

    def __init__(self, robot):
        self.robot = robot

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((*np.shape(observation)[:-1], self.robot.cables)), state


class Point:
    """An entry point of another package."""

    def __init__(self, entry):
        self.load = lambda: entry


def entry(name):
    return PolicyEntry(name=name, kind="learned", env_ids=ENV_IDS[:1], factory=Constant, summary="third party")


@pytest.fixture
def third_party(monkeypatch):
    """Two more policies beside the installed ones; asserts that the group is the promised one."""
    installed = policies.entry_points

    def with_more(*, group):
        assert group == ENTRY_POINT_GROUP == "cablebot_gym.policies"
        return [Point(entry("zzz")), *installed(group=group), Point(entry("constant"))]

    monkeypatch.setattr(policies, "entry_points", with_more)


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Makes an importable module of some source."""
    monkeypatch.syspath_prepend(tmp_path)
    made = []

    def make(source, name="toy_policy_module"):
        (tmp_path / f"{name}.py").write_text(source, encoding="utf-8")
        made.append(name)
        return name

    yield make
    for name in made:
        sys.modules.pop(name, None)


def one_sentence(error):
    text = str(error)
    assert "\n" not in text
    assert len(text) < 400
    return text


# --- names ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("robot", [PLANAR, SPATIAL], ids=lambda robot: robot.name)
def test_name_does_not_make_a_policy_for_another_robot(robot):
    policy = load_policy("fl", robot)
    assert isinstance(policy, FeedbackLinearization)
    assert policy.robot is robot


def test_installed_baseline_is_not_missing_from_the_entries():
    assert policy_entries()["fl"] is FL


@pytest.mark.usefixtures("third_party")
def test_policy_of_another_package_is_not_overlooked():
    assert list(policy_entries()) == sorted(policy_entries())
    assert {"constant", "fl", "zzz"} <= set(policy_entries())
    policy = load_policy("constant", SPATIAL)
    assert isinstance(policy, Constant)
    assert policy.robot is SPATIAL


@pytest.mark.usefixtures("third_party")
@pytest.mark.parametrize("name", ["FL", "", "lqr", "fl ", "constant.py"])
def test_unknown_name_is_not_refused_without_the_valid_ones(name):
    with pytest.raises(ValueError, match="constant, fl, ") as caught:
        load_policy(name, PLANAR)
    text = one_sentence(caught.value)
    assert text.startswith(f"unknown policy {name!r}; choose one of ")
    assert "zzz" in text
    assert text.endswith("an SB3 file ending in .zip, or package.module:factory")


# --- package.module:factory -------------------------------------------------------------------------------------------

SOURCE = """
class Made:
    def __init__(self, robot):
        self.robot = robot
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return observation, state

def function(robot):
    def policy(observation):
        return [robot.cables]
    return policy

def nothing(robot):
    return None

number = 3
"""


def test_factory_of_a_module_is_not_called_without_the_robot(module):
    made = load_policy(f"{module(SOURCE)}:Made", SPATIAL)
    assert isinstance(made, Policy)
    assert made.robot is SPATIAL


def test_factory_may_return_a_callable(module):
    policy = load_policy(f"{module(SOURCE)}:function", SPATIAL)
    assert isinstance(policy, CallablePolicy)
    np.testing.assert_array_equal(policy.predict(np.zeros((3, 2)))[0], [[6], [6], [6]])


def test_entry_of_a_module_is_not_taken_for_no_factory():
    policy = load_policy("baselines.classical:FL", PLANAR)
    assert isinstance(policy, FeedbackLinearization)


def test_factory_that_makes_no_policy_is_not_accepted(module):
    with pytest.raises(ValueError, match=r"must be a function robot -> policy, but: .*; NoneType is neither"):
        load_policy(f"{module(SOURCE)}:nothing", PLANAR)


@pytest.mark.parametrize(
    ("attribute", "message"),
    [
        ("missing", "'toy_policy_module' has no 'missing'"),
        ("", "'toy_policy_module' has no ''"),
        ("number", "'number' must be a function robot -> policy"),
    ],
)
def test_attribute_that_is_no_factory_is_not_an_obscure_error(module, attribute, message):
    name = f"{module(SOURCE)}:{attribute}"
    with pytest.raises(ValueError, match=message) as caught:
        load_policy(name, PLANAR)
    assert one_sentence(caught.value).startswith(f"policy {name!r}: ")


@pytest.mark.parametrize("name", ["no_such_package:make", "no_such_package.sub:make", "json.no_such:make"])
def test_module_that_does_not_exist_is_not_an_obscure_error(name):
    with pytest.raises(ValueError, match=f"cannot import '{name.partition(':')[0]}'") as caught:
        load_policy(name, PLANAR)
    one_sentence(caught.value)


def test_missing_dependency_of_a_module_is_not_hidden(module):
    name = module("import no_such_dependency\ndef make(robot): ...\n")
    with pytest.raises(ValueError, match=r"cannot import .*No module named 'no_such_dependency'"):
        load_policy(f"{name}:make", PLANAR)


def test_attribute_error_inside_a_module_is_not_blamed_on_the_factory(module):
    name = module("import json\njson.no_such_function()\ndef make(robot): ...\n")
    with pytest.raises(Exception, match="no_such_function"):
        load_policy(f"{name}:make", PLANAR)


# --- SB3 files --------------------------------------------------------------------------------------------------------


def test_file_that_does_not_exist_is_not_an_obscure_error(tmp_path):
    with pytest.raises(ValueError, match=r"policy file '.*missing\.zip' does not exist") as caught:
        load_policy(str(tmp_path / "missing.zip"), PLANAR)
    one_sentence(caught.value)


@pytest.mark.parametrize("content", ["text", "empty zip", "other zip"])
def test_broken_file_is_not_an_obscure_error(tmp_path, content):
    pytest.importorskip("stable_baselines3")
    path = tmp_path / "broken.zip"
    if content == "text":
        path.write_text("no zip at all", encoding="utf-8")
    else:
        with zipfile.ZipFile(path, "w") as file:
            if content == "other zip":
                file.writestr("readme.txt", "holds no model")
    with pytest.raises(ValueError, match=r"policy file '.*broken\.zip' is no SB3 model \(") as caught:
        load_policy(str(path), PLANAR)
    one_sentence(caught.value)


def test_missing_extra_is_not_named_without_its_command(tmp_path, monkeypatch):
    path = tmp_path / "model.zip"
    path.write_bytes(b"")
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(ValueError, match=r"pip install 'cablebot-gym\[sb3\]'"):
        load_policy(str(path), PLANAR)


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_model_of_another_algorithm_is_not_refused(tmp_path, algorithm):
    sb3 = pytest.importorskip("stable_baselines3")
    import gymnasium as gym

    env = gym.make("CableBot-Planar-v0")
    few = {"n_steps": 8, "batch_size": 8} if algorithm == "PPO" else {"buffer_size": 10}
    model = getattr(sb3, algorithm)("MlpPolicy", env, policy_kwargs={"net_arch": [4]}, seed=1, **few)
    path = tmp_path / "model.zip"
    model.save(path)
    loaded = load_policy(str(path), PLANAR)
    assert type(loaded).__name__ == algorithm
    observation, _ = env.reset(seed=0)
    batch = np.stack([observation, observation])
    np.testing.assert_array_equal(
        loaded.predict(batch, deterministic=True)[0], model.predict(batch, deterministic=True)[0]
    )


# --- as_policy --------------------------------------------------------------------------------------------------------


def test_policy_is_not_wrapped_a_second_time():
    policy = Constant(PLANAR)
    assert as_policy(policy) is policy


@pytest.mark.parametrize("thing", [None, 3, "fl", np.zeros(3)])
def test_what_is_neither_policy_nor_callable_is_not_accepted(thing):
    with pytest.raises(TypeError, match=rf"{type(thing).__name__} is neither"):
        as_policy(thing)


def test_callable_is_called_for_one_observation_at_a_time_and_keeps_the_state():
    shapes = []

    def function(observation):
        shapes.append(observation.shape)
        return observation[:2] * 2

    policy = as_policy(function)
    state = object()
    action, after = policy.predict(np.arange(12.0).reshape(3, 4), state=state)
    np.testing.assert_array_equal(action, [[0, 2], [8, 10], [16, 18]])
    assert (shapes, after) == ([(4,)] * 3, state)
    single, _ = policy.predict(np.arange(4.0))
    np.testing.assert_array_equal(single, [0, 2])


def test_callable_does_not_lose_what_it_declares():
    class Declared:
        unclipped = True

        def __init__(self):
            self.begun = []

        def begin(self, tasks):
            self.begun.append(tasks)

        def __call__(self, observation):
            return observation

    function = Declared()
    policy = as_policy(function)
    policy.begin(("task",))
    assert policy.unclipped is True
    assert function.begun == [("task",)]
    plain = as_policy(lambda observation: observation)
    assert plain.unclipped is False
    assert not hasattr(plain, "begin")


@pytest.mark.parametrize(
    ("returns", "message"),
    [
        (lambda lane: [1.0, 2.0] if lane != 2 else [1.0], r"shape \(1,\) after \(2,\)"),
        (lambda lane: [1.0, 2.0] if lane != 2 else "x", "raised ValueError"),
        (lambda lane: [1.0, 2.0] if lane != 2 else [][1], "raised IndexError"),
    ],
)
def test_failure_for_one_observation_does_not_hide_which(returns, message):
    with pytest.raises(LaneError, match=message) as caught:
        as_policy(lambda observation: returns(int(observation[0]))).predict(np.arange(4.0)[:, None])
    assert caught.value.lane == 2
