"""Policies as ONNX files: export, loading, and what is refused."""

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cablebot_baselines.learned.shipped import WEIGHTS
from cablebot_gym.cli import app as cli
from cablebot_gym.evaluation.rollout import record_rollout
from cablebot_gym.policies import load, load_policy
from cablebot_gym.policies.onnx import OnnxPolicy
from cablebot_gym.policies.onnx_export import ExportableModel
from cablebot_gym.robots import PLANAR, SPATIAL

sb3 = pytest.importorskip("stable_baselines3")
onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
PLANAR_ID = "CableBot-Planar-v0"
FLEXIBLE_ID = "CableBot-FlexPlanar-v0"


def untrained(algorithm, env, package="stable_baselines3", **keywords):
    """A model with random weights so large that its actions reach their bounds."""
    module = pytest.importorskip(package)
    if algorithm in ("SAC", "TD3", "DDPG", "TQC"):
        keywords["buffer_size"] = 10
    network = {"net_arch": [8], **keywords.pop("policy_kwargs", {})}
    model = getattr(module, algorithm)(
        keywords.pop("policy", "MlpPolicy"), env, policy_kwargs=network, seed=0, **keywords
    )
    for weights in model.policy.parameters():
        weights.data.normal_(std=1.0)
    return model


ALGORITHMS = {
    "PPO": {},
    "PPO that squashes": {
        "use_sde": True,
        "policy_kwargs": {"squash_output": True},
    },
    "A2C": {"policy_kwargs": {"activation_fn": "ReLU"}},
    "SAC": {},
    "SAC with gSDE": {"use_sde": True},
    "TD3": {},
    "DDPG": {"policy_kwargs": {"activation_fn": "Sigmoid"}},
    "TQC": {"package": "sb3_contrib"},
    "TRPO": {"package": "sb3_contrib", "policy_kwargs": {"net_arch": []}},
}


def with_classes(keywords):
    """The keywords of a model with classes in place of their names."""
    from stable_baselines3.common.torch_layers import FlattenExtractor
    from torch import nn

    class Doubling(FlattenExtractor):
        def forward(self, observations):
            return 2 * super().forward(observations)

    network = dict(keywords.get("policy_kwargs", {}))
    for name, value in network.items():
        if isinstance(value, str):
            network[name] = Doubling if value == "Doubling" else getattr(nn, value)
    return {**keywords, "policy_kwargs": network}


@pytest.mark.parametrize(("name", "keywords"), ALGORITHMS.items())
def test_file_returns_the_actions_of_each_algorithm(name, keywords):
    env = gym.make(PLANAR_ID, normalised_observation=True)
    model = untrained(name.split()[0], env, **with_classes(keywords))
    loaded = load(model, PLANAR).policy
    exportable = ExportableModel(name, loaded, PLANAR)
    policy = OnnxPolicy(exportable.to_onnx())
    space = gym.make(PLANAR_ID).observation_space
    rng = np.random.default_rng(0)
    observations = rng.uniform(space.low / 1e3, space.high / 1e3, (50, *space.shape))
    actions, _ = policy.predict(observations)
    assert np.abs(actions).max() > 0.95
    assert np.abs(actions).min() < 0.9
    assert_allclose(actions, loaded.predict(observations, deterministic=True)[0], atol=1e-5)
    exportable.compute_in_float64()
    expected = loaded.predict(observations, deterministic=True)[0]
    assert expected.dtype == actions.dtype == float
    assert_allclose(actions, expected, atol=1e-13)
    assert_allclose(policy.predict(observations[3])[0], actions[3], atol=1e-15)


@pytest.fixture
def saved(tmp_path, monkeypatch):
    """Saves an untrained PPO model and the statistics of its VecNormalize in an empty folder."""
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    monkeypatch.chdir(tmp_path)

    def save(env_id):
        env = VecNormalize(DummyVecEnv([lambda: gym.make(env_id)]), clip_obs=2.0)
        size = env.observation_space.shape[0]
        env.obs_rms.mean, env.obs_rms.var = np.linspace(-1, 1, size), np.linspace(0.5, 2, size)
        model = untrained("PPO", env)
        model.save("model.zip")
        env.save("vecnormalize.pkl")

    return save


