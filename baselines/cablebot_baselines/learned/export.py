"""Export from Stable-Baselines3 to a bundle: the mean of the actor, including the normalisation of its inputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

try:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize
    from torch import nn
except ImportError as error:
    raise ImportError("exporting needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name) from error

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.base import Base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.steering import Residual, Shift

_ACTIVATIONS: dict[type[nn.Module], str] = {nn.Tanh: "tanh", nn.ReLU: "relu"}


def network_from_sb3(model: BaseAlgorithm, normalize: VecNormalize) -> Network:
    """The deterministic actor of an ``MlpPolicy`` of PPO, SAC or TQC, as ``predict(…, deterministic=True)`` uses it.

    PPO's means beyond ±1 are kept; the action mapping clips them, as SB3 does.

    Args:
        model: trained model.
        normalize: normalisation of the model's observations.

    Raises:
        ValueError: if a :class:`Network` cannot represent the policy, or observations are not normalised.
    """
    policy: Any = model.policy
    if hasattr(policy, "actor"):
        layers, head, squash = list(policy.actor.latent_pi), policy.actor.mu, "tanh"
    elif hasattr(policy, "action_net"):
        layers, head, squash = list(policy.mlp_extractor.policy_net), policy.action_net, "none"
        if policy.squash_output:
            raise ValueError("a PPO policy with squash_output cannot be exported: remove squash_output")
    else:
        raise ValueError(f"a policy of {type(model).__name__} cannot be exported: train with PPO, SAC or TQC")
    linear = [layer for layer in layers if isinstance(layer, nn.Linear)]
    between = [type(layer) for layer in layers if not isinstance(layer, nn.Linear)]
    regular = len(between) == len(linear) and len({*between}) <= 1 and isinstance(head, nn.Linear)
    if not regular or any(kind not in _ACTIVATIONS for kind in between):
        raise ValueError("only linear layers with nn.Tanh or with nn.ReLU between them can be exported")
    if not normalize.norm_obs or normalize.clip_obs != Network.CUT:
        raise ValueError(f"observations must be normalised with norm_obs=True and clip_obs={Network.CUT:g}")
    statistics: Any = normalize.obs_rms
    return Network(
        mean=np.array(statistics.mean, float),
        scale=np.sqrt(statistics.var + normalize.epsilon),
        weights=tuple(_array(layer.weight) for layer in (*linear, head)),
        biases=tuple(_array(layer.bias) for layer in (*linear, head)),
        activation=_ACTIVATIONS[between[0]] if between else "tanh",
        squash=squash,
    )


def bundle_from_sb3(
    model: BaseAlgorithm,
    normalize: VecNormalize,
    *,
    env_id: str,
    base: Base,
    action_mapping: Shift | Residual,
    features: tuple[str, ...],
    card: Mapping[str, Any],
) -> Bundle:
    """Creates a bundle from a model; arguments as for :class:`Bundle` and :func:`network_from_sb3`.

    Raises:
        ValueError: if the model cannot be exported, or the arguments are inconsistent.
    """
    network = network_from_sb3(model, normalize)
    return Bundle(
        env_id=env_id, base=base, action_mapping=action_mapping, features=features, network=network, card=card
    )


def zero_network(features: int, actions: int) -> Network:
    """A network of the given sizes with output 0 for every input; its policy is the base law alone."""
    zeros = (np.zeros((actions, features)),)
    return Network(mean=np.zeros(features), scale=np.ones(features), weights=zeros, biases=(np.zeros(actions),))


def _array(values: Any) -> Array:
    return values.detach().cpu().numpy().astype(float)
