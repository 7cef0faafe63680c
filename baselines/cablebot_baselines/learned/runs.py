"""A training run: its settings, folder, checkpoints, evaluations and best policy.

A run's folder contains:

* ``run.json``, the settings and evaluations at the last checkpoint, and ``checkpoint``, the
  algorithm's state.
* ``best.zip``, the policy with the largest DLCC in the evaluations, and ``last.zip``, the final
  policy; both are a :class:`~cablebot_baselines.learned.bundle.Bundle`.
* ``evaluations.csv``, and ``learning-curve.png`` at the end if matplotlib is installed.

This module does not need torch.
"""

from __future__ import annotations

import json
import platform
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, astuple, dataclass, field, fields, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.network import Network
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_gym.envs import env_robot
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.plotting.figures import add_legend, new_figure, save_figure, set_title
from cablebot_gym.robots import find_robot
from cablebot_gym.utils.checks import whole
from cablebot_gym.utils.console import command_line
from cablebot_gym.utils.files import (
    atomic_write_text,
    check_writable_dir,
    read_text,
    write_csv,
)
from cablebot_gym.utils.palette import BLUE
from cablebot_gym.utils.results import Printed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HYPERPARAMS = Path(__file__).parent / "hyperparams" / "ppo.yaml"
"""File of the shipped configurations."""

STATE = "run.json"
CHECKPOINT = "checkpoint"
BEST = "best.zip"
LAST = "last.zip"
EVALUATIONS = "evaluations.csv"
CURVE = "learning-curve.png"
"""Names of the files and folders of a run."""

RESOLUTION = 0.05
"""Resolution of payloads in evaluations during training [kg]; ``evaluation`` may override it."""

_OPTIONS = {
    "config_file": "--config",
    "seed": "--seed",
    "timesteps": "--timesteps",
    "eval_every": "--eval-every",
    "checkpoint_every": "--checkpoint-every",
    "threads": "--threads",
    "evaluation": "--evaluation",
}
"""Options of ``cablebot train`` by the name of the setting, in the order of :meth:`command`."""

_LEAST = {"seed": 0, "timesteps": 1, "eval_every": 1, "checkpoint_every": 1, "threads": 1}
"""Least values of the options that are whole numbers."""

_PACKAGES = ("numpy", "torch", "stable-baselines3", "sb3-contrib", "cablebot-gym")

Progress = Callable[[int, int, str], None]
"""Function called with the number of timesteps so far, the total, and a text."""

