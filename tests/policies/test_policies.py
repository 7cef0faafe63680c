"""How a name, a file or ``package.module:factory`` becomes a policy, and what is said when it does not."""

from __future__ import annotations

import sys
import zipfile
from contextlib import closing

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box, MultiBinary

from cablebot_baselines.classical import FL, FeedbackLinearization
from cablebot_gym import ENV_IDS
from cablebot_gym.policies import (
    ENTRY_POINT_GROUP,
    FILE_ENTRY_POINT_GROUP,
    Policy,
    PolicyEntry,
    PolicyError,
    as_policy,
    load_policy,
    loading,
    policy_entries,
)
from cablebot_gym.policies.protocol import BatchItemError, CallablePolicy, reset_policy
from cablebot_gym.policies.sb3 import CONTRIB_ALGORITHMS, SB3_ALGORITHMS
from cablebot_gym.robots import PLANAR, SPATIAL
from cablebot_gym.task import Task


class Constant:
    """A third party's policy, which remembers the robot that it was made for."""

    def __init__(self, robot):
        self.robot = robot

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((*np.shape(observation)[:-1], self.robot.cables)), state


class Point:
    """An entry point of another package."""

    name, value = "other", "other:load"

    def __init__(self, entry):
        self.load = lambda: entry


def entry(name):
    return PolicyEntry(name=name, kind="learned", env_ids=ENV_IDS[:1], factory=Constant, summary="third party")


@pytest.fixture
def third_party(monkeypatch):
    """Two more policies beside the installed ones; asserts that the group is the promised one."""
    installed = loading.entry_points

    def with_more(*, group):
        assert group == ENTRY_POINT_GROUP == "cablebot_gym.policies"
        return [Point(entry("zzz")), *installed(group=group), Point(entry("constant"))]

    monkeypatch.setattr(loading, "entry_points", with_more)


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
    with pytest.raises(ValueError, match=r"apg-circle, .*, constant, ") as caught:
        load_policy(name, PLANAR)
    text = one_sentence(caught.value)
    assert text.startswith(f"unknown policy {name!r}; choose one of ")
    assert "zzz" in text
    assert "a learned bundle or an SB3 file ending in .zip, or package.module:factory" in text


@pytest.mark.parametrize(("name", "meant"), [("FL", "'fl'"), ("adaptve", "'adaptive'"), ("lqr", None)])
def test_misspelt_name_is_not_left_without_the_one_that_was_meant(name, meant):
    with pytest.raises(ValueError, match="unknown policy") as caught:
        load_policy(name, PLANAR)
    end = "package.module:factory"
    assert str(caught.value).endswith(end if meant is None else f"{end}; did you mean {meant}?")


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
    policy = load_policy("cablebot_baselines.classical:FL", PLANAR)
    assert isinstance(policy, FeedbackLinearization)


def test_factory_that_makes_no_policy_is_not_accepted(module):
    with pytest.raises(ValueError, match=r"the factory must return a policy; .*; NoneType is neither"):
        load_policy(f"{module(SOURCE)}:nothing", PLANAR)


@pytest.mark.parametrize(
    ("attribute", "message"),
    [
        ("missing", "'toy_policy_module' has no attribute 'missing'"),
        ("", "'toy_policy_module' has no attribute ''"),
        ("number", "'number' must be a function that takes a robot and returns a policy"),
    ],
)
def test_attribute_that_is_no_factory_is_not_an_obscure_error(module, attribute, message):
    name = f"{module(SOURCE)}:{attribute}"
    with pytest.raises(ValueError, match=message) as caught:
        load_policy(name, PLANAR)
    assert one_sentence(caught.value).startswith(f"policy {name!r}: ")


@pytest.mark.parametrize("name", ["no_such_package:make", "no_such_package.sub:make", "json.unknown_name_error:make"])
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


# --- files ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def loaders(monkeypatch):
    """Sets what other packages load policy files with, in place of what is installed."""
    installed, chosen = loading.entry_points, []

    def with_chosen(*, group):
        return [Point(item) for item in chosen] if group == FILE_ENTRY_POINT_GROUP else installed(group=group)

    assert FILE_ENTRY_POINT_GROUP == "cablebot_gym.policy_files"
    monkeypatch.setattr(loading, "entry_points", with_chosen)
    return chosen


