"""Training runs: a folder with checkpoints that go on to the bit, evaluations by payload, and the best policy so far.

A run's folder holds ``checkpoint.zip``; ``best.zip``, the policy that carried most of those evaluated, and
``last.zip``, the one at the end, both :class:`~cablebot_baselines.learned.bundle.Bundle`; ``evaluations.csv``; ``progress.csv``,
what Stable-Baselines3 logs, and the same in ``tensorboard`` where that is installed.

A checkpoint, see :mod:`cablebot_baselines.learned.checkpoint`, is taken between two rollouts. It is read with ``pickle``: resume
only runs of which you know where they come from.
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
from cablebot_baselines.learned.checkpoint import Checkpoint, Settings, model_parts
from cablebot_baselines.learned.config import Config, algorithm_class, make_config, read_config
from cablebot_baselines.learned.export import bundle_from_sb3, silent_network
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
    Trained,
    check_new,
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
from cablebot_gym.utils.files import usable_folder

PARTS = 20
"""Into how many parts evaluations and checkpoints divide a run, if nobody says how often they are wanted."""


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
) -> Trained:
    """Trains a learned policy. The same seed and threads on the same machine give the same weights, resumed or not.

    SIGINT and SIGTERM end a run at the end of its rollout, with a checkpoint; a second SIGINT ends it at once.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        algorithm: ``ppo``, ``sac`` or ``tqc``; None for ``ppo``.
        config: YAML file with RL-Zoo's keys; None for the one that ships.
        seed: of weights, exploration and environments; None for 0.
        timesteps: actions over all environments; None for the configuration's ``n_timesteps``.
        resume: whether to go on with the run in ``out``. Arguments that are None are then those it was started with,
            and others have to be the same, but for ``timesteps``.
        eval_every: timesteps from one evaluation to the next; None for a twentieth of all.
        checkpoint_every: timesteps from one checkpoint to the next; None for a twentieth of all.
        threads: of torch; None for 1, which for networks of this size is hardly slower than more, and much faster
            where other processes want the cores too.
        evaluation: keywords of :func:`cablebot_gym.evaluation.evaluate_dlcc` beyond criterion ``task`` and
            :data:`RESOLUTION`, such as ``{"payload_known": False}``.
        progress: told how far it is.
        say: told what a user should know.

    Raises:
        ValueError: if an argument or the configuration is not valid, ``out`` already has a run, or, to be resumed, has
            none, another one, or a damaged checkpoint; nothing was written then.
        Interrupted: after a signal, once the checkpoint is written.
        cablebot_gym.policies.PolicyError: if an evaluation fails.
    """
    tell: Callable[[str], None] = say or (lambda text: None)
    usable_folder(out)
    asked: dict[str, Any] = {"env_id": env_id, "algorithm": algorithm, "seed": seed, "eval_every": eval_every}
    asked |= {"checkpoint_every": checkpoint_every, "threads": threads}
    asked |= {"evaluation": None if evaluation is None else dict(evaluation)}
    if resume:
        checkpoint = Checkpoint.load(out / CHECKPOINT)
        if config is not None:
            asked["config"] = read_config(env_id, checkpoint.settings.algorithm, config)
        settings = _resumed(checkpoint.settings, asked, timesteps, out)
        if checkpoint.timesteps >= settings.timesteps:
            tell(f"nothing to do: {checkpoint.timesteps} of {settings.timesteps} timesteps are done; more: --timesteps")
            return checkpoint.trained(out)
        if (other := versions()) != checkpoint.versions:
            changed = ", ".join(
                f"{name} {other[name]}" for name in other if other[name] != checkpoint.versions.get(name)
            )
            tell(f"note: the run began with other versions than {changed}: it goes on, but not to the bit")
        if settings.timesteps != checkpoint.settings.timesteps:
            tell("note: the run began with other --timesteps: schedules that fall to the end fall to another one now")
    else:
        check_new(out)
        settings, checkpoint = _settings(asked, config, timesteps), None
    made = make_config(env_id, settings.algorithm, settings.config, timesteps=settings.timesteps)
    with torch_threads(settings.threads):
        run = _Run(settings, made, out, checkpoint, progress or (lambda text, done, total: None), tell)
        try:
            return run.finish()
        finally:
            run.close()


def _settings(asked: Mapping[str, Any], config: Path | None, timesteps: int | None) -> Settings:
    algorithm = "ppo" if asked["algorithm"] is None else asked["algorithm"]
    plain = read_config(asked["env_id"], algorithm, config)
    total = make_config(asked["env_id"], algorithm, plain, timesteps=timesteps).timesteps
    part = max(1, total // PARTS)
    given = {name: value for name, value in asked.items() if value is not None}
    least = {"seed": 0, "eval_every": 1, "checkpoint_every": 1, "threads": 1}
    for name in least:
        if name in given and given[name] < least[name]:
            raise ValueError(f"--{name.replace('_', '-')} must be at least {least[name]}, not {given[name]}")
    defaults = {"algorithm": algorithm, "seed": 0, "eval_every": part, "checkpoint_every": part}
    defaults |= {"threads": 1, "evaluation": {}, "config": plain}
    file = None if config is None else config.name
    return Settings(**{**defaults, **given, "timesteps": total, "config_file": file})


def _resumed(settings: Settings, asked: Mapping[str, Any], timesteps: int | None, out: Path) -> Settings:
    """The settings that a run goes on with.

    Raises:
        ValueError: if others are asked for than it was started with.
    """
    for name, value in asked.items():
        had = getattr(settings, name)
        if value is not None and value != had:
            option = "ID" if name == "env_id" else "--algo" if name == "algorithm" else f"--{name.replace('_', '-')}"
            other = "another --config" if name == "config" else f"{option} {had}, not {value}"
            raise ValueError(
                f"the run in {str(out)!r} was started with {other}: leave that out, or choose another --out"
            )
    return settings if timesteps is None else replace(settings, timesteps=timesteps)


class _Run:
    """A model in training and the folder that it leaves its traces in."""

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
            self.base_payload = self._evaluated(self._silent())
            self._checked = -1  # so that the first rollout starts with a checkpoint
        else:
            self._wall, self.evaluations = checkpoint.wall_s, list(checkpoint.evaluations)
            self.base_payload, self._checked = checkpoint.base_payload_kg, checkpoint.timesteps
            self._restore(checkpoint)
        self.bundle()  # what cannot be exported is found out before the work

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
        made: Any = algorithm_class(config.algorithm)
        # The CPU: for networks of this size an accelerator is slower, and the same weights could not be promised.
        try:
            self.model: BaseAlgorithm = made(config.policy, self.normalize, seed=seed, device="cpu", **config.model)
        except (TypeError, ValueError, AssertionError) as error:
            raise ValueError(f"{config.algorithm} refuses the hyperparameters ({error}): correct the file") from error

    def _restore(self, checkpoint: Checkpoint) -> None:
        """Everything as it was.

        Raises:
            ValueError: if it was pickled by code that is no longer like that.
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
                f"checkpoint {str(self.out / CHECKPOINT)!r} cannot be resumed, it is of other versions of the packages "
                f"({type(error).__name__}: {error}); nothing was changed: start again with another --out"
            ) from error

    def finish(self) -> Trained:
        """Trains to the end."""
        settings, model = self.settings, self.model
        self.out.mkdir(parents=True, exist_ok=True)
        self._logger = _logger(self.out, model.num_timesteps)
        model.set_logger(self._logger)
        write_evaluations(self.out, self.evaluations)
        off_policy = isinstance(model, OffPolicyAlgorithm)  # which count episodes, not rollouts
        with self._signals():
            model.learn(
                settings.timesteps - model.num_timesteps,
                callback=_Watch(self),
                log_interval=4 * self.config.n_envs if off_policy else 1,
                reset_num_timesteps=self._checked < 0,
            )
            if not self.evaluations or self.evaluations[-1].timesteps < model.num_timesteps:
                self._evaluate()
        self.bundle().save(self.out / LAST)
        return self._save().trained(self.out)

    def between(self) -> None:
        """Between two rollouts: evaluates and saves where it is time, and ends the run if that was asked for.

        Raises:
            Interrupted: if it was.
        """
        now, settings = self.model.num_timesteps, self.settings
        with suppress(AttributeError):  # without a curriculum
            self.model.logger.record("rollout/payload_ceiling", self._envs.get_attr("ceiling", 0)[0])
        evaluated = self.evaluations[-1].timesteps if self.evaluations else 0
        if now // settings.eval_every > evaluated // settings.eval_every:
            self._evaluate()
        stop = self._signal is not None
        if now // settings.checkpoint_every > self._checked // settings.checkpoint_every or (
            stop and now > self._checked
        ):
            self._save()
        if stop:
            raise Interrupted(now)

    def stepped(self) -> None:
        """After a step of all environments."""
        best = max((item.payload_kg or 0.0 for item in self.evaluations), default=0.0)
        self._progress(f"training, best {best:.2f} kg", self.model.num_timesteps, self.settings.timesteps)

    def _wall_s(self) -> float:
        return self._wall + time.monotonic() - self._started

    def _evaluated(self, bundle: Bundle) -> float | None:
        """Largest payload that a bundle carries on the plain environment [kg]."""
        conditions: dict[str, Any] = {"criterion": "task", "resolution": RESOLUTION, **self.settings.evaluation}
        return evaluate_dlcc(LearnedPolicy(bundle, self._robot), self.settings.env_id, **conditions).payload

    def _evaluate(self) -> None:
        now = self.model.num_timesteps
        self._progress("evaluating", now, self.settings.timesteps)
        bundle = self.bundle()
        payload = self._evaluated(bundle)
        before = max((rank(item.payload_kg) for item in self.evaluations), default=-2.0)
        self.evaluations.append(Evaluation(timesteps=now, wall_s=round(self._wall_s(), 3), payload_kg=payload))
        self.model.logger.record("eval/payload_kg", rank(payload))
        if rank(payload) > before:
            replace(bundle, card=self._card()).save(self.out / BEST)
        write_evaluations(self.out, self.evaluations)

    def bundle(self) -> Bundle:
        """The policy as it is now, with its card."""
        env_id = self.config.env_id
        return bundle_from_sb3(self.model, self.normalize, env_id=env_id, card=self._card(), **self._steered())

    def _silent(self) -> Bundle:
        """The base law alone."""
        shape = self.normalize.observation_space.shape
        assert shape is not None
        network = silent_network(shape[0], self.config.way.actions(self._robot))
        return Bundle(env_id=self.config.env_id, network=network, **self._steered())

    def _steered(self) -> dict[str, Any]:
        return {"base": self.config.base, "way": self.config.way, "features": self.config.features}

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
        parts = model_parts(self.model, (self._envs, counts, self.normalize, self.normalize.returns))
        checkpoint = Checkpoint(
            settings=self.settings,
            timesteps=self.model.num_timesteps,
            wall_s=round(self._wall_s(), 3),
            base_payload_kg=self.base_payload,
            evaluations=tuple(self.evaluations),
            versions=versions(),
            parts=parts,
        )
        checkpoint.save(self.out / CHECKPOINT)
        self._checked = checkpoint.timesteps
        return checkpoint

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """Within, the first SIGINT or SIGTERM is noted, and a second SIGINT raises. Ignored signals stay ignored."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def note(number: int, frame: Any) -> None:
            if self._signal is not None and number == signal.SIGINT:
                raise KeyboardInterrupt
            self._signal = number
            self._say("stopping when this rollout is done; Ctrl-C again stops at once, at the last checkpoint")

        heeded = [one for one in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(one) is not signal.SIG_IGN]
        before = {number: signal.signal(number, note) for number in heeded}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


class _Watch(BaseCallback):
    """Tells a run where Stable-Baselines3 is."""

    def __init__(self, run: _Run) -> None:
        super().__init__()
        self._run = run

    def _on_rollout_start(self) -> None:
        self._run.between()

    def _on_step(self) -> bool:
        self._run.stepped()
        return True


def _logger(out: Path, timesteps: int) -> Logger:
    """Logs to ``progress.csv``, after what a resumed run has there up to its checkpoint, and to TensorBoard."""
    path, past = out / PROGRESS, []
    if path.is_file() and timesteps:
        with path.open(newline="", encoding="utf-8") as file:
            past = [row for row in csv.DictReader(file) if _number(row.get("time/total_timesteps")) <= timesteps]
    formats: list[KVWriter] = [CSVOutputFormat(str(path))]
    for row in past:
        formats[0].write({name: float(value) for name, value in row.items() if value}, {})
    with suppress(AssertionError):  # how SB3 says that it is not installed
        formats.append(TensorBoardOutputFormat(str(out / TENSORBOARD)))
    return Logger(str(out), formats)


def _number(text: str | None) -> float:
    try:
        return float(text or "")
    except ValueError:
        return float("inf")
