"""Policies from names, files and ``package.module:factory``, and calls of a policy."""

import signal
import sys
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from cablebot_baselines.laws import FL
from cablebot_gym.envs import env_robot
from cablebot_gym.evaluation.batch import Batch
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.policies import (
    ENTRY_POINT_GROUP,
    Policy,
    PolicyError,
    PolicyFactory,
    PolicySpec,
    as_policy,
    load,
    load_policy,
    policy_entries,
    spec,
)
from cablebot_gym.policies.adapters import CallablePolicy
from cablebot_gym.policies.options import parse_options
from cablebot_gym.policies.protocol import reset_policy
from cablebot_gym.policies.spec import ESTIMATOR_ENTRY_POINT_GROUP
from cablebot_gym.robots import PLANAR, ROBOTS, SPATIAL, find_robot

PLANAR_ID = "CableBot-Planar-v0"


class Constant:
    """A third party's policy, made for a robot."""

    def __init__(self, robot):
        self.robot = robot

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((*np.shape(observation)[:-1], self.robot.cables)), state


class Point:
    """An entry point of another package."""

    value, dist = "other:load", SimpleNamespace(name="other")

    def __init__(self, entry, name="other"):
        self.name = getattr(entry, "name", name)
        self.load = lambda: entry


@pytest.fixture
def points(monkeypatch):
    """Entry points of other packages by group, in addition to the installed ones."""
    installed = spec.entry_points
    added = {}

    def entry_points(*, group, name=None):
        points = [*added.get(group, ()), *installed(group=group)]
        return [point for point in points if name in (None, point.name)]

    monkeypatch.setattr(spec, "entry_points", entry_points)
    return added


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Makes an importable module."""
    monkeypatch.syspath_prepend(tmp_path)

    def make(source):
        (tmp_path / "toy_policy_module.py").write_text(source)
        return "toy_policy_module"

    yield make
    sys.modules.pop("toy_policy_module", None)


# --- package.module:factory -------------------------------------------------------------------------------------------

SOURCE = """
class Made:
    def __init__(self, robot):
        self.robot = robot
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return observation, state

def function(robot):
    return lambda observation: [robot.cables]

def nothing(robot):
    return None

def raising(robot):
    raise KeyError("weights")

class Alone(Made):
    def __init__(self, gain=2.0):
        self.robot = gain

class Many(Made):
    def __init__(self, robot, gains):
        pass

made = Alone()

