"""Training by gradients through the inverse dynamics: no episodes, no noise, and the payload itself as the objective.

The base law tracks a shifted reference almost exactly, so that demands and tensions follow from the shifted motion
alone. Each training motion i has a payload m_i, a variable like the network's weights θ, and what is minimised is

    −mean m_i / scale + ρ · mean of squared violations,

of ``|demand| ≤ 1`` with the payload and without it, and of ``tension ≥ minimum`` likewise, at instants between the
decisions; ρ rises from round to round. On a fixed motion demands and tensions are affine in the mass, so that what
holds at both ends holds between them. Rounds are L-BFGS with a strong Wolfe search over all motions at once: what is
sought is the edge of a feasible set, on which first-order steps crawl.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

try:
    import torch
    from torch import Tensor, nn
except ImportError as error:
    raise ImportError("training needs torch: pip install 'cablebot-gym[sb3]'", name=error.name) from error

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.differentiable import asked
from cablebot_baselines.learned.features import feature_symmetry, feature_values
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.steering import Shift
from cablebot_baselines.learned.symmetry import SymmetricLayers, symmetries
from cablebot_gym.envs.observation import observed_reference
from cablebot_gym.robots import Robot
from cablebot_gym.task import Limits
from cablebot_gym.trajectories import Trajectory

PAYLOAD_SCALE = 10.0
"""Of payloads in the objective [kg]."""

VIOLATION_WEIGHT = 20.0
"""Of violations in the objective, with ρ."""

HISTORY = 50
"""Of L-BFGS."""

SHORTEST = 5
"""Evaluations; a search that ends sooner has nothing left to find."""

_EDGE = 1e-9
"""First and last instant of a decision lie within it by this share: derivatives of a spline jump at its knots."""


@dataclass(frozen=True, kw_only=True)
class GradientSettings:
    """Hyperparameters.

    Raises:
        ValueError: if a number is out of its range.
    """

    hidden: tuple[int, ...] = ()
    """Units of the network's layers; none for a linear one. A ``symmetric`` one has as many for each symmetry."""
    symmetric: bool = False
    """Whether the network turns and mirrors with a planar robot, see :mod:`cablebot_baselines.learned.symmetry`."""
    rounds: tuple[float, ...] = (30.0, 100.0, 300.0, 1000.0, 3000.0)
    """ρ of each round."""
    softness: tuple[float, ...] = ()
    """Of a planar robot's tensions in each round [N], see :func:`~cablebot_baselines.learned.differentiable.asked`; none for the
    least ones that the laws have: with joint springs their kinks are jumps of a demand, where no search gets past."""
    iterations: int = 250
    """Evaluations of the objective in each round, a few more or less. Where a kink ends a search, it starts anew."""
    instants: int = 3
    """Per decision at which limits are looked at; ≥ 2."""
    demand: float = 0.998
    """Largest drive command; > 0. What is left is for feedback."""
    tension: float = 2.0
    """Least tension without payload and with it [N]."""
    tension_scale: float = 20.0
    """Of tensions that are too low [N]; a demand's is 1."""
    lighter: float = 0.0
    """By how much of itself the platform may be lighter than told."""
    decay: float = 1e-6
    """On the squared weights of the network."""
    spread: float = 0.01
    """Of the last layer's first weights."""

    def __post_init__(self) -> None:
        if min(self.iterations, self.instants - 1, *self.hidden) < 1 or not self.rounds:
            raise ValueError("hidden and iterations must be at least 1, instants at least 2, rounds not empty")
        if self.softness and len(self.softness) != len(self.rounds):
            raise ValueError(f"softness must have a number for each of the {len(self.rounds)} rounds, or none")
        if not all(0 <= value < math.inf for value in self.softness):
            raise ValueError(f"softness must be at least 0, not {self.softness}")
        for name in ("demand", "spread", "tension_scale"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be greater than 0, not {getattr(self, name)!r}")
        if not 0 <= self.lighter < 1:
            raise ValueError(f"lighter must be at least 0 and below 1, not {self.lighter!r}")


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Where training stands."""

    round: int
    """From 1."""
    evaluations: int
    """Of the objective, in this round."""
    payload: float
    """Mean of the motions' payloads [kg]."""
    violation: float
    """Largest."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Motions:
    """Training motions at all decisions; each of M motions is filled up to the most decisions D."""

    inputs: Tensor
    """Features, (M, D, features)."""
    anchors: Tensor
    """What control points are counted from, from ``degree`` ones before the start on, (M, degree + D, n)."""
    reference: Tensor
    """X_d and its derivatives, (M, D, instants, order + 1, n)."""
    inside: Tensor
    """Whether the instant belongs to the motion, (M, D, instants)."""


@dataclass(kw_only=True, eq=False)
class GradientTraining:
    """A network that shifts references so that the most is carried along them.

    Raises:
        ValueError: if a feature depends on what the policy does: then decisions would not be known at once; or a
            softness is given for a spatial robot.
    """

    robot: Robot
    """Nominal."""
    trajectories: Sequence[Trajectory]
    """To train on."""
    way: Shift
    """How actions become shifts."""
    features: tuple[str, ...]
    """What the network reads."""
    seed: int = 0
    """Of the network's first weights."""
    settings: GradientSettings = field(default_factory=GradientSettings)
    limits: Limits = field(default_factory=Limits)
    """Bounds that the shift stays in."""
    minimum_tension: float = 5.0
    """T_min of the base law of a planar robot [N]."""
    payload: float = 1.0
    """Of each motion, at first [kg]."""

    def __post_init__(self) -> None:
        own = ("shift", "shift_velocity", "actions", "error", "pose", "velocity", "motor_angle", "motor_speed")
        if wrong := [name for name in self.features if name in (*own, "told_payload", "payload_known")]:
            raise ValueError(f"gradients go through the reference alone: feature {wrong[0]!r} says more, leave it out")
        if self.settings.softness and not self.robot.planar:
            raise ValueError(f"softness is for planar cables, and {self.robot.name!r} is spatial: leave it out")
        torch.manual_seed(self.seed)
        n = self.robot.coordinates
        self._order = 4 if self.robot.flexible else 2
        self._bounds = torch.tensor(self.way.bounds(self.limits, n))
        within = self.way.hold * np.linspace(_EDGE, 1 - _EDGE, self.settings.instants)
        self._within = within
        self._weights = torch.tensor(self.way.weights(within, self.way.hold)[:, : self._order + 1])
        self._motions = self._tabulated()
        seen = self._motions.inputs[self._motions.inside[..., 0]]
        moves = symmetries(self.robot) if self.settings.symmetric else np.eye(n)[None]
        reads = [feature_symmetry(self.features, self.robot, move) for move in moves]
        self._layers = SymmetricLayers(np.array(reads), moves, self.settings.hidden)
        self._mean, scale = self._layers.statistics(seen)
        self._scale = torch.where(scale > 1e-9, scale, 1.0)
        last = self._layers.layers[-1]
        with torch.no_grad():
            last.weight.normal_(std=self.settings.spread)
            last.bias.zero_()
        self._variables = [parameter for layer in self._layers.layers for parameter in layer.parameters()]
        self._payloads = torch.full((len(self.trajectories),), self.payload, dtype=torch.float64, requires_grad=True)
        self.evaluations = 0
        """Of the objective, in the present round."""
        self._softness = 0.0

    def _tabulated(self) -> _Motions:
        hold, degree, n = self.way.hold, self.way.degree, self.robot.coordinates
        most = max(math.ceil(trajectory.duration / hold - 1e-9) for trajectory in self.trajectories)
        decisions = np.arange(most) * hold
        instants = decisions[:, None] + self._within
        inputs, anchors, references, inside = [], [], [], []
        for trajectory in self.trajectories:
            blocks = observed_reference(trajectory, decisions, to_snap=self.robot.flexible)
            inputs.append(feature_values(self.features, blocks, {"elapsed": decisions[:, None]}))
            start = np.repeat(trajectory(np.zeros(1)).position, degree, axis=0)
            ahead = trajectory(decisions + self.way.lead).position
            anchors.append(np.concatenate([start, ahead]) if self.way.lead else np.zeros((degree + most, n)))
            motion = trajectory(instants)
            derivatives = (motion.position, motion.velocity, motion.acceleration, motion.jerk, motion.snap)
            references.append(np.stack(derivatives[: self._order + 1], axis=-2))
            inside.append(instants <= trajectory.duration)
        return _Motions(
            inputs=torch.tensor(np.stack(inputs)),
            anchors=torch.tensor(np.stack(anchors)),
            reference=torch.tensor(np.stack(references)),
            inside=torch.tensor(np.stack(inside)),
        )

    def _actions(self, inputs: Tensor) -> Tensor:
        values = ((inputs - self._mean) / self._scale).clamp(-Network.CUT, Network.CUT)
        weights = self._layers.weights()
        for place, (weight, bias) in enumerate(weights):
            values = nn.functional.linear(values, weight, bias)
            if place < len(weights) - 1:
                values = torch.tanh(values)
        lines = min(3, values.shape[-1])
        square = values[..., :lines].square().sum(-1, keepdim=True)
        rest = values[..., lines:]
        return torch.cat([values[..., :lines] / (1 + square).sqrt(), rest / (1 + rest.square()).sqrt()], dim=-1)

    def motion(self) -> Tensor:
        """The motions to be followed and their derivatives, (M, D, instants, order + 1, n)."""
        motions = self._motions
        actions = self._actions(motions.inputs)
        before = torch.zeros((len(actions), self.way.degree, actions.shape[-1]), dtype=torch.float64)
        points = torch.cat([before, actions * self._bounds], dim=1) + motions.anchors
        pieces = points.unfold(1, self.way.degree + 1, 1)
        spline = torch.einsum("jod,mknd->mkjon", self._weights, pieces)
        return spline if self.way.lead else motions.reference + spline

    def _violations(self) -> list[Tensor]:
        """By how much limits are broken, each ≥ 0."""
        settings, robot, inside = self.settings, self.robot, self._motions.inside
        flat = self.motion()[inside]
        payloads = self._payloads[:, None, None].expand(inside.shape)[inside]
        light = torch.full_like(payloads, robot.mass * (1 - settings.lighter))
        asks = asked(
            robot,
            [level.repeat(2, 1) for level in flat.unbind(1)],
            torch.cat([light, robot.mass + payloads]),
            minimum=self.minimum_tension,
            softness=self._softness,
        )
        broken = [torch.relu(asks.demand.abs() - settings.demand)]
        if not robot.planar:  # least tensions of a planar robot keep the minimum by themselves
            broken.append(torch.relu(settings.tension - asks.tensions) / settings.tension_scale)
        if self.way.lead:  # then nothing else keeps the motion in the tube
            away = (flat - self._motions.reference[inside])[:, 0] / self._bounds * self.way.share
            broken.append(torch.relu(torch.linalg.norm(away[:, :3], dim=1) - self.way.share))
            broken.append(torch.relu(away[:, 3:].abs() - self.way.share))
        return [value.flatten() for value in broken]

    def run(self, report: Callable[[Progress], None] = lambda _: None) -> None:
        """All rounds, with a report of each. After an interrupt the network is what the last evaluation made of it."""
        for number in range(len(self.settings.rounds)):
            self.round(number, report)

    def round(self, number: int, report: Callable[[Progress], None] = lambda _: None) -> None:
        """The round of this number, from 0 on, with reports of its progress.

        It depends on weights and payloads alone, so that a run can go on between two.
        """
        variables, weight = [*self._variables, self._payloads], self.settings.rounds[number]
        self.evaluations = 0
        self._softness = self.settings.softness[number] if self.settings.softness else 0.0

        def objective() -> Tensor:
            for variable in variables:
                variable.grad = None
            broken = torch.cat(self._violations())
            loss = VIOLATION_WEIGHT * weight * broken.square().mean() - self._payloads.mean() / PAYLOAD_SCALE
            loss = loss + self.settings.decay * sum(value.square().sum() for value in self._variables)
            torch.autograd.backward(loss)
            self.evaluations += 1
            report(
                Progress(
                    round=number + 1,
                    evaluations=self.evaluations,
                    payload=float(self._payloads.detach().mean()),
                    violation=float(broken.detach().max()),
                )
            )
            return loss

        while self.evaluations < self.settings.iterations:
            before = self.evaluations
            optimiser: Any = torch.optim.LBFGS(
                variables,
                max_iter=self.settings.iterations - before,
                max_eval=self.settings.iterations - before,
                history_size=HISTORY,
                line_search_fn="strong_wolfe",
                tolerance_grad=1e-9,
                tolerance_change=1e-12,
            )
            optimiser.step(objective)
            if self.evaluations - before < SHORTEST:
                break

    def state(self) -> dict[str, Array]:
        """What training changes, as arrays by name; :meth:`restore` reads them."""
        values = {f"variable{place}": value.detach().numpy().copy() for place, value in enumerate(self._variables)}
        return values | {"payloads": self.payloads}

    def restore(self, arrays: Mapping[str, Array]) -> None:
        """Goes back to a state.

        Raises:
            ValueError: if it is another training's.
        """
        here = self.state()
        if {name: value.shape for name, value in here.items()} != {name: np.shape(arrays[name]) for name in arrays}:
            raise ValueError("the checkpoint's arrays are those of another training: start again with another --out")
        with torch.no_grad():
            for place, value in enumerate(self._variables):
                value.copy_(torch.tensor(arrays[f"variable{place}"]))
            self._payloads.copy_(torch.tensor(arrays["payloads"]))

    @property
    def payloads(self) -> Array:
        """Of each motion, by the equations [kg]."""
        return self._payloads.detach().numpy().copy()

    @property
    def network(self) -> Network:
        """As plain arrays."""
        layers = [tuple(value.detach().numpy().copy() for value in layer) for layer in self._layers.weights()]
        return Network(
            mean=self._mean.numpy().copy(),
            scale=self._scale.numpy().copy(),
            weights=tuple(weight for weight, _ in layers),
            biases=tuple(bias for _, bias in layers),
            squash="ball",
        )