Say = Callable[[str], None]
"""Function called with a message for the user."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """An evaluation during training."""

    timesteps: int
    """Timesteps before the evaluation."""
    wall_s: float
    """Wall time since the start of the run, without pauses [s]."""
    payload_kg: float | None
    """DLCC [kg]; None if the policy fails unloaded."""


def rank(payload: float | None) -> float:
    """Sort key of payloads; None (fails unloaded) is below zero."""
    return -1.0 if payload is None else payload


def kg(payload: float | None) -> str:
    """A payload as text; None means that the policy fails unloaded."""
    return "fails unloaded" if payload is None else f"{payload:.2f} kg"


class Interrupted(KeyboardInterrupt):
    """A signal stopped the run; its last checkpoint is after ``timesteps``."""

    def __init__(self, timesteps: int) -> None:
        super().__init__(f"stopped at {timesteps} timesteps")
        self.timesteps = timesteps


@dataclass(kw_only=True, repr=False)
class TrainingResult(Printed):
    """Result of a run up to its last checkpoint; without ``out``, the content of ``run.json``."""

    out: Path
    """Folder of the run."""
    settings: dict[str, Any]
    """Options of ``cablebot train``, the content of the configuration file (``config``) and its
    name."""
    timesteps: int = 0
    """Number of timesteps."""
    wall_s: float = 0.0
    """Wall time without pauses [s]."""
    base_payload_kg: float | None = None
    """DLCC of the base law alone [kg]; None if it fails unloaded."""
    evaluations: list[Evaluation] = field(default_factory=list)
    """Evaluations in chronological order."""
    payload_ceiling: float | None = None
    """Largest payload of the curriculum at present [kg]; None without a curriculum."""

    @classmethod
    def load(cls, out: str | Path) -> TrainingResult:
        """Loads the result of the run in a folder.

        Raises:
            ValueError: if there is none, or it is damaged.
        """
        out = Path(out)
        if not (out / STATE).is_file():
            raise ValueError(
                f"there is no run to resume in {str(out)!r}. Omit --resume to start one"
            )
        with checkpoint_errors(out):
            data = json.loads(read_text(out / STATE))
            data["evaluations"] = [Evaluation(**item) for item in data["evaluations"]]
            return cls(out=out, **data)

    @property
    def best(self) -> Evaluation | None:
        """Evaluation of ``best.zip``; None if there is none yet."""
        return max(self.evaluations, key=lambda item: rank(item.payload_kg), default=None)

    @property
    def last(self) -> Evaluation | None:
        """Evaluation of the policy at ``timesteps``; None if it is not evaluated."""
        if self.evaluations and self.evaluations[-1].timesteps == self.timesteps:
            return self.evaluations[-1]
        return None

    @property
    def checkpoint(self) -> Path:
        """Folder of the algorithm's state."""
        return self.out / CHECKPOINT / str(self.timesteps)

    def command(self) -> str:
        """The command line that repeats the run, without ``--out``."""
        options = {
            option.removeprefix("--"): self.settings.get(name) for name, option in _OPTIONS.items()
        }
        return command_line("train", self.settings["env_id"], **options)

    def __str__(self) -> str:
        text = (
            f"{self.timesteps} timesteps in {self.wall_s:.0f} s; "
            f"DLCC of the base law alone: {kg(self.base_payload_kg)}"
        )
        if self.best:
            text += f"; of the best policy: {kg(self.best.payload_kg)} ({self.out / BEST})"
            if self.last:
                text += f"; of the last policy: {kg(self.last.payload_kg)}"
            resolution = self.settings["evaluation"].get("resolution", RESOLUTION)
            if rank(self.best.payload_kg) < rank(self.base_payload_kg) + resolution:
                text += f"; no gain over the base law within the resolution of {resolution:g} kg"
        return text


def draw_learning_curve(result: TrainingResult) -> Figure:
    """Draws the payload of each evaluation [kg], 0 if it fails unloaded, versus the timesteps.

    Raises:
        ImportError: if matplotlib is missing; the message names the command that installs it.
    """
    figure = new_figure(4.4)
    axes = figure.subplots()
    timesteps = [item.timesteps for item in result.evaluations]
    payloads = [item.payload_kg or 0.0 for item in result.evaluations]
    axes.plot(timesteps, payloads, color=BLUE, marker="o", markersize=3, label="policy")
    base = result.base_payload_kg or 0.0
    axes.axhline(base, color="black", linewidth=1.0, linestyle="--", label="base law alone")
    axes.set(xlabel="timesteps", ylabel="DLCC [kg]")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    add_legend(figure, axes)
    set_title(figure, result.command())
    return figure


def open_run(
    out: str | Path, env_id: str, options: Mapping[str, Any], *, resume: bool
) -> TrainingResult:
    """State of a new run, or of the run in ``out``. Writes no file.

    Args:
        out: folder of the run.
        env_id: id of the environment.
        options: the options of the training.
        resume: whether to resume the run in ``out``. Options must then equal those of the run,
            except ``timesteps``.

    Raises:
        ValueError: if an option is invalid, ``out`` already contains a run, or there is no such run
            to resume.
    """
    out = Path(out)
    check_writable_dir(out)
    settings: dict[str, Any] = {"env_id": env_id}
    settings |= {name: value for name, value in options.items() if value is not None}
    for name, least in _LEAST.items():
        if name in settings:
            whole(_OPTIONS[name], settings[name], least=least)
    config = settings.pop("config", None)
    if resume:
        return _resumed(out, settings, config)
    for file in (STATE, BEST, LAST, EVALUATIONS):
        if (out / file).exists():
            raise ValueError(
                f"{str(out)!r} already contains a run: add --resume, or choose another --out"
            )
    settings["config"] = read_yaml(env_id, config or HYPERPARAMS)
    settings["config_file"] = config and Path(config).name
    return TrainingResult(out=out, settings={"seed": 0, "threads": 1, **settings})


