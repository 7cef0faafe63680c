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
from cablebot_gym.policies import PolicyError, load_policy
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


class Uneven(gym.Wrapper):
    """Sends the action twice while the first coordinate is positive."""

    def step(self, action):
        result = self.env.step(action)
        return (
            self.env.step(action)
            if result[0][LAYOUT.slices()["reference_pose"]][0] > 0.03
            else result
        )


def test_rows_that_act_at_different_times_are_refused():
    policy = load_policy("fl", PLANAR_ID, wrappers=[Uneven])
    rows = np.tile(gym.make(PLANAR_ID).reset(seed=0)[0], (2, 1))
    _, state = policy.predict(rows)
    rows[:, LAYOUT.slices()["reference_pose"]] = [[0.1], [0.0]]
    with pytest.raises(
        RuntimeError, match=r"different numbers of times: pass a wrapper of the vector environment"
    ):
        policy.predict(rows, state)


def test_episodes_of_a_batch_keep_their_own_wrappers():
    """Excludes a state that is shared by rows, or that lasts from one batch to the next."""

    class Counts(gym.ActionWrapper):
        calls = 0

        def action(self, action):
            self.calls += 1
            return np.full(3, self.calls)

    policy = load_policy("fl", PLANAR_ID, wrappers=[Counts])
    for size in (40, 3):
        rows, state = np.zeros((size, LAYOUT.size)), None
        for call in (1, 2, 3):
            actions, state = policy.predict(rows, state)
            assert_array_equal(actions, np.full((size, 3), call))


def test_comparison_has_wrappers_for_each_policy():
    wrapper = [lambda env: vector.RescaleAction(env, -HALF, HALF)]
    pair = {"payload": 1.0, "names": ["fl", "half"], **SHORT}
    result = compare_policies(["fl", Inner(scale=0.5)], PLANAR_ID, wrappers=[[], wrapper], **pair)
    assert result.metrics[0].mean_error == pytest.approx(result.metrics[1].mean_error, rel=1e-4)
    with pytest.raises(ValueError, match="one list for each of the 2 policies"):
        compare_policies(["fl", Inner()], PLANAR_ID, wrappers=[wrapper], **pair)


# --- errors -----------------------------------------------------------------------------------------------------------


class Fails(gym.ObservationWrapper):
    def observation(self, observation):
        if observation[LAYOUT.slices()["time_to_go"]][0] < 1.2:
            raise KeyError("mass")
        return observation


class Reads(gym.Wrapper):
    def step(self, action):
        observation, *_, info = self.env.step(action)
        return observation, info["payload"], False, False, info


@pytest.mark.parametrize(("wrapper", "key"), [(Fails, "mass"), (Reads, "payload")])
def test_error_in_a_wrapper_names_its_line_and_payload(wrapper, key):
    cause = rf"a wrapper raised KeyError: '{key}' \(test_wrappers.py, line \d+\)"
    with pytest.raises(
        PolicyError, match=rf"^policy 'fl', at t = \d\.\d\d\d s with a payload of 1 kg: {cause}$"
    ):
        record_rollout("fl", PLANAR_ID, payload=1.0, wrappers=[wrapper])


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
import gymnasium as gym

class Half(gym.ActionWrapper):
    def action(self, action):
        return action / 2

class Spies(gym.Wrapper):
    def reset(self, **keywords):
        kinds = {type(each).__name__ for each in gc.get_objects()}
        assert not kinds & {"CableBotVectorEnv", "CableBotEnv", "Simulation"}, kinds
        return self.env.reset(**keywords)
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "toy_wrappers", raising=False)
    path = tmp_path / "toy_wrappers.py"
    path.write_text(MODULE)
    return path


@pytest.mark.landing
def test_isolated_wrappers_give_the_same_payload(module):
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
    assert isolated.to_dict()["wrappers"] == names
    with pytest.raises(ValueError, match="takes the names of its wrappers"):
        IsolatedPolicy("fl", PLANAR_ID, wrappers=[Fails])