@pytest.fixture
def archive(tmp_path):
    """A zip file of no known kind."""
    path = tmp_path / "mine.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("readme.txt", "holds no model, " * 50)
    return path


def test_file_of_another_package_is_offered_to_its_loader_with_the_robot(loaders, archive):
    asked = []

    def other(path, robot):
        asked.append((path, robot))

    loaders += [other, lambda path, robot: Constant(robot), lambda path, robot: pytest.fail("not its turn")]
    policy = load_policy(str(archive), SPATIAL)
    assert isinstance(policy, Constant)
    assert policy.robot is SPATIAL
    assert asked == [(archive, SPATIAL)]


def test_loader_is_not_asked_for_what_is_no_whole_file(loaders, archive):
    loaders.append(lambda path, robot: pytest.fail("asked"))
    load_policy("fl", PLANAR)
    archive.write_bytes(archive.read_bytes()[:-10])
    for name in (str(archive), str(archive.with_name("missing.zip"))):
        with pytest.raises(ValueError, match=r"does not exist|is not a zip file, or it is damaged"):
            load_policy(name, PLANAR)


def test_refusal_of_a_loader_is_passed_on_and_its_failure_named(loaders, archive):
    def refuses(path, robot):
        raise ValueError("made for another robot")

    def fails(path, robot):
        raise KeyError("weights")

    loaders.append(refuses)
    with pytest.raises(ValueError, match=r"^made for another robot$"):
        load_policy(str(archive), PLANAR)
    loaders[:] = [fails]
    message = r"^policy file '.*mine\.zip' cannot be loaded: other:load raised KeyError: 'weights'$"
    with pytest.raises(ValueError, match=message):
        load_policy(str(archive), PLANAR)


def test_loader_that_cannot_be_imported_does_not_stop_the_others(monkeypatch, archive, caplog):
    class Broken(Point):
        def __init__(self):
            self.load = lambda: __import__("no_such_dependency")

    points = [Broken(), Point(lambda path, robot: Constant(robot))]
    monkeypatch.setattr(loading, "entry_points", lambda *, group: points if group == FILE_ENTRY_POINT_GROUP else [])
    assert isinstance(load_policy(str(archive), PLANAR), Constant)
    assert "policy files of kind 'other' are skipped: other:load raised No module named" in caplog.text


def test_file_that_does_not_exist_is_not_an_obscure_error(tmp_path):
    with pytest.raises(ValueError, match=r"policy file '.*missing\.zip' does not exist") as caught:
        load_policy(str(tmp_path / "missing.zip"), PLANAR)
    one_sentence(caught.value)


# --- SB3 files --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("content", ["empty zip", "other zip", "data of another kind"])
def test_other_file_is_not_an_obscure_error(tmp_path, content):
    pytest.importorskip("stable_baselines3")
    path = tmp_path / "broken.zip"
    with zipfile.ZipFile(path, "w") as file:
        if content == "other zip":
            file.writestr("readme.txt", "holds no model")
        elif content == "data of another kind":
            file.writestr("data", "[1, 2]")
    with pytest.raises(
        ValueError, match=r"policy file '.*broken\.zip' is neither a bundle .* nor an SB3 model \("
    ) as caught:
        load_policy(str(path), PLANAR)
    one_sentence(caught.value)


def test_missing_extra_is_not_named_without_its_command(archive, monkeypatch):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(ValueError, match=r"pip install 'cablebot-gym\[sb3\]'"):
        load_policy(str(archive), PLANAR)


class Spaces(gym.Env):
    """Nothing but spaces."""

    def __init__(self, observation, action):
        self.observation_space, self.action_space = observation, action

    def reset(self, *, seed=None, options=None):
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, False, False, {}


def spaces_of(env_id):
    env = gym.make(env_id)
    return env.observation_space, env.action_space


