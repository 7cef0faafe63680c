"""The shipped settings for a training with Stable-Baselines3 (SB3): configuration, environments,
export.

``cablebot train`` uses the same functions::

    envs = make_training_envs("CableBot-Planar-v0", 256, seed=0)
    model = PPO("MlpPolicy", envs, seed=0, **ppo_settings("CableBot-Planar-v0", 256))
    model.learn(400_000)
    evaluate_dlcc(trained_policy(model), "CableBot-Planar-v0")

Configurations have the YAML format of RL Baselines3 Zoo (RL-Zoo). Of its conventions, those in the
shipped file are supported: ``lin_`` schedules, ``normalize``, ``env_wrapper``, and
``policy_kwargs`` as a mapping or as the text ``dict(…)``. All other keys are keyword arguments of
``PPO``. The wrappers are those of a batch of N environments, innermost first; the outermost one is
:class:`~cablebot_baselines.learned.wrappers.steered.Steered`.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import yaml
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
from torch import nn

from cablebot_baselines.laws.law import Array
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.vec_env import CableBotVecEnv
from cablebot_baselines.learned.wrappers import Steered
from cablebot_gym.utils.checks import number, whole
from cablebot_gym.utils.files import read_text

HYPERPARAMS = Path(__file__).parent / "hyperparams" / "ppo.yaml"
"""File of the shipped configurations."""

_NOT_OF_THE_MODEL = ("n_timesteps", "n_envs", "policy", "normalize", "env_wrapper", "env_kwargs")
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")
_ACTIVATIONS: dict[type[nn.Module], str] = {nn.Tanh: "tanh", nn.ReLU: "relu"}


@dataclass(frozen=True, kw_only=True)
class Config:
    """Arguments of the environments, of ``VecNormalize`` and of ``PPO``."""

    plain: Mapping[str, Any]
    """Content of the file for the environment."""
    timesteps: int
    """Number of training steps over all environments; each step is one action of the learner."""
    n_envs: int
    """Number of parallel environments, N."""
    env_kwargs: Mapping[str, Any]
    """Keyword arguments of the environment."""
    wrappers: tuple[tuple[type[Any], Mapping[str, Any]], ...]
    """Wrapper classes and their keyword arguments, innermost first."""
    normalize: Mapping[str, Any]
    """Keyword arguments of ``VecNormalize``."""
    model: Mapping[str, Any]
    """Keyword arguments of ``PPO``, with schedules and classes created."""


def find_config(env_id: str, path: str | Path = HYPERPARAMS) -> Config:
    """Reads the configuration of an environment; the key ``default`` holds for environments without
    a key.

    Args:
        env_id: id of the environment.
        path: YAML file.

    Raises:
        ValueError: if the file cannot be read, has no configuration for this environment, lacks a
            key, or has a value of an invalid form. Other values are checked by the wrappers and by
            SB3.
    """
    plain = _read(env_id, Path(path))
    if missing := [name for name in ("n_timesteps", "policy", "env_wrapper") if name not in plain]:
        raise ValueError(f"hyperparameters: {', '.join(missing)} must be given")
    model = {
        name: _model_value(name, value)
        for name, value in plain.items()
        if name not in _NOT_OF_THE_MODEL
    }
    normalize = plain.get("normalize")
    if isinstance(normalize, bool):
        normalize = {"norm_obs": normalize}
    return Config(
        plain=plain,
        timesteps=int(number("n_timesteps", plain["n_timesteps"], least=1)),
        n_envs=whole("n_envs", plain.get("n_envs", 1), least=1),
        env_kwargs=_keywords("env_kwargs", plain.get("env_kwargs", {})),
        wrappers=_wrappers(plain["env_wrapper"]),
        normalize={"gamma": model.get("gamma", 0.99), **_keywords("normalize", normalize or {})},
        model={"policy": plain["policy"], **model},
    )


def _read(env_id: str, path: Path) -> dict[str, Any]:
    try:
        data = yaml.safe_load(read_text(path))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        cause = " ".join(str(error).split())
        raise ValueError(
            f"--config: cannot read {str(path)!r} ({cause}); give a YAML file"
        ) from error
    if not isinstance(data, dict) or not all(isinstance(value, dict) for value in data.values()):
        raise ValueError(
            f"--config: {path.name} must map environments to hyperparameters: 'ID: {{n_envs: …}}'"
        )
    if env_id not in data and "default" not in data:
        raise ValueError(
            f"--config: {path.name} has no key {env_id} and no key default; it has {', '.join(data)}"
        )
    return dict(data[env_id if env_id in data else "default"])


def _model_value(name: str, value: Any) -> Any:
    if name == "policy_kwargs":
        return _keywords(name, value)
    if name in _SCHEDULES and isinstance(value, str) and value.startswith("lin_"):
        return LinearSchedule(float(value.removeprefix("lin_")), 0.0, 1.0)
    if isinstance(value, str):
        raise ValueError(
            f"{name} must be a number, not {value!r}: YAML reads 1.0e-3 as a number, but 1e-3 as text"
        )
    return value


def _keywords(name: str, value: Any) -> dict[str, Any]:
    """A mapping, also from RL-Zoo's text ``dict(…)``, which is parsed and not executed."""
    keywords = value
    try:
        if isinstance(value, str):
            keywords = _literal(ast.parse(value.strip(), mode="eval").body)
        return dict(keywords)
    except (AttributeError, SyntaxError, TypeError, ValueError) as error:
        raise ValueError(
            f"{name} must be a mapping or text such as 'dict(net_arch=[64])', not {value!r}"
        ) from error


