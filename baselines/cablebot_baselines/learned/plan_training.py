"""Training of a network that plans motions, without labels and without rollouts.

The loss are the violations of the limits by planned motions, without payload and with the present
payload of each motion, which grows while its plan is feasible. Nothing is simulated.

A run's folder contains ``plan.zip``, the weights, ``checkpoint.pt``, from which a run continues, and
``progress.csv``, the payloads on motions that are not trained on.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from cablebot_baselines.learned.plan_network import PASSES, PlanNetwork, control_points
from cablebot_baselines.learned.plan_space import (
    ERROR_WEIGHT,
    TOLERANCE,
    PlanProblem,
    PlanSpace,
    largest_violation,
)
from cablebot_baselines.learned.training import one_thread
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.kinematics import Array
from cablebot_gym.motions import Trajectory, find_trajectory, random_loop
from cablebot_gym.motions.loops import TRAINING_SEEDS
from cablebot_gym.robots import find_robot
from cablebot_gym.task import find_error_bounds
from cablebot_gym.utils.checks import whole
from cablebot_gym.utils.console import Step
from cablebot_gym.utils.files import atomic_write, atomic_write_text, check_writable_dir

MOTIONS = 3000
"""Motions of a training, with the seeds from 0."""

HELD_OUT = range(10_000, 10_016)
"""Seeds of the motions of the learning curve."""

MOVED = 4
"""One training motion of this number is moved towards the poses of the default motion, or away from
them: random loops in space are level, and the paper's circle is tilted."""

FARTHEST = 1.2
"""Largest such distance, as a fraction of that to the mean pose of the default motion."""

BATCH = 32
"""Motions in a step."""

LEARNING_RATE, WARM_UP, LAST_RATE = 2e-3, 50, 0.01
"""Learning rate after this number of steps, which falls to this fraction of it as a cosine."""

AVERAGE = 0.01
"""Weight of the present network in the moving average, which is what a run returns."""

FIRST_PAYLOAD = 1.5
"""First payload of each motion in payloads of exact tracking."""

GROWTH, SHRINKAGE = 1.05, 0.99
"""Factors of a payload whose plan is feasible, and of one whose plan is far from it."""

FEASIBLE, FAR = 0.01, 0.02
"""Largest violation of a feasible plan, and smallest of one that is far from it."""

LIGHTER = 0.2
"""Fraction of the plans for a lighter payload than the largest."""

LIGHTEST = 0.06
"""Largest mass that is missing from the unloaded platform, as a fraction of its mass."""

LEVELS = (0.0, 0.0, 0.3, 0.6, 1.0)
"""Levels of the random margins."""

LARGEST_MARGINS = {"position": 0.25, "rotation": 0.25, "tension": 0.8, "action": 0.09}
"""Largest random margins, in the units of :meth:`~cablebot_baselines.learned.plan_space.PlanSpace.violations`."""

MARGIN_KNOTS = 12
"""Knots of the random margins over time."""

LINEAR = 0.02
"""Violation at which the linear term of the loss is as large as the square one."""

PEAK = 8
"""Exponent of the norm over time that counts in addition: the payload is that of the worst instant."""

PARTS = 20
"""Checkpoints of a run."""

PLAN = "plan.zip"
"""Name of the file of the weights."""