def _resumed(out: Path, settings: dict[str, Any], config: str | Path | None) -> TrainingResult:
    """State of the run in ``out``, which must have been started with these settings."""
    state = TrainingResult.load(out)
    if config is not None:
        settings["config"] = read_yaml(settings["env_id"], config)
    for name, value in settings.items():
        started = state.settings.get(name)
        if name == "timesteps" or value == started:
            continue
        difference = f"{_OPTIONS.get(name, 'ID')} {started}, not {value}"
        if name == "config":
            difference = "another --config"
        raise ValueError(
            f"the run in {str(out)!r} was started with {difference}: omit it, or choose another --out"
        )
    state.settings |= settings
    return state


def read_yaml(env_id: str, path: str | Path) -> dict[str, Any]:
    """Reads the unchecked configuration of an environment; the key ``default`` holds for
    environments without a key.

    Args:
        env_id: id of the environment.
        path: YAML file.

    Raises:
        ValueError: if the file cannot be read, or has no configuration for this environment.
    """
    import yaml  # imported here: only training needs it

    path = Path(path)
    try:
        data = yaml.safe_load(read_text(path))
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        cause = " ".join(str(error).split())
        raise ValueError(
            f"--config: cannot read {str(path)!r} ({cause}); give a YAML file"
        ) from error
    if not isinstance(data, dict) or not all(isinstance(value, dict) for value in data.values()):
        raise ValueError(
            f"--config: {path.name} must map environments to hyperparameters: 'ID: {{n_envs: …}}'"
        )
    if env_id not in data and "default" not in data:
        raise ValueError(
            f"--config: {path.name} has no key {env_id} and no key default; it has {', '.join(data)}"
        )
    return dict(data[env_id if env_id in data else "default"])


