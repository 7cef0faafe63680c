"""Policies behind the wrappers of their training: judged like the policy that needs no wrappers."""

from __future__ import annotations

import functools
import pickle
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers as single
from gymnasium.wrappers import vector

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.evaluation import compare_policies, evaluate_dlcc
from cablebot_gym.evaluation.batch import Batch
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.isolation import IsolatedPolicy
from cablebot_gym.physics.textbook import inverse_dynamics, normalised_action
from cablebot_gym.policies import PolicyError, load_policy
from cablebot_gym.policies.wrappers import StandIn, statistics
from cablebot_gym.robots import PLANAR

PLANAR_ID = "CableBot-Planar-v0"
LAYOUT = observation_layout(PLANAR)
FEW = {"payload_max": 3.0, "resolution": 0.2}
"""A coarse search."""


class Inner:
    """The policy ``fl`` for observations and actions that wrappers change."""

    def __init__(self, read=lambda observation: observation, scale=1.0):
        self.law, self.read, self.scale = load_policy("fl", PLANAR_ID), read, scale

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return self.scale * self.law.predict(self.read(observation))[0], state


@functools.cache
def expected():
    return evaluate_dlcc("fl", PLANAR_ID, **FEW).payload


def payload(policy, *wrappers):
    return evaluate_dlcc(policy, PLANAR_ID, wrappers=wrappers, **FEW).payload


# --- wrappers ---------------------------------------------------------------------------------------------------------

HALF = np.full(3, 0.5, np.float32)


def raw(observation):
    """Inverse of the rescaling of observations to [-1, 1]."""
    space = LAYOUT.space()
    return space.low + (np.asarray(observation, float) + 1) / 2 * (space.high - space.low)


class Repeats(gym.Wrapper):
    """Sends each action twice, like a policy of half the control frequency."""

    def step(self, action):
        self.env.step(action)
        return self.env.step(action)


@pytest.mark.parametrize(
    ("policy", "wrapper"),
    [
        (Inner(scale=0.5), lambda env: vector.RescaleAction(env, -HALF, HALF)),
        (Inner(scale=0.5), lambda env: single.RescaleAction(env, -0.5, 0.5)),
        (Inner(read=lambda stack: stack[:, -1]), lambda env: single.FrameStackObservation(env, 3)),
        (Inner(read=lambda both: both[:, :-1]), lambda env: single.TimeAwareObservation(single.TimeLimit(env, 900))),
    ],
    ids=["vector action", "single action", "frame stack", "time"],
)
def test_policy_behind_wrappers_acts_as_it_does_alone(policy, wrapper):
    alone, behind = (
        record_rollout(one, PLANAR_ID, payload=1.5, wrappers=wrappers)
        for one, wrappers in (("fl", []), (policy, [wrapper]))
    )
    np.testing.assert_allclose(behind.arrays["pose"], alone.arrays["pose"], atol=1e-6)
    assert len(alone) > 500


@pytest.mark.slow
@pytest.mark.parametrize("form", ["vector", "single"])
def test_policy_behind_wrappers_carries_what_it_carries_alone(form):
    forms = {
        "vector": lambda env: vector.RescaleAction(env, -HALF, HALF),
        "single": lambda env: single.RescaleAction(env, -0.5, 0.5),
    }
    assert payload(Inner(scale=0.5), forms[form]) == pytest.approx(expected(), abs=1e-3)


def test_single_and_vector_wrappers_of_observations_act_alike():
    """The bounds are so wide that rescaled observations in single precision lose the motion: both forms, in double."""
    policy = Inner(read=raw)
    one, ones = np.full(31, -1.0), np.full(31, 1.0)
    both = [
        record_rollout(policy, PLANAR_ID, payload=1.0, wrappers=[wrapper]).arrays["pose"]
        for wrapper in (
            lambda env: single.TransformObservation(env, rescaled, gym.spaces.Box(one, ones, dtype=float)),
            lambda env: vector.TransformObservation(
                env, rescaled, single_observation_space=gym.spaces.Box(one, ones, dtype=float)
            ),
        )
    ]
    np.testing.assert_allclose(both[0], both[1], atol=1e-9)
    assert len(both[0]) > 300


