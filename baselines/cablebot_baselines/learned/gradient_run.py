"""Runs of :class:`~cablebot_baselines.learned.gradient.GradientTraining`: configuration, folder, checkpoints by round, best."""

from __future__ import annotations

import io
import json
import shlex
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cablebot_baselines.learned.base import Base, find_base
from cablebot_baselines.learned.bundle import Bundle
from cablebot_baselines.learned.config import read_yaml
from cablebot_baselines.learned.export import silent_network
from cablebot_baselines.learned.features import check_features
from cablebot_baselines.learned.gradient import GradientSettings, GradientTraining, Progress
from cablebot_baselines.learned.policy import LearnedPolicy
from cablebot_baselines.learned.runs import (
    BEST,
    CHECKPOINT,
    LAST,
    RESOLUTION,
    Evaluation,
    Interrupted,
    Trained,
    check_new,
    rank,
    torch_threads,
    versions,
    write_evaluations,
)
from cablebot_baselines.learned.steering import Shift, find_way
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.trajectories import TRAINING_SEEDS, RandomLoop, Trajectory, find_trajectory
from cablebot_gym.utils.files import usable_folder, write_whole

ALGORITHM = "gradient"
"""Of ``cablebot train --algo``."""

VALIDATION = TRAINING_SEEDS[-8:]
"""Training seeds that choose the best of a run's rounds, where it is trained on random loops; never trained on."""

_OWN = ("motions", "base", "steering", "features", "evaluation")


@dataclass(frozen=True, kw_only=True)
class GradientConfig:
    """A configuration that was checked."""

    env_id: str
    trajectories: tuple[Trajectory, ...]
    """To train on."""
    judged: tuple[Trajectory, ...]
    """To choose the best of the rounds by."""
    base: Base
    """The law that is steered."""
    way: Shift
    """How actions become what steers the law."""
    features: tuple[str, ...]
    """What the network reads."""
    settings: GradientSettings
    """Of the optimisation."""
    evaluation: Mapping[str, Any]
    """Keywords of :func:`cablebot_gym.evaluation.evaluate_dlcc`."""
    plain: Mapping[str, Any]
    """What the file says, JSON-able."""


def make_gradient_config(env_id: str, plain: Mapping[str, Any]) -> GradientConfig:
    """Checks ``plain``, what a file says.

    Its keys are ``motions``, ``base``, ``steering``, ``features``, ``evaluation``, and the fields of
    :class:`GradientSettings`. Motions are ``paper``, or a mapping with ``loops``, N for training seeds 0 to N − 1 of
    the random loops, or ``named``, a list for :func:`cablebot_gym.trajectories.find_trajectory`, or both.

    Raises:
        ValueError: if a key is unknown, or a value is not valid; the message says what is.
    """
    robot = find_robot(env_robot(env_id))
    known = [*_OWN, *(item.name for item in fields(GradientSettings))]
    if unknown := [name for name in plain if name not in known]:
        raise ValueError(f"hyperparameters of {ALGORITHM}: unknown key {unknown[0]!r}; it takes {', '.join(known)}")
    if missing := [name for name in ("base", "steering", "features") if name not in plain]:
        raise ValueError(f"hyperparameters of {ALGORITHM}: give {', '.join(missing)} too, so that the file says all")
    way = find_way(plain["steering"])
    if not isinstance(way, Shift):
        raise ValueError("gradients go through a shifted reference: steering must be of kind shift, not residual")
    settings = {name: value for name, value in plain.items() if name not in _OWN}
    settings |= {name: tuple(settings[name]) for name in ("hidden", "rounds", "softness") if name in settings}
    trajectories, judged = _motions(plain.get("motions", "paper"), robot)
    return GradientConfig(
        env_id=env_id,
        trajectories=trajectories,
        judged=judged,
        base=find_base(plain["base"]),
        way=way,
        features=check_features(plain["features"], robot),
        settings=GradientSettings(**settings),
        evaluation=dict(plain.get("evaluation", {})),
        plain=dict(plain),
    )


