"""Training runs with PPO of Stable-Baselines3 (SB3): DLCC evaluations, best policy, checkpoints.

A run's folder contains:

* ``best.zip``, the policy with the largest DLCC in the evaluations, and ``last.zip``, the final
  policy; both are a :class:`~cablebot_baselines.learned.bundle.Bundle`.
* ``run.json``, settings and evaluations up to the last checkpoint, and ``config.yaml``, the
  configuration.
* ``log``, SB3's log: ``progress.csv``, and events for TensorBoard. A run that was resumed after N
  timesteps continues in ``log_N``.
* ``checkpoints``, the files of SB3's ``CheckpointCallback``. SB3 loads them with ``pickle``: resume
  only runs that you trust.
"""

from __future__ import annotations

import json
import signal
import threading
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

try:
    import torch
    import yaml
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import CheckpointCallback, EventCallback
    from stable_baselines3.common.logger import configure
    from stable_baselines3.common.vec_env import VecNormalize
except ImportError as error:
    raise ImportError(
        "training needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name
    ) from error

from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.recipe import (
    HYPERPARAMS,
    Config,
    find_config,
    make_training_envs,
    steered_env,
    trained_policy,
)
from cablebot_baselines.learned.wrappers import PayloadCurriculum
from cablebot_baselines.learned.wrappers.layers import layers
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.utils.checks import whole
from cablebot_gym.utils.console import Step, command_line, say
from cablebot_gym.utils.files import atomic_write_text, check_writable_dir, json_text, read_text
from cablebot_gym.utils.results import Printed

RUN = "run.json"
CONFIG = "config.yaml"
BEST = "best.zip"
LAST = "last.zip"
CHECKPOINTS = "checkpoints"
"""Names of the files and folders of a run."""

RESOLUTION = 0.05
"""Resolution of payloads in evaluations during training [kg]; ``evaluation`` may override it."""

PARTS = 20
"""Default number of evaluations in a run."""


class Interrupted(KeyboardInterrupt):
    """A signal has stopped a run."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """An evaluation during training."""

    timesteps: int
    """Timesteps before the evaluation."""
    payload_kg: float | None
    """DLCC [kg]; None if the policy fails unloaded."""

    @property
    def rank(self) -> float:
        """Sort key; a policy that fails unloaded is below a payload of zero."""
        return -1.0 if self.payload_kg is None else self.payload_kg

    def __str__(self) -> str:
        return "fails unloaded" if self.payload_kg is None else f"{self.payload_kg:.2f} kg"


@dataclass(kw_only=True, repr=False)
class TrainingRun(Printed):
    """Settings and results of a run up to its last checkpoint: the content of ``run.json``.

    Raises:
        ValueError: if a setting is invalid.
    """

    env_id: str
    """Id of the environment."""
    seed: int
    """Seed of weights, exploration and environments."""
    timesteps: int
    """Number of actions over all environments at the end of the run."""
    eval_every: int
    """Timesteps between two evaluations. A checkpoint follows each one."""
    evaluation: dict[str, Any]
    """Keyword arguments of ``evaluate_dlcc``."""
    done: int = 0
    """Number of timesteps at the last checkpoint."""
    payload_ceiling: float | None = None
    """Largest payload of the curriculum at the last checkpoint [kg]; None without a curriculum."""
    base: Evaluation | None = None
    """Evaluation of the base law alone; None before it."""
    evaluations: list[Evaluation] = field(default_factory=list)
    """Evaluations in chronological order."""

    def __post_init__(self) -> None:
        for name, least in (("seed", 0), ("timesteps", 1), ("eval_every", 1)):
            whole(name, getattr(self, name), least=least)

    @classmethod
    def load(cls, out: str | Path) -> TrainingRun:
        """Loads the run in a folder.

        Raises:
            ValueError: if there is none, or it is damaged.
        """
        path = Path(out, RUN)
        if not path.is_file():
            raise ValueError(
                f"there is no run to resume in {str(out)!r}. Omit --resume to start one"
            )
        with checkpoint_errors(out):
            data = json.loads(read_text(path))
            data["base"] = Evaluation(**data["base"])
            data["evaluations"] = [Evaluation(**item) for item in data["evaluations"]]
            return cls(**data)

    @property
    def best(self) -> Evaluation | None:
        """Evaluation of ``best.zip``; None if there is none yet."""
        return max(self.evaluations, key=lambda item: item.rank, default=None)

    @property
    def evaluated(self) -> int:
        """Number of timesteps at the last evaluation; 0 before it."""
        return self.evaluations[-1].timesteps if self.evaluations else 0

    def __str__(self) -> str:
        text = f"{self.done} timesteps; DLCC of the base law alone: {self.base}"
        if self.best is None or self.base is None:
            return text
        text += f", of the best policy: {self.best}, of the last one: {self.evaluations[-1]}"
        resolution = self.evaluation["resolution"]
        if self.best.rank < self.base.rank + resolution:
            text += f"; no gain over the base law within the resolution of {resolution:g} kg"
        return text


@contextmanager
def one_thread() -> Iterator[None]:
    """Limits torch to one thread: more do not speed up so small a network, and they are much slower
    if other processes use the cores."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@one_thread()