def rescaled(observation):
    space = LAYOUT.space()
    return 2 * (observation - space.low) / (space.high - space.low) - 1


def test_wrapper_that_repeats_actions_steps_the_robot_twice():
    actions = record_rollout(Inner(), PLANAR_ID, wrappers=[Repeats]).arrays["commanded_action"]
    np.testing.assert_array_equal(actions[0:20:2], actions[1:21:2])
    assert (actions[2:20:2] != actions[1:19:2]).any()


class Uneven(gym.Wrapper):
    """Sends the action twice while the first coordinate is positive."""

    def step(self, action):
        result = self.env.step(action)
        return self.env.step(action) if result[0][LAYOUT.slices()["reference_pose"]][0] > 0.03 else result


def test_rows_that_act_at_different_times_are_refused():
    policy = load_policy_behind(Uneven)
    rows = np.tile(gym.make(PLANAR_ID).reset(seed=0)[0], (2, 1))
    _, state = policy.predict(rows)
    rows[:, LAYOUT.slices()["reference_pose"]] = [[0.1], [0.0]]
    with pytest.raises(RuntimeError, match=r"different numbers of times: pass a wrapper of the vector environment"):
        policy.predict(rows, state)


def load_policy_behind(*wrappers):
    return load_policy("fl", PLANAR_ID, wrappers=wrappers)


def test_episodes_of_a_batch_keep_their_own_wrappers():
    """Excludes a state that is shared by rows, or that lasts from one batch to the next."""

    class Counts(gym.ActionWrapper):
        calls = 0

        def action(self, action):
            self.calls += 1
            return np.full(3, self.calls)

    policy = load_policy_behind(Counts)
    for size in (40, 3):
        rows, state = np.zeros((size, LAYOUT.size)), None
        for call in (1, 2, 3):
            actions, state = policy.predict(rows, state)
            np.testing.assert_array_equal(actions, np.full((size, 3), call))


def test_comparison_has_wrappers_for_each_policy():
    wrapper = [lambda env: vector.RescaleAction(env, -HALF, HALF)]
    pair = {"payload": 1.0, "names": ["fl", "half"]}
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


@pytest.mark.parametrize(
    ("wrapper", "message"),
    [
        (Fails, r"a wrapper raised KeyError: 'mass' \(test_wrapped.py, line \d+\)"),
        (Reads, r"a wrapper raised KeyError: 'payload' \(test_wrapped.py, line \d+\)"),
    ],
)
def test_error_in_a_wrapper_names_its_line_and_payload(wrapper, message):
    with pytest.raises(PolicyError, match=rf"^policy 'fl', at t = \d\.\d\d\d s with a payload of 1 kg: {message}$"):
        record_rollout("fl", PLANAR_ID, payload=1.0, wrappers=[wrapper])


@pytest.mark.parametrize(
    ("wrappers", "message"),
    [
        ([single.NormalizeObservation], r"NormalizeObservation goes on learning .* obs_rms, .*update_running_mean = F"),
        ([vector.NormalizeObservation], r"NormalizeObservation goes on learning"),
        ([lambda env: None], r"around a vector environment it raised TypeError: it returned NoneType; around a single"),
        ([3], "wrapper 'int' must be a function or class that takes an environment"),
        (["no_such_module:name"], r"wrapper 'no_such_module:name': cannot import it \(No module named"),
        (["none.pkl"], "cannot read wrapper 'none.pkl': No such file"),
        ("mine.py:wrap", r"wrappers must be a list, such as \['mine.py:wrap'\]"),
    ],
)
def test_invalid_wrapper_is_refused_before_the_first_episode(wrappers, message):
    with pytest.raises(ValueError, match=message):
        load_policy("fl", PLANAR_ID, wrappers=wrappers)


