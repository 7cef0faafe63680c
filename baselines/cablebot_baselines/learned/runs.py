"""What every training run leaves in its folder, whatever the algorithm: names, evaluations, what came of it."""

from __future__ import annotations

import csv
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

try:
    import torch
except ImportError as error:
    raise ImportError("training needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name) from error

from cablebot_gym.utils.files import write_whole

CHECKPOINT, BEST, LAST = "checkpoint.zip", "best.zip", "last.zip"
EVALUATIONS, PROGRESS, TENSORBOARD = "evaluations.csv", "progress.csv", "tensorboard"
"""Files and folders of a run."""

RESOLUTION = 0.05
"""Of payloads in evaluations while training [kg]; ``evaluation`` may say otherwise."""

_PACKAGES = ("numpy", "torch", "stable-baselines3", "sb3-contrib", "cablebot-gym")

Progress = Callable[[str, int, int], None]
"""Called with what is being done, timesteps done and wanted."""


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """What a policy on the way carried."""

    timesteps: int
    """Done by then."""
    wall_s: float
    """Since the run began, pauses left out [s]."""
    payload_kg: float | None
    """None where not even zero payload is carried."""


@dataclass(frozen=True, kw_only=True)
class Trained:
    """What came of a run."""

    out: Path
    """Folder of the run."""
    timesteps: int
    """Done."""
    wall_s: float
    """Pauses left out [s]."""
    base_payload_kg: float | None
    """What the base law carries alone."""
    evaluations: tuple[Evaluation, ...]
    """In the order of time."""

    @property
    def best(self) -> Evaluation | None:
        """The evaluation of ``best.zip``; None if there was none yet."""
        return max(self.evaluations, key=lambda item: rank(item.payload_kg), default=None)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data."""
        return asdict(self) | {"out": str(self.out)}

    def __str__(self) -> str:
        done = f"{self.timesteps} timesteps in {self.wall_s:.0f} s; its base law, with the gains of the configuration, "
        done += f"carries {kg(self.base_payload_kg)} alone"
        if self.best is None:
            return done
        return f"{done}, the best policy {kg(self.best.payload_kg)}: {self.out / BEST}"


def rank(payload: float | None) -> float:
    """By which payloads are ordered: where not even zero is carried, below zero."""
    return -1.0 if payload is None else payload


class Interrupted(KeyboardInterrupt):
    """A run was stopped by a signal after ``timesteps``, and its checkpoint is written."""

    def __init__(self, timesteps: int) -> None:
        super().__init__(f"stopped at {timesteps} timesteps")
        self.timesteps = timesteps


def check_new(out: Path) -> None:
    """Refuses a folder ``out`` that has a run.

    Raises:
        ValueError: saying what to type.
    """
    for name in (CHECKPOINT, BEST, LAST, EVALUATIONS, PROGRESS):
        if (out / name).exists():
            go_on = "add --resume to go on with it, or choose" if (out / CHECKPOINT).exists() else "choose"
            raise ValueError(f"folder {str(out)!r} already holds a run ({name}): {go_on} another --out")


def write_evaluations(out: Path, evaluations: Sequence[Evaluation]) -> None:
    """Writes ``evaluations.csv`` into the folder ``out``, whole or not at all."""

    def write(temporary: Path) -> None:
        with temporary.open("w", newline="", encoding="utf-8") as file:
            rows = csv.DictWriter(file, list(Evaluation.__dataclass_fields__))
            rows.writeheader()
            rows.writerows(asdict(item) for item in evaluations)

    write_whole(out / EVALUATIONS, write)


@contextmanager
def torch_threads(count: int) -> Iterator[None]:
    """Has torch use so many threads meanwhile."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def kg(payload: float | None) -> str:
    """A payload in words; None is where not even zero is carried."""
    return "nothing" if payload is None else f"{payload:.2f} kg"


def versions() -> dict[str, str]:
    """Of Python and of every package that a training depends on and that is installed."""
    found = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
