"""The cells of the benchmark, each one number: what a policy carries under one set of conditions, or the best found."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any

from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.envs import env_robot
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.batch import BATCH, versions
from cablebot_gym.evaluation.evaluator import DEFAULT_RESOLUTION, DRAWN_RESOLUTION, PAYLOAD_MAX, SCAN_POINTS
from cablebot_gym.policies import Policy, load_policy
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.task import Limits, as_plain
from cablebot_gym.uncertainty import Spread, find_uncertainty
from cablebot_gym.utils.code_hash import source_hash

DEFAULT_LIMITS = MappingProxyType(as_plain(Limits()))
"""Bounds of the errors in every suite [m, rad]."""

TOLD_SHARE = MappingProxyType({"told": 1.0, "untold": None, "told-0.9": 0.9, "told-1.1": 1.1})
"""Information sets: which share of the true payload the policy is told; None for nothing."""


@dataclass(frozen=True, kw_only=True)
class PolicyCell:
    """What a policy carries.

    Raises:
        ValueError: if the information set is unknown.
    """

    env_id: str
    """Environment."""
    trajectory: Mapping[str, Any]
    """Motion, as :func:`~cablebot_gym.trajectories.find_trajectory` takes it: ``{"name": …}`` and its fields."""
    policy: str
    """As on the command line."""
    criterion: str = "task"
    """``task`` or ``paper``."""
    information: str = "told"
    """A name of :data:`TOLD_SHARE`."""
    uncertainty: str | None = None
    """Name of what else the policy does not know; None for nothing."""
    draws: int = 1
    """Episodes at each payload."""
    probability: float = 0.95
    """Share of the draws that has to carry a payload."""
    limits: Mapping[str, float] = field(default_factory=lambda: dict(DEFAULT_LIMITS))
    """Bounds of the errors [m, rad]."""
    control_frequency: float = 500.0
    """[Hz]"""
    seed: int = 0
    """Of the environments."""
    resolution: float | None = None
    """[kg]; None for the evaluator's own."""
    stiffness: float | None = None
    """Of the joint springs, K [N·m/rad]; None for the environment's own."""

    def __post_init__(self) -> None:
        if self.information not in TOLD_SHARE:
            raise ValueError(f"unknown information set {self.information!r}; choose one of {', '.join(TOLD_SHARE)}")

    @property
    def key(self) -> str:
        """Tells cells apart."""
        return canonical(self.to_dict())

    @property
    def stem(self) -> str:
        """For people who look for its file."""
        unknown = (self.uncertainty,) if self.uncertainty else ()
        return _stem(self.env_id, self.trajectory, self.policy, self.information, *unknown, self.criterion)

    @property
    def source(self) -> str:
        """Hash of the code that makes the number: this package's and the policy's."""
        modules, data = policy_source(self.policy)
        return source_hash("cablebot_gym.evaluation.evaluator", *modules, data=data)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data; :func:`cell_from` reads it."""
        return {"kind": "policy", **asdict(self)}

    @property
    def robot(self) -> Robot:
        """The nominal one.

        Raises:
            ValueError: if it has no joint springs, and their stiffness is given.
        """
        return _robot(self.env_id, self.stiffness)

    @property
    def told_share(self) -> float:
        """A wrong payload is told by asking for it, and meeting another: what is asked for, as a share of the other."""
        return TOLD_SHARE[self.information] or 1.0

    def conditions(self) -> dict[str, Any]:
        """Of an episode: the environment's keywords, JSON-able."""
        own = {} if self.stiffness is None else {"robot": self.robot.to_dict()}
        return own | {
            "trajectory": dict(self.trajectory),
            "limits": dict(self.limits),
            "payload_known": TOLD_SHARE[self.information] is not None,
            "uncertainty": self._uncertainty(),
            "control_frequency": self.control_frequency,
        }

    def question(self) -> dict[str, Any]:
        """What :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc` is asked: its keywords, JSON-able."""
        usual = DEFAULT_RESOLUTION if self.draws == 1 else DRAWN_RESOLUTION
        return self.conditions() | {
            "criterion": self.criterion,
            "payload_max": self.told_share * PAYLOAD_MAX["planar" if self.robot.planar else "spatial"],
            "resolution": self.told_share * (usual if self.resolution is None else self.resolution),
            "draws": self.draws,
            "probability": self.probability,
            "seed": self.seed,
        }

    def compute(self) -> dict[str, Any]:
        """The payload, and why not more."""
        robot = self.robot
        policy = load_policy(self.policy, robot)
        if self.criterion == "paper" and not getattr(policy, "unclipped", False):
            return {"applicable": False, "payload": None, "total_mass": None}
        result = evaluate_dlcc(policy, self.env_id, name=self.policy, **self.question())
        share = self.told_share
        payload = _true(result.payload, share)
        return {
            "applicable": True,
            "payload": payload,
            "total_mass": None if payload is None else payload + robot.mass,
            "resolution": _true(result.resolution, share),
            "limit": asdict(result.limit),
            "assured_payload": _true(result.assured_payload, share),
            "feasible": [[_true(end, share) for end in interval] for interval in result.feasible],
            "failures": result.failures,
            "fallbacks": _fallbacks(policy, self.draws),
        }

    def _uncertainty(self) -> str | dict[str, Any] | None:
        """A name where there is one, else data."""
        share = self.told_share
        if share == 1.0:
            return self.uncertainty
        unknown = find_uncertainty(self.uncertainty, self.robot)
        wrong = Spread(low=1 / share - 1, high=1 / share - 1)
        plain: dict[str, Any] = as_plain(replace(unknown, parameters={**unknown.parameters, "payload": wrong}))
        return plain


