"""Training of a planning network by gradients through its motions.

The motion is the double integral of the planned accelerations, so that a rollout needs no physics
but two sums. The inverse dynamics then gives actions and tensions at all its instants at once. The
loss is the violations of the limits by robots with random strengths of the motors, wrenches and
payloads. Random accelerations move the platform off its plan, so that the network learns feedback.
The wall of the tube is not in the training: it would hide the errors that the network has to avoid.

Each training motion has a payload, which grows while the network carries it and shrinks otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import compress, pairwise
from typing import Any

import numpy as np

try:
    import torch
    from torch import Tensor
except ImportError as error:
    raise ImportError(
        "training needs torch: pip install 'cablebot-gym[sb3]'", name=error.name
    ) from error

from cablebot_baselines.classical.law import Array
from cablebot_baselines.classical.observer_law import UNCERTAINTY
from cablebot_baselines.estimation.expectation import Expectation
from cablebot_baselines.learned.differentiable import required_actuation
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.planner import (
    MASS_SCALE,
    RATE_TIME,
    Planning,
    Preview,
    error_scale,
    input_count,
    network_inputs,
    robot_inputs,
)
from cablebot_gym.bounds.closed_form import exact_payload
from cablebot_gym.robots import Robot
from cablebot_gym.task import find_error_bounds, start_pose
from cablebot_gym.trajectories import Trajectory
from cablebot_gym.uncertainty import find_uncertainty
from cablebot_gym.utils.checks import number, numbers, whole

STEP = 0.005
"""Time for which a planned acceleration is constant in training [s]. With 0.01 s the network learns
a feedback that exceeds the error bounds at shorter control periods."""

UNLOADED, HEAVIEST = 0.15, 0.4
"""Fractions of the episodes without payload and with the heaviest payload of their motion; the
payloads of the others are in between."""

GROWTH, SHRINKAGE = 1.06, 0.985
"""Factors of the payload of a motion that the network carries or does not carry."""

LINEAR = 0.02
"""Weight of the violations beside that of their squares."""

TENSION_SCALE = 20.0
"""Scale of violations of the minimum tension [N]; the scale of actions is 1."""

LARGEST_GRADIENT = 1.0
"""Norm at which gradients are clipped."""

WARM_UP = 10
"""Iterations until the learning rate is reached."""

LARGEST = 4.0
"""Largest first payload of a motion, as a multiple of the median of all motions."""

SPREAD = 0.05
"""Initial weights of the last layer, as a fraction of those of the others."""


@dataclass(frozen=True, kw_only=True)
class PlannerSettings:
    """Hyperparameters of the training.

    Raises:
        ValueError: if a number is out of its range.
    """

    hidden: tuple[int, ...] = (128, 128)
    """Hidden units of each layer."""
    rounds: int = 2
    """Number of rounds; the network is evaluated after each of them."""
    iterations: int = 500
    """Steps of Adam in each round."""
    batch: int = 64
    """Episodes of a step."""
    learning_rate: float = 1e-3
    """Largest learning rate of Adam; it falls to zero as a cosine."""
    action_margin: float = 0.03
    """Margin of the actions to ± 1."""
    tension_margin: float = 4.0
    """Margin to the minimum tension of the robot [N]."""
    error_margin: float = 0.12
    """Margin to the error bounds, as a fraction of them."""
    noise: float = 0.3
    """Standard deviation of the random accelerations [m/s², rad/s²]."""
    error_weight: float = 5.0
    """Weight of violations of the error bounds."""
    tolerance: float = 0.02
    """Largest violation with which a payload counts as carried."""

    def __post_init__(self) -> None:
        for name in ("rounds", "iterations", "batch"):
            whole(name, getattr(self, name), least=1)
        numbers("hidden", self.hidden, above=0.0)
        for name in ("learning_rate", "error_weight", "tolerance"):
            number(name, getattr(self, name), above=0.0)
        for name in ("tension_margin", "noise"):
            number(name, getattr(self, name), least=0.0)
        for name in ("action_margin", "error_margin"):
            number(name, getattr(self, name), least=0.0, below=1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Motions:
    """Training motions at all steps; each of the M motions is padded to the largest number S."""

    position: Tensor
    """X_d, (M, S + 1, n)."""
    velocity: Tensor
    """Ẋ_d, (M, S + 1, n)."""
    acceleration: Tensor
    """Ẍ_d, (M, S + 1, n)."""
    preview: Tensor
    """Inputs of the network, (M, S + 1, inputs)."""
    start: Tensor
    """Start poses, (M, n)."""
    steps: Tensor
    """Number of steps, (M,)."""

    def of(self, indices: Tensor) -> _Motions:
        """Some of the motions."""
        tables = {name: table[indices] for name, table in vars(self).items()}
        return _Motions(**tables)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Episodes:
    """Robots and payloads of a batch of N episodes."""

    motions: _Motions
    """Motion of each episode."""
    mass: Tensor
    """Mass of platform and payload, (N,) [kg]."""
    strength: Tensor
    """Strength of each motor, (N, m)."""
    disturbance: Tensor
    """Acceleration by a wrench, (N, n) [m/s², rad/s²]."""
    noise: Tensor
    """Random accelerations, (N, S, n) [m/s², rad/s²]."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Violations:
    """Violations of the limits at each step, each (N, S) and ≥ 0."""

    actuation: Tensor
    """Sum of those of actions and tensions."""
    error: Tensor
    """Those of the error bounds, in units of them."""
    squares: Tensor
    """Mean over the episodes of their squares and a small part of themselves, ()."""


