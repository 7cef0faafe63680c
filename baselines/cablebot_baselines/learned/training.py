"""Training runs with Stable-Baselines3 (SB3): checkpoints for bit-exact resumption, DLCC evaluations, best policy.

A run's folder contains:

* ``checkpoint.zip``, see :mod:`cablebot_baselines.learned.checkpoint`; it is written between two rollouts.
* ``best.zip``, the policy with the largest DLCC in the evaluations, and ``last.zip``, the final policy; both are a
  :class:`~cablebot_baselines.learned.bundle.Bundle`.
* ``evaluations.csv``.
* ``progress.csv``, SB3's log, and the same log in ``tensorboard`` if TensorBoard is installed.

Resuming loads the checkpoint with ``pickle``: resume only runs that you trust.
"""

from __future__ import annotations

import csv
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

try:
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import CSVOutputFormat, KVWriter, Logger, TensorBoardOutputFormat
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    from stable_baselines3.common.vec_env import VecMonitor, VecNormalize
except ImportError as error:
    raise ImportError("training needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name) from error

from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.checkpoint import Checkpoint, Settings, model_members
from cablebot_baselines.learned.config import Config, algorithm_class, make_config, read_config
from cablebot_baselines.learned.export import bundle_from_sb3, zero_network
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.runs import (
    BEST,
    CHECKPOINT,
    LAST,
    PROGRESS,
    RESOLUTION,
    TENSORBOARD,
    Evaluation,
    Interrupted,
    Progress,
    TrainingResult,
    check_no_run,
    rank,
    torch_threads,
    versions,
    write_evaluations,
)
from cablebot_baselines.learned.vec_env import CableBotVecEnv
from cablebot_baselines.learned.wrappers import make_steered_vec
from cablebot_gym.envs import env_robot
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.robots import find_robot
from cablebot_gym.utils.files import check_writable_dir

PARTS = 20
"""Default number of evaluations and of checkpoints in a run."""


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
    progress: Progress | None = None,
    say: Callable[[str], None] | None = None,
) -> TrainingResult:
    """Trains a learned policy with Stable-Baselines3.

    The same seed and number of threads on the same machine give the same weights, also if the run was resumed. SIGINT
    and SIGTERM stop a run after the current rollout, with a checkpoint; a second SIGINT stops it immediately.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        algorithm: ``ppo``, ``sac`` or ``tqc``; None for ``ppo``.
        config: YAML file with RL-Zoo's keys; None for the shipped one.
        seed: seed of weights, exploration and environments; None for 0.
        timesteps: number of actions over all environments; None for the configuration's ``n_timesteps``.
        resume: whether to resume the run in ``out``. Arguments that are None keep the values that the run was started
            with; other arguments must equal these values, except for ``timesteps``.
        eval_every: timesteps between two evaluations; None for 1/20 of all timesteps.
        checkpoint_every: timesteps between two checkpoints; None for 1/20 of all timesteps.
        threads: number of torch's threads; None for 1. For networks of this size, more threads are hardly faster, and
            much slower if other processes use the cores.
        evaluation: keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc` in addition to the
            criterion ``task`` and ``RESOLUTION``, such as ``{"payload_known": False}``.
        progress: function called with the progress.
        say: function called with messages for the user.

    Raises:
        ValueError: if an argument or the configuration is invalid, or ``out`` already contains a run. With ``resume``
            also if ``out`` contains no run, a run with other settings, or a damaged checkpoint. No file is changed.
        Interrupted: after a signal, when the checkpoint is written.
        cablebot_gym.policies.protocol.PolicyError: if an evaluation fails.
    """
    tell: Callable[[str], None] = say or (lambda text: None)
    check_writable_dir(out)
    arguments: dict[str, Any] = {
        "env_id": env_id,
        "algorithm": algorithm,
        "seed": seed,
        "eval_every": eval_every,
        "checkpoint_every": checkpoint_every,
        "threads": threads,
        "evaluation": None if evaluation is None else dict(evaluation),
    }
    if resume:
        checkpoint = Checkpoint.load(out / CHECKPOINT)
        if config is not None:
            arguments["config"] = read_config(env_id, checkpoint.settings.algorithm, config)
        settings = _resumed(checkpoint.settings, arguments, timesteps, out)
        if checkpoint.timesteps >= settings.timesteps:
            done = f"{checkpoint.timesteps} of {settings.timesteps} timesteps are done"
            tell(f"nothing to do: {done}. Use --timesteps to train longer")
            return checkpoint.result(out)
        if (other := versions()) != checkpoint.versions:
            changed = ", ".join(
                f"{name} {other[name]}" for name in other if other[name] != checkpoint.versions.get(name)
            )
            tell(f"note: the run started with other versions than {changed}; the result is not bit-exact")
        if settings.timesteps != checkpoint.settings.timesteps:
            tell("note: the run started with another --timesteps; linear schedules now end at the new value")
    else:
        check_no_run(out)
        settings, checkpoint = _settings(arguments, config, timesteps), None
    checked = make_config(env_id, settings.algorithm, settings.config, timesteps=settings.timesteps)
    with torch_threads(settings.threads):
        run = _Run(settings, checked, out, checkpoint, progress or (lambda text, done, total: None), tell)
        try:
            return run.finish()
        finally:
            run.close()