def train_plans(
    env_id: str, *, out: str | Path, steps: int, seed: int = 0, progress: Step | None = None
) -> list[float]:
    """Trains a network for the robot of an environment, or continues the run in ``out``. Returns its
    payloads on the motions :data:`HELD_OUT` [kg].

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        steps: number of steps in all.
        seed: seed of weights and batches.
        progress: function called with the progress.

    Raises:
        ValueError: if an argument is invalid, the robot has more than one redundant cable, or ``out``
            has the run of another robot, seed or number of steps.
    """
    robot = find_robot(env_robot(env_id))
    whole("steps", steps, least=1)
    out = Path(out)
    check_writable_dir(out)
    out.mkdir(parents=True, exist_ok=True)
    space = PlanSpace(robot, find_error_bounds(None, robot))
    with one_thread():
        training = PlanTraining(space, steps=steps, seed=seed, progress=progress)
        training.load(out)
        every = max(1, steps // PARTS)
        while training.step < steps:
            if progress is not None:
                progress(training.step, steps, "training")
            training.learn()
            if training.step % every == 0 or training.step == steps:
                row = [training.step, round(training.seconds, 1), *training.curve()]
                training.progress.append(row)
                training.save(out)
    return training.progress[-1][2:]


class PlanTraining:
    """Network, its average, optimiser and payloads of a training.

    Args:
        space: splines and limits of the robot.
        steps: number of steps in all, over which the learning rate falls.
        seed: seed of weights and batches.
    """

    def __init__(
        self, space: PlanSpace, *, steps: int, seed: int, progress: Step | None = None
    ) -> None:
        self.space, self.steps, self.seed, self.step, self.seconds = space, steps, seed, 0, 0.0
        self.motions = problems(space, range(MOTIONS), progress)
        self.held_out = problems(space, HELD_OUT)
        self.payload = FIRST_PAYLOAD * self.motions.exact
        """Present payload of each motion but for the factor, (N,) [kg]."""
        self.progress: list[list[float]] = []
        """Steps, processor seconds and payloads on the motions that are not trained on [kg]."""
        self.factors = torch.ones(len(LEVELS), dtype=torch.float64)
        """Factors of all payloads at each level of margins."""
        self._random = np.random.default_rng(seed)
        torch.manual_seed(seed)
        start = torch.arange(min(4 * BATCH, MOTIONS))
        margins = self._margins(self._random.integers(len(LEVELS), size=len(start)))
        pair = torch.stack([torch.zeros(len(start)), self.payload[start]], dim=1)
        self.network = PlanNetwork.fresh(space, space.query(self.motions[start], pair, margins))
        self.average = PlanNetwork.of_weights(space, self.network.state_dict())
        self._optimiser = torch.optim.AdamW(self.network.parameters(), weight_decay=1e-4)

    def learn(self) -> None:
        """One step."""
        began = time.process_time()
        self._set_rate()
        space, random = self.space, self._random
        rows = torch.tensor(random.choice(len(self.motions), BATCH, replace=False))
        levels = random.integers(len(LEVELS), size=BATCH)
        problem = self.motions[rows]
        margins = self._margins(levels)
        heaviest = self.payload[rows] * self.factors[levels]
        lighter = torch.tensor(random.uniform(size=BATCH) < LIGHTER)
        fraction = torch.tensor(random.uniform(0.4, 1.0, size=BATCH))
        payload = torch.where(lighter, fraction * heaviest, heaviest)
        lightest = -LIGHTEST * space.robot.mass * torch.tensor(random.uniform(size=BATCH))
        pair = torch.stack([lightest, payload], dim=1)
        query = space.query(problem, pair, margins)
        passes = int(random.integers(PASSES))
        moves = self.network(query, self.network.moves(query, passes))
        points = control_points(space, query, moves)
        reserved = replace(query, margins=margins + space.reserve)
        parts = space.violations(reserved, points, space.stages)
        loss = _loss(parts)
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self._optimiser.step()
        with torch.no_grad():
            for mean, value in zip(
                self.average.parameters(), self.network.parameters(), strict=True
            ):
                mean.lerp_(value, max(AVERAGE, 1 / (self.step + 1)))
        if passes > 0:
            self._adapt(
                rows[~lighter], levels[~lighter.numpy()], largest_violation(parts)[~lighter]
            )
        self.step += 1
        self.seconds += time.process_time() - began

    def _set_rate(self) -> None:
        warm = min(1.0, (self.step + 1) / WARM_UP)
        falling = (1 + math.cos(math.pi * self.step / self.steps)) / 2
        for group in self._optimiser.param_groups:
            group["lr"] = LEARNING_RATE * (warm * falling + LAST_RATE)

    def _adapt(self, rows: Tensor, levels: Any, violation: Tensor) -> None:
        """Payloads grow where the plans are feasible: that of each motion, and the factor of all
        motions at a level of margins."""
        factor = torch.ones_like(violation)
        factor[violation < FEASIBLE] = GROWTH
        factor[violation > FAR] = SHRINKAGE
        self.payload[rows] *= factor
        for level in range(len(LEVELS)):
            marked = torch.tensor(levels == level)
            if marked.any():
                self.factors[level] *= factor[marked].log().mean().div(4).exp()

    def _margins(self, levels: Any) -> Tensor:
        """Random margins at the control points for the levels of N motions."""
        largest = self.space.margin_vector(LARGEST_MARGINS).numpy()
        size = (len(levels), len(largest), 1)
        level = np.asarray(LEVELS)[levels][:, None, None] * largest[:, None]
        amplitude = level * self._random.uniform(size=size)
        knots = self._random.uniform(size=(len(levels), len(largest), MARGIN_KNOTS)) ** 2
        times = np.linspace(0.0, MARGIN_KNOTS - 1, len(self.space.nodes))
        before = np.minimum(times.astype(int), MARGIN_KNOTS - 2)
        part = times - before
        values = (1 - part) * knots[..., before] + part * knots[..., before + 1]
        margins = amplitude * (0.2 + 0.8 * values)
        if self.space.redundant:  # their least tension is constant
            margins[:, 2] = margins[:, 2].max(axis=-1, keepdims=True)
        return torch.tensor(np.swapaxes(margins, 1, 2).copy())

    @property
    def _run(self) -> str:
        """What a run is continued with."""
        return f"robot {self.space.robot.name!r}, seed {self.seed} and {self.steps} steps"

    def curve(self) -> list[float]:
        """Payloads that the average carries on the motions that are not trained on [kg]."""
        problem = self.held_out
        margins = self.space.no_margins(len(problem))
        low = torch.zeros_like(problem.exact)
        high = 6 * problem.exact + 2
        for _ in range(10):
            payload = (low + high) / 2
            pair = torch.stack([torch.zeros_like(payload), payload], dim=1)
            query = self.space.query(problem, pair, margins)
            _, violations = self.average.plan(query)
            carried = violations < TOLERANCE
            low = torch.where(carried, payload, low)
            high = torch.where(carried, high, payload)
        return [round(value, 3) for value in low.tolist()]

    def save(self, out: Path) -> None:
        """Writes the checkpoint, the weights of the average and the progress."""
        state = {name: getattr(self, name) for name in _STATE}
        state |= {name: getattr(self, name).state_dict() for name in _MODULES}
        state["random"] = self._random.bit_generator.state
        state["run"] = self._run
        atomic_write(out / "checkpoint.pt", partial(torch.save, state))
        buffer = BytesIO()  # in a file's archive, torch writes the name of the file
        torch.save(self.average.state_dict(), buffer)
        atomic_write(out / PLAN, lambda file: file.write_bytes(buffer.getvalue()))
        head = ["step", "processor seconds", *(f"payload of loop {seed} [kg]" for seed in HELD_OUT)]
        table: list[list[Any]] = [head, *self.progress]
        lines = [",".join(map(str, row)) + "\n" for row in table]
        atomic_write_text(out / "progress.csv", "".join(lines))

    def load(self, out: Path) -> None:
        """Continues from the checkpoint of a folder, if there is one.

        Raises:
            ValueError: if it is that of another run.
        """
        path = out / "checkpoint.pt"
        if not path.exists():
            return
        state = torch.load(path, weights_only=True)
        if state["run"] != self._run:
            raise ValueError(
                f"the run in {str(out)!r} is that of {state['run']}: choose another --out"
            )
        for name in _STATE:
            setattr(self, name, state[name])
        for name in _MODULES:
            getattr(self, name).load_state_dict(state[name])
        self._random.bit_generator.state = state["random"]


_STATE = ("step", "seconds", "payload", "factors", "progress")
_MODULES = ("network", "average", "_optimiser")


def problems(space: PlanSpace, seeds: range, progress: Step | None = None) -> PlanProblem:
    """The random motions of some seeds as one problem. Some of those for training are moved."""
    robot = space.robot
    default = find_trajectory(default_trajectory(robot), robot.kind)
    middle = default(np.linspace(0.0, default.duration, 50)).position.mean(0)
    problem = []
    for index, seed in enumerate(seeds):
        motion = random_loop(robot.kind, seed)
        if seed in TRAINING_SEEDS and seed % MOVED == 0:
            motion = _moved(motion, middle, seed)
        problem.append(space.problem(motion))
        if progress is not None:
            progress(index + 1, len(seeds), "motions")
    return PlanProblem.joined(problem)


def _moved(motion: Any, middle: Array, seed: int) -> Trajectory:
    """A random loop whose center is moved towards a pose, or away from it."""
    center = np.array(motion.motion.center)
    away = np.random.default_rng(seed).uniform(-FARTHEST, FARTHEST, len(center))
    moved = center + away * (middle - center)
    loop = replace(motion.motion, center=tuple(moved.tolist()))
    return replace(motion, motion=loop)


def _loss(parts: tuple[Tensor, ...]) -> Tensor:
    """Sums of the violations and their largest ones, mean over the motions."""
    loss = torch.zeros((), dtype=torch.float64)
    peak = torch.full((len(parts[0]),), 1e-24, dtype=torch.float64)
    for part, weight in zip(parts, (1.0, ERROR_WEIGHT), strict=True):
        values = part.flatten(1)
        loss = loss + weight * (values**2 + LINEAR * values).sum(1)
        peak = peak + (values**PEAK).sum(1)
    return (loss + peak ** (1 / PEAK)).mean()
