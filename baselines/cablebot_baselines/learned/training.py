"""Training runs with PPO of Stable-Baselines3 (SB3): checkpoints, DLCC evaluations, best policy.

In addition to the files in :mod:`cablebot_baselines.learned.runs`, a run's folder contains
``progress.csv``, SB3's log, and the same log in ``tensorboard`` if TensorBoard is installed. A run
that was resumed after N timesteps continues in ``progress_N.csv``. The folder ``checkpoint``
contains the files of SB3's own functions: ``model.zip`` and ``vecnormalize.pkl``. SB3 loads them with
``pickle``: resume only runs that you trust.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, TypedDict, Unpack

try:
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import (
        KVWriter,
        Logger,
        TensorBoardOutputFormat,
        make_output_format,
    )
    from stable_baselines3.common.vec_env import VecNormalize
except ImportError as error:
    raise ImportError(
        "training needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name
    ) from error

from cablebot_baselines.learned import runs
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.config import Config, make_config
from cablebot_baselines.learned.export import network_from_sb3
from cablebot_baselines.learned.recipe import make_training_envs, steered_env
from cablebot_baselines.learned.wrappers import PayloadCurriculumVector, SteeredVector
from cablebot_baselines.learned.wrappers.layers import layers
from cablebot_gym.utils.checks import check_keywords

PARTS = 20
"""Default number of evaluations and of checkpoints in a run."""

_MODEL = "model.zip"
_NORMALIZE = "vecnormalize.pkl"


class TrainingOptions(TypedDict, total=False):
    """Options of :func:`train`. An option that is missing or None has its default, or in a resumed
    run the value that the run was started with."""

    config: str | Path | None
    """YAML file with RL-Zoo's keys; by default the shipped one."""
    seed: int | None
    """Seed of weights, exploration and environments; by default 0."""
    timesteps: int | None
    """Number of actions over all environments; by default the configuration's ``n_timesteps``."""
    eval_every: int | None
    """Timesteps between two evaluations; by default 1/20 of all timesteps. A checkpoint follows
    each one."""
    checkpoint_every: int | None
    """Timesteps between two checkpoints; by default 1/20 of all timesteps."""
    threads: int | None
    """Number of torch's threads; by default 1. For networks of this size, more threads are hardly
    faster, and much slower if other processes use the cores."""
    evaluation: Mapping[str, Any] | None
    """Keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc` in addition to
    the criterion ``task`` and ``RESOLUTION``, such as ``{"payload_known": False}``."""


def train(
    env_id: str,
    *,
    out: str | Path,
    resume: bool = False,
    progress: runs.Progress | None = None,
    say: runs.Say | None = None,
    **options: Unpack[TrainingOptions],
) -> runs.TrainingResult:
    """Trains a learned policy with Stable-Baselines3.

    The same seed and number of threads on the same machine give the same weights, unless the run is
    interrupted. SIGINT and SIGTERM stop a run after the current rollout, or within an evaluation,
    with a checkpoint; a second SIGINT stops it immediately.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        resume: whether to resume the run in ``out`` from its last checkpoint with new episodes. The
            result is therefore not that of an uninterrupted run. Options must equal those that the
            run was started with, except for ``timesteps``, at whose new value linear schedules end.
        progress: function called with the progress.
        say: function called with messages for the user.
        options: see :class:`TrainingOptions`.

    Raises:
        ValueError: if an argument or the configuration is invalid, or ``out`` already contains a
            run. With ``resume`` also if ``out`` contains no run, a run with other settings, or a
            damaged checkpoint. No file is changed.
        Interrupted: after a signal, when the checkpoint is written.
        cablebot_gym.policies.protocol.PolicyError: if an evaluation fails.
    """
    state, config = _open_run(env_id, out, resume, options)
    timesteps = state.settings["timesteps"]
    if state.timesteps >= timesteps and state.last:
        if say:
            say(
                f"nothing to do: {state.timesteps} timesteps are done. Use --timesteps to train longer"
            )
        return state
    threads = runs.torch_threads(state.settings["threads"])
    seed = state.settings["seed"] + state.timesteps  # a resumed run does not repeat its episodes
    with threads, closing(make_training_envs(env_id, seed=seed, config=config)) as envs:
        model = (_load if resume else _make)(state, config, envs)
        network_from_sb3(model)  # fails before the training if the model cannot be exported
        steered = steered_env(model)
        run = runs.Run(
            state,
            Bundle.of_steering(env_id, steered.steering),
            total=timesteps,
            evaluation=state.settings["evaluation"],
            progress=progress,
            say=say,
        )
        rollout = model.n_envs * getattr(model, "n_steps", 1)  # SAC and TQC have no n_steps
        total = state.timesteps + math.ceil((timesteps - state.timesteps) / rollout) * rollout
        if say and total > timesteps:
            say(f"trains {total:,} timesteps: whole rollouts of {rollout:,}")
        if not resume:
            run.start()
        _learn(model, _RunCallback(run, _curriculum(steered)), run)
    return state


