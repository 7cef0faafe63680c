"""Training runs by analytic policy gradient (APG): configuration, folder, checkpoints after each round, best policy."""

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
from cablebot_baselines.learned.export import zero_network
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
    TrainingResult,
    check_no_run,
    rank,
    torch_threads,
    versions,
    write_evaluations,
)
from cablebot_baselines.learned.steering import Shift, find_action_mapping
from cablebot_gym.envs import env_robot
from cablebot_gym.envs.settings import default_trajectory
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.trajectories import TRAINING_SEEDS, RandomLoop, Trajectory, find_trajectory
from cablebot_gym.utils.files import atomic_write, check_writable_dir

ALGORITHM = "gradient"
"""Name for ``cablebot train --algo``."""

VALIDATION = TRAINING_SEEDS[-8:]
"""Seeds of the random loops that select the best round of a run; they are never trained on."""

_OWN = ("motions", "base", "steering", "features", "evaluation")


@dataclass(frozen=True, kw_only=True)
class GradientConfig:
    """A checked configuration."""

    env_id: str
    trajectories: tuple[Trajectory, ...]
    """Training motions."""
    validation: tuple[Trajectory, ...]
    """Motions that select the best round."""
    base: Base
    """Base law."""
    action_mapping: Shift
    """Mapping from actions to shifts of the reference."""
    features: tuple[str, ...]
    """Names of the network's inputs."""
    settings: GradientSettings
    """Hyperparameters of the optimisation."""
    evaluation: Mapping[str, Any]
    """Keyword arguments of :func:`cablebot_gym.evaluation.evaluator.evaluate_dlcc`."""
    plain: Mapping[str, Any]
    """Content of the file for this environment, JSON-able."""


def make_gradient_config(env_id: str, plain: Mapping[str, Any]) -> GradientConfig:
    """Checks ``plain``, the content of a configuration file for an environment.

    The keys are ``motions``, ``base``, ``steering``, ``features``, ``evaluation``, and the fields of
    :class:`GradientSettings`. ``motions`` is ``paper`` or a mapping with one or both of these keys:

    * ``loops``: a number N, for the random loops with training seeds 0 to N − 1.
    * ``named``: a list of trajectories for :func:`cablebot_gym.trajectories.find_trajectory`.

    Raises:
        ValueError: if a key is unknown, or a value is invalid; the message names the valid ones.
    """
    robot = find_robot(env_robot(env_id))
    known = [*_OWN, *(item.name for item in fields(GradientSettings))]
    if unknown := [name for name in plain if name not in known]:
        raise ValueError(f"hyperparameters of {ALGORITHM}: unknown key {unknown[0]!r}; it takes {', '.join(known)}")
    if missing := [name for name in ("base", "steering", "features") if name not in plain]:
        raise ValueError(f"hyperparameters of {ALGORITHM}: {', '.join(missing)} must be given explicitly")
    action_mapping = find_action_mapping(plain["steering"])
    if not isinstance(action_mapping, Shift):
        raise ValueError(f"steering must be of kind shift for {ALGORITHM}, not residual")
    settings = {name: value for name, value in plain.items() if name not in _OWN}
    settings |= {name: tuple(settings[name]) for name in ("hidden", "rounds", "softness") if name in settings}
    trajectories, validation = _motions(plain.get("motions", "paper"), robot)
    return GradientConfig(
        env_id=env_id,
        trajectories=trajectories,
        validation=validation,
        base=find_base(plain["base"]),
        action_mapping=action_mapping,
        features=check_features(plain["features"], robot),
        settings=GradientSettings(**settings),
        evaluation=dict(plain.get("evaluation", {})),
        plain=dict(plain),
    )


def _motions(value: Any, robot: Robot) -> tuple[tuple[Trajectory, ...], tuple[Trajectory, ...]]:
    """Training motions and validation motions."""
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
        raise ValueError(
            f"motions: seed {held_out[0].seed} is reserved for evaluation: train with seeds from 0 to {most - 1}"
        )
    return (*_loops(TRAINING_SEEDS[:count], robot), *others), _loops(VALIDATION, robot) if count else others


def _loops(seeds: Sequence[int], robot: Robot) -> tuple[Trajectory, ...]:
    name = "loop-planar" if robot.planar else "loop-spatial"
    return tuple(find_trajectory({"name": name, "seed": seed}, robot.coordinates) for seed in seeds)