def _motions(value: Any, robot: Robot) -> tuple[tuple[Trajectory, ...], tuple[Trajectory, ...]]:
    """Motions to train on, and those that choose the best."""
    if value == "paper":
        value = {"named": [default_trajectory(robot)]}
    if not isinstance(value, Mapping) or not value or not {"loops", "named"} >= {*value}:
        raise ValueError(f"motions must be 'paper', {{loops: N}}, {{named: [TRAJECTORY, …]}} or both, not {value!r}")
    most = len(TRAINING_SEEDS) - len(VALIDATION)
    count, named = value.get("loops", 0), value.get("named", [])
    if isinstance(count, bool) or not isinstance(count, int) or ("loops" in value and not 1 <= count <= most):
        raise ValueError(f"motions: loops must be a number from 1 to {most}, not {count!r}")
    if not isinstance(named, (list, tuple)) or ("named" in value and not named):
        raise ValueError(f"motions: named must be a list of trajectories, such as [paper-spatial], not {named!r}")
    others = tuple(find_trajectory(one, robot.coordinates) for one in named)
    if held_out := [one for one in others if isinstance(one, RandomLoop) and one.seed not in TRAINING_SEEDS[:most]]:
        raise ValueError(f"motions: seed {held_out[0].seed} is kept for judging: train with seeds from 0 to {most - 1}")
    return (*_loops(TRAINING_SEEDS[:count], robot), *others), _loops(VALIDATION, robot) if count else others


def _loops(seeds: Sequence[int], robot: Robot) -> tuple[Trajectory, ...]:
    name = "loop-planar" if robot.planar else "loop-spatial"
    return tuple(find_trajectory({"name": name, "seed": seed}, robot.coordinates) for seed in seeds)