def _open_run(
    env_id: str, out: str | Path, resume: bool, options: TrainingOptions
) -> tuple[runs.TrainingResult, Config]:
    """State of the run, with defaults of the options that are not given, and its configuration."""
    check_keywords(options, TrainingOptions.__annotations__, train)
    state = runs.open_run(out, env_id, options, resume=resume)
    config = make_config(state.settings["config"])
    timesteps = state.settings.setdefault("timesteps", config.timesteps)
    interval = max(1, timesteps // PARTS)
    defaults = {"eval_every": interval, "checkpoint_every": interval, "evaluation": {}}
    state.settings = defaults | state.settings
    return state, config


def _make(state: runs.TrainingResult, config: Config, envs: VecNormalize) -> PPO:
    """Makes a new model.

    Raises:
        ValueError: if SB3 rejects the hyperparameters.
    """
    seed = state.settings["seed"]
    try:
        # The CPU is faster than an accelerator for networks of this size, and gives reproducible
        # weights.
        return PPO(env=envs, seed=seed, device="cpu", **config.model)
    except (TypeError, ValueError, AssertionError) as error:
        raise ValueError(f"PPO rejects the hyperparameters ({error}): correct the file") from error


def _load(state: runs.TrainingResult, config: Config, envs: VecNormalize) -> PPO:
    """Loads the model of a checkpoint, and the payload ceiling of its curriculum.

    Raises:
        ValueError: if the checkpoint is damaged.
    """
    folder = state.checkpoint
    with runs.checkpoint_errors(state.out):
        normalize = VecNormalize.load(str(folder / _NORMALIZE), envs.venv)
        model = PPO.load(folder / _MODEL, env=normalize, device="cpu")
    model.set_random_seed(state.settings["seed"] + state.timesteps)
    curriculum = _curriculum(steered_env(model))
    if curriculum is not None and state.payload_ceiling is not None:
        curriculum.ceiling = state.payload_ceiling
    return model


def _curriculum(steered: SteeredVector) -> PayloadCurriculumVector | None:
    for layer in layers(steered):
        if isinstance(layer, PayloadCurriculumVector):
            return layer
    return None


class _RunCallback(BaseCallback):
    """Evaluates and saves the model between two rollouts, and stops the training after a signal."""

    def __init__(self, run: runs.Run, curriculum: PayloadCurriculumVector | None) -> None:
        super().__init__()
        self._run = run
        self._curriculum = curriculum
        self._saved = run.state.timesteps
        self._evaluated = 0
        if run.state.evaluations:
            self._evaluated = run.state.evaluations[-1].timesteps

    def evaluate(self) -> None:
        """Evaluates the model, unless this has just been done.

        Raises:
            Interrupted: after a signal, when the checkpoint is written.
        """
        state = self._run.state
        state.timesteps = self.model.num_timesteps
        if self._evaluated >= state.timesteps:
            return
        try:
            payload = self._run.evaluate(network_from_sb3(self.model))
        except runs.Interrupted:
            self.save()
            raise
        self.logger.record("eval/payload_kg", runs.rank(payload))
        self._evaluated = state.timesteps

    def save(self) -> None:
        """Writes a checkpoint."""
        state = self._run.state
        state.timesteps = self._saved = self.model.num_timesteps
        if self._curriculum is not None:
            state.payload_ceiling = self._curriculum.ceiling
        self._run.save(self._write)

    def _write(self, folder: Path) -> None:
        normalize = self.model.get_vec_normalize_env()
        assert normalize is not None
        self.model.save(folder / _MODEL)
        normalize.save(str(folder / _NORMALIZE))

    def _is_due(self, setting: str, since: int) -> bool:
        """Whether a multiple of an interval has been passed since a timestep."""
        interval: int = self._run.state.settings[setting]
        return self.model.num_timesteps // interval > since // interval

    def _on_rollout_start(self) -> None:
        """Evaluates and saves if due.

        Raises:
            Interrupted: after a signal.
        """
        if self._curriculum is not None:
            self.logger.record("rollout/payload_ceiling", self._curriculum.ceiling)
        evaluation_due = self._is_due("eval_every", self._evaluated)
        if evaluation_due:
            self.evaluate()
        stopped = self._run.stopped
        unsaved = self.model.num_timesteps > self._saved
        if evaluation_due or self._is_due("checkpoint_every", self._saved) or (stopped and unsaved):
            self.save()
        if stopped:
            raise runs.Interrupted(self.model.num_timesteps)

    def _on_step(self) -> bool:
        text = "training"
        if best := self._run.state.best:
            text = f"training, best {runs.kg(best.payload_kg)}"
        self._run.report(text, self.num_timesteps)
        return True


def _learn(model: PPO, callback: _RunCallback, run: runs.Run) -> None:
    """Trains to the end."""
    start = model.num_timesteps
    out = run.out
    callback.init_callback(model)
    suffix = f"_{start}" if start else ""
    formats: list[KVWriter] = [make_output_format("csv", str(out), suffix)]
    with suppress(AssertionError):  # SB3 raises it if TensorBoard is not installed
        formats.append(TensorBoardOutputFormat(str(out / "tensorboard")))
    logger = Logger(str(out), formats)
    model.set_logger(logger)
    try:
        with run.signals():
            if not start:
                callback.save()
            model.learn(
                run.state.settings["timesteps"] - start,
                callback=callback,
                reset_num_timesteps=not start,
            )
            callback.evaluate()
        run.finish(network_from_sb3(model))
        callback.save()
    finally:
        logger.close()
