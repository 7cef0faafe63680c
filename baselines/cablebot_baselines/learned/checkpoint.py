"""Checkpoints of training runs: everything that the next rollout depends on, in one file, to the bit.

That is weights, optimiser, replay buffer, normalisation, environments in the middle of their episodes, and random
generators. A checkpoint is read with ``pickle``, as Stable-Baselines3's own files are: read only those of which you
know where they come from.
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

from cablebot_baselines.learned.runs import Evaluation, Trained
from cablebot_gym.utils.files import write_whole

FORMAT = 1
"""Of checkpoints."""

_STATE, _MODEL, _ENV, _RANDOM, _REPLAY = "state.json", "model.zip", "env.pkl", "random.pkl", "replay.npz"
_REPLAY_ARRAYS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What a run was started with."""

    env_id: str
    algorithm: str
    """As ``cablebot train --algo`` has it."""
    seed: int
    """Of weights, exploration and environments."""
    timesteps: int
    """Actions over all environments."""
    eval_every: int
    """Timesteps from one evaluation to the next."""
    checkpoint_every: int
    """Timesteps from one checkpoint to the next."""
    threads: int
    """Of torch. Weights depend on it in their last digits, which training makes more of."""
    evaluation: Mapping[str, Any]
    """Keywords of :func:`cablebot_gym.evaluation.evaluate_dlcc`."""
    config: Mapping[str, Any]
    """RL-Zoo's keys, as the file has them."""
    config_file: str | None
    """Its name; None for the one that ships."""

    def command(self) -> str:
        """What to type for the same run, but for ``--out``."""
        words = ["cablebot", "train", self.env_id, "--algo", self.algorithm]
        words += [] if self.config_file is None else ["--config", self.config_file]
        words += ["--seed", str(self.seed), "--timesteps", str(self.timesteps)]
        words += ["--eval-every", str(self.eval_every), "--checkpoint-every", str(self.checkpoint_every)]
        words += ["--threads", str(self.threads)]
        words += ["--evaluation", json.dumps(dict(self.evaluation))] if self.evaluation else []
        return shlex.join(words)


@dataclass(frozen=True, kw_only=True, eq=False)
class Checkpoint:
    """Where a run stands between two rollouts."""

    settings: Settings
    timesteps: int
    """Done so far."""
    wall_s: float
    """Spent so far, pauses left out [s]."""
    base_payload_kg: float | None
    """What the base law carries alone; None if not even zero."""
    evaluations: tuple[Evaluation, ...]
    """Made so far."""
    versions: Mapping[str, str]
    """Of Python and packages."""
    parts: Mapping[str, bytes] = field(repr=False)
    """Members of the file but its state."""

    def save(self, path: Path) -> None:
        """Writes it whole or not at all."""
        names = ("timesteps", "wall_s", "base_payload_kg", "versions")
        state: dict[str, Any] = {"format": FORMAT} | {name: getattr(self, name) for name in names}
        state |= {"settings": asdict(self.settings), "evaluations": [asdict(item) for item in self.evaluations]}

        def write(temporary: Path) -> None:
            with zipfile.ZipFile(temporary, "w") as file:
                file.writestr(_STATE, json.dumps(state, ensure_ascii=False))
                for name, data in self.parts.items():
                    file.writestr(name, data)

        write_whole(path, write)

    @classmethod
    def load(cls, path: Path) -> Checkpoint:
        """A checkpoint that was saved.

        Raises:
            ValueError: if there is none, or it is damaged.
        """
        if not path.is_file():
            raise ValueError(
                f"there is no run to resume, {str(path)!r} does not exist: leave --resume out to start one"
            )
        try:
            with zipfile.ZipFile(path) as file:
                if (broken := file.testzip()) is not None:
                    raise ValueError(f"{broken} is not what was written")
                parts = {name: file.read(name) for name in file.namelist()}
            state = json.loads(parts.pop(_STATE))
            if state.pop("format") != FORMAT:
                raise ValueError("it is of another version of this package")
            if missing := [name for name in (_MODEL, _ENV, _RANDOM) if name not in parts]:
                raise ValueError(f"{missing[0]} is missing")
            settings = Settings(**state.pop("settings"))
            evaluations = tuple(Evaluation(**item) for item in state.pop("evaluations"))
            return cls(settings=settings, evaluations=evaluations, parts=parts, **state)
        except (OSError, EOFError, KeyError, TypeError, ValueError, NotImplementedError, zipfile.BadZipFile) as error:
            raise ValueError(
                f"checkpoint {str(path)!r} cannot be resumed ({error}); nothing was changed: "
                "start again with another --out"
            ) from error

    def trained(self, out: Path) -> Trained:
        """What has come of the run in the folder ``out``."""
        return Trained(
            out=out,
            timesteps=self.timesteps,
            wall_s=self.wall_s,
            base_payload_kg=self.base_payload_kg,
            evaluations=self.evaluations,
        )

    def environments(self) -> Any:
        """What was given as ``environments`` to :func:`model_parts`."""
        return pickle.loads(self.parts[_ENV])

    def model(self, made: type[BaseAlgorithm], env: VecEnv) -> BaseAlgorithm:
        """The model, of class ``made``, with its replay buffer; random generators are set to where they stood."""
        model = made.load(io.BytesIO(self.parts[_MODEL]), env=env, device="cpu", force_reset=False)
        if isinstance(model, OffPolicyAlgorithm):
            _set_replay(self.parts[_REPLAY], model)
        _set_random_state(pickle.loads(self.parts[_RANDOM]), model)
        return model


def model_parts(model: BaseAlgorithm, environments: Any) -> dict[str, bytes]:
    """Members of a checkpoint: a model with its replay buffer, its environments, and random generators."""
    buffer = io.BytesIO()
    model.save(buffer)
    parts = {
        _MODEL: buffer.getvalue(),
        _ENV: pickled(environments),
        _RANDOM: pickled(_random_state(model)),
    }
    if isinstance(model, OffPolicyAlgorithm):
        parts[_REPLAY] = _replay(model)
    return parts


class _Pickler(pickle.Pickler):
    """Keeps arrays that are views of one another views, and compiled functions the module's own.

    The environments write through such views; and a copy of a function would be compiled once more.
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
    """Bytes of a value for ``pickle.loads`` that keep views and compiled functions."""
    buffer = io.BytesIO()
    _Pickler(buffer, protocol=pickle.HIGHEST_PROTOCOL).dump(value)
    return buffer.getvalue()


def _random_state(model: BaseAlgorithm) -> Any:
    action_space = model.action_space.np_random.bit_generator.state
    return torch.get_rng_state().numpy(), np.random.get_state(), random.getstate(), action_space  # noqa: NPY002


def _set_random_state(state: Any, model: BaseAlgorithm) -> None:
    torch.set_rng_state(torch.from_numpy(state[0]))
    np.random.set_state(state[1])  # noqa: NPY002 - where SB3 draws from
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