@dataclass(kw_only=True)
class _Standing:
    """Where a run stands between two rounds."""

    settings: Mapping[str, Any]
    """What it was started with."""
    rounds: int
    """Done."""
    evaluated: int
    """Evaluations of the objective."""
    wall_s: float
    base_payload_kg: float | None
    evaluations: list[Evaluation]

    def save(self, path: Path, arrays: Mapping[str, Any]) -> None:
        """Writes it whole or not at all."""
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, standing=np.array(json.dumps(asdict(self))), **arrays)

        def write(temporary: Path) -> None:
            temporary.write_bytes(buffer.getvalue())

        write_whole(path, write)

    @classmethod
    def load(cls, path: Path) -> tuple[_Standing, dict[str, Any]]:
        """What was saved, and the arrays.

        Raises:
            ValueError: if there is none, or it is damaged.
        """
        if not path.is_file():
            raise ValueError(
                f"there is no run to resume, {str(path)!r} does not exist: leave --resume out to start one"
            )
        try:
            # Opened here: of a damaged file numpy leaves its own open.
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            data = json.loads(str(arrays.pop("standing")))
            data["evaluations"] = [Evaluation(**item) for item in data["evaluations"]]
            return cls(**data), arrays
        except (OSError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
            raise ValueError(
                f"checkpoint {str(path)!r} cannot be resumed ({error}); nothing was changed: start again with another "
                "--out"
            ) from error


def train_gradient(
    env_id: str,
    *,
    out: Path,
    config: Path | None = None,
    seed: int | None = None,
    resume: bool = False,
    threads: int | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Trained:
    """Trains a policy by gradients. The same seed and threads on the same machine give the same weights.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        config: YAML file, or the name of one that ships; None for ``gradient``.
        seed: of the first weights; None for 0.
        resume: whether to go on with the run in ``out`` from its last whole round.
        threads: of torch; None for 1.
        progress: told what is being done, evaluations of the objective so far and at most.

    Raises:
        ValueError: if an argument or the configuration is not valid, ``out`` already has a run, or, to be resumed, has
            none, another one, or a damaged checkpoint; nothing was written then.
        Interrupted: after Ctrl-C; the checkpoint is that of the last whole round.
    """
    usable_folder(out)
    plain = read_yaml(env_id, config if config is not None else Path(ALGORITHM))
    asked = {"seed": 0 if seed is None else seed, "threads": 1 if threads is None else threads}
    if asked["seed"] < 0 or asked["threads"] < 1:
        raise ValueError(f"--seed must be at least 0 and --threads at least 1, not {seed} and {threads}")
    file = None if config is None else config.name
    settings: dict[str, Any] = {"env_id": env_id, **asked, "config": dict(plain), "config_file": file}
    arrays: dict[str, Any] = {}
    if resume:
        standing, arrays = _Standing.load(out / CHECKPOINT)
        given = {"env_id": env_id, "seed": seed, "threads": threads, "config": config and settings["config"]}
        for name, value in given.items():
            if value is not None and value != standing.settings.get(name):
                raise ValueError(f"the run in {str(out)!r} was started with another {name}: choose another --out")
        plain = standing.settings["config"]
    else:
        check_new(out)
        standing = _Standing(settings=settings, rounds=0, evaluated=0, wall_s=0.0, base_payload_kg=None, evaluations=[])
    made = make_gradient_config(env_id, plain)
    with torch_threads(standing.settings["threads"]):
        run = _Run(made, standing, out, progress or (lambda text, done, total: None))
        try:
            return run.finish(arrays)
        except KeyboardInterrupt as stop:
            raise Interrupted(standing.evaluated) from stop


class _Run:
    """A training and the folder that it leaves its traces in."""

    def __init__(
        self,
        config: GradientConfig,
        standing: _Standing,
        out: Path,
        progress: Callable[[str, int, int], None],
    ) -> None:
        self.config, self.standing, self.out, self._progress = config, standing, out, progress
        self.robot = find_robot(env_robot(config.env_id))
        self._started, self._wall = time.monotonic(), standing.wall_s
        self._total = config.settings.iterations * len(config.settings.rounds)

    def finish(self, arrays: Mapping[str, Any]) -> Trained:
        """Trains to the end."""
        standing, config = self.standing, self.config
        self._progress("preparing", standing.evaluated, self._total)
        training = GradientTraining(
            robot=self.robot,
            trajectories=config.trajectories,
            way=config.way,
            features=config.features,
            seed=standing.settings["seed"],
            settings=config.settings,
            minimum_tension=config.base.minimum_tension,
        )
        self.out.mkdir(parents=True, exist_ok=True)
        if arrays:
            training.restore(arrays)
        else:
            network = training.network
            zero = silent_network(network.inputs, network.outputs)
            standing.base_payload_kg = self._payload(replace(self._bundle(training), network=zero))
            self._save(training)
        for number in range(standing.rounds, len(config.settings.rounds)):
            before = standing.evaluated
            training.round(number, partial(self._report, before))
            standing.evaluated, standing.rounds = before + training.evaluations, number + 1
            self._evaluate(training)
            self._save(training)
        self._bundle(training).save(self.out / LAST)
        return Trained(
            out=self.out,
            timesteps=standing.evaluated,
            wall_s=standing.wall_s,
            base_payload_kg=standing.base_payload_kg,
            evaluations=tuple(standing.evaluations),
        )

    def _report(self, before: int, at: Progress) -> None:
        text = f"round {at.round}, {at.payload:.2f} kg by the equations"
        self._progress(text, before + at.evaluations, self._total)

    def _payload(self, bundle: Bundle) -> float | None:
        """Mean payload that a bundle carries on the motions it is judged by [kg]; None if one is not carried at all."""
        conditions: dict[str, Any] = {"criterion": "task", "resolution": RESOLUTION, **self.config.evaluation}
        payloads = [
            evaluate_dlcc(LearnedPolicy(bundle, self.robot), bundle.env_id, trajectory=motion, **conditions).payload
            for motion in self.config.judged
        ]
        # A motion that is not carried even without payload counts as none carried.
        return float(np.mean([payload or 0.0 for payload in payloads]))

    def _evaluate(self, training: GradientTraining) -> None:
        self._progress("evaluating", self.standing.evaluated, self._total)
        payload, standing = self._payload(self._bundle(training)), self.standing
        before = max((rank(item.payload_kg) for item in standing.evaluations), default=-2.0)
        wall = round(self._wall_s(), 3)
        standing.evaluations.append(Evaluation(timesteps=standing.evaluated, wall_s=wall, payload_kg=payload))
        if rank(payload) > before:
            self._bundle(training).save(self.out / BEST)
        write_evaluations(self.out, standing.evaluations)

    def _save(self, training: GradientTraining) -> None:
        self.standing.wall_s = round(self._wall_s(), 3)
        self.standing.save(self.out / CHECKPOINT, training.state())

    def _wall_s(self) -> float:
        return self._wall + time.monotonic() - self._started

    def _bundle(self, training: GradientTraining) -> Bundle:
        config = self.config
        return Bundle(
            env_id=config.env_id,
            base=config.base,
            way=config.way,
            features=config.features,
            network=training.network,
            card=self._card(training),
        )

    def _card(self, training: GradientTraining) -> dict[str, Any]:
        standing, settings = self.standing, self.standing.settings
        words = ["cablebot", "train", self.config.env_id, "--algo", ALGORITHM]
        words += [] if settings["config_file"] is None else ["--config", settings["config_file"]]
        words += ["--seed", str(settings["seed"]), "--threads", str(settings["threads"])]
        rows = standing.evaluations
        return {
            "command": shlex.join(words),
            "env_id": self.config.env_id,
            "algorithm": ALGORITHM,
            "config": dict(self.config.plain),
            "seed": settings["seed"],
            "timesteps": standing.evaluated,
            "wall_s": round(self._wall_s(), 3),
            "threads": settings["threads"],
            "versions": versions(),
            "payload_kg": rows[-1].payload_kg if rows else None,
            "payload_by_equations_kg": float(np.mean(training.payloads)),
            "evaluation": {"criterion": "task", "resolution": RESOLUTION, **self.config.evaluation},
            "base_payload_kg": standing.base_payload_kg,
            "planner_output_used": False,
            "curve": [asdict(item) for item in rows],
        }