class Run:
    """Records a training run: evaluates policies, writes the files, and catches signals.

    Args:
        state: result so far, from :func:`open_run`; it is kept up to date.
        untrained: the policy with a network of output zero.
        total: number of timesteps at the end.
        evaluation: keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc`.
        progress: function called with the progress.
        say: function called with messages for the user.
    """

    def __init__(
        self,
        state: TrainingResult,
        untrained: Bundle,
        *,
        total: int,
        evaluation: Mapping[str, Any],
        progress: Progress | None = None,
        say: Say | None = None,
    ) -> None:
        self.out = state.out
        self.state = state
        self.stopped = False
        """Whether a signal has arrived within :meth:`signals`."""
        self._total = total
        self._base = untrained
        self._conditions = {"criterion": "task", "resolution": RESOLUTION, **evaluation}
        self._progress = progress
        self._say = say
        self._started = time.monotonic() - state.wall_s

    def report(self, text: str, done: int) -> None:
        """Reports the progress."""
        if self._progress:
            self._progress(done, self._total, text)

    def start(self) -> None:
        """Evaluates the base law alone."""
        self.state.base_payload_kg = self._dlcc(self._base.base_alone, "evaluating the base law")
        self.report("starting", 0)  # the time left counts from here

    def evaluate(self, network: Network) -> float | None:
        """Evaluates a network [kg]; writes ``evaluations.csv``, and ``best.zip`` if no earlier
        network was as good.

        Raises:
            Interrupted: after a signal, within a control step.
        """
        state = self.state
        best = state.best
        payload = self._dlcc(replace(self._base, network=network), "evaluating")
        state.evaluations.append(
            Evaluation(timesteps=state.timesteps, wall_s=self._wall_s(), payload_kg=payload)
        )
        if best is None or rank(payload) > rank(best.payload_kg):
            self._bundle(network).save(self.out / BEST)
        head = [item.name for item in fields(Evaluation)]
        write_csv(self.out / EVALUATIONS, [head, *map(astuple, state.evaluations)])
        return payload

    def finish(self, network: Network) -> None:
        """Writes the final policy and, if matplotlib is installed, the figure of the evaluations."""
        self._bundle(network).save(self.out / LAST)
        with suppress(ImportError):
            save_figure(draw_learning_curve(self.state), self.out / CURVE)

    def _bundle(self, network: Network) -> Bundle:
        """A policy with its training record."""
        state = self.state
        card: dict[str, Any] = {"command": state.command()}
        for name in ("env_id", "config", "seed", "threads"):
            card[name] = state.settings[name]
        payload = None
        if state.last:
            payload = state.last.payload_kg
        card |= {
            "timesteps": state.timesteps,
            "wall_s": self._wall_s(),
            "versions": versions(),
            "payload_kg": payload,
            "evaluation": self._conditions,
            "base_payload_kg": state.base_payload_kg,
            "curve": [asdict(item) for item in state.evaluations],
        }
        return replace(self._base, network=network, card=card)

    def save(self, write: Callable[[Path], None]) -> None:
        """Writes a checkpoint; ``write`` is called with the folder for the algorithm's state."""
        self.state.wall_s = self._wall_s()
        folder = self.state.checkpoint
        folder.mkdir(parents=True, exist_ok=True)
        write(folder)
        data = asdict(self.state)
        del data["out"]
        atomic_write_text(self.out / STATE, json.dumps(data, ensure_ascii=False))
        # Only now does run.json name this checkpoint.
        for checkpoint in folder.parent.iterdir():
            if checkpoint != folder:
                shutil.rmtree(checkpoint)

    @contextmanager
    def signals(self) -> Iterator[None]:
        """Notes SIGINT or SIGTERM in :attr:`stopped`; a second SIGINT raises. Ignored signals stay
        ignored."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def note(number: int, frame: Any) -> None:
            if self.stopped and number == signal.SIGINT:
                raise KeyboardInterrupt
            self.stopped = True
            if self._say:
                self._say("stopping; Ctrl-C again stops immediately and keeps the last checkpoint")

        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        for number, handler in handlers.items():
            if handler is not signal.SIG_IGN:
                signal.signal(number, note)
        try:
            yield
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)

    def _dlcc(self, bundle: Bundle, text: str) -> float | None:
        """DLCC of a bundle [kg]; None if it fails unloaded. Reports the progress with a text."""
        done = self.state.timesteps
        self.report(text, done)

        def after_step(steps: int, expected: int) -> None:
            if self.stopped:
                raise Interrupted(done)
            self.report(f"{text}, {steps / expected:.0%}", done)

        policy = LearnedPolicy(bundle, find_robot(env_robot(bundle.env_id)))
        options = {"progress": after_step, **self._conditions}
        return evaluate_dlcc(policy, bundle.env_id, **options).payload

    def _wall_s(self) -> float:
        return round(time.monotonic() - self._started, 3)


@contextmanager
def checkpoint_errors(out: str | Path) -> Iterator[None]:
    """Raises a ValueError in place of any error within the context, which reads the checkpoint in
    ``out``."""
    try:
        yield
    except (
        Exception
    ) as error:  # damaged files raise errors of zipfile, pickle, json, numpy and torch
        raise ValueError(
            f"the checkpoint in {str(out)!r} cannot be resumed ({type(error).__name__}: {error}); no file was changed. "
            "Start a new run with another --out"
        ) from error


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Sets the number of torch's threads within the context."""
    import torch  # imported here: the rest of this module works without torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def versions() -> dict[str, str]:
    """Versions of Python and of the installed packages that training depends on."""
    numbers = {"python": platform.python_version()}
    for name in _PACKAGES:
        with suppress(PackageNotFoundError):
            numbers[name] = version(name)
    return numbers
