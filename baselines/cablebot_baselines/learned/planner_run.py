"""Training runs of a planning network: configuration, checkpoints after each round, best policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_baselines.learned import runs
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.planner import Planning
from cablebot_baselines.learned.planner_training import PlannerSettings, PlannerTraining
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.trajectories import (
    TRAINING_SEEDS,
    BetweenDwells,
    RandomLoop,
    Trajectory,
    find_trajectory,
)
from cablebot_gym.utils.checks import mapping, record, whole

ALGORITHM = "planner"
"""Name for ``cablebot train --algo``."""

VALIDATION = TRAINING_SEEDS[-8:]
"""Seeds of the random loops that select the best round of a run; they are never trained on."""

_SETUP = ("motions", "planning", "evaluation")
"""Keys of each configuration besides the fields of the settings."""

_ARRAYS = "training.npz"


@dataclass(frozen=True, kw_only=True)
class PlannerConfig:
    """A checked configuration."""

    trajectories: tuple[Trajectory, ...]
    """Training motions."""
    validation: tuple[Trajectory, ...]
    """Motions that select the best round."""
    planning: Planning
    """Meaning of the network's outputs."""
    settings: PlannerSettings
    """Hyperparameters of the optimisation."""
    evaluation: Mapping[str, Any]
    """Keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc`."""


def make_planner_config(env_id: str, plain: Mapping[str, Any]) -> PlannerConfig:
    """Checks ``plain``, the content of a configuration file for an environment.

    The keys are ``motions``, ``planning`` with fields of :class:`Planning`, ``evaluation``, and the
    fields of :class:`PlannerSettings`. ``motions`` is a mapping with one or both of these keys; the
    default is the default motion of the environment:

    * ``loops``: a number N, for the random loops with training seeds 0 to N − 1.
    * ``named``: a list of trajectories for :func:`cablebot_gym.trajectories.names.find_trajectory`.

    Raises:
        ValueError: if a key is unknown, or a value is invalid.
    """
    robot = find_robot(env_robot(env_id))
    optimisation = [item.name for item in fields(PlannerSettings)]
    mapping("hyperparameters", plain, [*_SETUP, *optimisation])
    settings = {name: plain[name] for name in optimisation if name in plain}
    if isinstance(settings.get("hidden"), list):
        settings["hidden"] = tuple(settings["hidden"])
    trajectories, validation = _motions(plain.get("motions"), robot)
    return PlannerConfig(
        trajectories=trajectories,
        validation=validation,
        planning=record("planning", Planning, plain.get("planning", {})),
        settings=PlannerSettings(**settings),
        evaluation=dict(plain.get("evaluation", {})),
    )


def _motions(value: Any, robot: Robot) -> tuple[tuple[Trajectory, ...], tuple[Trajectory, ...]]:
    """Training motions and validation motions."""
    if value is None:
        value = {"named": [default_trajectory(robot)]}
    motions = mapping("motions", value, ["loops", "named"])
    most = len(TRAINING_SEEDS) - len(VALIDATION)
    count = 0
    if "loops" in motions:
        count = whole("loops", motions["loops"], least=1, most=most)
    names = motions.get("named", [])
    if not isinstance(names, list) or not (names or count):
        raise ValueError(
            f"motions must be {{loops: N}}, {{named: [TRAJECTORY, …]}} or both, not {value!r}"
        )
    named = tuple(find_trajectory(name, robot.kind) for name in names)
    for trajectory in named:
        if isinstance(trajectory, BetweenDwells):
            trajectory = trajectory.motion
        if isinstance(trajectory, RandomLoop) and trajectory.seed not in TRAINING_SEEDS[:most]:
            raise ValueError(
                f"motions: other seeds are reserved for evaluation: train with seeds from 0 to {most - 1}"
            )
    if not count:
        return named, named
    return (*_loops(TRAINING_SEEDS[:count], robot), *named), _loops(VALIDATION, robot)


def _loops(seeds: Sequence[int], robot: Robot) -> tuple[Trajectory, ...]:
    return tuple(
        find_trajectory({"name": f"loop-{robot.kind}", "seed": seed}, robot.kind) for seed in seeds
    )


def train_planner(
    env_id: str,
    *,
    out: Path,
    config: Path | None = None,
    seed: int | None = None,
    resume: bool = False,
    threads: int | None = None,
    progress: runs.Progress | None = None,
    say: runs.Say | None = None,
) -> runs.TrainingResult:
    """Trains a planning network, see :mod:`cablebot_baselines.learned.planner_training`.

    The same seed and number of threads on the same machine give the same weights, also if the run
    was resumed.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        config: YAML file; None for the shipped one.
        seed: seed of the initial weights and of all random numbers; None for 0.
        resume: whether to resume the run in ``out`` after its last finished round.
        threads: number of torch's threads; None for 1.
        progress: function called with the steps of Adam so far, their total, and a text.
        say: function called with messages for the user.

    Raises:
        ValueError: if an argument or the configuration is invalid, or ``out`` already contains a
            run. With ``resume`` also if ``out`` contains no run, a run with other settings, or a
            damaged checkpoint. No file is changed.
        Interrupted: after SIGINT or SIGTERM; the checkpoint is that of the last finished round.
    """
    options = {"algorithm": ALGORITHM, "config": config, "seed": seed, "threads": threads}
    state = runs.open_run(out, env_id, options, resume=resume)
    checked = make_planner_config(env_id, state.settings["config"])
    with runs.torch_threads(state.settings["threads"]):
        training = PlannerTraining(
            robot=find_robot(env_robot(env_id)),
            trajectories=checked.trajectories,
            planning=checked.planning,
            seed=state.settings["seed"],
            settings=checked.settings,
        )
        if resume:
            # The file is opened here because np.load does not close a damaged file that it opened.
            with runs.checkpoint_errors(out), (state.checkpoint / _ARRAYS).open("rb") as file:
                training.restore(np.load(file, allow_pickle=False))
        run = runs.Run(
            state,
            Bundle.of_planning(env_id, checked.planning),
            total=checked.settings.iterations * training.rounds,
            evaluation=checked.evaluation,
            trained_on=checked.trajectories,
            motions=[{"trajectory": motion} for motion in checked.validation],
            progress=progress,
            say=say,
        )
        with run.signals():
            _train(run, training, resume)
    return state


def _train(run: runs.Run, training: PlannerTraining, resume: bool) -> None:
    """Trains to the end.

    Raises:
        Interrupted: after a signal.
    """
    state = run.state

    def write(folder: Path) -> None:
        np.savez(folder / _ARRAYS, allow_pickle=False, **training.state())

    def report() -> None:
        text = f"round {state.rounds + 1}, optimised payload {training.payloads.mean():.2f} kg"
        run.report(text, state.timesteps + training.evaluations)
        if run.stopped:
            raise runs.Interrupted(state.timesteps)

    def notes() -> dict[str, float]:
        return {"payload_by_equations_kg": float(np.mean(training.payloads))}

    if not resume:
        run.start()
        run.save(write)
    while state.rounds < training.rounds:
        training.round(state.rounds, report)
        state.timesteps += training.evaluations
        state.rounds += 1
        run.evaluate(training.network, **notes())
        run.save(write)
    run.finish(training.network, **notes())
