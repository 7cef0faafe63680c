"""Training configurations in RL-Zoo's YAML format: hyperparameters and wrappers by environment.

A file that is valid here also works with ``python -m rl_zoo3.train --conf-file``.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

try:
    import yaml
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.utils import LinearSchedule
    from torch import nn
except ImportError as error:
    raise ImportError("training needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name) from error

from cablebot_baselines.learned.base import Base, find_base
from cablebot_baselines.learned.features import check_features
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.steering import Residual, Shift, find_action_mapping
from cablebot_gym.envs import env_robot
from cablebot_gym.robots import find_robot
from cablebot_gym.utils.checks import unknown_name_error

ALGORITHMS = ("ppo", "sac", "tqc")
"""Names for ``--algo``; each has a file of the same name in :data:`HYPERPARAMS`."""

HYPERPARAMS = Path(__file__).parent / "hyperparams"
"""Folder of the shipped configurations."""

STEERED = "cablebot_baselines.learned.wrappers.Steered"
"""Wrapper that every configuration must have; a bundle stores its arguments."""

_OWN = ("n_timesteps", "n_envs", "policy", "normalize", "env_wrapper", "env_kwargs")
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")
_NOT_PLAIN = ("action_noise", "replay_buffer_class", "rollout_buffer_class")
_GIVEN = ("self", "policy", "env", "tensorboard_log", "verbose", "seed", "device", "_init_setup_model")
_NORMALIZE = ("norm_obs", "norm_reward", "clip_reward", "epsilon")
_ACTIVATIONS: dict[str, type[nn.Module]] = {"Tanh": nn.Tanh, "ReLU": nn.ReLU}


@dataclass(frozen=True, kw_only=True)
class Config:
    """A checked configuration."""

    env_id: str
    algorithm: str
    """One of :data:`ALGORITHMS`."""
    timesteps: int
    """Number of training steps over all environments; each step is one action of the learner."""
    n_envs: int
    """Number of parallel environments, N."""
    policy: str
    """Name of the policy class in Stable-Baselines3; ``MlpPolicy``."""
    model: Mapping[str, Any]
    """Other keyword arguments of the algorithm, with schedules and classes created."""
    normalize: Mapping[str, Any]
    """Keyword arguments of ``VecNormalize``."""
    wrappers: tuple[tuple[type[Any], Mapping[str, Any]], ...]
    """Wrapper classes and their keyword arguments, innermost first; each class has a vector form, ``vector``."""
    env_kwargs: Mapping[str, Any]
    """Keyword arguments of the environment."""
    base: Base
    """Base law, from the wrapper's arguments."""
    action_mapping: Shift | Residual
    """Mapping from actions to the base law, from the wrapper's arguments."""
    features: tuple[str, ...]
    """Names of the network's inputs, from the wrapper's arguments."""
    plain: Mapping[str, Any] = field(repr=False)
    """Content of the file for this environment, JSON-able."""