def test_frozen_statistics_of_gymnasium_are_applied():
    mean, var = np.linspace(0, 1, LAYOUT.size), np.full(LAYOUT.size, 4.0)

    def normalize(env):
        env = vector.NormalizeObservation(env)
        env.obs_rms.mean, env.obs_rms.var, env.update_running_mean = mean, var, False
        return env

    seen = []
    policy = Inner(read=lambda observation: seen.append(observation) or observation)
    load_policy_with(policy, normalize).predict(np.ones((2, LAYOUT.size)))
    np.testing.assert_allclose(seen[0], np.tile((1 - mean) / 2, (2, 1)), rtol=1e-5)


def load_policy_with(policy, *wrappers):
    return Batch(policy, PLANAR_ID, wrappers=wrappers).policy.policy


# --- nothing but the stand-in -----------------------------------------------------------------------------------------


def test_wrapper_that_looks_for_the_environment_finds_the_stand_in():
    found = []

    class Looks(vector.TransformAction):
        def __init__(self, env):
            super().__init__(env, lambda action: action)

        def reset(self, **keywords):
            found.extend([self.unwrapped, self.unwrapped.tasks[0]])
            return super().reset(**keywords)

    record_rollout("fl", PLANAR_ID, payload=1.375, payload_known=False, wrappers=[Looks])
    assert type(found[0]) is StandIn
    assert found[0].layout == LAYOUT
    public = {name.lstrip("_") for name in vars(found[0])}
    assert not public & {"simulation", "settings", "truth", "payload", "seeds", "streams"}
    assert 1.375 not in [value for value in vars(found[1]).values() if isinstance(value, float)]


