"""Training runs by analytic policy gradient (APG): configuration, checkpoints after each round,
best policy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_baselines.learned import runs
from cablebot_baselines.learned.base import find_base
from cablebot_baselines.learned.bundle import Bundle, find_mapping
from cablebot_baselines.learned.gradient import GradientSettings, GradientTraining
from cablebot_baselines.learned.planner import Planning
from cablebot_baselines.learned.planner_training import PlannerSettings, PlannerTraining
from cablebot_baselines.learned.steering import Shift, Steering
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
from cablebot_gym.utils.checks import mapping, whole

ALGORITHM = "gradient"
"""Name for ``cablebot train --algo``."""

VALIDATION = TRAINING_SEEDS[-8:]
"""Seeds of the random loops that select the best round of a run; they are never trained on."""

_SETUP = ("motions", "steering", "evaluation")
"""Keys of each configuration besides the fields of the settings."""

_ARRAYS = "training.npz"


@dataclass(frozen=True, kw_only=True)
class GradientConfig:
    """A checked configuration."""

    trajectories: tuple[Trajectory, ...]
    """Training motions."""
    validation: tuple[Trajectory, ...]
    """Motions that select the best round."""
    untrained: Bundle
    """The policy with a network of output zero."""
    settings: GradientSettings | PlannerSettings
    """Hyperparameters of the optimisation."""
    evaluation: Mapping[str, Any]
    """Keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc`."""


def make_gradient_config(env_id: str, plain: Mapping[str, Any]) -> GradientConfig:
    """Checks ``plain``, the content of a configuration file for an environment.

    The keys are ``motions``, ``steering``, ``evaluation``, and for steering of kind planning the
    fields of :class:`PlannerSettings`; for steering of kind shift ``base``, ``features`` and the
    fields of :class:`GradientSettings`. ``motions`` is a mapping with one or both of these keys;
    the default is the default motion of the environment:

    * ``loops``: a number N, for the random loops with training seeds 0 to N − 1.
    * ``named``: a list of trajectories for :func:`cablebot_gym.trajectories.names.find_trajectory`.

    Raises:
        ValueError: if a key is unknown or missing, or a value is invalid.
    """
    robot = find_robot(env_robot(env_id))
    if "steering" not in plain:
        raise ValueError("hyperparameters: steering must be given")
    action_mapping = find_mapping(plain["steering"])
    plans = isinstance(action_mapping, Planning)
    kind: type[PlannerSettings] | type[GradientSettings]
    kind, parts = (PlannerSettings, ()) if plans else (GradientSettings, ("base", "features"))
    optimisation = [item.name for item in fields(kind)]
    mapping("hyperparameters", plain, [*_SETUP, *parts, *optimisation])
    if missing := [name for name in parts if name not in plain]:
        raise ValueError(f"hyperparameters: {', '.join(missing)} must be given")
    settings = {name: plain[name] for name in optimisation if name in plain}
    for name, value in settings.items():
        settings[name] = tuple(value) if isinstance(value, list) else value
    trajectories, validation = _motions(plain.get("motions"), robot)
    return GradientConfig(
        trajectories=trajectories,
        validation=validation,
        untrained=_untrained(env_id, robot, plain, action_mapping),
        settings=kind(**settings),
        evaluation=dict(plain.get("evaluation", {})),
    )


def _untrained(
    env_id: str,
    robot: Robot,
    plain: Mapping[str, Any],
    action_mapping: Shift | Planning,
) -> Bundle:
    if isinstance(action_mapping, Planning):
        return Bundle.of_planning(env_id, action_mapping)
    steering = Steering(
        robot,
        base=find_base(plain["base"]),
        action_mapping=action_mapping,
        features=plain["features"],
    )
    return Bundle.of_steering(env_id, steering)


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


def train_gradient(
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
    """Trains a policy by analytic policy gradient (APG).

    The same seed and number of threads on the same machine give the same weights, also if the run
    was resumed.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        config: YAML file, or the name of a shipped one; None for ``gradient``.
        seed: seed of the initial weights; None for 0.
        resume: whether to resume the run in ``out`` after its last finished round.
        threads: number of torch's threads; None for 1.
        progress: function called with the evaluations of the objective so far, their largest
            number, and a text.
        say: function called with messages for the user.

    Raises:
        ValueError: if an argument or the configuration is invalid, or ``out`` already contains a
            run. With ``resume`` also if ``out`` contains no run, a run with other settings, or a
            damaged checkpoint. No file is changed.
        Interrupted: after SIGINT or SIGTERM; the checkpoint is that of the last finished round.
    """
    options = {"algorithm": ALGORITHM, "config": config, "seed": seed, "threads": threads}
    state = runs.open_run(out, env_id, options, resume=resume)
    checked = make_gradient_config(env_id, state.settings["config"])
    with runs.torch_threads(state.settings["threads"]):
        training = _make_training(checked, state.settings["seed"])
        if resume:
            # The file is opened here because np.load does not close a damaged file that it opened.
            with runs.checkpoint_errors(out), (state.checkpoint / _ARRAYS).open("rb") as file:
                training.restore(np.load(file, allow_pickle=False))
        run = runs.Run(
            state,
            checked.untrained,
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


def _make_training(config: GradientConfig, seed: int) -> GradientTraining | PlannerTraining:
    untrained = config.untrained
    robot = find_robot(env_robot(untrained.env_id))
    match untrained.action_mapping, config.settings:
        case Planning() as planning, PlannerSettings() as settings:
            return PlannerTraining(
                robot=robot,
                trajectories=config.trajectories,
                planning=planning,
                seed=seed,
                settings=settings,
            )
        case Shift() as shift, GradientSettings() as settings:
            steering = untrained.steering(robot)
            return GradientTraining(
                robot=robot,
                trajectories=config.trajectories,
                action_mapping=shift,
                features=steering.features,
                seed=seed,
                settings=settings,
                minimum_tension=steering.law.minimum_tension,
            )
    raise AssertionError("the settings belong to another kind of steering")


def _train(run: runs.Run, training: GradientTraining | PlannerTraining, resume: bool) -> None:
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