def algorithm_class(name: str) -> type[BaseAlgorithm]:
    """The class of an algorithm.

    Raises:
        ValueError: if the name is unknown.
        ImportError: if a required package is missing; the message names the extra.
    """
    if name not in ALGORITHMS:
        raise unknown_name_error("algorithm", name, ALGORITHMS)
    if name == "tqc":
        try:
            from sb3_contrib import TQC
        except ImportError as error:
            raise ImportError("tqc needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name) from error
        return TQC
    return PPO if name == "ppo" else SAC


def read_config(env_id: str, algorithm: str, path: Path | None = None) -> dict[str, Any]:
    """Reads the unchecked configuration of an environment; the key ``default`` holds for environments without a key.

    Args:
        env_id: id of the environment.
        algorithm: one of :data:`ALGORITHMS`.
        path: YAML file; None for the shipped one.

    Raises:
        ValueError: if the file cannot be read, or has no configuration for this environment.
    """
    algorithm_class(algorithm)
    return read_yaml(env_id, Path(algorithm) if path is None else path)


def read_yaml(env_id: str, path: Path) -> dict[str, Any]:
    """Reads the unchecked configuration of an environment; the key ``default`` holds for environments without a key.

    Args:
        env_id: id of the environment.
        path: YAML file, or the name of a shipped one without its suffix.

    Raises:
        ValueError: if the file cannot be read, or has no configuration for this environment.
    """
    shipped = sorted(file.stem for file in HYPERPARAMS.glob("*.yaml"))
    if str(path) in shipped:  # even if a folder of that name exists
        path = HYPERPARAMS / f"{path}.yaml"
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(
            f"--config: cannot read {str(path)!r} ({error}); give a YAML file, or one of {', '.join(shipped)}"
        ) from error
    except yaml.YAMLError as error:
        raise ValueError(f"--config: {str(path)!r} is not valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict) or not all(isinstance(value, dict) for value in data.values()):
        raise ValueError(f"--config: {path.name} must map environments to hyperparameters: 'ID: {{n_envs: …}}'")
    if env_id not in data and "default" not in data:
        raise ValueError(f"--config: {path.name} has no key {env_id} and no key default; it has {', '.join(data)}")
    configuration: dict[str, Any] = data[env_id if env_id in data else "default"]
    return configuration


def make_config(env_id: str, algorithm: str, plain: Mapping[str, Any], *, timesteps: int | None = None) -> Config:
    """Checks a configuration and converts it to arguments of Stable-Baselines3.

    Args:
        env_id: id of the environment.
        algorithm: one of :data:`ALGORITHMS`.
        plain: configuration in RL-Zoo's keys, from :func:`read_config`.
        timesteps: replacement for ``n_timesteps``.

    Raises:
        ValueError: if a key is unknown, or a value is invalid; the message names the valid ones.
    """
    robot = find_robot(env_robot(env_id))
    known = [name for name in inspect.signature(algorithm_class(algorithm)).parameters]
    known = [*_OWN, *(name for name in known if name not in (*_GIVEN, *_NOT_PLAIN))]
    if unknown := [name for name in plain if name not in known]:
        raise ValueError(f"hyperparameters of {algorithm}: unknown key {unknown[0]!r}; it takes {', '.join(known)}")
    policy = plain.get("policy")
    if policy != "MlpPolicy":
        raise ValueError(f"policy must be 'MlpPolicy', the only one that can be exported, not {policy!r}")
    env_kwargs = _mapping("env_kwargs", plain.get("env_kwargs", {}))
    wrappers = _wrappers(plain.get("env_wrapper"))
    steered = _steered(plain["env_wrapper"])
    model = {name: _model_value(name, value) for name, value in plain.items() if name not in _OWN}
    if model.get("use_sde") and algorithm != "ppo":
        raise ValueError(f"use_sde cannot be exported from {algorithm}: remove it, or use ppo")
    return Config(
        env_id=env_id,
        algorithm=algorithm,
        timesteps=_whole("n_timesteps", plain.get("n_timesteps"))
        if timesteps is None
        else _whole("timesteps", timesteps),
        n_envs=_whole("n_envs", plain.get("n_envs", 1)),
        policy=policy,
        model=model,
        normalize={**_normalize(plain.get("normalize")), "gamma": model.get("gamma", 0.99)},
        wrappers=wrappers,
        env_kwargs=env_kwargs,
        base=find_base(steered["base"]),
        action_mapping=find_action_mapping(steered["steering"]),
        features=check_features(steered["features"], robot),
        plain=dict(plain),
    )


def _whole(name: str, value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value < 1 or value != int(value):
        raise ValueError(f"{name} must be a whole number of at least 1, such as 1000000 or !!float 1e6, not {value!r}")
    return int(value)


def _model_value(name: str, value: Any) -> Any:
    if name in _SCHEDULES:
        return schedule(name, value)
    if name == "policy_kwargs":
        return policy_keywords(value)
    if name == "train_freq" and isinstance(value, list):
        return tuple(value)
    if isinstance(value, (list, dict)) and not name.endswith("_kwargs"):
        raise ValueError(f"{name} must be a number, not {value!r}")
    if isinstance(value, str) and not value.startswith("auto"):
        raise ValueError(
            f"{name} must be a number, not the text {value!r}: YAML reads 1.0e-3 as a number, but 1e-3 as text"
        )
    return value


def schedule(name: str, value: Any) -> Any:
    """Converts a hyperparameter: a number stays, ``lin_1e-3`` becomes a schedule that decreases linearly to 0.

    Raises:
        ValueError: if the value is neither.
    """
    if value is None and name == "clip_range_vf":
        return None
    if isinstance(value, (int, float)) and not isinstance(value, bool) and 0 < value < math.inf:
        return float(value)
    kind, _, start = value.partition("_") if isinstance(value, str) else ("", "", "")
    if kind == "lin":
        try:
            number = float(start)
        except ValueError:
            number = math.nan
        if 0 < number < math.inf:
            return LinearSchedule(number, 0.0, 1.0)
    raise ValueError(
        f"{name} must be a number above 0, such as 1.0e-3, or a linear schedule such as 'lin_1e-3', not {value!r}"
    )


def policy_keywords(value: Any) -> dict[str, Any]:
    """Returns ``policy_kwargs`` from a mapping or from RL-Zoo's text, ``dict(net_arch=[64, 64])``.

    The text is parsed, not executed: it may contain numbers, lists, dicts, ``nn.Tanh`` and ``nn.ReLU``.

    Raises:
        ValueError: if the value is neither, or contains anything else.
    """
    keywords = _mapping("policy_kwargs", value)
    activation = keywords.get("activation_fn", nn.Tanh)
    if activation not in _ACTIVATIONS.values():
        example = '"dict(activation_fn=nn.ReLU)"'
        raise ValueError(
            f"policy_kwargs: activation_fn must be nn.Tanh or nn.ReLU, as in {example}, not {activation!r}"
        )
    for name in ("features_extractor_class", "squash_output"):
        if name in keywords:
            raise ValueError(f"policy_kwargs: {name!r} cannot be exported to a bundle: remove it")
    return keywords


def _mapping(name: str, value: Any) -> dict[str, Any]:
    """Returns a mapping from a mapping or its text, which may contain literals, ``dict(…)`` and activations."""
    if isinstance(value, str):
        try:
            value = _literal(ast.parse(value.strip(), mode="eval").body)
        except (SyntaxError, ValueError) as error:
            text = f"{name} must be a mapping or text such as 'dict(net_arch=[64, 64])', not {value!r}"
            raise ValueError(f"{text} ({error})") from None
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ValueError(f"{name} must be a mapping, {{key: value}}, not {value!r}")
    return dict(value)


def _literal(node: ast.expr) -> Any:
    match node:
        case ast.Call(func=ast.Name(id="dict"), args=[], keywords=keywords) if all(item.arg for item in keywords):
            return {item.arg: _literal(item.value) for item in keywords}
        case ast.Dict(keys=keys, values=values):
            return {_literal(key): _literal(value) for key, value in zip(keys, values, strict=True) if key is not None}
        case ast.List(elts=items) | ast.Tuple(elts=items):
            return [_literal(item) for item in items]
        case ast.Attribute(attr=name) if ast.unparse(node) in (f"nn.{name}", f"th.nn.{name}", f"torch.nn.{name}"):
            if name in _ACTIVATIONS:
                return _ACTIVATIONS[name]
    return ast.literal_eval(node)


def _normalize(value: Any) -> dict[str, Any]:
    """Keyword arguments of ``VecNormalize``; observations must be normalised because the exported network does so."""
    keywords = {} if value is True else {"norm_obs": False} if not value else _mapping("normalize", value)
    if keywords.get("clip_obs", Network.CUT) != Network.CUT:
        raise ValueError(f"normalize: clip_obs is {Network.CUT:g} in an exported network: remove it")
    keywords.pop("clip_obs", None)
    if unknown := [name for name in keywords if name not in _NORMALIZE]:
        raise ValueError(f"normalize: unknown key {unknown[0]!r}; it takes {', '.join(_NORMALIZE)}")
    if keywords.get("norm_obs", True) is not True:
        raise ValueError("normalize must be true, or a mapping with norm_obs: true")
    return keywords


def _wrappers(value: Any) -> tuple[tuple[type[Any], Mapping[str, Any]], ...]:
    """Classes and keyword arguments of ``env_wrapper``."""
    wrappers = []
    for name, keywords in _named(value):
        module_name, _, class_name = name.rpartition(".")
        try:
            wrapper = getattr(importlib.import_module(module_name), class_name)
        except (ImportError, AttributeError, ValueError) as error:
            raise ValueError(f"env_wrapper: cannot import {name!r} ({error}); give package.module.Class") from error
        if not hasattr(wrapper, "vector"):
            raise ValueError(f"env_wrapper: {name!r} has no vector form (attribute 'vector'): train with RL-Zoo")
        wrappers.append((wrapper, keywords))
    return tuple(wrappers)


def _named(value: Any) -> list[tuple[str, dict[str, Any]]]:
    """Dotted names and keyword arguments of ``env_wrapper``: a name, ``{name: keywords}``, or a list of these."""
    entries = value if isinstance(value, list) else [] if value is None else [value]
    named = []
    for entry in entries:
        one = {entry: {}} if isinstance(entry, str) else entry
        if not isinstance(one, dict) or len(one) != 1 or not isinstance(next(iter(one)), str):
            raise ValueError(f"env_wrapper must be a list of 'package.module.Class: {{keyword: value}}', not {entry!r}")
        ((name, keywords),) = one.items()
        named.append((name, _mapping(f"env_wrapper {name}", keywords or {})))
    if [name for name, _ in named].count(STEERED) != 1:
        raise ValueError(f"env_wrapper must contain {STEERED} exactly once: the policy's file stores its arguments")
    return named


def _steered(value: Any) -> dict[str, Any]:
    """Keyword arguments of the wrapper ``Steered``."""
    keywords = dict(_named(value))[STEERED]
    if missing := [name for name in ("base", "steering", "features") if name not in keywords]:
        raise ValueError(f"env_wrapper {STEERED}: {', '.join(missing)} must be given explicitly")
    return keywords
