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
from cablebot_baselines.learned.gradient import GradientSettings, GradientTraining
from cablebot_baselines.learned.steering import Shift, Steering, find_action_mapping
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

_OWN = ("motions", "base", "steering", "features", "evaluation")
_ARRAYS = "training.npz"


@dataclass(frozen=True, kw_only=True)
class GradientConfig:
    """A checked configuration."""

    trajectories: tuple[Trajectory, ...]
    """Training motions."""
    validation: tuple[Trajectory, ...]
    """Motions that select the best round."""
    steering: Steering
    """Base law, mapping from actions to shifts of the reference, and names of the network's
    inputs."""
    shift: Shift
    """Action mapping of ``steering``."""
    settings: GradientSettings
    """Hyperparameters of the optimisation."""
    evaluation: Mapping[str, Any]
    """Keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc`."""


def make_gradient_config(env_id: str, plain: Mapping[str, Any]) -> GradientConfig:
    """Checks ``plain``, the content of a configuration file for an environment.

    The keys are ``motions``, ``base``, ``steering``, ``features``, ``evaluation``, and the fields
    of :class:`GradientSettings`. ``motions`` is a mapping with one or both of these keys; the
    default is the default motion of the environment:

    * ``loops``: a number N, for the random loops with training seeds 0 to N − 1.
    * ``named``: a list of trajectories for :func:`cablebot_gym.trajectories.names.find_trajectory`.

    Raises:
        ValueError: if a key is unknown or missing, or a value is invalid.
    """
    robot = find_robot(env_robot(env_id))
    mapping("hyperparameters", plain, [*_OWN, *(item.name for item in fields(GradientSettings))])
    if missing := [name for name in ("base", "steering", "features") if name not in plain]:
        raise ValueError(f"hyperparameters: {', '.join(missing)} must be given")
    shift = find_action_mapping(plain["steering"])
    if not isinstance(shift, Shift):
        raise ValueError(f"steering must be of kind shift for {ALGORITHM}, not residual")
    settings = {name: value for name, value in plain.items() if name not in _OWN}
    settings |= {
        name: tuple(settings[name]) for name in ("hidden", "rounds", "softness") if name in settings
    }
    trajectories, validation = _motions(plain.get("motions"), robot)
    return GradientConfig(
        trajectories=trajectories,
        validation=validation,
        steering=Steering(
            robot, base=find_base(plain["base"]), action_mapping=shift, features=plain["features"]
        ),
        shift=shift,
        settings=GradientSettings(**settings),
        evaluation=dict(plain.get("evaluation", {})),
    )


def _motions(value: Any, robot: Robot) -> tuple[tuple[Trajectory, ...], tuple[Trajectory, ...]]:
    """Training motions and validation motions."""
    given = mapping(
        "motions",
        {"named": [default_trajectory(robot)]} if value is None else value,
        ["loops", "named"],
    )
    most = len(TRAINING_SEEDS) - len(VALIDATION)
    count = whole("loops", given["loops"], least=1, most=most) if "loops" in given else 0
    named = given.get("named", [])
    if not isinstance(named, list) or not (named or count):
        raise ValueError(
            f"motions must be {{loops: N}}, {{named: [TRAJECTORY, …]}} or both, not {value!r}"
        )
    others = tuple(find_trajectory(one, robot.kind) for one in named)
    moving = [one.motion if isinstance(one, BetweenDwells) else one for one in others]
    if any(isinstance(one, RandomLoop) and one.seed not in TRAINING_SEEDS[:most] for one in moving):
        raise ValueError(
            f"motions: other seeds are reserved for evaluation: train with seeds from 0 to {most - 1}"
        )
    return (*_loops(TRAINING_SEEDS[:count], robot), *others), _loops(
        VALIDATION, robot
    ) if count else others


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
    options = {"env_id": env_id, "algorithm": ALGORITHM, "seed": seed, "threads": threads}
    state = runs.open_run(out, options, config, resume=resume)
    made = make_gradient_config(env_id, state.settings["config"])
    steering = made.steering
    with runs.torch_threads(state.settings["threads"]):
        training = GradientTraining(
            robot=steering.robot,
            trajectories=made.trajectories,
            action_mapping=made.shift,
            features=steering.features,
            seed=state.settings["seed"],
            settings=made.settings,
            minimum_tension=steering.base.make(steering.robot).minimum_tension,
        )
        if resume:
            # The file is opened here because np.load does not close a damaged file that it opened.
            with runs.checkpoint_errors(out), (state.checkpoint / _ARRAYS).open("rb") as file:
                training.restore(np.load(file, allow_pickle=False))
        run = runs.Run(
            state,
            steering,
            total=made.settings.iterations * len(made.settings.rounds),
            evaluation=made.evaluation,
            trained_on=made.trajectories,
            motions=[{"trajectory": motion} for motion in made.validation],
            progress=progress,
            say=say,
        )
        with run.signals():
            _train(run, training, resume)
    return state


def _train(run: runs.Run, training: GradientTraining, resume: bool) -> None:
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

    if not resume:
        run.start()
        run.save(write)
    while state.rounds < len(training.settings.rounds):
        training.round(state.rounds, report)
        state.timesteps = state.timesteps + training.evaluations
        state.rounds = state.rounds + 1
        run.evaluate(training.network, payload_by_equations_kg=float(np.mean(training.payloads)))
        run.save(write)
    run.bundle(training.network, payload_by_equations_kg=float(np.mean(training.payloads))).save(
        run.out / runs.LAST
    )