"""


def test_factory_of_a_module_makes_a_policy(module):
    name = module(SOURCE)
    made = load_policy(f"{name}:Made", SPATIAL)
    assert isinstance(made, Policy)
    assert made.robot is SPATIAL
    policy = load_policy(f"{name}:function", SPATIAL)
    assert isinstance(policy, CallablePolicy)
    assert_array_equal(policy.predict(np.zeros((3, 2)))[0], [[6], [6], [6]])
    assert load_policy(f"{name}:Alone", SPATIAL).robot == 2.0
    assert load_policy(f"{name}:made", SPATIAL).robot == 2.0


def test_class_is_made_for_the_robot_of_the_evaluation():
    batch = Batch(Constant, Conditions.of(PLANAR_ID))
    assert (batch.policy.name, batch.policy.policy.robot.name) == ("Constant", "planar")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("lqr", r"unknown policy 'lqr'; choose one of .*fl, .*observing"),
        ("missing.zip", "policy file 'missing.zip' does not exist"),
        ("toy_policy_module:nothing", r"the factory must return a policy; .*; NoneType is neither"),
        (
            "toy_policy_module:raising",
            r"the factory raised KeyError: 'weights' \(toy_policy_module.py, line 15\)",
        ),
        (
            "toy_policy_module:Many",
            "the factory raised TypeError: .* missing 1 required positional argument: 'gains'",
        ),
        ("no_such_module:make", r"cannot import it \(No module named 'no_such_module'\)"),
    ],
)
def test_name_that_loads_no_policy_is_explained(module, name, message):
    module(SOURCE)
    with pytest.raises(ValueError, match=message) as caught:
        load_policy(name, PLANAR)
    assert f"'{name}'" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "gains", "minimum_tension"),
    [
        ("fl:gains=tuned", (2000.0, 90.0), 5.0),
        ("fl:gains=900/60,minimum_tension=3", (900.0, 60.0), 3.0),
    ],
)
def test_options_of_a_name_are_arguments_of_the_law(name, gains, minimum_tension):
    spec = PolicySpec.parse(name)
    assert (spec.kind, spec.shipped, spec.target) == ("installed", True, name)
    law = load_policy(name, PLANAR)
    assert (law.outer.gains, law.minimum_tension) == (gains, minimum_tension)
    assert load(f"ekf+{name}", PLANAR).name == f"ekf+{name}"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "fl:gain=3",
            "unknown fl option 'gain'; choose one of gains, minimum_tension, such as fl:",
        ),
        ("fl:gains=tund", "unknown gains 'tund'; choose one of paper, tuned"),
        ("trajopt:gains=tuned", "policy 'trajopt' has no options: leave 'gains=tuned' out"),
        ("fl:tuned", "No module named 'fl'"),
    ],
)
def test_invalid_option_raises_with_the_valid_ones(name, message):
    with pytest.raises(ValueError, match=message):
        load_policy(name, PLANAR)


def test_boolean_option_rejects_other_values():
    entry = replace(FL, factory=lambda robot, *, damped=True: FL.factory(robot))
    assert parse_options(entry, "damped=false") == {"damped": False}
    with pytest.raises(ValueError, match="damped must be true or false, not 'maybe'"):
        parse_options(entry, "damped=maybe")


def test_first_estimator_is_in_front_of_the_second(points):
    class Behind(Constant):
        def __init__(self, name, robot, policy):
            super().__init__(robot)
            self.order = [name, *getattr(policy, "order", [])]

    def point(name):
        return Point(partial(Behind, name), name)

    points[ESTIMATOR_ENTRY_POINT_GROUP] = [point("first"), point("second")]
    assert load_policy("first+second+fl", PLANAR).order == ["first", "second"]


def test_entry_that_is_named_by_its_module_refuses_other_kinds_of_robots():
    with pytest.raises(ValueError, match=r"does not support robot 'flex-planar'.*: use one of "):
        load_policy("cablebot_baselines.laws:FL", find_robot("flex-planar"))


def test_name_is_read_without_importing_anything(module):
    name = module("raise SystemExit")
    kinds = {
        text: PolicySpec.parse(text).kind
        for text in ("fl", "ekf+fl", "best.zip", f"{name}:make", "a.py", "lqr")
    }
    assert list(kinds.values()) == [
        "installed",
        "installed",
        "file",
        "factory",
        "factory",
        "unknown",
    ]
    behind = PolicySpec.parse("ekf+fl")
    assert ([point.name for point in behind.estimators], behind.target) == (["ekf"], "fl")
    assert (behind.installed, behind.shipped) == (False, True)


def test_policy_is_loaded_once():
    """Excludes a loaded policy that a second entrance makes anew, or that loses its declarations
    or wrappers there."""
    loaded = load("ekf+fl", PLANAR, wrappers=["normalised_observation"])
    again = load(loaded, SPATIAL, name="mine")
    assert (again.policy, again.name, again.shipped) == (loaded.policy, "mine", False)
    assert again.wrappers == ("normalised_observation",)
    assert again.declarations.measurement == "winches"
    shipped = load(load("fl", PLANAR), PLANAR)
    assert (shipped.shipped, load(shipped.policy, PLANAR).shipped) == (True, False)
    with pytest.raises(ValueError, match="is loaded already"):
        load(loaded, PLANAR, wrappers=["mine.py:wrap"])


# --- as_policy --------------------------------------------------------------------------------------------------------


def test_callable_gets_one_observation_at_a_time():
    class Function:
        unsaturated_actions = True
        tasks = ()

        def reset(self, tasks):
            self.tasks = tasks

        def __call__(self, observation):
            assert observation.shape == (4,)
            return observation[:2] * 2

    function, state = Function(), object()
    policy = as_policy(function)
    action, after = policy.predict(np.arange(12.0).reshape(3, 4), state=state)
    assert_array_equal(action, [[0, 2], [8, 10], [16, 18]])
    assert after is state
    assert_array_equal(policy.predict(np.arange(4.0))[0], [0, 2])
    policy.reset(("task",))
    assert (policy.unsaturated_actions, function.tasks) == (True, ("task",))
    assert not as_policy(lambda observation: observation).unsaturated_actions


# --- reset ------------------------------------------------------------------------------------------------------------


def with_reset(reset):
    policy = Constant(PLANAR)
    policy.reset = reset
    return policy


def test_reset_gets_one_task_per_observation_if_it_takes_any():
    calls = []
    tasks = ("first task", "second task")
    reset_policy(with_reset(lambda batch, /: calls.append(batch)), "mine", lambda: tasks)
    assert calls == [tasks]
    for reset in (lambda: calls.append(None), lambda seed=None: calls.append(seed)):
        reset_policy(with_reset(reset), "mine", lambda: pytest.fail("the tasks are not needed"))
    assert calls[1:] == [None, None]
    reset_policy(Constant(PLANAR), "mine", lambda: pytest.fail("the tasks are not needed"))


# --- one instance per episode -----------------------------------------------------------------------------------------


class Remembers:
    """A controller with state: it counts its calls."""

    unsaturated_actions, stochastic = True, True

    def __init__(self):
        self.calls, self.tasks = 0, None

    def reset(self, tasks):
        self.tasks = tasks

    def __call__(self, observation):
        self.calls += 1
        if observation[0] == 9:
            raise KeyError("mass")
        return [observation[0], self.calls, 0.0 if self.tasks is None else self.tasks[0]]


def test_factory_makes_one_instance_for_each_episode_of_a_batch():
    policy = PolicyFactory(Remembers)
    assert isinstance(policy, Policy)
    assert (policy.name, policy.unsaturated_actions, policy.stochastic) == ("Remembers", True, True)
    for _ in range(2):
        policy.reset([7.0, 8.0])
        state = None
        for call in (1, 2):
            action, state = policy.predict(np.array([[5.0], [6.0]]), state)
            assert_array_equal(action, [[5, call, 7], [6, call, 8]])
    with pytest.raises(
        PolicyError, match=r"it failed with KeyError: 'mass' \(test_policies.py"
    ) as caught:
        policy.predict(np.array([[5.0], [9.0]]))
    assert caught.value.index == 1


# --- calls ------------------------------------------------------------------------------------------------------------


class Own(BaseException):
    def __str__(self):
        raise SystemExit


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (SystemExit(0), r"it raised SystemExit: 0 \(test_policies.py, line \d+\)"),
        (RuntimeError("lost" * 1000), "it raised RuntimeError: (lost){250}…"),
        (Own(), "it raised Own: its message cannot be shown"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_every_exception_but_an_interrupt_is_a_policy_error(error, message):
    """``sys.exit(0)`` of a policy ended a benchmark with status 0 and without a table."""

    def fail(*_, **__):
        raise error

    policy = Constant(PLANAR)
    policy.predict = policy.reset = fail
    with pytest.raises(
        PolicyError, match=rf"^policy 'mine', at t = 0.000 s with a payload of 0 kg: {message}"
    ):
        call(policy)
    with pytest.raises(
        PolicyError, match=rf"^policy 'mine': it raised {type(error).__name__} in reset\(\)"
    ):
        reset_policy(policy, "mine", tuple)
    with pytest.raises(PolicyError, match=message.replace("raised", "failed with")):
        call(as_policy(fail))
    policy.predict = policy.reset = lambda *_, **__: signal.raise_signal(signal.SIGINT)
    for run in (lambda: call(policy), lambda: reset_policy(policy, "mine", tuple)):
        with pytest.raises(KeyboardInterrupt):
            run()


OBSERVATION = np.zeros((1, 21))


def call(policy, observation=OBSERVATION):
    start = np.ones(len(observation), np.bool_)
    payloads = np.arange(len(observation), dtype=float)
    loaded = load(policy, PLANAR, name="mine")
    return loaded.act(observation, None, start, cables=3, payloads=payloads, time=0.0)


def test_policy_gets_a_copy_of_the_observation():
    def overwrites(observation):
        observation[:] = np.nan
        return np.zeros(3)

    observation = np.ones((2, 21))
    call(as_policy(overwrites), observation)
    assert (observation == 1).all()


# --- unsaturated actions ----------------------------------------------------------------------------------------------

DECLARING = [
    (name, env_id)
    for name, entry in policy_entries().items()
    if entry.unsaturated_actions
    for env_id in entry.env_ids[:1]
    if load_policy(name, find_robot(env_robot(env_id))).unsaturated_actions
]


@pytest.mark.parametrize(("name", "env_id"), DECLARING)
def test_declaring_law_requests_more_torque_than_the_motors_have(name, env_id):
    """A law that saturates under the declaration scored 4.59 instead of 1.78 kg under the paper
    criterion."""
    env = gym.make(env_id).unwrapped
    robot = env.settings.robot
    policy = load_policy(name, robot)
    payload = 60.0 if robot.name in ROBOTS else max(60.0, 12 * robot.mass)
    observation, _ = env.reset(seed=0, options={"payload": payload})
    policy.reset([env.task])
    state, largest = None, 0.0
    for step in range(200):
        action, state = policy.predict(observation, state, np.array(step == 0))
        largest = max(largest, np.abs(action).max())
        if largest > 1.05:
            return
        observation, _, terminated, _, _ = env.step(np.clip(action, -1, 1))
        assert not terminated
    pytest.fail(f"largest action {largest}")


def test_only_policies_of_this_project_are_shipped(points):
    assert all(PolicySpec.parse(name).shipped for name, _ in DECLARING)
    assert {name for name, entry in policy_entries().items() if entry.unsaturated_actions} == {
        name for name, _ in DECLARING
    }
    points[ENTRY_POINT_GROUP] = [Point(replace(FL, name="theirs"))]
    assert PolicySpec.parse("theirs").entry().unsaturated_actions
    for name in ("mine:make", "model.zip", "theirs"):
        assert not PolicySpec.parse(name).shipped