def train(
    env_id: str,
    *,
    out: str | Path,
    config: str | Path = HYPERPARAMS,
    seed: int = 0,
    timesteps: int | None = None,
    eval_every: int | None = None,
    evaluation: Mapping[str, Any] | None = None,
    progress: Step | None = None,
) -> TrainingRun:
    """Trains a learned policy with Stable-Baselines3.

    The same seed on the same machine gives the same weights, unless the run is interrupted. SIGINT
    and SIGTERM stop a run after the current rollout, or within an evaluation, with a checkpoint; a
    second SIGINT stops it immediately.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        config: YAML file with RL-Zoo's keys; by default the shipped one.
        seed: seed of weights, exploration and environments.
        timesteps: number of actions over all environments, in whole rollouts; None for
            ``n_timesteps`` of the configuration.
        eval_every: timesteps between two evaluations, which checkpoints follow; None for 1/20 of
            all timesteps.
        evaluation: keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc` in
            addition to the criterion ``task`` and :data:`RESOLUTION`, such as ``{"payload_known":
            False}``.
        progress: function called with the progress.

    Raises:
        ValueError: if an argument or the configuration is invalid, or ``out`` already contains a
            run. No file is changed.
        Interrupted: after a signal, when the checkpoint is written.
        cablebot_gym.policies.protocol.PolicyError: if an evaluation fails.
    """
    out = Path(out)
    check_writable_dir(out)
    if any((out / name).exists() for name in (RUN, BEST, LAST)):
        raise ValueError(
            f"{str(out)!r} already contains a run: add --resume, or choose another --out"
        )
    settings = find_config(env_id, config)
    if timesteps is None:
        timesteps = settings.timesteps
    if eval_every is None:
        eval_every = max(1, timesteps // PARTS)
    run = TrainingRun(
        env_id=env_id,
        seed=seed,
        timesteps=timesteps,
        eval_every=eval_every,
        evaluation={"criterion": "task", "resolution": RESOLUTION, **(evaluation or {})},
    )
    with closing(make_training_envs(env_id, seed=seed, config=settings)) as envs:
        try:
            # The CPU is faster than an accelerator for networks of this size, and gives
            # reproducible weights.
            model = PPO(env=envs, seed=seed, device="cpu", **settings.model)
        except (TypeError, ValueError, AssertionError) as error:
            raise ValueError(
                f"PPO rejects the hyperparameters ({error}): correct the file"
            ) from error
        _learn(model, run, out, settings, progress)
    return run


@one_thread()
def resume_training(
    env_id: str, *, out: str | Path, timesteps: int | None = None, progress: Step | None = None
) -> TrainingRun:
    """Continues the run in a folder from its last checkpoint.

    Weights, optimiser, normalisation and payload ceiling are those of the checkpoint, but the
    episodes are new: the result is not that of an uninterrupted run. SB3's checkpoints have neither
    the state of the environments nor that of the random generators.

    Args:
        env_id: id of the run.
        out: folder of the run.
        timesteps: new number of timesteps at the end, at which linear schedules end; None for that
            of the run.
        progress: function called with the progress.

    Raises:
        ValueError: if ``out`` contains no run, a run of another id, or a damaged checkpoint. No
            file is changed.
        Interrupted: after a signal, when the checkpoint is written.
        cablebot_gym.policies.protocol.PolicyError: if an evaluation fails.
    """
    out = Path(out)
    run = TrainingRun.load(out)
    if env_id != run.env_id:
        raise ValueError(f"the run in {str(out)!r} was started with {run.env_id}, not {env_id}")
    if timesteps is not None:
        run = replace(run, timesteps=timesteps)
    if run.evaluated >= run.timesteps:
        return run
    config = find_config(env_id, out / CONFIG)
    seed = run.seed + run.done  # a resumed run does not repeat its episodes
    with closing(make_training_envs(env_id, seed=seed, config=config)) as envs:
        prefix = str(out / CHECKPOINTS / "rl_model")
        with checkpoint_errors(out):
            normalize = VecNormalize.load(f"{prefix}_vecnormalize_{run.done}_steps.pkl", envs.venv)
            model = PPO.load(f"{prefix}_{run.done}_steps.zip", env=normalize, device="cpu")
        model.set_random_seed(seed)
        _learn(model, run, out, config, progress)
    return run


def _learn(model: PPO, run: TrainingRun, out: Path, config: Config, progress: Step | None) -> None:
    """Trains to the end; writes no file before the base law is evaluated."""
    with _stop_request() as stop:
        callback = EvaluateDLCC(model, run, out, config, progress, stop)
        if run.base is None:
            policy = trained_policy(model)
            policy = LearnedPolicy(policy.bundle.base_alone, policy.robot)
            run.base = callback.dlcc(policy, "evaluating the base law")
        out.mkdir(parents=True, exist_ok=True)
        text = yaml.safe_dump({run.env_id: config.plain}, sort_keys=False)
        atomic_write_text(out / CONFIG, text)
        suffix = f"_{run.done}" if run.done else ""
        logger = configure(str(out / f"log{suffix}"), ["csv", "tensorboard"])
        model.set_logger(logger)
        try:
            model.learn(
                run.timesteps - run.done, callback=callback, reset_num_timesteps=not run.done
            )
            callback.finish()
        except Interrupted:
            callback.save()
            again = command_line("train", run.env_id, out=out, resume=True)
            say(f"stopped after {run.done} timesteps; to resume: {again}")
            raise
        finally:
            logger.close()


class EvaluateDLCC(EventCallback):
    """Evaluates the payload of the policy between two rollouts, and writes the best one. SB3's
    ``CheckpointCallback`` follows each evaluation.

    SB3's ``EvalCallback`` evaluates the mean return, which is not what counts here.

    Args:
        model: model on environments of
            :func:`~cablebot_baselines.learned.recipe.make_training_envs`.
        run: the run, which is kept up to date.
        out: folder of the run.
        config: configuration of the run.
        progress: function called with the progress.
        stop: set to stop the run.
    """

    def __init__(
        self,
        model: PPO,
        run: TrainingRun,
        out: Path,
        config: Config,
        progress: Step | None,
        stop: threading.Event,
    ) -> None:
        path = str(out / CHECKPOINTS)
        super().__init__(CheckpointCallback(1, path, save_vecnormalize=True))
        self.model: PPO = model
        self._run = run
        self._out = out
        self._config = config
        self._progress = progress
        self._stop = stop
        self._curriculum: PayloadCurriculum | None = None
        for layer in layers(steered_env(model)):
            if isinstance(layer, PayloadCurriculum):
                self._curriculum = layer
                layer.ceiling = run.payload_ceiling or layer.ceiling

    def _report(self, text: str) -> None:
        if self._progress:
            self._progress(self.model.num_timesteps, self._run.timesteps, text)

    def dlcc(self, policy: LearnedPolicy, text: str) -> Evaluation:
        """Evaluates a policy.

        Raises:
            Interrupted: after a signal, within a control step.
        """

        def after_step(steps: int, expected: int) -> None:
            if self._stop.is_set():
                raise Interrupted
            self._report(f"{text}, {steps / expected:.0%}")

        options: dict[str, Any] = {"progress": after_step, **self._run.evaluation}
        result = evaluate_dlcc(policy, self._run.env_id, **options)
        return Evaluation(timesteps=self.model.num_timesteps, payload_kg=result.payload)

    def _evaluate(self) -> None:
        run = self._run
        run.done = self.model.num_timesteps
        best = run.best
        policy = trained_policy(self.model)
        evaluation = self.dlcc(policy, "evaluating")
        run.evaluations.append(evaluation)
        if best is None or evaluation.rank > best.rank:
            self._write(policy, BEST)
        self.logger.record("eval/payload_kg", evaluation.rank)
        self.logger.record("time/total_timesteps", run.done, exclude="tensorboard")
        self.logger.dump(run.done)
        self.save()

    def _write(self, policy: LearnedPolicy, name: str) -> None:
        """Writes a policy with its training record."""
        packages = ("torch", "stable-baselines3")
        card = {
            **asdict(self._run),
            "config": self._config.plain,
            "versions": versions() | {package: version(package) for package in packages},
        }
        replace(policy.bundle, card=card).save(self._out / name)

    def save(self) -> None:
        """Writes a checkpoint."""
        run = self._run
        run.done = self.model.num_timesteps
        if self._curriculum is not None:
            run.payload_ceiling = self._curriculum.ceiling
        self._on_event()
        # Only now does run.json name this checkpoint.
        atomic_write_text(self._out / RUN, json_text(asdict(run)))

    def finish(self) -> None:
        """Evaluates and writes the final policy.

        Raises:
            Interrupted: after a signal.
        """
        self._run.done = self.model.num_timesteps
        if self._run.evaluated < self._run.done:
            self._evaluate()
        self._write(trained_policy(self.model), LAST)

    def _on_rollout_start(self) -> None:
        if self._stop.is_set():
            raise Interrupted
        if self._curriculum is not None:
            self.logger.record("rollout/payload_ceiling", self._curriculum.ceiling)
        interval = self._run.eval_every
        if self.model.num_timesteps // interval > self._run.evaluated // interval:
            self._evaluate()

    def _on_step(self) -> bool:
        text = "training"
        if self._run.best is not None:
            text += f", best {self._run.best}"
        self._report(text)
        return True


@contextmanager
def _stop_request() -> Iterator[threading.Event]:
    """An event that SIGINT or SIGTERM sets; a second SIGINT raises. Ignored signals stay ignored."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop
        return

    def note(number: int, frame: Any) -> None:
        if stop.is_set() and number == signal.SIGINT:
            raise KeyboardInterrupt
        stop.set()
        say("stopping; Ctrl-C again stops immediately and keeps the last checkpoint")

    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number, handler in handlers.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, note)
    try:
        yield stop
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def checkpoint_errors(out: str | Path) -> Iterator[None]:
    """Raises a ValueError in place of any error within the context, which reads the checkpoint in
    ``out``."""
    try:
        yield
    # Damaged files raise errors of zipfile, pickle, json, numpy and torch.
    except Exception as error:
        raise ValueError(
            f"the checkpoint in {str(out)!r} cannot be resumed ({type(error).__name__}: {error}); no file was changed. "
            "Start a new run with another --out"
        ) from error
