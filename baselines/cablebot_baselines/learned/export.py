"""Export from Stable-Baselines3: the mean of the actor as a network, including the normalisation of
its inputs."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

from cablebot_baselines.laws.law import Array
from cablebot_baselines.learned.network import Network

_ACTIVATIONS: dict[type[nn.Module], str] = {nn.Tanh: "tanh", nn.ReLU: "relu"}


def network_from_sb3(model: BaseAlgorithm) -> Network:
    """The deterministic actor of an ``MlpPolicy`` of PPO, as ``predict(…, deterministic=True)`` uses
    it.

    Means beyond ±1 are kept; the action mapping clips them, as SB3 does.

    Args:
        model: model with normalised observations (``VecNormalize``).

    Raises:
        ValueError: if a :class:`Network` cannot represent the policy, or observations are not
            normalised.
    """
    policy: Any = model.policy
    layers = policy.mlp_extractor.policy_net
    head = policy.action_net
    linear = [layer for layer in layers if isinstance(layer, nn.Linear)]
    functions = [type(layer) for layer in layers if not isinstance(layer, nn.Linear)]
    activation = functions[0] if functions else nn.Tanh
    if (
        not isinstance(head, nn.Linear)
        or functions != [activation] * len(linear)
        or activation not in _ACTIVATIONS
        or policy.squash_output
    ):
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
        weights=tuple(_array(layer.weight) for layer in (*linear, head)),
        biases=tuple(_array(layer.bias) for layer in (*linear, head)),
        activation=_ACTIVATIONS[activation],
    )


def _array(values: Any) -> Array:
    return values.detach().cpu().numpy().astype(float)