@dataclass(kw_only=True)
class _RunState:
    """State of a run between two rounds."""

    settings: Mapping[str, Any]
    """Settings that the run was started with."""
    rounds: int
    """Number of finished rounds."""
    evaluated: int
    """Number of evaluations of the objective."""
    wall_s: float
    base_payload_kg: float | None
    evaluations: list[Evaluation]

    def save(self, path: Path, arrays: Mapping[str, Any]) -> None:
        """Writes state and arrays atomically."""
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, standing=np.array(json.dumps(asdict(self))), **arrays)

        def write(temporary: Path) -> None:
            temporary.write_bytes(buffer.getvalue())

        atomic_write(path, write)

    @classmethod
    def load(cls, path: Path) -> tuple[_RunState, dict[str, Any]]:
        """Loads a state and its arrays.

        Raises:
            ValueError: if the file does not exist or is damaged.
        """
        if not path.is_file():
            raise ValueError(f"there is no run to resume: {str(path)!r} does not exist. Omit --resume to start a run")
        try:
            # The file is opened here because np.load does not close a damaged file that it opened.
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            data = json.loads(str(arrays.pop("standing")))
            data["evaluations"] = [Evaluation(**item) for item in data["evaluations"]]
            return cls(**data), arrays
        except (OSError, EOFError, KeyError, TypeError, ValueError, zipfile.BadZipFile) as error:
            raise ValueError(
                f"checkpoint {str(path)!r} cannot be resumed ({error}); no file was changed. "
                "Start a new run with another --out"
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
) -> TrainingResult:
    """Trains a policy by analytic policy gradient (APG).

    The same seed and number of threads on the same machine give the same weights.

    Args:
        env_id: one of :data:`cablebot_gym.ENV_IDS`.
        out: folder of the run.
        config: YAML file, or the name of a shipped one; None for ``gradient``.
        seed: seed of the initial weights; None for 0.
        resume: whether to resume the run in ``out`` after its last finished round.
        threads: number of torch's threads; None for 1.
        progress: function called with a text, the evaluations of the objective so far, and their largest number.

    Raises:
        ValueError: if an argument or the configuration is invalid, or ``out`` already contains a run. With ``resume``
            also if ``out`` contains no run, a run with other settings, or a damaged checkpoint. No file is changed.
        Interrupted: after Ctrl-C; the checkpoint is that of the last finished round.
    """
    check_writable_dir(out)
    plain = read_yaml(env_id, config if config is not None else Path(ALGORITHM))
    numbers = {"seed": 0 if seed is None else seed, "threads": 1 if threads is None else threads}
    if numbers["seed"] < 0 or numbers["threads"] < 1:
        raise ValueError(f"--seed must be at least 0 and --threads at least 1, not {seed} and {threads}")
    file = None if config is None else config.name
    settings: dict[str, Any] = {"env_id": env_id, **numbers, "config": dict(plain), "config_file": file}
    arrays: dict[str, Any] = {}
    if resume:
        state, arrays = _RunState.load(out / CHECKPOINT)
        given = {"env_id": env_id, "seed": seed, "threads": threads, "config": config and settings["config"]}
        for name, value in given.items():
            if value is not None and value != state.settings.get(name):
                raise ValueError(f"the run in {str(out)!r} was started with another {name}: choose another --out")
        plain = state.settings["config"]
    else:
        check_no_run(out)
        state = _RunState(settings=settings, rounds=0, evaluated=0, wall_s=0.0, base_payload_kg=None, evaluations=[])
    checked = make_gradient_config(env_id, plain)
    with torch_threads(state.settings["threads"]):
        run = _Run(checked, state, out, progress or (lambda text, done, total: None))
        try:
            return run.finish(arrays)
        except KeyboardInterrupt as stop:
            raise Interrupted(state.evaluated) from stop


