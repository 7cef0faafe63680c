"""Folder of a training run, the same for all algorithms: names of the files, evaluations, and the result."""

from __future__ import annotations

import csv
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from cablebot_gym.utils.files import atomic_write

CHECKPOINT, BEST, LAST = "checkpoint.zip", "best.zip", "last.zip"
EVALUATIONS, PROGRESS, TENSORBOARD = "evaluations.csv", "progress.csv", "tensorboard"
"""Names of the files and folders of a run."""

RESOLUTION = 0.05
"""Resolution of payloads in evaluations during training [kg]; ``evaluation`` may override it."""

_PACKAGES = ("numpy", "torch", "stable-baselines3", "sb3-contrib", "cablebot-gym")

Progress = Callable[[str, int, int], None]
"""Function called with a text, the number of timesteps so far, and the total."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """An evaluation during training."""

    timesteps: int
    """Timesteps before the evaluation."""
    wall_s: float
    """Wall time since the start of the run, without pauses [s]."""
    payload_kg: float | None
    """DLCC [kg]; None if the policy fails unloaded."""


@dataclass(frozen=True, kw_only=True)
class TrainingResult:
    """Result of a run."""

    out: Path
    """Folder of the run."""
    timesteps: int
    """Number of timesteps."""
    wall_s: float
    """Wall time without pauses [s]."""
    base_payload_kg: float | None
    """DLCC of the base law alone [kg]; None if it fails unloaded."""
    evaluations: tuple[Evaluation, ...]
    """Evaluations in chronological order."""

    @property
    def best(self) -> Evaluation | None:
        """Evaluation of ``best.zip``; None if there is none yet."""
        return max(self.evaluations, key=lambda item: rank(item.payload_kg), default=None)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data."""
        return asdict(self) | {"out": str(self.out)}

    def __str__(self) -> str:
        text = f"{self.timesteps} timesteps in {self.wall_s:.0f} s; DLCC of the base law alone, with the gains of the "
        text += f"configuration: {kg(self.base_payload_kg)}"
        if self.best is None:
            return text
        return f"{text}; of the best policy: {kg(self.best.payload_kg)} ({self.out / BEST})"


def rank(payload: float | None) -> float:
    """Sort key of payloads; None (fails unloaded) is below zero."""
    return -1.0 if payload is None else payload


class Interrupted(KeyboardInterrupt):
    """A signal stopped the run after ``timesteps``; the checkpoint is written."""

    def __init__(self, timesteps: int) -> None:
        super().__init__(f"stopped at {timesteps} timesteps")
        self.timesteps = timesteps


def check_no_run(out: Path) -> None:
    """Checks that the folder ``out`` contains no run.

    Raises:
        ValueError: if it does; the message names the options to use.
    """
    for name in (CHECKPOINT, BEST, LAST, EVALUATIONS, PROGRESS):
        if (out / name).exists():
            advice = "add --resume to resume it, or choose" if (out / CHECKPOINT).exists() else "choose"
            raise ValueError(f"folder {str(out)!r} already contains a run ({name}): {advice} another --out")


def write_evaluations(out: Path, evaluations: Sequence[Evaluation]) -> None:
    """Writes ``evaluations.csv`` into the folder ``out`` atomically."""

    def write(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8") as file:
            rows = csv.DictWriter(file, list(Evaluation.__dataclass_fields__))
            rows.writeheader()
            rows.writerows(asdict(item) for item in evaluations)

    atomic_write(out / EVALUATIONS, write)


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Sets the number of torch's threads within the context."""
    import torch  # imported here: reading cards uses this module without torch

    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def kg(payload: float | None) -> str:
    """A payload as text; None means that the policy fails unloaded."""
    return "fails unloaded" if payload is None else f"{payload:.2f} kg"


def versions() -> dict[str, str]:
    """Versions of Python and of the installed packages that training depends on."""
    numbers = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            numbers[name] = version(name)
        except PackageNotFoundError:
            continue
    return numbers
