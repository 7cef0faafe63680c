"""Checkpoints of training runs: the complete state of a run in one file, so that a resumed run is bit-exact.

The state consists of weights, optimiser, replay buffer, normalisation, environments within their episodes, and random
generators. Loading a checkpoint uses ``pickle``, as Stable-Baselines3 does: load only files that you trust.
"""

from __future__ import annotations

import importlib
import io
import json
import pickle
import random
import shlex
import sys
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

try:
    import torch
    from stable_baselines3.common.base_class import BaseAlgorithm
    from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError("training needs the extra: pip install 'cablebot-gym[sb3]'", name=error.name) from error

from cablebot_baselines.learned.runs import Evaluation, TrainingResult
from cablebot_gym.utils.files import atomic_write

FORMAT = 1
"""Format number of checkpoints."""

_STATE, _MODEL, _ENV, _RANDOM, _REPLAY = "state.json", "model.zip", "env.pkl", "random.pkl", "replay.npz"
_REPLAY_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of a run."""

    env_id: str
    algorithm: str
    """Name of the algorithm, as for ``cablebot train --algo``."""
    seed: int
    """Seed of the weights, the exploration and the environments."""
    timesteps: int
    """Number of actions, summed over all environments."""
    eval_every: int
    """Timesteps between two evaluations."""
    checkpoint_every: int
    """Timesteps between two checkpoints."""
    threads: int
    """Number of torch's threads. It affects the last digits of the weights, and training amplifies the difference."""
    evaluation: Mapping[str, Any]
    """Keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc`."""
    config: Mapping[str, Any]
    """Hyperparameters in RL-Zoo's keys, as in the file."""
    config_file: str | None
    """Name of the file of hyperparameters; None for the shipped one."""

    def command(self) -> str:
        """The command line that repeats the run, without ``--out``."""
        words = ["cablebot", "train", self.env_id, "--algo", self.algorithm]
        words += [] if self.config_file is None else ["--config", self.config_file]
        words += ["--seed", str(self.seed), "--timesteps", str(self.timesteps)]
        words += ["--eval-every", str(self.eval_every), "--checkpoint-every", str(self.checkpoint_every)]
        words += ["--threads", str(self.threads)]
        words += ["--evaluation", json.dumps(dict(self.evaluation))] if self.evaluation else []
        return shlex.join(words)


@dataclass(frozen=True, kw_only=True, eq=False)
class Checkpoint:
    """State of a run between two rollouts."""

    settings: Settings
    timesteps: int
    """Number of timesteps so far."""
    wall_s: float
    """Wall time so far, without pauses [s]."""
    base_payload_kg: float | None
    """DLCC of the base law alone [kg]; None if it fails unloaded."""
    evaluations: tuple[Evaluation, ...]
    """Evaluations so far."""
    versions: Mapping[str, str]
    """Versions of Python and of the packages."""
    members: Mapping[str, bytes] = field(repr=False)
    """Members of the file other than the JSON state."""

    def save(self, path: Path) -> None:
        """Writes the checkpoint atomically."""
        names = ("timesteps", "wall_s", "base_payload_kg", "versions")
        state: dict[str, Any] = {"format": FORMAT} | {name: getattr(self, name) for name in names}
        state |= {"settings": asdict(self.settings), "evaluations": [asdict(item) for item in self.evaluations]}

        def write(temporary: Path) -> None:
            with zipfile.ZipFile(temporary, "w") as file:
                file.writestr(_STATE, json.dumps(state, ensure_ascii=False))
                for name, data in self.members.items():
                    file.writestr(name, data)

        atomic_write(path, write)

    @classmethod
    def load(cls, path: Path) -> Checkpoint:
        """Loads a checkpoint.

        Raises:
            ValueError: if the file does not exist or is damaged.
        """
        if not path.is_file():
            raise ValueError(f"there is no run to resume: {str(path)!r} does not exist. Omit --resume to start a run")
        try:
            with zipfile.ZipFile(path) as file:
                if (broken := file.testzip()) is not None:
                    raise ValueError(f"{broken} is damaged")
                members = {name: file.read(name) for name in file.namelist()}
            state = json.loads(members.pop(_STATE))
            if state.pop("format") != FORMAT:
                raise ValueError("another version of this package wrote it")
            if missing := [name for name in (_MODEL, _ENV, _RANDOM) if name not in members]:
                raise ValueError(f"{missing[0]} is missing")
            settings = Settings(**state.pop("settings"))
            evaluations = tuple(Evaluation(**item) for item in state.pop("evaluations"))
            return cls(settings=settings, evaluations=evaluations, members=members, **state)
        except (OSError, EOFError, KeyError, TypeError, ValueError, NotImplementedError, zipfile.BadZipFile) as error:
            raise ValueError(
                f"checkpoint {str(path)!r} cannot be resumed ({error}); no file was changed. "
                "Start a new run with another --out"
            ) from error

    def result(self, out: Path) -> TrainingResult:
        """Result of the run in the folder ``out``."""
        return TrainingResult(
            out=out,
            timesteps=self.timesteps,
            wall_s=self.wall_s,
            base_payload_kg=self.base_payload_kg,
            evaluations=self.evaluations,
        )

    def environments(self) -> Any:
        """The ``environments`` that were given to :func:`model_members`."""
        return pickle.loads(self.members[_ENV])

    def model(self, model_class: type[BaseAlgorithm], env: VecEnv) -> BaseAlgorithm:
        """Restores the model and its replay buffer, and sets the random generators to their saved states."""
        model = model_class.load(io.BytesIO(self.members[_MODEL]), env=env, device="cpu", force_reset=False)
        if isinstance(model, OffPolicyAlgorithm):
            _set_replay(self.members[_REPLAY], model)
        _set_random_state(pickle.loads(self.members[_RANDOM]), model)
        return model


