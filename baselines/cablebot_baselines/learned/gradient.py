"""Analytic policy gradient (APG): training by gradients through the inverse dynamics, with the
payload as objective.

Training uses no episodes and no noise. The base law tracks a shifted reference almost exactly, so
that actions and tensions follow from the shifted motion alone. Each training motion i has a payload
m_i, which is optimised together with the network's weights θ. The objective to minimise is

    −mean m_i / scale + ρ · mean of squared violations

of ``|action| ≤ 1`` and ``tension ≥ minimum``, both with and without payload, at instants between
the decisions. ρ increases from round to round. On a fixed motion, actions and tensions are affine
in the mass, so that constraints that hold at both ends hold in between. Each round runs L-BFGS with
a strong Wolfe line search over all motions at once: the optimum lies on the boundary of the
feasible set, where first-order steps converge slowly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

try:
    import torch
    from torch import Tensor, nn
except ImportError as error:
    raise ImportError(
        "training needs torch: pip install 'cablebot-gym[sb3]'", name=error.name
    ) from error

from cablebot_baselines.classical.law import Array
from cablebot_baselines.learned.differentiable import required_actuation
from cablebot_baselines.learned.features import feature_values, is_planned
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.steering import Shift
from cablebot_gym.envs.observation import observed_reference
from cablebot_gym.robots import Robot
from cablebot_gym.task import find_error_bounds, start_pose
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.utils.checks import number, numbers, whole

PAYLOAD_SCALE = 10.0
"""Scale of the payloads in the objective [kg]."""

VIOLATION_WEIGHT = 20.0
"""Weight of the violations in the objective; multiplied by ρ."""

HISTORY = 50
"""History size of L-BFGS."""

SHORTEST = 5
"""Number of evaluations; a search that ends sooner has converged."""

_EDGE = 1e-9
"""Inset of a decision's first and last instant, as a fraction of it: a spline's derivatives jump at
its knots."""


@dataclass(frozen=True, kw_only=True)
class GradientSettings:
    """Hyperparameters of the training.

    Raises:
        ValueError: if a number is out of its range.
    """

    hidden: tuple[int, ...] = ()
    """Hidden units of each layer; empty for a linear network."""
    rounds: tuple[float, ...] = (30.0, 100.0, 300.0, 1000.0, 3000.0)
    """Penalty weight ρ of each round."""
    softness: tuple[float, ...] = ()
    """Smoothing of a planar robot's tensions in each round [N], see
    :func:`~cablebot_baselines.learned.differentiable.required_actuation`; empty for none. With
    joint springs, a kink of an unsmoothed tension is a jump of the action, which stops the line
    search."""
    iterations: int = 250
    """Approximate number of evaluations of the objective in each round. A search that stops at a
    kink is restarted."""
    instants: int = 3
    """Number of instants per decision at which constraints are evaluated; ≥ 2."""
    action_limit: float = 0.998
    """Largest action; > 0. The remainder is left for feedback."""
    tension: float = 2.0
    """Minimum tension of a spatial robot, with and without payload [N]; at least that of the
    robot."""
    tension_scale: float = 20.0
    """Scale of violations of the minimum tension [N]; the scale of actions is 1."""
    decay: float = 1e-6
    """Weight of the squared network weights in the objective."""
    spread: float = 0.01
    """Standard deviation of the last layer's initial weights."""

    def __post_init__(self) -> None:
        whole("iterations", self.iterations, least=1)
        whole("instants", self.instants, least=2)
        numbers("rounds", self.rounds, above=0.0)
        numbers("softness", self.softness or (0.0,), least=0.0)
        if not self.rounds or len(self.softness) not in (0, len(self.rounds)):
            raise ValueError(
                "rounds must not be empty, and softness must be empty or have one number for each round"
            )
        for name in ("action_limit", "spread", "tension_scale"):
            number(name, getattr(self, name), above=0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Motions:
    """Training motions at all decisions; each of the M motions is padded to the largest number of
    decisions D."""

    inputs: Tensor
    """Features, (M, D, features)."""
    anchors: Tensor
    """Origins of the control points, from ``degree`` points before the start on, (M, degree + D,
    n). Before the start they are those of the start pose."""
    reference: Tensor
    """X_d and its derivatives, (M, D, instants, order + 1, n)."""
    inside: Tensor
    """Whether an instant is within the motion, (M, D, instants)."""


@dataclass(kw_only=True, eq=False)
class GradientTraining:
    """Training of a network that shifts references to maximise the payload.

    Raises:
        ValueError: if a feature depends on the state or on past actions, so that the actions cannot
            be computed in one pass; if ``softness`` is given for a spatial robot; or if the minimum
            tension is below the robot's.
    """

    robot: Robot
    """Nominal robot."""
    trajectories: Sequence[Trajectory]
    """Training motions."""
    action_mapping: Shift
    """Mapping from actions to shifts."""
    features: tuple[str, ...]
    """Names of the network's inputs."""
    seed: int = 0
    """Seed of the network's initial weights."""
    settings: GradientSettings = field(default_factory=GradientSettings)
    minimum_tension: float = 5.0
    """Least tension that the base law allocates with more cables than coordinates [N]."""

    @property
    def _redundant(self) -> bool:
        return self.robot.cables > self.robot.coordinates

    def __post_init__(self) -> None:
        self._check()
        torch.manual_seed(self.seed)
        robot = self.robot
        mapping = self.action_mapping
        error_bounds = find_error_bounds(None, robot)
        self._order = 4 if robot.flexible else 2
        self._bounds = torch.tensor(mapping.bounds(error_bounds, robot))
        self._within = mapping.action_period * np.linspace(_EDGE, 1 - _EDGE, self.settings.instants)
        weights = mapping.weights(self._within, mapping.action_period)
        self._weights = torch.tensor(weights[:, : self._order + 1])
        start_shifts = []
        for trajectory in self.trajectories:
            start = start_pose(robot, trajectory, error_bounds)
            start_shifts.append(start - trajectory(0.0).position)
        self._start_shifts = np.array(start_shifts)  # (M, n)
        self._motions = self._tabulated()
        self._make_layers()
        self._payloads = torch.ones(len(self.trajectories), dtype=torch.float64, requires_grad=True)
        self.evaluations = 0
        """Evaluations of the objective in the current round."""
        self._softness = 0.0

    @property
    def rounds(self) -> int:
        """Number of rounds."""
        return len(self.settings.rounds)

    def _check(self) -> None:
        for name in self.features:
            if not is_planned(name):
                raise ValueError(
                    f"features must depend on the reference and time alone: remove {name!r}"
                )
        tension = self.minimum_tension if self._redundant else self.settings.tension
        least = self.robot.minimum_tension
        if tension < least:
            raise ValueError(
                f"the minimum tension {tension:g} N is below the robot's {least:g} N: raise it"
            )
        if self.settings.softness and (self.robot.kind, self.robot.cables) != ("planar", 3):
            raise ValueError(
                f"softness is for planar robots with three cables, not for {self.robot.name!r}: remove it"
            )

    def _make_layers(self) -> None:
        inputs = self._motions.inputs[self._motions.inside[..., 0]]
        sizes = (inputs.shape[-1], *self.settings.hidden, self.robot.coordinates)
        self._layers: Any = nn.ModuleList()
        for size, outputs in pairwise(sizes):
            self._layers.append(nn.Linear(size, outputs, dtype=torch.float64))
        self._variables = list(self._layers.parameters())
        self._mean = inputs.mean(0)
        scale = inputs.std(0)
        self._scale = torch.where(scale > 1e-9, scale, 1.0)
        start = torch.tensor(self._start_shifts.mean(0)) / self._bounds
        *_, weight, bias = self._variables
        with torch.no_grad():
            weight.normal_(std=self.settings.spread)
            # The first motions stay where they start: this is the inverse of the squash.
            bias.copy_(start / (1 - start.square()).sqrt())

    def _tabulated(self) -> _Motions:
        action_period = self.action_mapping.action_period
        degree = self.action_mapping.degree
        preview = self.action_mapping.preview
        longest = max(trajectory.duration for trajectory in self.trajectories)
        count = math.ceil(longest / action_period - 1e-9)
        decisions = np.arange(count) * action_period
        instants = decisions[:, None] + self._within
        inputs, anchors, references, inside = [], [], [], []
        for trajectory, start_shift in zip(self.trajectories, self._start_shifts, strict=True):
            blocks = observed_reference(trajectory, decisions, to_snap=self.robot.flexible)
            inputs.append(
                feature_values(self.features, blocks, {"time_since_start": decisions[:, None]})
            )
            # Without a preview the spline is the shift alone.
            origins = np.zeros((degree + count, self.robot.coordinates))
            if preview:
                origins[:degree] = trajectory(0.0).position
                origins[degree:] = trajectory(decisions + preview).position
            origins[:degree] += start_shift
            anchors.append(origins)
            motion = trajectory(instants)
            derivatives = (
                motion.position,
                motion.velocity,
                motion.acceleration,
                motion.jerk,
                motion.snap,
            )
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
        *hidden, last = self._layers
        for layer in hidden:
            values = torch.tanh(layer(values))
        values = last(values)
        # The squash "ball" of the network.
        position = values[..., :3]
        angles = values[..., 3:]
        square = position.square().sum(-1, keepdim=True)
        return torch.cat(
            [position / (1 + square).sqrt(), angles / (1 + angles.square()).sqrt()], dim=-1
        )

    def motion(self) -> Tensor:
        """The shifted motions and their derivatives, (M, D, instants, order + 1, n)."""
        motions = self._motions
        actions = self._actions(motions.inputs)
        before = torch.zeros(
            (len(actions), self.action_mapping.degree, actions.shape[-1]), dtype=torch.float64
        )
        points = torch.cat([before, actions * self._bounds], dim=1) + motions.anchors
        pieces = points.unfold(1, self.action_mapping.degree + 1, 1)
        spline = torch.einsum("jod,mknd->mkjon", self._weights, pieces)
        return spline if self.action_mapping.preview else motions.reference + spline

    def _violations(self) -> list[Tensor]:
        """Violations of the constraints, each ≥ 0."""
        settings = self.settings
        robot = self.robot
        inside = self._motions.inside
        motion = self.motion()[inside]
        payloads = self._payloads[:, None, None].expand(inside.shape)[inside]
        light = torch.full_like(payloads, robot.mass)
        required = required_actuation(
            robot,
            [derivative.repeat(2, 1) for derivative in motion.unbind(1)],
            torch.cat([light, robot.mass + payloads]),
            minimum=self.minimum_tension,
            softness=self._softness,
        )
        violations = [torch.relu(required.action.abs() - settings.action_limit)]
        # Between the cables of a point in a plane, the distribution keeps the minimum.
        if robot.kind != "planar":
            least = self.minimum_tension if self._redundant else settings.tension
            violations.append(torch.relu(least - required.tensions) / settings.tension_scale)
        # Without a preview the shift stays within the error bounds by construction.
        if self.action_mapping.preview:
            fraction = self.action_mapping.fraction
            shift = motion - self._motions.reference[inside]
            error = shift[:, 0] / self._bounds * fraction
            d = robot.dimensions
            violations.append(torch.relu(torch.linalg.norm(error[:, :d], dim=1) - fraction))
            violations.append(torch.relu(error[:, d:].abs() - fraction))
        return [violation.flatten() for violation in violations]

    def round(self, index: int, report: Callable[[], None] = lambda: None) -> None:
        """Runs round ``index``, counted from 0, and calls ``report`` after each evaluation of the
        objective.

        A round depends on weights and payloads alone, so that a run can be resumed between two
        rounds. After an interrupt the network has the weights of the last evaluation.
        """
        variables = [*self._variables, self._payloads]
        weight = self.settings.rounds[index]
        self.evaluations = 0
        if self.settings.softness:
            self._softness = self.settings.softness[index]

        def objective() -> Tensor:
            for variable in variables:
                variable.grad = None
            violations = torch.cat(self._violations())
            penalty = VIOLATION_WEIGHT * weight * violations.square().mean()
            squares = sum(variable.square().sum() for variable in self._variables)
            loss = penalty - self._payloads.mean() / PAYLOAD_SCALE
            loss = loss + self.settings.decay * squares
            torch.autograd.backward(loss)
            self.evaluations += 1
            report()
            return loss

        while self.evaluations < self.settings.iterations:
            evaluations_before = self.evaluations
            remaining = self.settings.iterations - self.evaluations
            optimiser: Any = torch.optim.LBFGS(
                variables,
                max_iter=remaining,
                max_eval=remaining,
                history_size=HISTORY,
                line_search_fn="strong_wolfe",
                tolerance_grad=1e-9,
                tolerance_change=1e-12,
            )
            optimiser.step(objective)
            if self.evaluations - evaluations_before < SHORTEST:
                break

    def state(self) -> dict[str, Array]:
        """State of the training as arrays by name, for :meth:`restore`."""
        arrays = {"payloads": self.payloads}
        for index, variable in enumerate(self._variables):
            arrays[f"variable{index}"] = _array(variable)
        return arrays

    def restore(self, arrays: Mapping[str, Array]) -> None:
        """Restores a state of the same configuration."""
        with torch.no_grad():
            for index, variable in enumerate(self._variables):
                variable.copy_(torch.tensor(arrays[f"variable{index}"]))
            self._payloads.copy_(torch.tensor(arrays["payloads"]))

    @property
    def payloads(self) -> Array:
        """Optimised payload of each motion [kg]."""
        return _array(self._payloads)

    @property
    def network(self) -> Network:
        """The network as plain arrays."""
        return Network(
            mean=_array(self._mean),
            scale=_array(self._scale),
            weights=tuple(_array(layer.weight) for layer in self._layers),
            biases=tuple(_array(layer.bias) for layer in self._layers),
            squash="ball",
        )


def _array(values: Tensor) -> Array:
    return values.detach().numpy().copy()