@dataclass(kw_only=True, eq=False)
class PlannerTraining:
    """Training of a network that plans accelerations for the largest payload.

    Raises:
        ValueError: if the motors can track none of the motions without payload.
    """

    robot: Robot
    """Nominal rigid robot."""
    trajectories: Sequence[Trajectory]
    """Training motions."""
    planning: Planning
    """Meaning of the network's outputs."""
    seed: int = 0
    """Seed of the initial weights and of all random numbers."""
    settings: PlannerSettings = field(default_factory=PlannerSettings)

    def __post_init__(self) -> None:
        robot = self.robot
        error_bounds = find_error_bounds(None, robot)
        uncertainty = find_uncertainty(UNCERTAINTY, robot)
        self._expected = Expectation.of(robot, uncertainty)
        self._bounds = torch.tensor(error_scale(robot, error_bounds))
        self._acceleration = torch.tensor(self.planning.scale(robot))
        self._minimum = robot.minimum_tension + self.settings.tension_margin
        exact_payloads = []
        for motion in self.trajectories:
            exact_bound = exact_payload(robot, motion)
            exact_payloads.append(exact_bound.payload)
        # Slow motions allow payloads that no other motion needs.
        largest = LARGEST * float(np.median(exact_payloads))
        payloads = np.minimum(exact_payloads, largest)
        is_trackable = payloads > 0
        if not is_trackable.any():
            raise ValueError(
                "the motors cannot track any training motion without payload: choose other motions"
            )
        self.payloads = payloads[is_trackable]
        """Payload of each training motion that the motors can track without payload [kg]."""
        motions = list(compress(self.trajectories, is_trackable))
        starts = [start_pose(robot, motion, error_bounds) for motion in motions]
        self._motions = _tabulated(motions, np.array(starts))
        self._make_network()
        self.evaluations = 0
        """Steps of Adam in the current round."""

    @property
    def rounds(self) -> int:
        """Number of rounds."""
        return self.settings.rounds

    def _make_network(self) -> None:
        generator = torch.Generator().manual_seed(self.seed)
        inputs = input_count(self.robot)
        sizes = [inputs, *self.settings.hidden, self.robot.coordinates]
        self._variables: list[Tensor] = []
        for width, outputs in pairwise(sizes):
            shape = (outputs, width)
            weight = torch.randn(shape, dtype=torch.float64, generator=generator)
            weight /= math.sqrt(width)
            bias = torch.zeros(outputs, dtype=torch.float64)
            self._variables += [weight, bias]
        self._variables[-2] *= SPREAD
        for variable in self._variables:
            variable.requires_grad_(True)
        self._adam = torch.optim.Adam(self._variables)
        self._mean, self._scale = self._statistics()

    def _statistics(self) -> tuple[Tensor, Tensor]:
        """Mean and scale of the inputs of the network: those of the motions, and what is expected
        of errors and robots."""
        robot, motions = self.robot, self._motions
        zeros = torch.zeros(robot.coordinates).double()
        halves = torch.full((robot.coordinates,), 0.5).double()
        mean_payload = float(np.mean(self.payloads))
        # The masses are rounded to single precision, as in the shipped networks.
        mass = torch.tensor([robot.mass + mean_payload]).double()
        mass_scale = torch.tensor([mean_payload]).double()
        reciprocal_scale = torch.tensor([MASS_SCALE / robot.mass / 3]).double()
        strength = torch.ones(robot.cables).double()
        strength_scale = max(self._expected.strength_spread, 0.01) * strength
        steps = torch.arange(motions.preview.shape[1])
        inside = steps <= motions.steps[:, None]
        preview = motions.preview[inside]
        position = motions.position[inside]
        velocity = motions.velocity[inside]
        means = network_inputs(
            error=zeros,
            rate=zeros,
            preview=preview.mean(0),
            pose=position.mean(0),
            velocity=zeros,
            known=robot_inputs(mass, strength, zeros),
        )
        scales = network_inputs(
            error=halves,
            rate=halves,
            preview=preview.std(0) + 1e-6,
            pose=position.std(0) + 1e-3,
            velocity=velocity.std(0) + 1e-2,
            known=[mass_scale, reciprocal_scale, strength_scale, halves],
        )
        return torch.cat(means), torch.cat(scales)

    def _planned(self, inputs: Tensor) -> Tensor:
        """Planned accelerations, (N, n)."""
        linear = torch.nn.functional.linear
        normalised = (inputs - self._mean) / self._scale
        values = normalised.clamp(-Network.CUT, Network.CUT)
        *hidden_variables, weight, bias = self._variables
        hidden_layers = zip(hidden_variables[::2], hidden_variables[1::2], strict=True)
        for hidden_weight, hidden_bias in hidden_layers:
            values = torch.tanh(linear(values, hidden_weight, hidden_bias))
        output = linear(values, weight, bias)
        return self._acceleration * output

    def _motion(self, episodes: _Episodes) -> tuple[Tensor, Tensor, Tensor]:
        """Poses (N, S + 1, n), and velocities and planned accelerations (N, S, n)."""
        motions = episodes.motions
        mass = episodes.mass[:, None]
        known = robot_inputs(mass, episodes.strength, episodes.disturbance)
        pose_gain, rate_gain = self.planning.gains
        pose = motions.start
        velocity = torch.zeros_like(pose)
        poses = [pose]
        velocities = []
        accelerations = []
        steps = episodes.noise.shape[1]
        for step in range(steps):
            error = pose - motions.position[:, step]
            rate = velocity - motions.velocity[:, step]
            inputs = network_inputs(
                error=error / self._bounds,
                rate=RATE_TIME * rate / self._bounds,
                preview=motions.preview[:, step],
                pose=pose,
                velocity=velocity,
                known=known,
            )
            reference = motions.acceleration[:, step]
            tracking = reference - pose_gain * error - rate_gain * rate
            planned = self._planned(torch.cat(inputs, dim=1))
            acceleration = tracking + planned
            velocities.append(velocity)
            accelerations.append(acceleration)
            moved = acceleration + episodes.noise[:, step]
            pose = pose + STEP * velocity + STEP**2 / 2 * moved
            velocity = velocity + STEP * moved
            poses.append(pose)
        return (
            torch.stack(poses, dim=1),
            torch.stack(velocities, dim=1),
            torch.stack(accelerations, dim=1),
        )

    def _violations(self, episodes: _Episodes) -> _Violations:
        settings = self.settings
        poses, velocities, accelerations = self._motion(episodes)
        count, steps, _ = accelerations.shape
        inside = torch.arange(steps) < episodes.motions.steps[:, None]
        # Motors and cables are checked in the middle of each step.
        middle_poses = poses[:, :-1] + STEP / 2 * velocities + STEP**2 / 8 * accelerations
        forced = accelerations - episodes.disturbance[:, None]
        middle_velocities = velocities + STEP / 2 * accelerations
        masses = episodes.mass[:, None].expand(count, steps)
        required = required_actuation(
            self._expected.robot,
            [middle_poses[inside], middle_velocities[inside], forced[inside]],
            masses[inside],
            minimum=self._minimum,
        )
        strengths = episodes.strength[:, None].expand(-1, steps, -1)
        used_fraction = required.action.abs() / strengths[inside]
        overload = torch.relu(used_fraction - (1 - settings.action_margin))
        slack = torch.relu(self._minimum - required.tensions) / TENSION_SCALE
        errors = self._relative_errors(poses, episodes.motions)
        excess = torch.relu(errors - (1 - settings.error_margin))
        excess = excess * inside[..., None]
        actuation = torch.zeros((count, steps), dtype=torch.float64)
        actuation[inside] = (overload + slack).sum(1)
        squares = _penalty(overload) + _penalty(slack)
        squares = squares + settings.error_weight * _penalty(excess)
        return _Violations(
            actuation=actuation,
            error=excess.amax(2),
            squares=squares / count,
        )

    def _relative_errors(self, poses: Tensor, motions: _Motions) -> Tensor:
        """Errors after each step in units of their bounds: length of the position's error, and
        absolute value of each rotation's, (N, S, ...)."""
        references = motions.position[:, 1 : poses.shape[1]]
        errors = (poses[:, 1:] - references) / self._bounds
        positions = errors[..., : self.robot.dimensions]
        rotations = errors[..., self.robot.dimensions :]
        lengths = positions.norm(dim=-1, keepdim=True)
        return torch.cat([lengths, rotations.abs()], dim=-1)

    def _drawn(self, generator: np.random.Generator) -> tuple[Array, Array, _Episodes]:
        """Motions (N,), payloads as fractions of those of the motions (N,), and the episodes."""
        robot = self.robot
        expected = self._expected
        count = self.settings.batch
        n, m = robot.coordinates, robot.cables
        indices = generator.integers(len(self.payloads), size=count)
        fractions = generator.uniform(size=count)
        kinds = generator.uniform(size=count)
        fractions[kinds < UNLOADED] = 0.0
        fractions[kinds > 1 - HEAVIEST] = 1.0
        platform = expected.robot.mass + expected.mass_spread * generator.normal(size=count)
        mass = platform + fractions * self.payloads[indices]
        deviations = generator.normal(size=(count, m)).clip(-2, 2)
        strength = 1 + expected.strength_spread * deviations
        wrench = expected.wrench_spread * generator.normal(size=(count, n))
        corner_distances = np.linalg.norm(robot.platform, axis=-1)
        radius = float(np.mean(corner_distances)) or 1.0
        is_position = np.arange(n) < robot.dimensions
        inertia = mass[:, None] * np.where(is_position, 1.0, radius**2)
        motions = self._motions.of(torch.tensor(indices))
        steps = int(motions.steps.max())
        noise = self.settings.noise * generator.normal(size=(count, steps, n))
        episodes = _Episodes(
            motions=motions,
            mass=torch.tensor(mass),
            strength=torch.tensor(strength),
            disturbance=torch.tensor(wrench / inertia),
            noise=torch.tensor(noise),
        )
        return indices, fractions, episodes

    def round(self, index: int, report: Callable[[], None] = lambda: None) -> None:
        """Runs round ``index``, counted from 0, and calls ``report`` after each step.

        The random numbers of a step depend on its number alone, so that a run can be resumed
        between two rounds.
        """
        settings = self.settings
        total = settings.rounds * settings.iterations
        start = index * settings.iterations
        self.evaluations = 0
        for step in range(start, start + settings.iterations):
            warm_up = min(1.0, (step + 1) / WARM_UP)
            cosine = math.cos(math.pi * step / total)
            rate = settings.learning_rate * warm_up
            rate *= (1 + cosine) / 2
            for group in self._adam.param_groups:
                group["lr"] = rate
            self._improve(np.random.default_rng([self.seed, step]))
            self.evaluations += 1
            report()

    def _improve(self, generator: np.random.Generator) -> None:
        """One step of Adam, and the payloads of its motions."""
        indices, fractions, episodes = self._drawn(generator)
        violations = self._violations(episodes)
        self._adam.zero_grad()
        torch.autograd.backward(violations.squares)
        torch.nn.utils.clip_grad_norm_(self._variables, LARGEST_GRADIENT)
        self._adam.step()
        with torch.no_grad():
            violation = torch.maximum(violations.actuation, violations.error)
            largest = violation.amax(1).numpy()
        is_heaviest = fractions == 1
        tolerance = self.settings.tolerance
        is_carried = is_heaviest & (largest < tolerance)
        is_failed = is_heaviest & (largest > 2 * tolerance)
        self.payloads[indices[is_carried]] *= GROWTH
        self.payloads[indices[is_failed]] *= SHRINKAGE

    @property
    def network(self) -> Network:
        """The network."""
        arrays = []
        for variable in self._variables:
            values = variable.detach().numpy()
            arrays.append(values.copy())
        return Network(
            mean=self._mean.numpy(),
            scale=self._scale.numpy(),
            weights=tuple(arrays[::2]),
            biases=tuple(arrays[1::2]),
            squash="none",
        )

    def state(self) -> dict[str, Array]:
        """Weights, payloads and the state of Adam as arrays by name, for :meth:`restore`."""
        arrays = {"payloads": self.payloads}
        for index, variable in enumerate(self._variables):
            arrays[f"variable{index}"] = variable.detach().numpy()
            adam_state = self._adam.state.get(variable, {})
            for name, value in adam_state.items():
                arrays[f"{name}{index}"] = value.numpy()
        return arrays

    def restore(self, arrays: Mapping[str, Any]) -> None:
        """Restores the arrays of :meth:`state`.

        Raises:
            KeyError: if an array is missing.
            RuntimeError: if an array has another shape.
        """
        self.payloads = np.array(arrays["payloads"])
        for index, variable in enumerate(self._variables):
            values = torch.tensor(arrays[f"variable{index}"])
            with torch.no_grad():
                variable.copy_(values)
            if f"step{index}" in arrays:
                adam_state = {}
                for name in ("step", "exp_avg", "exp_avg_sq"):
                    adam_state[name] = torch.tensor(arrays[f"{name}{index}"])
                self._adam.state[variable] = adam_state


def _penalty(violations: Tensor) -> Tensor:
    """Sum of squares and a small part of the sum."""
    squares = violations.square().sum()
    return squares + LINEAR * violations.sum()


def _tabulated(trajectories: Sequence[Trajectory], starts: Array) -> _Motions:
    counts = [int(motion.duration / STEP + 1e-9) for motion in trajectories]
    longest = max(counts)
    steps = np.arange(longest + 1)
    tables = []
    for motion, count in zip(trajectories, counts, strict=True):
        instants = np.minimum(steps, count) * STEP
        tables.append(Preview.of(motion, instants))

    def stacked(name: str) -> Tensor:
        arrays = [getattr(table, name) for table in tables]
        return torch.tensor(np.stack(arrays))

    return _Motions(
        position=stacked("position"),
        velocity=stacked("velocity"),
        acceleration=stacked("acceleration"),
        preview=stacked("inputs"),
        start=torch.tensor(starts),
        steps=torch.tensor(counts),
    )
