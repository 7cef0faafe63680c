"""The cells of the benchmark, each one number: what a policy carries under one set of conditions, or the best found."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType
from typing import Any

from cablebot_gym.benchmark.source import policy_source
from cablebot_gym.dlcc import evaluate_dlcc
from cablebot_gym.dlcc.batch import BATCH, versions
from cablebot_gym.dlcc.evaluator import DEFAULT_RESOLUTION, DRAWN_RESOLUTION, PAYLOAD_MAX, SCAN_POINTS
from cablebot_gym.envs import env_robot
from cablebot_gym.policies import Policy, load_policy
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.source import source_hash
from cablebot_gym.task import Limits, as_plain
from cablebot_gym.uncertainty import Spread, Uncertainty, find_uncertainty

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
        return source_hash("cablebot_gym.dlcc.evaluator", *modules, data=data)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data; :func:`cell_from` reads it."""
        return {"kind": "policy", **asdict(self)}

    def compute(self) -> dict[str, Any]:
        """The payload, and why not more."""
        robot = find_robot(env_robot(self.env_id))
        policy = load_policy(self.policy, robot)
        if self.criterion == "paper" and not getattr(policy, "unclipped", False):
            return {"applicable": False, "payload": None, "total_mass": None}
        share = TOLD_SHARE[self.information] or 1.0  # a wrong payload is told by asking for it, and meeting another
        usual = DEFAULT_RESOLUTION if self.draws == 1 else DRAWN_RESOLUTION
        result = evaluate_dlcc(
            policy,
            self.env_id,
            criterion=self.criterion,
            limits=dict(self.limits),
            payload_max=share * PAYLOAD_MAX["planar" if robot.planar else "spatial"],
            resolution=share * (usual if self.resolution is None else self.resolution),
            uncertainty=self._uncertainty(robot, share),
            draws=self.draws,
            probability=self.probability,
            seed=self.seed,
            name=self.policy,
            trajectory=dict(self.trajectory),
            payload_known=TOLD_SHARE[self.information] is not None,
            control_frequency=self.control_frequency,
        )
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

    def _uncertainty(self, robot: Robot, share: float) -> Uncertainty:
        unknown = find_uncertainty(self.uncertainty, robot)
        if share == 1.0:
            return unknown
        wrong = Spread(low=1 / share - 1, high=1 / share - 1)
        return replace(unknown, parameters={**unknown.parameters, "payload": wrong})


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
        return source_hash("cablebot_gym.dlcc.optimum")

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data; :func:`cell_from` reads it."""
        return {"kind": "best", **asdict(self)}

    def compute(self) -> dict[str, Any]:
        """What :func:`cablebot_gym.dlcc.optimum.best_found` says."""
        from cablebot_gym.dlcc.optimum import best_found

        found = best_found(
            self.env_id,
            trajectory=dict(self.trajectory),
            limits=dict(self.limits),
            control_frequency=self.control_frequency,
        )
        return dict(found.to_dict())


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
