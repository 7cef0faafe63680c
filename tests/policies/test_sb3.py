"""Policy files: those of other packages, and models of Stable-Baselines3 behind the wrappers of
their training."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.spaces import Box, MultiBinary
from numpy.testing import assert_allclose, assert_array_equal

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.policies import load, load_policy
from cablebot_gym.policies.sb3 import CONTRIB_ALGORITHMS, SB3_ALGORITHMS
from cablebot_gym.robots import PLANAR

PLANAR_ID = "CableBot-Planar-v0"
LAYOUT = observation_layout(PLANAR)


class Spaces(gym.Env):
    """An environment that has only spaces."""

    def __init__(self, observation, action):
        self.observation_space = observation
        self.action_space = action

    def reset(self, *, seed=None, options=None):
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, False, False, {}


def spaces_of(env_id):
    env = gym.make(env_id)
    return env.observation_space, env.action_space


def saved(path, observation, action, algorithm="PPO", package="stable_baselines3"):
    """Saves an untrained model."""
    recurrent = algorithm == "RecurrentPPO"
    has_buffer = algorithm in ("SAC", "TD3", "DDPG", "TQC", "CrossQ")
    model = getattr(pytest.importorskip(package), algorithm)(
        "MlpLstmPolicy" if recurrent else "MlpPolicy",
        Spaces(observation, action),
        policy_kwargs={"net_arch": [4]} | ({"lstm_hidden_size": 4} if recurrent else {}),
        seed=1,
        **({"buffer_size": 10} if has_buffer else {}),
    )
    model.save(path)
    return model


CASES = [
    pytest.param(package, name, marks=() if name == "PPO" else pytest.mark.landing)
    for package, names in (
        ("stable_baselines3", SB3_ALGORITHMS),
        ("sb3_contrib", CONTRIB_ALGORITHMS),
    )
    for name in names
]
OBSERVED, ACTIONS = spaces_of(PLANAR_ID)


@pytest.mark.parametrize(("package", "algorithm"), CASES)
def test_loaded_model_predicts_like_the_saved_one(tmp_path, package, algorithm):
    path = tmp_path / "model.zip"
    model = saved(path, OBSERVED, ACTIONS, algorithm, package)
    loaded = load_policy(str(path), PLANAR)
    observation, _ = gym.make(PLANAR_ID).reset(seed=0)
    batch = np.stack([observation, observation / 2])
    state = None
    expected_state = None
    for step in range(3):
        start = np.array([step == 0, True])
        action, state = loaded.predict(batch, state, start, deterministic=True)
        expected, expected_state = model.predict(batch, expected_state, start, deterministic=True)
        assert_array_equal(action, expected)


@pytest.mark.parametrize(
    ("observation", "action", "message"),
    [
        (
            *spaces_of("CableBot-Spatial-v0"),
            r"the model reads 76 numbers within .* and returns 6 numbers within \[-1, 1\]",
        ),
        (
            OBSERVED,
            MultiBinary(3),
            r"the model reads 31 numbers within .* and returns MultiBinary\(3\)",
        ),
        (
            Box(-10.0, 10.0, (31,)),
            ACTIONS,
            r"the model reads 31 numbers within \[-10, 10\] and returns 3 numbers within \[-1, 1\]",
        ),
        (
            OBSERVED,
            Box(-0.5, 0.5, (3,)),
            r"the model reads 31 numbers within .* and returns 3 numbers within \[-0.5, 0.5\]",
        ),
    ],
)
def test_model_with_other_spaces_is_rejected(tmp_path, observation, action, message):
    path = tmp_path / "model.zip"
    saved(path, observation, action)
    match = rf"^policy file '.*model\.zip' does not fit robot 'planar': {message}, not 31 numbers within"
    with pytest.raises(ValueError, match=match):
        load_policy(str(path), PLANAR)


def test_model_of_normalised_observations_gets_them(tmp_path):
    """Excludes a model that is silently fed with observations of another scale."""
    env = gym.make(PLANAR_ID, normalised_observation=True, observation_dtype="float32")
    path = tmp_path / "model.zip"
    model = saved(path, env.observation_space, env.action_space)
    policy = load_policy(str(path), PLANAR)
    raw = gym.make(PLANAR_ID).reset(seed=0)[0]
    normalised = env.reset(seed=0)[0]
    action = policy.predict(raw, deterministic=True)[0]
    assert_array_equal(action, model.predict(normalised, deterministic=True)[0])
    assert not np.array_equal(action, model.predict(raw, deterministic=True)[0])
    assert_array_equal(load(model, PLANAR).policy.predict(raw, deterministic=True)[0], action)


# --- wrappers of the training -----------------------------------------------------------------------------------------


@pytest.fixture
def trained():
    """An untrained PPO model and the ``VecNormalize`` of its training environment, whose observations
    are normalised."""
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    venv = DummyVecEnv([lambda: gym.make(PLANAR_ID, normalised_observation=True)])
    normalize = VecNormalize(venv)
    few = {"n_steps": 8, "batch_size": 8, "n_epochs": 1, "policy_kwargs": {"net_arch": []}}
    return sb3.PPO("MlpPolicy", normalize, seed=0, **few), normalize


def test_statistics_of_a_file_normalise_the_observations(trained, tmp_path):
    model, normalize = trained
    normalize.obs_rms.mean, normalize.obs_rms.var = np.linspace(-1, 1, 31), np.linspace(0.5, 2, 31)
    raw_observation = gym.make(PLANAR_ID).reset(seed=0)[0]
    seen = normalize.normalize_obs(LAYOUT.normalise(raw_observation))
    expected = model.predict(seen, deterministic=True)[0]
    file, pkl = str(tmp_path / "best.zip"), tmp_path / "vecnormalize.pkl"
    model.save(file)
    normalize.save(pkl)
    policy = load_policy(file, PLANAR, wrappers=[pkl])
    assert policy.wrappers == ("normalised_observation", str(pkl))
    assert_allclose(policy.predict(raw_observation)[0], expected)


def test_model_without_its_statistics_is_refused(trained, tmp_path):
    """The zip does not say that there was a VecNormalize, but it has the last observation of the
    training."""
    model, _ = trained
    model.learn(64)
    model.save(tmp_path / "best.zip")
    with pytest.raises(
        ValueError, match=r"was trained behind VecNormalize or a wrapper like it.*--wrapper FILE"
    ):
        load_policy(str(tmp_path / "best.zip"), PLANAR)
    assert "normalised_observation" in load(model, PLANAR).wrappers