def _literal(node: ast.expr) -> Any:
    """The value of a literal, in which ``dict(…)`` and activations such as ``nn.ReLU`` are
    allowed."""
    match node:
        case ast.Call(func=ast.Name(id="dict"), args=[], keywords=keywords):
            return {str(item.arg): _literal(item.value) for item in keywords}
        case ast.Attribute(value=ast.Name(id="nn"), attr=name):
            return getattr(nn, name)
    return ast.literal_eval(node)


def _wrappers(entries: Any) -> tuple[tuple[type[Any], Mapping[str, Any]], ...]:
    """Classes and keyword arguments of ``env_wrapper``."""
    wrappers = []
    try:
        for entry in entries:
            ((path, keywords),) = entry.items()
            module, _, name = path.rpartition(".")
            wrappers.append((getattr(importlib.import_module(module), name), dict(keywords)))
    except (AttributeError, ImportError, TypeError, ValueError) as error:
        raise ValueError(
            "env_wrapper must be a list of 'package.module.Class: {keyword: value}', "
            f"not {entries!r} ({error})"
        ) from error
    return tuple(wrappers)


def ppo_settings(env_id: str, n_envs: int | None = None) -> dict[str, Any]:
    """The shipped hyperparameters of PPO for an environment, as keyword arguments of SB3's ``PPO``.

    Without ``policy``, ``env`` and ``seed``. The CPU is faster than an accelerator for networks of
    this size.

    Args:
        env_id: as for :func:`make_training_envs`.
        n_envs: as for :func:`make_training_envs`; the batch size is proportional to it.
    """
    config = find_config(env_id)
    settings = {"device": "cpu", **config.model}
    del settings["policy"]
    if n_envs is not None:
        settings["batch_size"] = max(1, settings["batch_size"] * n_envs // config.n_envs)
    return settings


def make_training_envs(
    env_id: str, n_envs: int | None = None, *, seed: int = 0, config: Config | None = None
) -> VecNormalize:
    """Makes the environments of a training: the learner steers a law, and heavier payloads follow
    its success.

    Observations and rewards are normalised, and an episode ends at its first violation of a limit.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        n_envs: number of environments N; None for that of the settings.
        seed: environment i gets ``seed + i`` at the first reset.
        config: the settings; None for those of :func:`find_config`.

    Raises:
        ValueError: if a setting is invalid.
    """
    if config is None:
        config = find_config(env_id)
    env: Any = gym.make_vec(
        env_id,
        num_envs=config.n_envs if n_envs is None else n_envs,
        autoreset_mode=AutoresetMode.DISABLED,
        **config.env_kwargs,
    )
    try:
        for wrapper, keywords in config.wrappers:
            env = wrapper(env, **keywords)
        if not isinstance(env, Steered):
            raise ValueError("the last wrapper, which is the outermost one, must be Steered")
        vec_env = CableBotVecEnv(env)
        vec_env.seed(seed)
        vec_env.action_space.seed(seed)
        return VecNormalize(VecMonitor(vec_env), **config.normalize)
    except TypeError as error:
        raise ValueError(f"env_wrapper or normalize: {error}; correct the file") from error


def steered_env(model: PPO) -> Steered:
    """The environments of :func:`make_training_envs` without normalisation, from a model that has
    them.

    Raises:
        ValueError: if the model has other environments.
    """
    envs: Any = model.get_vec_normalize_env()
    steered = getattr(getattr(envs, "unwrapped", None), "env", None)
    if not isinstance(steered, Steered):
        raise ValueError(
            "the model must have the environments that it was trained on, from make_training_envs"
        )
    return steered


def network_from_sb3(model: PPO) -> Network:
    """The deterministic actor of an ``MlpPolicy``, as ``predict(…, deterministic=True)`` uses it,
    including the normalisation of its inputs.

    Means beyond ±1 are kept; the action mapping clips them, as SB3 does.

    Args:
        model: model with normalised observations (``VecNormalize``).

    Raises:
        ValueError: if a :class:`Network` cannot represent the policy, or observations are not
            normalised.
    """
    policy: Any = model.policy
    hidden = list(policy.mlp_extractor.policy_net)
    linear = [*hidden[::2], policy.action_net]
    activations = {_ACTIVATIONS.get(type(layer)) for layer in hidden[1::2]} or {"tanh"}
    activation = activations.pop()
    is_linear = all(isinstance(layer, nn.Linear) for layer in linear)
    if not is_linear or activations or activation is None or policy.squash_output:
        raise ValueError(
            "only linear layers with nn.Tanh or with nn.ReLU between them can be exported"
        )
    normalize: Any = model.get_vec_normalize_env()
    if not normalize.norm_obs or normalize.clip_obs != Network.CUT:
        raise ValueError(
            f"observations must be normalised with norm_obs=True and clip_obs={Network.CUT:g}"
        )
    return Network(
        mean=np.array(normalize.obs_rms.mean, float),
        scale=np.sqrt(normalize.obs_rms.var + normalize.epsilon),
        weights=tuple(_array(layer.weight) for layer in linear),
        biases=tuple(_array(layer.bias) for layer in linear),
        activation=activation,
    )


def _array(values: Any) -> Array:
    return values.detach().cpu().numpy().astype(float)


def trained_policy(model: PPO) -> LearnedPolicy:
    """The policy of a model that was trained on :func:`make_training_envs`, without exploration.

    ``trained_policy(model).bundle.save("mine.zip")`` stores it for ``cablebot dlcc ID --policy
    mine.zip``.

    Raises:
        ValueError: if the model has other environments, or its network cannot be exported.
    """
    env = steered_env(model)
    assert env.spec is not None
    steering = env.steering
    bundle = Bundle.of_steering(env.spec.id, steering, network_from_sb3(model))
    return LearnedPolicy(bundle, steering.robot)
