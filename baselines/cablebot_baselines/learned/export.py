"""From a model of Stable-Baselines3 to the arrays that ship: the actor's mean behind the normalisation it was given."""

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
    """The deterministic actor of an ``MlpPolicy`` of PPO, SAC or TQC: what ``predict(…, deterministic=True)`` gives.

    PPO's means beyond ±1 stay: whoever acts on them cuts them, as SB3 does.

    Args:
        model: trained.
        normalize: what it saw its observations through.

    Raises:
        ValueError: if the policy has parts that a :class:`Network` cannot have, or observations are not normalised.
    """
    policy: Any = model.policy
    if hasattr(policy, "actor"):
        layers, head, squash = list(policy.actor.latent_pi), policy.actor.mu, "tanh"
    elif hasattr(policy, "action_net"):
        layers, head, squash = list(policy.mlp_extractor.policy_net), policy.action_net, "none"
        if policy.squash_output:
            raise ValueError("a PPO policy with squash_output cannot be exported: leave squash_output out")
    else:
        raise ValueError(f"a policy of {type(model).__name__} cannot be exported: train with PPO, SAC or TQC")
    linear = [layer for layer in layers if isinstance(layer, nn.Linear)]
    between = [type(layer) for layer in layers if not isinstance(layer, nn.Linear)]
    regular = len(between) == len(linear) and len({*between}) <= 1 and isinstance(head, nn.Linear)
    if not regular or any(kind not in _ACTIVATIONS for kind in between):
        raise ValueError("only linear layers with nn.Tanh or with nn.ReLU between them can be exported")
    if not normalize.norm_obs or normalize.clip_obs != Network.CUT:
        raise ValueError(f"observations must be normalised, with norm_obs and clip_obs = {Network.CUT:g}")
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
    way: Shift | Residual,
    features: tuple[str, ...],
    card: Mapping[str, Any],
) -> Bundle:
    """A model with what it steers; arguments as for :class:`Bundle` and :func:`network_from_sb3`.

    Raises:
        ValueError: if the model cannot be exported, or the parts do not fit each other.
    """
    network = network_from_sb3(model, normalize)
    return Bundle(env_id=env_id, base=base, way=way, features=features, network=network, card=card)


def silent_network(features: int, actions: int) -> Network:
    """A network of so many features and actions that says 0 whatever it reads: its policy is the base law alone."""
    zeros = (np.zeros((actions, features)),)
    return Network(mean=np.zeros(features), scale=np.ones(features), weights=zeros, biases=(np.zeros(actions),))


def _array(values: Any) -> Array:
    return values.detach().cpu().numpy().astype(float)