def model_members(model: BaseAlgorithm, environments: Any) -> dict[str, bytes]:
    """Members of a checkpoint: model, replay buffer, environments, and random generators."""
    buffer = io.BytesIO()
    model.save(buffer)
    members = {
        _MODEL: buffer.getvalue(),
        _ENV: pickled(environments),
        _RANDOM: pickled(_random_state(model)),
    }
    if isinstance(model, OffPolicyAlgorithm):
        members[_REPLAY] = _replay(model)
    return members


class _Pickler(pickle.Pickler):
    """A pickler that preserves views of arrays, and references compiled functions by name.

    The environments write through such views, and a copied function would be compiled again.
    """

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, Dispatcher):
            name = value.py_func.__qualname__
            module = sys.modules[value.py_func.__module__]
            return (getattr, (module, name)) if getattr(module, name, None) is value else NotImplemented
        if isinstance(value, ModuleType):
            return importlib.import_module, (value.__name__,)
        if type(value) is not np.ndarray or type(value.base) is not np.ndarray or value.dtype.hasobject:
            return NotImplemented
        owner = value.base
        if not owner.flags.c_contiguous or value.size == 0:
            return NotImplemented
        offset = value.__array_interface__["data"][0] - owner.__array_interface__["data"][0]
        return _view, (owner, value.dtype, value.shape, value.strides, offset)


def _view(owner: Any, dtype: Any, shape: Any, strides: Any, offset: int) -> Any:
    return np.ndarray(shape, dtype, owner, offset, strides)


def pickled(value: Any) -> bytes:
    """Pickles a value for ``pickle.loads``, preserving views and compiled functions."""
    buffer = io.BytesIO()
    _Pickler(buffer, protocol=pickle.HIGHEST_PROTOCOL).dump(value)
    return buffer.getvalue()


def _random_state(model: BaseAlgorithm) -> Any:
    action_space = model.action_space.np_random.bit_generator.state
    return torch.get_rng_state().numpy(), np.random.get_state(), random.getstate(), action_space  # noqa: NPY002


def _set_random_state(state: Any, model: BaseAlgorithm) -> None:
    torch.set_rng_state(torch.from_numpy(state[0]))
    np.random.set_state(state[1])  # noqa: NPY002 - SB3 draws from this generator
    random.setstate(state[2])
    model.action_space.np_random.bit_generator.state = state[3]


def _replay(model: OffPolicyAlgorithm) -> bytes:
    buffer, file = model.replay_buffer, io.BytesIO()
    assert buffer is not None
    rows = buffer.buffer_size if buffer.full else min(buffer.pos + 1, buffer.buffer_size)
    arrays = {name: getattr(buffer, name)[:rows] for name in _REPLAY_ARRAYS if hasattr(buffer, name)}
    np.savez(file, allow_pickle=False, place=np.array([buffer.pos, buffer.full]), **arrays)
    return file.getvalue()


def _set_replay(data: bytes, model: OffPolicyAlgorithm) -> None:
    buffer = model.replay_buffer
    assert buffer is not None
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        buffer.pos, buffer.full = int(file["place"][0]), bool(file["place"][1])
        for name in _REPLAY_ARRAYS:
            if name in file:
                getattr(buffer, name)[: len(file[name])] = file[name]