def saved(path, observation, action, algorithm="PPO", package="stable_baselines3", **keywords):
    """A file of an untrained model."""
    few = {"PPO": {"n_steps": 8, "batch_size": 8}, "RecurrentPPO": {"n_steps": 8, "batch_size": 8}}
    few |= {"A2C": {}, "ARS": {"n_delta": 1}, "TRPO": {"n_steps": 8, "batch_size": 8}}
    made = getattr(pytest.importorskip(package), algorithm)
    small = {"net_arch": [4]} | ({"lstm_hidden_size": 4} if algorithm == "RecurrentPPO" else {})
    model = made(
        "MlpLstmPolicy" if algorithm == "RecurrentPPO" else "MlpPolicy",
        Spaces(observation, action),
        policy_kwargs=small,
        seed=1,
        **few.get(algorithm, {"buffer_size": 10}),
        **keywords,
    )
    model.save(path)
    return model


CASES = [("stable_baselines3", name) for name in SB3_ALGORITHMS] + [
    ("sb3_contrib", name) for name in CONTRIB_ALGORITHMS
]


@pytest.mark.parametrize(("package", "algorithm"), CASES)
def test_model_of_another_algorithm_is_not_refused(tmp_path, package, algorithm):
    path = tmp_path / "model.zip"
    model = saved(path, *spaces_of("CableBot-Planar-v0"), algorithm, package)
    loaded = load_policy(str(path), PLANAR)
    if algorithm in ("PPO", "SAC", "TD3", "TQC", "CrossQ", "RecurrentPPO", "ARS"):  # others' files look the same
        assert type(loaded).__name__ == algorithm
    observation, _ = gym.make("CableBot-Planar-v0").reset(seed=0)
    batch, state, expected_state = np.stack([observation, observation / 2]), None, None
    for step in range(3):
        start = np.array([step == 0, True])
        action, state = loaded.predict(batch, state, start, deterministic=True)
        expected, expected_state = model.predict(batch, expected_state, start, deterministic=True)
        np.testing.assert_array_equal(action, expected)


def test_model_of_a_missing_package_is_not_refused_without_its_command(tmp_path, monkeypatch):
    path = tmp_path / "model.zip"
    saved(path, *spaces_of("CableBot-Planar-v0"), "TQC", "sb3_contrib")
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    with pytest.raises(ValueError, match=r"was saved by sb3-contrib: pip install 'cablebot-gym\[sb3\]'") as caught:
        load_policy(str(path), PLANAR)
    one_sentence(caught.value)
    saved(path, *spaces_of("CableBot-Planar-v0"))
    assert type(load_policy(str(path), PLANAR)).__name__ == "PPO"


REMEDY = "Export a model trained inside wrappers as a bundle by `cablebot train`"
GIVES = (
    r"\. The robot has 21 observed numbers \(pose 2, velocity 2, time_to_go 1, .*\) and 3 actions within \[-1, 1\]\. "
)


@pytest.mark.parametrize(
    ("observation", "action", "message"),
    [
        (57, 6, "the model reads 57 numbers and returns 6 numbers, which fits CableBot-Spatial-v0"),
        (31, 3, "the model reads 31 numbers and returns 3 numbers, which fits CableBot-FlexPlanar-v0"),
        (40, 3, "the model reads 40 numbers and returns 3 numbers"),
        (21, 2, "the model reads 21 numbers and returns 2 numbers"),
        (Box(-1.0, 1.0, (4, 21)), 3, "the model reads 4×21 numbers and returns 3 numbers"),
        (21, MultiBinary(3), r"the model reads 21 numbers and returns MultiBinary\(3\)"),
        (Box(-10.0, 10.0, (21,)), 3, r"the model reads a normalised observation within \[-10, 10\]"),
        (Box(-np.inf, np.inf, (21,)), 3, r"the model reads a normalised observation within \[-inf, inf\]"),
        (21, Box(-0.5, 0.5, (3,)), r"the model returns rescaled actions within \[-0.5, 0.5\]"),
    ],
)
def test_model_of_other_spaces_does_not_reach_an_evaluation(tmp_path, observation, action, message):
    own, path = spaces_of("CableBot-Planar-v0"), tmp_path / "model.zip"
    if isinstance(observation, int):
        observation = own[0] if observation == 21 else Box(-np.arange(1.0, observation + 1), 1.0, dtype=np.float64)
    saved(path, observation, Box(-1.0, 1.0, (action,)) if isinstance(action, int) else action)
    match = rf"^policy file '.*model\.zip' does not fit robot 'planar': {message}{GIVES}.*{REMEDY}$"
    with pytest.raises(ValueError, match=match) as caught:
        load_policy(str(path), PLANAR)
    assert "\n" not in str(caught.value)


