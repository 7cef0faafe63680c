"""Hyperparameters of PPO of Stable-Baselines3 (SB3) by environment, in the YAML format of RL
Baselines3 Zoo (RL-Zoo).

The shipped file also works with ``python -m rl_zoo3.train --conf-file``. RL-Zoo itself is not a
dependency, because its versions of packages conflict with this project's. Of its conventions, those
in the shipped file are supported: ``lin_`` schedules, ``normalize``, ``env_wrapper``, and
``policy_kwargs`` as a mapping or as the text ``dict(…)``. All other keys are keyword arguments of
``PPO``.
"""

from __future__ import annotations

import ast
import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stable_baselines3.common.utils import LinearSchedule
from torch import nn

from cablebot_gym.utils.checks import whole

_NOT_OF_THE_MODEL = ("n_timesteps", "n_envs", "policy", "normalize", "env_wrapper", "env_kwargs")
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")


@dataclass(frozen=True, kw_only=True)
class Config:
    """Arguments of the environments, of ``VecNormalize`` and of ``PPO``."""

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


def make_config(plain: Mapping[str, Any]) -> Config:
    """Converts hyperparameters of an environment, from
    :func:`~cablebot_baselines.learned.runs.read_yaml`.

    Raises:
        ValueError: if a key is missing, or a value has an invalid form. Other values are checked by
            the wrappers and by SB3.
    """
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
        timesteps=_count("n_timesteps", plain["n_timesteps"]),
        n_envs=_count("n_envs", plain.get("n_envs", 1)),
        env_kwargs=_keywords("env_kwargs", plain.get("env_kwargs", {})),
        wrappers=_wrappers(plain["env_wrapper"]),
        normalize={"gamma": model.get("gamma", 0.99), **_keywords("normalize", normalize)},
        model={"policy": plain["policy"], **model},
    )


def _count(name: str, value: Any) -> int:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    return whole(name, value, least=1)


def _model_value(name: str, value: Any) -> Any:
    if name == "policy_kwargs":
        return _keywords(name, value)
    if name in _SCHEDULES and isinstance(value, str) and value.startswith("lin_"):
        return LinearSchedule(float(value.removeprefix("lin_")), 0.0, 1.0)
    if isinstance(value, str) and not value.startswith("auto"):
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


def _wrappers(value: Any) -> tuple[tuple[type[Any], Mapping[str, Any]], ...]:
    """Classes and keyword arguments of ``env_wrapper``: a dotted name, ``{name: keywords}``, or a
    list of these."""
    wrappers = []
    entries = value if isinstance(value, list) else [value]
    for entry in entries:
        try:
            if isinstance(entry, str):
                name, keywords = entry, {}
            else:
                ((name, keywords),) = entry.items()
            module_name, _, class_name = name.rpartition(".")
            wrapper = getattr(importlib.import_module(module_name), class_name)
            wrappers.append((wrapper, dict(keywords)))
        except (AttributeError, ImportError, TypeError, ValueError) as error:
            text = "env_wrapper must be a list of 'package.module.Class: {keyword: value}'"
            raise ValueError(f"{text}, not {entry!r} ({error})") from error
    return tuple(wrappers)