def export(monkeypatch, env_id, policy="model.zip"):
    """Runs the command, and returns its exit status."""
    typed = ["cablebot", "export-policy", env_id, "--policy", policy, "--out", "policy.onnx"]
    monkeypatch.setattr("sys.argv", typed)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return ended.value.code or 0


@pytest.mark.parametrize("env_id", [PLANAR_ID, FLEXIBLE_ID])
def test_file_moves_the_robot_like_its_model(saved, monkeypatch, capsys, env_id):
    saved(env_id)
    assert export(monkeypatch, env_id) == 0
    assert "the model in float64" in capsys.readouterr().out
    motions = [record_rollout(file, env_id, seed=1) for file in ("model.zip", "policy.onnx")]
    before, after = (motion.arrays["true_pose"] for motion in motions)
    assert len(before) > 20
    assert_allclose(after, before, atol=1e-6, rtol=0)
    texts = {item.key: item.value for item in onnx.load("policy.onnx").metadata_props}
    assert (texts["env_id"], texts["control_period"]) == (env_id, "0.002 s")
    assert '{"name": "pose", "size": 2, "unit": "m"}' in texts["observation"]


REFUSED = {
    "law": ({}, "fl", "'fl' cannot be exported: it is no model in a file"),
    "bundle": ({}, str(WEIGHTS / "apg-loops-planar.zip"), "it is of the type"),
    "recurrent": (
        {"algorithm": "RecurrentPPO", "package": "sb3_contrib", "policy": "MlpLstmPolicy"},
        "model.zip",
        "it is of the type RecurrentPPO. `cablebot export-policy` exports .zip models",
    ),
    "layer": (
        {"policy_kwargs": {"activation_fn": "ELU"}},
        "model.zip",
        "its network has a layer ELU, not only Linear, Tanh, ReLU, Sigmoid",
    ),
    "other network": (
        {"policy_kwargs": {"features_extractor_class": "Doubling"}},
        "model.zip",
        "mm, more than --tolerance 0.001: the actor must be a sequence of its layers",
    ),
}


@pytest.mark.parametrize(("keywords", "policy", "message"), REFUSED.values())
def test_policy_that_cannot_be_exported_is_refused(
    tmp_path, monkeypatch, capfd, keywords, policy, message
):
    monkeypatch.chdir(tmp_path)
    made = {"algorithm": "PPO", **with_classes(keywords)}
    untrained(env=gym.make(PLANAR_ID), **made).save("model.zip")
    assert export(monkeypatch, PLANAR_ID, policy=policy) == 2
    assert message in capfd.readouterr().err
    assert not (tmp_path / "policy.onnx").exists()


def test_file_of_another_observation_is_refused(tmp_path):
    path = tmp_path / "policy.onnx"
    model = ExportableModel("mine", untrained("PPO", gym.make(PLANAR_ID)), PLANAR)
    content = model.to_onnx(env_id=PLANAR_ID)
    path.write_bytes(content)
    zeros = np.zeros((2, 31))
    assert_array_equal(
        load_policy(str(path), PLANAR).predict(zeros)[0], OnnxPolicy(content).predict(zeros)[0]
    )
    message = r"observation of CableBot-Planar-v0 \(31 numbers\), not that of this robot \(76"
    with pytest.raises(ValueError, match=message):
        load_policy(str(path), SPATIAL)
    foreign = onnx.load_from_string(content)
    del foreign.metadata_props[:]
    for damaged, message in (
        (content[:-100], "policy.onnx' is damaged, export it again"),
        (foreign.SerializeToString(), "was not written by this version of `cablebot export-policy"),
    ):
        path.write_bytes(damaged)
        with pytest.raises(ValueError, match=message):
            load_policy(str(path), PLANAR)