MODULE = """
import gc
import gymnasium as gym

class Half(gym.ActionWrapper):
    def action(self, action):
        return action / 2

class Spies(gym.Wrapper):
    def reset(self, **keywords):
        kinds = {type(one).__name__ for one in gc.get_objects()}
        assert not kinds & {"CableBotVectorEnv", "CableBotEnv", "Simulation"}, kinds
        return self.env.reset(**keywords)
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "toy_wrappers", raising=False)
    path = tmp_path / "toy_wrappers.py"
    path.write_text(MODULE, encoding="utf-8")
    return path


@pytest.mark.slow
def test_isolated_process_gives_the_same_payload_from_the_stand_in_alone(module):
    names = [f"{module}:Spies", f"{module}:Half"]
    with IsolatedPolicy("fl", PLANAR_ID, wrappers=names) as policy:
        isolated = evaluate_dlcc(policy, PLANAR_ID, **FEW)
        assert isolated.wrappers == tuple(names)
        with pytest.raises(ValueError, match="is loaded already: give the wrappers where it is loaded"):
            evaluate_dlcc(policy, PLANAR_ID, wrappers=names)
    assert isolated.payload == payload("fl", names[1]) != expected()
    assert isolated.to_dict()["wrappers"] == names
    with pytest.raises(ValueError, match="takes the names of its wrappers"):
        IsolatedPolicy("fl", PLANAR_ID, wrappers=[Fails])


# --- Stable-Baselines3 ------------------------------------------------------------------------------------------------


@pytest.fixture
def trained(tmp_path):
    """A PPO model whose network is linear, and the wrapped training environment; see :func:`linear`."""
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

    def make(wrap=lambda env: env, *, frames=1, **keywords):
        venv = DummyVecEnv([lambda: wrap(gym.make(PLANAR_ID, **keywords))])
        normalize = VecNormalize(venv)
        venv = VecFrameStack(normalize, frames) if frames > 1 else normalize
        model = sb3.PPO("MlpPolicy", venv, n_steps=8, batch_size=8, n_epochs=1, policy_kwargs={"net_arch": []}, seed=0)
        return model, normalize

    return make


def make_linear(model, normalize):
    """Makes the network of a model of normalised observations a linear tracking law behind statistics that matter."""
    import torch

    fl, env, slices, rng = load_policy("fl", PLANAR), gym.make(PLANAR_ID), LAYOUT.slices(), np.random.default_rng(0)
    (observation, _), seen, over = env.reset(seed=0), [], False
    while not over:
        seen.append(observation)
        observation, _, terminated, truncated, _ = env.step(fl.predict(observation)[0])
        over = terminated or truncated
    rows = np.repeat(seen[::10], 3, axis=0)
    rows[:, slices["pose"]] += rng.normal(scale=0.003, size=(len(rows), 2))
    rows[:, slices["velocity"]] += rng.normal(scale=0.03, size=(len(rows), 2))
    actions = []
    for row in rows:
        now = LAYOUT.split(row)
        error, rate = now["reference_pose"] - now["pose"], now["reference_velocity"] - now["velocity"]
        acceleration = now["reference_acceleration"] + 400 * error + 40 * rate
        needed = inverse_dynamics(PLANAR, PLANAR.mass, now["pose"], now["velocity"], acceleration, minimum=20.0)
        actions.append(normalised_action(PLANAR, needed.torques, needed.speeds))
    names = ("pose", "velocity", "reference_pose", "reference_velocity", "reference_acceleration")
    used = np.concatenate([np.arange(LAYOUT.size)[slices[name]] for name in names])
    columns = np.column_stack([LAYOUT.normalise(rows)[:, used], np.ones(len(rows))])
    solution = np.linalg.lstsq(columns, np.array(actions), rcond=1e-6)[0]
    mean, var = np.linspace(-1, 1, LAYOUT.size), np.linspace(0.5, 2, LAYOUT.size)
    gains = np.zeros((3, LAYOUT.size))
    gains[:, used] = solution[:-1].T
    normalize.obs_rms.mean, normalize.obs_rms.var, normalize.clip_obs = mean, var, 1e6
    with torch.no_grad():
        model.policy.action_net.weight.copy_(torch.as_tensor(gains * np.sqrt(var)))
        model.policy.action_net.bias.copy_(torch.as_tensor(solution[-1] + gains @ mean))


def test_model_carries_only_behind_the_statistics_of_its_training(trained, tmp_path):
    model, normalize = trained(normalised_observation=True)
    make_linear(model, normalize)
    model.save(tmp_path / "best.zip")
    assert record_rollout(model, PLANAR_ID).verdict.carried
    assert not record_rollout(str(tmp_path / "best.zip"), PLANAR_ID).verdict.carried
    normalize.save(tmp_path / "vecnormalize.pkl")
    assert record_rollout(str(tmp_path / "best.zip"), PLANAR_ID).verdict.carried


def test_statistics_beside_the_file_are_used_and_said(trained, tmp_path, caplog):
    """A model of normalised observations was judged on raw ones, silently."""
    model, normalize = trained(normalised_observation=True)
    normalize.obs_rms.mean, normalize.obs_rms.var = np.linspace(-1, 1, 31), np.linspace(0.5, 2, 31)
    layouts = {
        "plain": ("best.zip", "vecnormalize.pkl"),
        "zoo": ("ppo/ID_1/ID.zip", "ppo/ID_1/ID/vecnormalize.pkl"),
        "best": ("zoo/ID_1/best_model.zip", "zoo/ID_1/ID/vecnormalize.pkl"),
        "checkpoint": ("rl_model_800_steps.zip", "rl_model_vecnormalize_800_steps.pkl"),
    }
    raw_observation = gym.make(PLANAR_ID).reset(seed=0)[0]
    seen = normalize.normalize_obs(LAYOUT.normalise(raw_observation))
    for folder, (zip_name, pkl_name) in layouts.items():
        file, pkl = tmp_path / folder / zip_name, tmp_path / folder / pkl_name
        pkl.parent.mkdir(parents=True, exist_ok=True)
        model.save(file)
        normalize.save(pkl)
        policy = load_policy(str(file), PLANAR)
        assert policy.wrappers == ("normalised_observation", str(pkl))
        assert f"note: policy file {str(file)!r} gets observations normalised by {str(pkl)!r}" in caplog.text
        np.testing.assert_allclose(policy.predict(raw_observation)[0], model.predict(seen, deterministic=True)[0])
    Path(pkl).unlink()
    assert not hasattr(load_policy(str(file), PLANAR), "wrappers")
    np.testing.assert_array_equal(
        load_policy(str(file), PLANAR, wrappers=[tmp_path / "plain" / "vecnormalize.pkl"]).predict(raw_observation)[0],
        policy.predict(raw_observation)[0],
    )


def test_statistics_of_another_robot_are_refused(trained, tmp_path):
    model, normalize = trained()
    model.save(tmp_path / "best.zip")
    normalize.obs_rms.mean = np.zeros(3)
    normalize.observation_space = gym.spaces.Box(-1, 1, (76,))
    normalize.save(tmp_path / "vecnormalize.pkl")
    with pytest.raises(ValueError, match=r"its statistics are those of 76 numbers, but the environment has 31"):
        load_policy(str(tmp_path / "best.zip"), PLANAR)
    (tmp_path / "vecnormalize.pkl").write_bytes(b"no pickle")
    with pytest.raises(ValueError, match=r"vecnormalize.pkl': it is no pickle of VecNormalize"):
        load_policy(str(tmp_path / "best.zip"), PLANAR)


def test_model_trained_behind_statistics_that_are_missing_is_refused(trained, tmp_path):
    """The zip does not say that there was a VecNormalize, but it has the last observation of the training."""
    model, _ = trained(normalised_observation=True)
    model.learn(64)
    model.save(tmp_path / "best.zip")
    with pytest.raises(ValueError, match=r"was trained behind VecNormalize or a wrapper like it.*--normalize FILE"):
        load_policy(str(tmp_path / "best.zip"), PLANAR)
    assert "normalised_observation" in Batch(model, PLANAR_ID).policy.wrappers


def test_wrapped_spaces_decide_whether_a_model_fits(trained, tmp_path):
    """Excludes a model that is judged behind fewer or other wrappers than it was trained behind."""
    stack, half = (
        (lambda env: single.FrameStackObservation(env, 2)),
        (lambda env: single.RescaleAction(env, -HALF, HALF)),
    )
    model, normalize = trained(lambda env: single.FlattenObservation(stack(half(env))))
    model.save(tmp_path / "best.zip")
    normalize.save(tmp_path / "vecnormalize.pkl")
    wrappers = [half, stack, single.FlattenObservation, tmp_path / "vecnormalize.pkl"]
    policy = load_policy(str(tmp_path / "best.zip"), PLANAR, wrappers=wrappers)
    assert policy.predict(np.zeros((2, 31)))[0].shape == (2, 3)
    (tmp_path / "vecnormalize.pkl").rename(tmp_path / "statistics.pkl")
    for fewer, message in (
        ([], r"the model reads 62 numbers and returns 3 numbers. .*--wrapper file.py:name and --normalize FILE"),
        (
            wrappers[1:3],
            r"returns rescaled actions within \[-0.5, 0.5\].*Behind <lambda>, FlattenObservation it has 62",
        ),
    ):
        with pytest.raises(ValueError, match=message):
            load_policy(str(tmp_path / "best.zip"), PLANAR, wrappers=fewer)


def test_frames_are_stacked_as_stable_baselines_does(trained):
    from stable_baselines3.common.vec_env import VecFrameStack

    model, normalize = trained(frames=2)
    normalize.obs_rms.mean = np.linspace(-1, 1, 31)
    env = model.get_env()
    first = env.reset()
    action = model.predict(first, deterministic=True)[0]
    second = env.step(action)[0]
    policy = Batch(
        model, PLANAR_ID, wrappers=[frozen(normalize), functools.partial(VecFrameStack, n_stack=2)]
    ).policy.policy
    given, state = policy.predict(normalize.unnormalize_obs(first[:, 31:]))
    np.testing.assert_allclose(given, action, atol=1e-5)
    given, _ = policy.predict(normalize.unnormalize_obs(second[:, 31:]), state)
    np.testing.assert_allclose(given, model.predict(second, deterministic=True)[0], atol=1e-5)


def frozen(normalize):
    return statistics("VecNormalize", pickle.dumps(normalize))