def test_model_for_another_workspace_is_not_refused(tmp_path):
    wide = PLANAR.replace(name="wide", base_anchors=1.5 * PLANAR.base)
    env = gym.make("CableBot-Planar-v0", robot=wide)
    assert env.observation_space != spaces_of("CableBot-Planar-v0")[0]
    saved(tmp_path / "model.zip", env.observation_space, env.action_space)
    assert load_policy(str(tmp_path / "model.zip"), PLANAR) is not None


# --- as_policy --------------------------------------------------------------------------------------------------------


def test_policy_is_not_wrapped_a_second_time():
    policy = Constant(PLANAR)
    assert as_policy(policy) is policy


def test_class_in_place_of_a_policy_is_not_called_for_commands():
    with pytest.raises(TypeError, match=r"not the class Constant: pass Constant\(…\)"):
        as_policy(Constant)


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
        unsaturated_actions = True

        def __init__(self):
            self.begun = []

        def reset(self, tasks):
            self.begun.append(tasks)

        def __call__(self, observation):
            return observation

    function = Declared()
    policy = as_policy(function)
    policy.reset(("task",))
    assert policy.unsaturated_actions is True
    assert function.begun == [("task",)]
    plain = as_policy(lambda observation: observation)
    assert plain.unsaturated_actions is False
    assert not hasattr(plain, "reset")


@pytest.mark.parametrize(
    ("returns", "message"),
    [
        (lambda index: [1.0, 2.0] if index != 2 else [1.0], r"shape \(1,\) after \(2,\)"),
        (lambda index: [1.0, 2.0] if index != 2 else "x", "returned str instead of real numbers"),
        (lambda index: [1.0, 2.0] if index != 2 else None, "returned NoneType instead of real numbers"),
        (lambda index: [1.0, 2.0] if index != 2 else [][1], "raised IndexError"),
    ],
)
def test_failure_for_one_observation_does_not_hide_which(returns, message):
    with pytest.raises(BatchItemError, match=message) as caught:
        as_policy(lambda observation: returns(int(observation[0]))).predict(np.arange(4.0)[:, None])
    assert caught.value.index == 2


# --- reset ------------------------------------------------------------------------------------------------------------


class Resettable(Constant):
    """Records the arguments of every reset."""

    def __init__(self):
        super().__init__(PLANAR)
        self.calls = []


class TakesTasks(Resettable):
    def reset(self, tasks):
        self.calls.append(tasks)


class TakesOther(Resettable):
    def reset(self, batch, /):
        self.calls.append(batch)


class TakesNothing(Resettable):
    def reset(self):
        self.calls.append(None)


class TakesSeed(Resettable):
    def reset(self, seed=None):
        self.calls.append(seed)


@pytest.mark.parametrize("kind", [TakesTasks, TakesOther])
def test_reset_gets_one_task_per_observation(kind):
    policy = kind()
    with closing(gym.make_vec("CableBot-Planar-v0", num_envs=3)) as envs:
        envs.reset(seed=0)
        reset_policy(policy, "mine", lambda: envs.unwrapped.tasks)
    assert len(policy.calls) == 1
    assert len(policy.calls[0]) == 3
    assert all(isinstance(task, Task) for task in policy.calls[0])


@pytest.mark.parametrize("kind", [TakesNothing, TakesSeed])
def test_reset_without_tasks_is_called_without_arguments(kind):
    policy = kind()
    reset_policy(policy, "mine", lambda: pytest.fail("the tasks are not needed"))
    assert policy.calls == [None]


def test_policy_without_reset_is_accepted():
    reset_policy(Constant(PLANAR), "mine", lambda: pytest.fail("the tasks are not needed"))


@pytest.mark.parametrize("takes_tasks", [True, False])
def test_raising_reset_gives_a_policy_error(takes_tasks):
    def with_tasks(tasks):
        raise RuntimeError("no plan")

    def without_tasks():
        raise RuntimeError("no plan")

    policy = Constant(PLANAR)
    policy.reset = with_tasks if takes_tasks else without_tasks
    with pytest.raises(PolicyError, match=r"policy 'mine' raised RuntimeError in reset\(\): no plan \(test_policies"):
        reset_policy(policy, "mine", tuple)