class _Run:
    """A training and its folder."""

    def __init__(
        self,
        config: GradientConfig,
        state: _RunState,
        out: Path,
        progress: Callable[[str, int, int], None],
    ) -> None:
        self.config, self.state, self.out, self._progress = config, state, out, progress
        self.robot = find_robot(env_robot(config.env_id))
        self._started, self._wall = time.monotonic(), state.wall_s
        self._total = config.settings.iterations * len(config.settings.rounds)

    def finish(self, arrays: Mapping[str, Any]) -> TrainingResult:
        """Trains to the end."""
        state, config = self.state, self.config
        self._progress("preparing", state.evaluated, self._total)
        training = GradientTraining(
            robot=self.robot,
            trajectories=config.trajectories,
            action_mapping=config.action_mapping,
            features=config.features,
            seed=state.settings["seed"],
            settings=config.settings,
            minimum_tension=config.base.minimum_tension,
        )
        self.out.mkdir(parents=True, exist_ok=True)
        if arrays:
            training.restore(arrays)
        else:
            network = training.network
            zero = zero_network(network.inputs, network.outputs)
            state.base_payload_kg = self._payload(replace(self._bundle(training), network=zero))
            self._save(training)
        for number in range(state.rounds, len(config.settings.rounds)):
            before = state.evaluated
            training.round(number, partial(self._report, before))
            state.evaluated, state.rounds = before + training.evaluations, number + 1
            self._evaluate(training)
            self._save(training)
        self._bundle(training).save(self.out / LAST)
        return TrainingResult(
            out=self.out,
            timesteps=state.evaluated,
            wall_s=state.wall_s,
            base_payload_kg=state.base_payload_kg,
            evaluations=tuple(state.evaluations),
        )

    def _report(self, before: int, at: Progress) -> None:
        text = f"round {at.round}, optimised payload {at.payload:.2f} kg"
        self._progress(text, before + at.evaluations, self._total)

    def _payload(self, bundle: Bundle) -> float | None:
        """Mean DLCC of a bundle on the validation motions [kg]; a motion on which it fails unloaded counts as 0."""
        conditions: dict[str, Any] = {"criterion": "task", "resolution": RESOLUTION, **self.config.evaluation}
        payloads = [
            evaluate_dlcc(LearnedPolicy(bundle, self.robot), bundle.env_id, trajectory=motion, **conditions).payload
            for motion in self.config.validation
        ]
        return float(np.mean([payload or 0.0 for payload in payloads]))

    def _evaluate(self, training: GradientTraining) -> None:
        self._progress("evaluating", self.state.evaluated, self._total)
        payload, state = self._payload(self._bundle(training)), self.state
        before = max((rank(item.payload_kg) for item in state.evaluations), default=-2.0)
        wall = round(self._wall_s(), 3)
        state.evaluations.append(Evaluation(timesteps=state.evaluated, wall_s=wall, payload_kg=payload))
        if rank(payload) > before:
            self._bundle(training).save(self.out / BEST)
        write_evaluations(self.out, state.evaluations)

    def _save(self, training: GradientTraining) -> None:
        self.state.wall_s = round(self._wall_s(), 3)
        self.state.save(self.out / CHECKPOINT, training.state())

    def _wall_s(self) -> float:
        return self._wall + time.monotonic() - self._started

    def _bundle(self, training: GradientTraining) -> Bundle:
        config = self.config
        return Bundle(
            env_id=config.env_id,
            base=config.base,
            action_mapping=config.action_mapping,
            features=config.features,
            network=training.network,
            card=self._card(training),
        )

    def _card(self, training: GradientTraining) -> dict[str, Any]:
        state, settings = self.state, self.state.settings
        words = ["cablebot", "train", self.config.env_id, "--algo", ALGORITHM]
        words += [] if settings["config_file"] is None else ["--config", settings["config_file"]]
        words += ["--seed", str(settings["seed"]), "--threads", str(settings["threads"])]
        rows = state.evaluations
        return {
            "command": shlex.join(words),
            "env_id": self.config.env_id,
            "algorithm": ALGORITHM,
            "config": dict(self.config.plain),
            "seed": settings["seed"],
            "timesteps": state.evaluated,
            "wall_s": round(self._wall_s(), 3),
            "threads": settings["threads"],
            "versions": versions(),
            "payload_kg": rows[-1].payload_kg if rows else None,
            "payload_by_equations_kg": float(np.mean(training.payloads)),
            "evaluation": {"criterion": "task", "resolution": RESOLUTION, **self.config.evaluation},
            "base_payload_kg": state.base_payload_kg,
            "planner_output_used": False,
            "curve": [asdict(item) for item in rows],
        }