@dataclass(frozen=True, kw_only=True)
class BestCell:
    """The best found: the largest payload for which some motion inside the limits is known."""

    env_id: str
    """Environment."""
    trajectory: Mapping[str, Any]
    """Motion."""
    limits: Mapping[str, float] = field(default_factory=lambda: dict(DEFAULT_LIMITS))
    """Bounds of the errors [m, rad]."""
    control_frequency: float = 500.0
    """[Hz]"""
    stiffness: float | None = None
    """Of the joint springs, K [N·m/rad]; None for the environment's own."""

    @property
    def key(self) -> str:
        """Tells cells apart."""
        return canonical(self.to_dict())

    @property
    def stem(self) -> str:
        """For people who look for its file."""
        return _stem(self.env_id, self.trajectory, "best-found")

    @property
    def source(self) -> str:
        """Hash of the code that makes the number."""
        return source_hash("cablebot_gym.bounds.best_known")

    @property
    def robot(self) -> Robot:
        """The one that moves.

        Raises:
            ValueError: if it has no joint springs, and their stiffness is given.
        """
        return _robot(self.env_id, self.stiffness)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data; :func:`cell_from` reads it."""
        return {"kind": "best", **asdict(self)}

    def question(self) -> dict[str, Any]:
        """What :func:`cablebot_gym.bounds.best_known.best_found` is asked: its keywords; JSON-able but for the robot."""
        own = {} if self.stiffness is None else {"robot": self.robot}
        return own | {
            "trajectory": dict(self.trajectory),
            "limits": dict(self.limits),
            "control_frequency": self.control_frequency,
        }

    def compute(self) -> dict[str, Any]:
        """What :func:`cablebot_gym.bounds.best_known.best_found` says."""
        from cablebot_gym.bounds.best_known import best_found

        return dict(best_found(self.env_id, **self.question()).to_dict())


Cell = PolicyCell | BestCell


@dataclass(frozen=True, kw_only=True)
class Record:
    """A cell and what came of it."""

    cell: Cell
    """What was asked."""
    source: str
    """Hash of the code that made the result."""
    versions: Mapping[str, str]
    """Of Python and of the packages that made it."""
    result: Mapping[str, Any]
    """What was found; ``error`` is a sentence if nothing was. The same each time."""
    seconds: float
    """What it took."""
    final: bool = True
    """Whether trying again gives the same; not where a package, a file or memory was missing, or a process died."""

    @property
    def error(self) -> str | None:
        """Why there is no result; None if there is one."""
        return self.result.get("error")


def compute(cell: Cell) -> Record:
    """A cell's result. Whatever goes wrong is the cell's: a policy that fails does not end the benchmark."""
    start, final = time.perf_counter(), True
    try:
        result = cell.compute()
    except (ImportError, OSError, MemoryError) as error:
        result, final = {"error": _sentence(error)}, False
    except Exception as error:
        result = {"error": _sentence(error)}
    seconds = time.perf_counter() - start
    return Record(
        cell=cell, source=cell.source, versions=versions(), result=_plain(result), seconds=seconds, final=final
    )


def failed(cell: Cell, why: str) -> Record:
    """A cell that is to be tried again another time, with ``why`` as its error."""
    return Record(cell=cell, source=cell.source, versions=versions(), result={"error": why}, seconds=0.0, final=False)


def cell_from(data: Mapping[str, Any]) -> Cell:
    """A cell from ``data``, what its ``to_dict`` says.

    Raises:
        KeyError, TypeError, ValueError: if that is no cell's.
    """
    kinds: dict[str, type[PolicyCell] | type[BestCell]] = {"policy": PolicyCell, "best": BestCell}
    return kinds[data["kind"]](**{name: value for name, value in data.items() if name != "kind"})


def canonical(data: Any) -> str:
    """JSON that is the same for equal data."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _robot(env_id: str, stiffness: float | None) -> Robot:
    robot = find_robot(env_robot(env_id))
    if stiffness is None:
        return robot
    if not robot.flexible:
        raise ValueError(f"{env_id} has no joint springs: leave stiffness out, or choose an id with -Flex")
    return robot.replace(transmission=robot.transmission.replace(stiffness=stiffness))


def _plain(result: Mapping[str, Any]) -> dict[str, Any]:
    """As it is read again: lists in place of tuples, keys that are strings."""
    data: dict[str, Any] = json.loads(canonical(result))
    return data


def _true(payload: float | None, share: float) -> float | None:
    """What was on the platform when ``payload`` was told."""
    return None if payload is None else payload / share


def _fallbacks(policy: Policy, draws: int) -> float | None:
    """How often a policy fell back on something safer in an episode at the payload found, where it counts that."""
    counted = getattr(policy, "fallbacks", None)
    if counted is None:
        return None
    episodes = min(SCAN_POINTS, max(1, BATCH // draws)) * draws  # the evaluator's last batch, of one payload alone
    return float(counted) / episodes


def _sentence(error: Exception) -> str:
    """An error's words in one line."""
    words = " ".join(str(error).split())
    return words if isinstance(error, (ValueError, ImportError, RuntimeError)) else f"{type(error).__name__}: {words}"


def _stem(env_id: str, trajectory: Mapping[str, Any], *words: str) -> str:
    fields = [str(value) for name, value in trajectory.items() if name != "name"]
    text = "-".join([env_id.removeprefix("CableBot-").removesuffix("-v0"), *words, str(trajectory["name"]), *fields])
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.").lower()[:100]
