"""Policies behind the wrappers of their training: judged like the policy that needs no wrappers."""

import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers as single
from gymnasium.wrappers import vector
from numpy.testing import assert_allclose, assert_array_equal

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.evaluation import compare_policies, evaluate_dlcc
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.isolation import IsolatedPolicy
from cablebot_gym.policies import PolicyError, load, load_policy
from cablebot_gym.robots import PLANAR

PLANAR_ID = "CableBot-Planar-v0"
SHORT = {"trajectory": {"name": "line-planar", "duration": 0.4, "dwell": 0.05}}
LAYOUT = observation_layout(PLANAR)
FEW = {"payload_max": 3.0, "resolution": 0.2}
"""A coarse search."""


class Inner:
    """The policy ``fl`` for observations and actions that wrappers change."""

    def __init__(self, read=lambda observation: observation, scale=1.0):
        self.law = load_policy("fl", PLANAR_ID)
        self.read = read
        self.scale = scale

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return self.scale * self.law.predict(self.read(observation))[0], state


# --- wrappers ---------------------------------------------------------------------------------------------------------

HALF = np.full(3, 0.5, np.float32)


class Half(gym.ActionWrapper):
    def action(self, action):
        return action / 2


class Repeats(gym.Wrapper):
    """Sends each action twice, like a policy of half the control frequency."""

    def step(self, action):
        self.env.step(action)
        return self.env.step(action)


@pytest.mark.parametrize(
    ("policy", "wrapper"),
    [
        (Inner(scale=0.5), lambda env: vector.RescaleAction(env, -HALF, HALF)),
        (Inner(read=lambda stack: stack[:, -1]), lambda env: single.FrameStackObservation(env, 3)),
        (
            Inner(read=lambda both: both[:, :-1]),
            lambda env: single.TimeAwareObservation(single.TimeLimit(env, 900)),
        ),
    ],
    ids=["vector action", "frame stack", "time"],
)
def test_policy_behind_wrappers_acts_as_it_does_alone(policy, wrapper):
    alone, behind = (
        record_rollout(each, PLANAR_ID, payload=1.5, wrappers=wrappers, **SHORT)
        for each, wrappers in (("fl", []), (policy, [wrapper]))
    )
    assert_allclose(behind.arrays["pose"], alone.arrays["pose"], atol=1e-6)
    assert len(alone) > 200


def test_wrapper_that_repeats_actions_steps_the_robot_twice():
    rollout = record_rollout(Inner(), PLANAR_ID, wrappers=[Repeats], **SHORT)
    actions = rollout.arrays["commanded_action"]
    assert_array_equal(actions[60:80:2], actions[61:81:2])
    assert (actions[62:80:2] != actions[61:79:2]).any()


def test_episodes_have_their_own_wrappers():
    """Excludes a state that one episode leaves to another, in the same or in the next evaluation."""
    steps = []

    class Counts(gym.ActionWrapper):
        calls = 0

        def action(self, action):
            self.calls += 1
            steps.append(self.calls)
            return action

    results = [
        compare_policies(
            ["fl"], PLANAR_ID, wrappers=[[Counts]], uncertainty="hardware", draws=3, **SHORT
        )
        for _ in range(2)
    ]
    assert steps == 6 * list(range(1, len(steps) // 6 + 1))
    alone = compare_policies(["fl"], PLANAR_ID, uncertainty="hardware", draws=3, **SHORT)
    first, second, expected = (each.metrics[0].max_error for each in (*results, alone))
    assert_array_equal(first, expected)
    assert_array_equal(second, expected)


# --- errors -----------------------------------------------------------------------------------------------------------


class Fails(gym.ObservationWrapper):
    def observation(self, observation):
        if observation[LAYOUT.slices()["time_to_go"]][0] < 1.2:
            raise KeyError("mass")
        return observation


@pytest.mark.parametrize(
    ("wrappers", "message"),
    [
        (
            [single.NormalizeObservation],
            r"NormalizeObservation goes on learning .* obs_rms, .*update_running_mean = F",
        ),
        (
            [lambda env: None],
            r"around a vector environment it raised TypeError: it returned NoneType; around a single",
        ),
        ([3], "wrapper 'int' must be a function or class that takes an environment"),
        (["none.pkl"], "cannot read wrapper 'none.pkl': No such file"),
        ("mine.py:wrap", r"wrappers must be a list, such as \['mine.py:wrap'\]"),
    ],
)
def test_invalid_wrapper_is_refused_before_the_first_episode(wrappers, message):
    with pytest.raises(ValueError, match=message):
        load_policy("fl", PLANAR_ID, wrappers=wrappers)


MODULE = """
import gc
from gymnasium.vector import VectorActionWrapper, VectorWrapper

class Half(VectorActionWrapper):
    def actions(self, actions):
        return actions / 2

class Spies(VectorWrapper):
    def reset(self, **keywords):
        kinds = {type(each).__name__ for each in gc.get_objects()}
        assert not kinds & {"CableBotVectorEnv", "CableBotEnv", "Simulation"}, kinds
        return self.env.reset(**keywords)
"""


@pytest.mark.landing
def test_isolated_wrappers_give_the_same_payload(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    module = tmp_path / "toy_wrappers.py"
    module.write_text(MODULE)
    names = [f"{module}:Spies", f"{module}:Half"]
    with IsolatedPolicy("fl", PLANAR_ID, wrappers=names) as policy:
        isolated = evaluate_dlcc(policy, PLANAR_ID, **FEW)
        assert isolated.details.wrappers == tuple(names)
        with pytest.raises(
            ValueError, match="is loaded already: give the wrappers where it is loaded"
        ):
            evaluate_dlcc(policy, PLANAR_ID, wrappers=names)
    alone, behind = (
        evaluate_dlcc("fl", PLANAR_ID, wrappers=inline, **FEW) for inline in ([], names[1:])
    )
    assert isolated.payload == behind.payload != alone.payload
    assert isolated.to_dict()["wrappers"] == tuple(names)
    with pytest.raises(ValueError, match="takes the names of its wrappers"):
        IsolatedPolicy("fl", PLANAR_ID, wrappers=[Fails])


def test_policy_behind_wrappers_is_called_by_evaluations_only():
    """Excludes a policy that reads observations without its wrappers, silently."""
    policy = load_policy("fl", PLANAR_ID, wrappers=[Half])
    with pytest.raises(RuntimeError, match="behind Half reads wrapped observations: pass it to an"):
        policy.predict(np.zeros(LAYOUT.size))
    with pytest.raises(ValueError, match="'fl' acts in a wrapped environment, and estimator 'ekf'"):
        load_policy("ekf+fl", PLANAR_ID, wrappers=[Half])
    with pytest.raises(ValueError, match="has wrappers: give all of them where it is loaded"):
        load(policy, PLANAR, wrappers=[Half])


def test_wrapper_that_restarts_episodes_is_refused():
    class Restarts(gym.Wrapper):
        def step(self, action):
            self.env.step(action)
            return self.env.reset()[0], 0.0, False, False, {}

    with pytest.raises(
        PolicyError, match="a wrapper raised RuntimeError: a wrapper resets the env"
    ):
        record_rollout(Inner(), PLANAR_ID, wrappers=[Restarts], **SHORT)


def test_error_of_a_wrapper_has_time_and_line():
    with pytest.raises(
        PolicyError,
        match=r"at t = 0\.\d+ s .*a wrapper raised KeyError: 'mass' \(test_wrappers\.py",
    ):
        record_rollout(Inner(), PLANAR_ID, wrappers=[Fails], **SHORT)
