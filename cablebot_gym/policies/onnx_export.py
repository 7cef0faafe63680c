"""A model of Stable-Baselines3 as one ONNX graph, with the scaling of its observation and action."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from cablebot_gym.envs.observation import observation_layout
from cablebot_gym.policies.adapters import NormalisedPolicy, WrappedPolicy
from cablebot_gym.policies.onnx import ACTION, OBSERVATION, metadata
from cablebot_gym.policies.wrappers import NORMALISED
from cablebot_gym.robots import Robot

PACKAGES = ("stable_baselines3", "sb3_contrib")
ALGORITHMS = ("PPO", "A2C", "SAC", "TD3", "DDPG", "TQC", "TRPO")
"""Packages and algorithms whose models can be exported."""

ACTIVATIONS = {"Tanh": "Tanh", "ReLU": "Relu", "Sigmoid": "Sigmoid"}
"""ONNX operators of layers, those that ONNX Runtime computes in float64."""

OPSET, IR_VERSION = 17, 8
"""Versions of ONNX's operators and file format, of 2022: older runtimes read the file too."""


def import_onnx() -> None:
    """Checks that files can be written.

    Raises:
        ImportError: if the package is missing; the message names the command that installs it.
    """
    try:
        import_module("onnx")
    except ImportError:
        raise ImportError("the export needs onnx: pip install 'cablebot-gym[onnx]'") from None


def not_exportable(name: str, reason: str) -> ValueError:
    """The error about a policy that cannot be exported."""
    return ValueError(
        f"policy {name!r} cannot be exported: {reason}. `cablebot export-policy` exports .zip models "
        f"of Stable-Baselines3 and sb3-contrib ({', '.join(ALGORITHMS)}), with VecNormalize"
    )


class _Chain:
    """Nodes one after the other, in float64. ``value`` is the name of the last result."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []
        self.value = OBSERVATION

    def add(self, operator: str, *constants: Any, **attributes: Any) -> None:
        """Adds a node that takes the last result and constants."""
        from onnx import helper, numpy_helper

        inputs = [self.value]
        for constant in constants:
            inputs.append(f"constant_{len(self.constants)}")
            array = np.asarray(constant, np.float64)
            self.constants.append(numpy_helper.from_array(array, inputs[-1]))
        self.value = f"value_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, inputs, [self.value], **attributes))


class ExportableModel:
    """A model of Stable-Baselines3 without the adapters in which it was loaded.

    Args:
        name: name of the policy, for messages.
        policy: the loaded policy.
        robot: nominal robot.

    Raises:
        ValueError: if the policy is no such model, or has wrappers other than ``VecNormalize``.
    """

    def __init__(self, name: str, policy: Any, robot: Robot) -> None:
        self.robot = robot
        self._name = name
        self._layout = observation_layout(robot)
        self._normalised = False
        self._statistics: Any = None
        if isinstance(policy, NormalisedPolicy):
            self._normalised = True
            policy = policy.model
        elif isinstance(policy, WrappedPolicy):
            stack = policy.stack
            self._normalised = NORMALISED in stack.names
            for layer in stack.layers():
                if type(layer).__name__ == "VecNormalize":
                    self._statistics = layer
            known = self._normalised + (self._statistics is not None)
            if len(stack.names) > known:
                wrappers = ", ".join(stack.names)
                raise not_exportable(name, f"it has the wrappers {wrappers}")
            policy = policy.policy
        algorithm = type(policy).__name__
        package = type(policy).__module__.partition(".")[0]
        if package not in PACKAGES or algorithm not in ALGORITHMS:
            raise not_exportable(name, f"it is of the type {algorithm}")
        self._network = policy.policy

    def compute_in_float64(self) -> None:
        """Makes the model compute in float64. It still rounds its observation to float32."""
        from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

        self._network.double()
        for module in self._network.modules():
            if isinstance(module, BaseFeaturesExtractor):
                module.register_forward_pre_hook(lambda _, inputs: (inputs[0].double(),))

    def to_onnx(self, **texts: str) -> bytes:
        """Content of a file with further texts as metadata. Its input is the observation of the
        environment, (N, size), and its output the deterministic action, (N, m)."""
        from onnx import TensorProto, helper

        double = TensorProto.DOUBLE
        chain = _Chain()
        self._add_scaling(chain)
        # Stable-Baselines3 rounds what the network reads.
        chain.add("Cast", to=TensorProto.FLOAT)
        chain.add("Cast", to=double)
        for layer in self._layers():
            self._add_layer(chain, layer)
        if self._network.squash_output:
            chain.add("Tanh")
        # Bounds of the action. Those of a squashed one are equal, so unscaling changes nothing.
        chain.add("Clip", -1.0, 1.0)
        chain.nodes[-1].output[0] = ACTION
        inputs = helper.make_tensor_value_info(OBSERVATION, double, ["N", self._layout.size])
        outputs = helper.make_tensor_value_info(ACTION, double, ["N", self.robot.cables])
        graph = helper.make_graph(chain.nodes, "policy", [inputs], [outputs], chain.constants)
        opsets = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION)
        helper.set_model_props(model, metadata(self.robot, **texts))
        return bytes(model.SerializeToString())

    def _add_scaling(self, chain: _Chain) -> None:
        """Adds the environment's normalisation and that of ``VecNormalize``, where the model has
        them."""
        if self._normalised:
            differences = np.eye(self._layout.size)
            slices = self._layout.slices()
            for block in self._layout.blocks:
                if block.relative_to:
                    differences[slices[block.relative_to], block.slice] = -np.eye(block.size)
            chain.add("MatMul", differences)
            chain.add("Sub", self._layout.centre)
            chain.add("Mul", self._layout.per_scale)
        statistics = self._statistics
        if statistics is not None and statistics.norm_obs:
            chain.add("Sub", statistics.obs_rms.mean)
            chain.add("Div", np.sqrt(statistics.obs_rms.var + statistics.epsilon))
            chain.add("Clip", -statistics.clip_obs, statistics.clip_obs)

    def _layers(self) -> list[Any]:
        """Layers of the actor in their order, without a last one that squashes."""
        network = self._network
        if hasattr(network, "mlp_extractor"):
            extractor = network.pi_features_extractor
            modules = [extractor, network.mlp_extractor.policy_net, network.action_net]
        else:
            actor = network.actor
            modules = [actor.features_extractor, actor.mu]
            if hasattr(actor, "latent_pi"):
                modules.insert(1, actor.latent_pi)
        layers = []
        for module in modules:
            for layer in module.modules():
                if not list(layer.children()):
                    layers.append(layer)
        if network.squash_output and type(layers[-1]).__name__ == "Tanh":  # as in TD3
            del layers[-1]
        return layers

    def _add_layer(self, chain: _Chain, layer: Any) -> None:
        """Adds a layer.

        Raises:
            ValueError: if there is no ONNX operator for it.
        """
        kind = type(layer).__name__
        if kind == "Linear":
            arrays = [value.detach().double().numpy() for value in layer.parameters()]
            chain.add("Gemm", *arrays, transB=1)
        elif kind == "Hardtanh":
            chain.add("Clip", layer.min_val, layer.max_val)
        elif kind in ACTIVATIONS:
            chain.add(ACTIVATIONS[kind])
        elif kind not in ("Flatten", "Identity", "Sequential"):  # an empty one is no layer
            valid = ", ".join(["Linear", *ACTIVATIONS])
            raise not_exportable(self._name, f"its network has a layer {kind}, not only {valid}")
