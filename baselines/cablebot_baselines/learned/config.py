"""How to train, read from RL-Zoo's YAML: by environment, the algorithm's numbers and the wrappers.

A file that is valid here trains unchanged with ``python -m rl_zoo3.train --conf-file``.
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
from cablebot_baselines.learned.steering import Residual, Shift, find_way
from cablebot_gym.envs import env_robot
from cablebot_gym.robots import find_robot
from cablebot_gym.utils.suggestions import no_such

ALGORITHMS = ("ppo", "sac", "tqc")
"""Names of ``--algo``; each has a file of its name in :data:`HYPERPARAMS`."""

HYPERPARAMS = Path(__file__).parent / "hyperparams"
"""Folder of the configurations that ship."""

STEERED = "cablebot_baselines.learned.wrappers.Steered"
"""The wrapper that every configuration has, and what it is made with is what a bundle keeps."""

_OWN = ("n_timesteps", "n_envs", "policy", "normalize", "env_wrapper", "env_kwargs")
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")
_NOT_PLAIN = ("action_noise", "replay_buffer_class", "rollout_buffer_class")
_GIVEN = ("self", "policy", "env", "tensorboard_log", "verbose", "seed", "device", "_init_setup_model")
_NORMALIZE = ("norm_obs", "norm_reward", "clip_reward", "epsilon")
_ACTIVATIONS: dict[str, type[nn.Module]] = {"Tanh": nn.Tanh, "ReLU": nn.ReLU}


@dataclass(frozen=True, kw_only=True)
class Config:
    """A configuration that was checked."""

    env_id: str
    algorithm: str
    """One of :data:`ALGORITHMS`."""
    timesteps: int
    """Steps of training, over all environments; each is one action of the learner."""
    n_envs: int
    """Environments at once, N."""
    policy: str
    """Stable-Baselines3's name; ``MlpPolicy``."""
    model: Mapping[str, Any]
    """The algorithm's other keywords, schedules and classes made."""
    normalize: Mapping[str, Any]
    """``VecNormalize``'s keywords."""
    wrappers: tuple[tuple[type[Any], Mapping[str, Any]], ...]
    """Wrappers of one environment and their keywords, the innermost first; each class has its ``vector`` twin."""
    env_kwargs: Mapping[str, Any]
    """The environment's own keywords."""
    base: Base
    """The law that is steered, from the wrapper's keywords."""
    way: Shift | Residual
    """How actions become what steers the law."""
    features: tuple[str, ...]
    """What the network reads."""
    plain: Mapping[str, Any] = field(repr=False)
    """What the file says, JSON-able."""


