"""Training runs with Stable-Baselines3 (SB3): checkpoints, DLCC evaluations, best policy.

In addition to the files in :mod:`cablebot_baselines.learned.runs`, a run's folder contains
``progress.csv``, SB3's log, and the same log in ``tensorboard`` if TensorBoard is installed. A run
that was resumed after N timesteps continues in ``progress_N.csv``. The folder ``checkpoint``
contains the files of SB3's own functions: ``model.zip``, ``vecnormalize.pkl``, and
``replay_buffer.pkl`` with SAC and TQC. SB3 loads them with ``pickle``: resume only runs that you
trust.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

try:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import (
        KVWriter,
        Logger,
        TensorBoardOutputFormat,
        make_output_format,
    )
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    from stable_baselines3.common.vec_env import VecNormalize
except ImportError as error:
    raise ImportError(
        "training needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name
    ) from error

from cablebot_baselines.learned import runs
from cablebot_baselines.learned.config import Config, algorithm_class, make_config
from cablebot_baselines.learned.export import network_from_sb3
from cablebot_baselines.learned.recipe import make_training_envs, steered_env
from cablebot_baselines.learned.wrappers import PayloadCurriculumVector, SteeredVector

PARTS = 20
"""Default number of evaluations and of checkpoints in a run."""

_MODEL = "model.zip"
_NORMALIZE = "vecnormalize.pkl"
_REPLAY = "replay_buffer.pkl"


def train(
    env_id: str,
    *,
    out: Path,
    algorithm: str | None = None,
    config: Path | None = None,
    seed: int | None = None,
    timesteps: int | None = None,
    resume: bool = False,
    eval_every: int | None = None,
    checkpoint_every: int | None = None,
    threads: int | None = None,
    evaluation: Mapping[str, Any] | None = None,
    progress: runs.Progress | None = None,
    say: runs.Say | None = None,
) -> runs.TrainingResult:
    """Trains a learned policy with Stable-Baselines3.

    The same seed and number of threads on the same machine give the same weights, unless the run is
    interrupted. SIGINT and SIGTERM stop a run after the current rollout, with a checkpoint; a
    second SIGINT stops it immediately.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        algorithm: ``ppo``, ``sac`` or ``tqc``; None for ``ppo``.
        config: YAML file with RL-Zoo's keys; None for the shipped one.
        seed: seed of weights, exploration and environments; None for 0.
        timesteps: number of actions over all environments; None for the configuration's
            ``n_timesteps``.
        resume: whether to resume the run in ``out`` from its last checkpoint: the saved model,
            normalisation and replay buffer, with new episodes. The result is therefore not that of
            an uninterrupted run. Arguments that are None keep the values that the run was started
            with; other arguments must equal these values, except for ``timesteps``, at whose new
            value linear schedules end.
        eval_every: timesteps between two evaluations; None for 1/20 of all timesteps. A checkpoint
            follows each one.
        checkpoint_every: timesteps between two checkpoints; None for 1/20 of all timesteps.
        threads: number of torch's threads; None for 1. For networks of this size, more threads are
            hardly faster, and much slower if other processes use the cores.
        evaluation: keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc` in
            addition to the criterion ``task`` and ``RESOLUTION``, such as ``{"payload_known":
            False}``.
        progress: function called with the progress.
        say: function called with messages for the user.

    Raises:
        ValueError: if an argument or the configuration is invalid, or ``out`` already contains a
            run. With ``resume`` also if ``out`` contains no run, a run with other settings, or a
            damaged checkpoint. No file is changed.
        Interrupted: after a signal, when the checkpoint is written.
        cablebot_gym.policies.protocol.PolicyError: if an evaluation fails.
    """
    options: dict[str, Any] = {
        "env_id": env_id,
        "algorithm": algorithm or (None if resume else "ppo"),
        "seed": seed,
        "timesteps": timesteps,
        "eval_every": eval_every,
        "checkpoint_every": checkpoint_every,
        "threads": threads,
        "evaluation": None if evaluation is None else dict(evaluation),
    }
    algorithm_class(algorithm or "ppo")
    state = runs.open_run(out, options, config, resume=resume)
    settings = state.settings
    hyperparameters = make_config(settings["config"])
    interval = max(1, settings.setdefault("timesteps", hyperparameters.timesteps) // PARTS)
    state.settings = {
        "eval_every": interval,
        "checkpoint_every": interval,
        "evaluation": {},
        **settings,
    }
    if state.timesteps >= settings["timesteps"]:
        if say:
            say(
                f"nothing to do: {state.timesteps} timesteps are done. Use --timesteps to train longer"
            )
        return state
    with (
        runs.torch_threads(settings["threads"]),
        closing(_environments(hyperparameters, state)) as envs,
    ):
        model = (_load if resume else _make)(state, hyperparameters, envs)
        network_from_sb3(model)  # fails before the training if the model cannot be exported
        total = state.settings["timesteps"]
        evaluation = state.settings["evaluation"]
        steered = steered_env(model)
        plain: Any = steered.unwrapped
        run = runs.Run(
            state,
            steered.steering,
            total=total,
            evaluation=evaluation,
            trained_on=[plain.settings.trajectory],
            progress=progress,
            say=say,
        )
        callback = _RunCallback(run, _curriculum(steered))
        callback.init_callback(model)
        if not resume:
            run.start()
        _learn(model, callback, run)
    return state


def _environments(config: Config, state: runs.TrainingResult) -> VecNormalize:
    seed = (
        state.settings["seed"] + state.timesteps
    )  # a resumed run does not repeat its first episodes
    return make_training_envs(state.settings["env_id"], seed=seed, config=config)


def _make(state: runs.TrainingResult, config: Config, envs: VecNormalize) -> BaseAlgorithm:
    """Makes a new model.

    Raises:
        ValueError: if SB3 rejects the hyperparameters.
    """
    name = state.settings["algorithm"]
    algorithm: Any = algorithm_class(name)
    try:
        # The CPU is faster than an accelerator for networks of this size, and gives reproducible
        # weights.
        model: BaseAlgorithm = algorithm(
            env=envs, seed=state.settings["seed"], device="cpu", **config.model
        )
    except (TypeError, ValueError, AssertionError) as error:
        raise ValueError(
            f"{name} rejects the hyperparameters ({error}): correct the file"
        ) from error
    return model


def _load(state: runs.TrainingResult, config: Config, envs: VecNormalize) -> BaseAlgorithm:
    """Loads the model of a checkpoint, and the payload ceiling of its curriculum.

    Raises:
        ValueError: if the checkpoint is damaged.
    """
    folder = state.checkpoint
    with runs.checkpoint_errors(state.out):
        normalize = VecNormalize.load(str(folder / _NORMALIZE), envs.venv)
        model = algorithm_class(state.settings["algorithm"]).load(
            folder / _MODEL, env=normalize, device="cpu"
        )
        if isinstance(model, OffPolicyAlgorithm):
            model.load_replay_buffer(folder / _REPLAY)
    model.set_random_seed(state.settings["seed"] + state.timesteps)
    curriculum = _curriculum(steered_env(model))
    if curriculum is not None and state.payload_ceiling is not None:
        curriculum.ceiling = state.payload_ceiling
    return model


def _curriculum(steered: SteeredVector) -> PayloadCurriculumVector | None:
    layer: Any = steered
    while layer is not None and not isinstance(layer, PayloadCurriculumVector):
        layer = getattr(layer, "env", None)
    return layer


class _RunCallback(BaseCallback):
    """Evaluates and saves the model between two rollouts, and stops the training after a signal."""

    def __init__(self, run: runs.Run, curriculum: PayloadCurriculumVector | None) -> None:
        super().__init__()
        self._run, self._curriculum = run, curriculum
        self._saved = self._evaluated = run.state.timesteps

    def evaluate(self) -> None:
        """Evaluates the model, unless this has just been done."""
        state = self._run.state
        state.timesteps = self.model.num_timesteps
        if self._evaluated < state.timesteps:
            payload = self._run.evaluate(network_from_sb3(self.model))
            self.logger.record("eval/payload_kg", runs.rank(payload))
            self._evaluated = state.timesteps

    def save(self) -> None:
        """Writes a checkpoint."""
        state = self._run.state
        state.timesteps = self._saved = self.model.num_timesteps
        state.payload_ceiling = None if self._curriculum is None else self._curriculum.ceiling
        self._run.save(self._write)

    def _write(self, folder: Path) -> None:
        normalize = self.model.get_vec_normalize_env()
        assert normalize is not None
        self.model.save(folder / _MODEL)
        normalize.save(str(folder / _NORMALIZE))
        if isinstance(self.model, OffPolicyAlgorithm):
            self.model.save_replay_buffer(folder / _REPLAY)

    def _on_rollout_start(self) -> None:
        """Evaluates and saves if due.

        Raises:
            Interrupted: after a signal.
        """
        run = self._run
        settings = self._run.state.settings
        now = self.model.num_timesteps
        if self._curriculum is not None:
            self.logger.record("rollout/payload_ceiling", self._curriculum.ceiling)
        evaluation_due = now // settings["eval_every"] > self._evaluated // settings["eval_every"]
        if evaluation_due:
            self.evaluate()
        due = (
            evaluation_due
            or now // settings["checkpoint_every"] > self._saved // settings["checkpoint_every"]
        )
        if due or (run.stopped and now > self._saved):
            self.save()
        if run.stopped:
            raise runs.Interrupted(now)

    def _on_step(self) -> bool:
        best = self._run.state.best
        self._run.report(
            f"training, best {runs.kg(best.payload_kg)}" if best else "training", self.num_timesteps
        )
        return True


def _learn(model: BaseAlgorithm, callback: _RunCallback, run: runs.Run) -> None:
    """Trains to the end."""
    start, out = model.num_timesteps, run.out
    formats: list[KVWriter] = [make_output_format("csv", str(out), f"_{start}" if start else "")]
    with suppress(AssertionError):  # SB3 raises it if TensorBoard is not installed
        formats.append(TensorBoardOutputFormat(str(out / "tensorboard")))
    logger = Logger(str(out), formats)
    model.set_logger(logger)
    off_policy = isinstance(
        model, OffPolicyAlgorithm
    )  # its log_interval counts episodes, not rollouts
    try:
        with run.signals():
            if not start:
                callback.save()
            model.learn(
                run.state.settings["timesteps"] - start,
                callback=callback,
                log_interval=4 * model.n_envs if off_policy else 1,
                reset_num_timesteps=not start,
            )
            callback.evaluate()
        run.bundle(network_from_sb3(model)).save(out / runs.LAST)
        callback.save()
    finally:
        logger.close()