def _settings(arguments: Mapping[str, Any], config: Path | None, timesteps: int | None) -> Settings:
    algorithm = "ppo" if arguments["algorithm"] is None else arguments["algorithm"]
    plain = read_config(arguments["env_id"], algorithm, config)
    total = make_config(arguments["env_id"], algorithm, plain, timesteps=timesteps).timesteps
    interval = max(1, total // PARTS)
    given = {name: value for name, value in arguments.items() if value is not None}
    least = {"seed": 0, "eval_every": 1, "checkpoint_every": 1, "threads": 1}
    for name in least:
        if name in given and given[name] < least[name]:
            raise ValueError(f"--{name.replace('_', '-')} must be at least {least[name]}, not {given[name]}")
    defaults = {"algorithm": algorithm, "seed": 0, "eval_every": interval, "checkpoint_every": interval}
    defaults |= {"threads": 1, "evaluation": {}, "config": plain}
    file = None if config is None else config.name
    return Settings(**{**defaults, **given, "timesteps": total, "config_file": file})


def _resumed(settings: Settings, arguments: Mapping[str, Any], timesteps: int | None, out: Path) -> Settings:
    """Settings of a resumed run.

    Raises:
        ValueError: if an argument differs from the settings that the run was started with.
    """
    for name, value in arguments.items():
        had = getattr(settings, name)
        if value is not None and value != had:
            option = "ID" if name == "env_id" else "--algo" if name == "algorithm" else f"--{name.replace('_', '-')}"
            other = "another --config" if name == "config" else f"{option} {had}, not {value}"
            raise ValueError(f"the run in {str(out)!r} was started with {other}: omit it, or choose another --out")
    return settings if timesteps is None else replace(settings, timesteps=timesteps)


class _Run:
    """A training and its folder."""

    def __init__(
        self,
        settings: Settings,
        config: Config,
        out: Path,
        checkpoint: Checkpoint | None,
        progress: Progress,
        say: Callable[[str], None],
    ) -> None:
        self.settings, self.config, self.out, self._progress, self._say = settings, config, out, progress, say
        self._robot = find_robot(env_robot(settings.env_id))
        self._logger: Logger | None = None
        self._started = time.monotonic()
        self._signal: int | None = None
        self._progress("preparing", 0, settings.timesteps)
        if checkpoint is None:
            self._wall, self.evaluations = 0.0, []
            self._begin()
            self.base_payload = self._dlcc(self._base_bundle())
            self._last_checkpoint = -1  # the first rollout starts with a checkpoint
        else:
            self._wall, self.evaluations = checkpoint.wall_s, list(checkpoint.evaluations)
            self.base_payload, self._last_checkpoint = checkpoint.base_payload_kg, checkpoint.timesteps
            self._restore(checkpoint)
        self.bundle()  # fails before the training if the model cannot be exported

    def close(self) -> None:
        """Closes the environments and the logs."""
        self.normalize.close()
        if self._logger is not None:
            self._logger.close()

    def _begin(self) -> None:
        config, seed = self.config, self.settings.seed
        envs = make_steered_vec(
            config.env_id, config.n_envs, wrappers=list(config.wrappers), seed=seed, **config.env_kwargs
        )
        self._envs = CableBotVecEnv(envs)
        self._monitor = VecMonitor(self._envs)
        self.normalize = VecNormalize(self._monitor, **config.normalize)
        algorithm: Any = algorithm_class(config.algorithm)
        # The CPU is faster than an accelerator for networks of this size, and gives reproducible weights.
        try:
            self.model: BaseAlgorithm = algorithm(
                config.policy, self.normalize, seed=seed, device="cpu", **config.model
            )
        except (TypeError, ValueError, AssertionError) as error:
            raise ValueError(f"{config.algorithm} rejects the hyperparameters ({error}): correct the file") from error

    def _restore(self, checkpoint: Checkpoint) -> None:
        """Restores environments and model from a checkpoint.

        Raises:
            ValueError: if the present code cannot unpickle it.
        """
        try:
            self._envs, monitor, normalize, returns = checkpoint.environments()
            self._monitor = VecMonitor(self._envs)
            self._monitor.episode_returns, self._monitor.episode_lengths, self._monitor.episode_count = monitor
            self.normalize = normalize
            normalize.set_venv(self._monitor)
            normalize.returns = returns
            self.model = checkpoint.model(algorithm_class(self.config.algorithm), normalize)
        except Exception as error:
            raise ValueError(
                f"checkpoint {str(self.out / CHECKPOINT)!r} cannot be resumed with these versions of the packages "
                f"({type(error).__name__}: {error}); no file was changed. Start a new run with another --out"
            ) from error

    def finish(self) -> TrainingResult:
        """Trains to the end."""
        settings, model = self.settings, self.model
        self.out.mkdir(parents=True, exist_ok=True)
        self._logger = _logger(self.out, model.num_timesteps)
        model.set_logger(self._logger)
        write_evaluations(self.out, self.evaluations)
        off_policy = isinstance(model, OffPolicyAlgorithm)  # its log_interval counts episodes, not rollouts
        with self._signals():
            model.learn(
                settings.timesteps - model.num_timesteps,
                callback=_RunCallback(self),
                log_interval=4 * self.config.n_envs if off_policy else 1,
                reset_num_timesteps=self._last_checkpoint < 0,
            )
            if not self.evaluations or self.evaluations[-1].timesteps < model.num_timesteps:
                self._evaluate()
        self.bundle().save(self.out / LAST)
        return self._save().result(self.out)

    def on_rollout_start(self) -> None:
        """Evaluates and saves if due, and stops the run after a signal.

        Raises:
            Interrupted: after a signal.
        """
        now, settings = self.model.num_timesteps, self.settings
        with suppress(AttributeError):  # there is no ceiling without a curriculum
            self.model.logger.record("rollout/payload_ceiling", self._envs.get_attr("ceiling", 0)[0])
        evaluated = self.evaluations[-1].timesteps if self.evaluations else 0
        if now // settings.eval_every > evaluated // settings.eval_every:
            self._evaluate()
        stop = self._signal is not None
        due = now // settings.checkpoint_every > self._last_checkpoint // settings.checkpoint_every
        if due or (stop and now > self._last_checkpoint):
            self._save()
        if stop:
            raise Interrupted(now)

    def on_step(self) -> None:
        """Reports the progress after a step of all environments."""
        best = max((item.payload_kg or 0.0 for item in self.evaluations), default=0.0)
        self._progress(f"training, best {best:.2f} kg", self.model.num_timesteps, self.settings.timesteps)

    def _wall_s(self) -> float:
        return self._wall + time.monotonic() - self._started

    def _dlcc(self, bundle: Bundle) -> float | None:
        """DLCC of a bundle in the environment without wrappers [kg]; None if it fails unloaded."""
        conditions: dict[str, Any] = {"criterion": "task", "resolution": RESOLUTION, **self.settings.evaluation}
        return evaluate_dlcc(LearnedPolicy(bundle, self._robot), self.settings.env_id, **conditions).payload

    def _evaluate(self) -> None:
        now = self.model.num_timesteps
        self._progress("evaluating", now, self.settings.timesteps)
        bundle = self.bundle()
        payload = self._dlcc(bundle)
        before = max((rank(item.payload_kg) for item in self.evaluations), default=-2.0)
        self.evaluations.append(Evaluation(timesteps=now, wall_s=round(self._wall_s(), 3), payload_kg=payload))
        self.model.logger.record("eval/payload_kg", rank(payload))
        if rank(payload) > before:
            replace(bundle, card=self._card()).save(self.out / BEST)
        write_evaluations(self.out, self.evaluations)

    def bundle(self) -> Bundle:
        """The current policy with its training record."""
        env_id = self.config.env_id
        return bundle_from_sb3(self.model, self.normalize, env_id=env_id, card=self._card(), **self._steered())

    def _base_bundle(self) -> Bundle:
        """A bundle with the base law alone."""
        shape = self.normalize.observation_space.shape
        assert shape is not None
        network = zero_network(shape[0], self.config.action_mapping.actions(self._robot))
        return Bundle(env_id=self.config.env_id, network=network, **self._steered())

    def _steered(self) -> dict[str, Any]:
        return {
            "base": self.config.base,
            "action_mapping": self.config.action_mapping,
            "features": self.config.features,
        }

    def _card(self) -> dict[str, Any]:
        settings, rows = self.settings, self.evaluations
        return {
            "command": settings.command(),
            "env_id": settings.env_id,
            "algorithm": settings.algorithm,
            "config": dict(settings.config),
            "seed": settings.seed,
            "timesteps": self.model.num_timesteps,
            "wall_s": round(self._wall_s(), 3),
            "threads": settings.threads,
            "versions": versions(),
            "payload_kg": rows[-1].payload_kg if rows and rows[-1].timesteps == self.model.num_timesteps else None,
            "evaluation": {"criterion": "task", "resolution": RESOLUTION, **settings.evaluation},
            "base_payload_kg": self.base_payload,
            "planner_output_used": False,
            "curve": [asdict(item) for item in rows],
        }

    def _save(self) -> Checkpoint:
        monitor = self._monitor
        counts = (monitor.episode_returns, monitor.episode_lengths, monitor.episode_count)
        members = model_members(self.model, (self._envs, counts, self.normalize, self.normalize.returns))
        checkpoint = Checkpoint(
            settings=self.settings,
            timesteps=self.model.num_timesteps,
            wall_s=round(self._wall_s(), 3),
            base_payload_kg=self.base_payload,
            evaluations=tuple(self.evaluations),
            versions=versions(),
            members=members,
        )
        checkpoint.save(self.out / CHECKPOINT)
        self._last_checkpoint = checkpoint.timesteps
        return checkpoint

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """Records the first SIGINT or SIGTERM; a second SIGINT raises. Ignored signals stay ignored."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def note(number: int, frame: Any) -> None:
            if self._signal is not None and number == signal.SIGINT:
                raise KeyboardInterrupt
            self._signal = number
            self._say("stopping after this rollout; Ctrl-C again stops immediately and keeps the last checkpoint")

        handled = [one for one in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(one) is not signal.SIG_IGN]
        before = {number: signal.signal(number, note) for number in handled}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


class _RunCallback(BaseCallback):
    """Callback of Stable-Baselines3 that calls a run."""

    def __init__(self, run: _Run) -> None:
        super().__init__()
        self._run = run

    def _on_rollout_start(self) -> None:
        self._run.on_rollout_start()

    def _on_step(self) -> bool:
        self._run.on_step()
        return True


def _logger(out: Path, timesteps: int) -> Logger:
    """Logger to ``progress.csv`` and TensorBoard; a resumed run keeps its rows up to the checkpoint."""
    path, past = out / PROGRESS, []
    if path.is_file() and timesteps:
        with path.open(newline="", encoding="utf-8") as file:
            past = [row for row in csv.DictReader(file) if _number(row.get("time/total_timesteps")) <= timesteps]
    formats: list[KVWriter] = [CSVOutputFormat(str(path))]
    for row in past:
        formats[0].write({name: float(value) for name, value in row.items() if value}, {})
    with suppress(AssertionError):  # SB3 raises it if TensorBoard is not installed
        formats.append(TensorBoardOutputFormat(str(out / TENSORBOARD)))
    return Logger(str(out), formats)


def _number(text: str | None) -> float:
    try:
        return float(text or "")
    except ValueError:
        return float("inf")