def algorithm_class(name: str) -> type[BaseAlgorithm]:
    """The class of an algorithm.

    Raises:
        ValueError: if the name is unknown.
        ImportError: if it needs a package that is not there, naming the extra.
    """
    if name not in ALGORITHMS:
        raise ValueError(no_such("algorithm", name, ALGORITHMS))
    if name == "tqc":
        try:
            from sb3_contrib import TQC
        except ImportError as error:
            raise ImportError("tqc needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name) from error
        return TQC
    return PPO if name == "ppo" else SAC


def read_config(env_id: str, algorithm: str, path: Path | None = None) -> dict[str, Any]:
    """What a file says of an environment, unchecked; its key ``default`` stands for those that it does not name.

    Args:
        env_id: of the environment.
        algorithm: one of :data:`ALGORITHMS`.
        path: the file; None for the one that ships.

    Raises:
        ValueError: if the file cannot be read, or says nothing of this environment.
    """
    algorithm_class(algorithm)
    return read_yaml(env_id, Path(algorithm) if path is None else path)


def read_yaml(env_id: str, path: Path) -> dict[str, Any]:
    """What a file says of an environment, unchecked; its key ``default`` stands for those that it does not name.

    Args:
        env_id: of the environment.
        path: the file, or the name of one that ships, without ending.

    Raises:
        ValueError: if the file cannot be read, or says nothing of this environment.
    """
    shipped = sorted(file.stem for file in HYPERPARAMS.glob("*.yaml"))
    if str(path) in shipped:  # whatever a folder of that name holds
        path = HYPERPARAMS / f"{path}.yaml"
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(
            f"--config: cannot read {str(path)!r} ({error}); name a YAML file, or {', '.join(shipped)}"
        ) from error
    except yaml.YAMLError as error:
        raise ValueError(f"--config: {str(path)!r} is no valid YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict) or not all(isinstance(value, dict) for value in data.values()):
        raise ValueError(f"--config: {path.name} has to hold, by environment, the hyperparameters: 'ID: {{n_envs: …}}'")
    if env_id not in data and "default" not in data:
        raise ValueError(f"--config: {path.name} says nothing of {env_id}; it has {', '.join(data)}")
    found: dict[str, Any] = data[env_id if env_id in data else "default"]
    return found


def make_config(env_id: str, algorithm: str, plain: Mapping[str, Any], *, timesteps: int | None = None) -> Config:
    """Checks what a file says and makes of it what Stable-Baselines3 takes.

    Args:
        env_id: of the environment.
        algorithm: one of :data:`ALGORITHMS`.
        plain: RL-Zoo's keys, from :func:`read_config`.
        timesteps: instead of ``n_timesteps``.

    Raises:
        ValueError: if a key is unknown, or a value is not valid; the message says what is.
    """
    robot = find_robot(env_robot(env_id))
    known = [name for name in inspect.signature(algorithm_class(algorithm)).parameters]
    known = [*_OWN, *(name for name in known if name not in (*_GIVEN, *_NOT_PLAIN))]
    if unknown := [name for name in plain if name not in known]:
        raise ValueError(f"hyperparameters of {algorithm}: unknown key {unknown[0]!r}; it takes {', '.join(known)}")
    policy = plain.get("policy")
    if policy != "MlpPolicy":
        raise ValueError(f"policy must be 'MlpPolicy', whose network can be exported, not {policy!r}")
    env_kwargs = _mapping("env_kwargs", plain.get("env_kwargs", {}))
    wrappers = _wrappers(plain.get("env_wrapper"))
    steered = _steered(plain["env_wrapper"])
    model = {name: _model_value(name, value) for name, value in plain.items() if name not in _OWN}
    if model.get("use_sde") and algorithm != "ppo":
        raise ValueError(f"use_sde cannot be exported from {algorithm}: leave it out, or choose ppo")
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
        way=find_way(steered["steering"]),
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
            f"{name} must be a number, not the text {value!r}: YAML reads 1.0e-3 as a number, 1e-3 as text"
        )
    return value


def schedule(name: str, value: Any) -> Any:
    """The value of a hyperparameter: a number, or ``lin_1e-3`` as a schedule that falls linearly to 0.

    Raises:
        ValueError: if it is neither.
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
    raise ValueError(f"{name} must be a number above 0, such as 1.0e-3, or fall linearly, 'lin_1e-3', not {value!r}")


def policy_keywords(value: Any) -> dict[str, Any]:
    """``policy_kwargs`` from a value: a mapping, or RL-Zoo's text, ``dict(net_arch=[64, 64], activation_fn=nn.ReLU)``.

    Nothing in the text is run: it may hold numbers, lists, dicts, and the names of two activations.

    Raises:
        ValueError: if it is something else.
    """
    keywords = _mapping("policy_kwargs", value)
    activation = keywords.get("activation_fn", nn.Tanh)
    if activation not in _ACTIVATIONS.values():
        named = '"dict(activation_fn=nn.ReLU)"'
        raise ValueError(
            f"policy_kwargs: activation_fn must be nn.Tanh or nn.ReLU, as text: {named}, not {activation!r}"
        )
    for name in ("features_extractor_class", "squash_output"):
        if name in keywords:
            raise ValueError(f"policy_kwargs: {name!r} cannot be exported to a bundle: leave it out")
    return keywords


def _mapping(name: str, value: Any) -> dict[str, Any]:
    """A mapping, or the text of one: literals, ``dict(…)`` and activations."""
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
    """``VecNormalize``'s keywords; observations have to be normalised, for the exported network does it."""
    keywords = {} if value is True else {"norm_obs": False} if not value else _mapping("normalize", value)
    if keywords.get("clip_obs", Network.CUT) != Network.CUT:
        raise ValueError(f"normalize: clip_obs is {Network.CUT:g} in an exported network: leave it out")
    keywords.pop("clip_obs", None)
    if unknown := [name for name in keywords if name not in _NORMALIZE]:
        raise ValueError(f"normalize: unknown key {unknown[0]!r}; it takes {', '.join(_NORMALIZE)}")
    if keywords.get("norm_obs", True) is not True:
        raise ValueError("normalize must be true, or a mapping with norm_obs true: the exported network normalises")
    return keywords


def _wrappers(value: Any) -> tuple[tuple[type[Any], Mapping[str, Any]], ...]:
    """The classes of ``env_wrapper`` and their keywords."""
    made = []
    for name, keywords in _named(value):
        module_name, _, class_name = name.rpartition(".")
        try:
            found = getattr(importlib.import_module(module_name), class_name)
        except (ImportError, AttributeError, ValueError) as error:
            raise ValueError(f"env_wrapper: cannot import {name!r} ({error}); name package.module.Class") from error
        if not hasattr(found, "vector"):
            raise ValueError(f"env_wrapper: {name!r} has no twin for batches, an attribute 'vector': train with RL-Zoo")
        made.append((found, keywords))
    return tuple(made)


def _named(value: Any) -> list[tuple[str, dict[str, Any]]]:
    """Dotted names and keywords of ``env_wrapper``: a name, ``{name: keywords}``, or a list of these."""
    entries = value if isinstance(value, list) else [] if value is None else [value]
    named = []
    for entry in entries:
        one = {entry: {}} if isinstance(entry, str) else entry
        if not isinstance(one, dict) or len(one) != 1 or not isinstance(next(iter(one)), str):
            raise ValueError(f"env_wrapper must be a list of 'package.module.Class: {{keyword: value}}', not {entry!r}")
        ((name, keywords),) = one.items()
        named.append((name, _mapping(f"env_wrapper {name}", keywords or {})))
    if [name for name, _ in named].count(STEERED) != 1:
        raise ValueError(f"env_wrapper has to name {STEERED} once: what it steers is what a policy's file keeps")
    return named


def _steered(value: Any) -> dict[str, Any]:
    """Keywords of the wrapper that steers."""
    keywords = dict(_named(value))[STEERED]
    if missing := [name for name in ("base", "steering", "features") if name not in keywords]:
        raise ValueError(f"env_wrapper {STEERED}: give {', '.join(missing)} too, so that the file says all")
    return keywords
