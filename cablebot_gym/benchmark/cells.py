"""Cells of the benchmark. A cell is one number: the DLCC of a policy under given conditions or a best known payload."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from types import MappingProxyType
from typing import Any

from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.envs import env_robot
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.batch import BATCH, versions
from cablebot_gym.evaluation.evaluator import DEFAULT_RESOLUTION, DRAWN_RESOLUTION, PAYLOAD_MAX, SCAN_POINTS
from cablebot_gym.policies import Policy, load_policy
from cablebot_gym.robots import Robot, find_robot
from cablebot_gym.task import ErrorBounds, payload_model_text, to_jsonable
from cablebot_gym.utils.code_hash import source_hash

DEFAULT_ERROR_BOUNDS = MappingProxyType(to_jsonable(ErrorBounds()))
"""Error bounds of every suite: ``position`` [m] and ``rotation`` [rad]."""


@dataclass(frozen=True, kw_only=True)
class PolicyCell:
    """The DLCC of one policy under one set of conditions."""

    env_id: str
    """Environment id."""
    trajectory: Mapping[str, Any]
    """Reference motion, ``{"name": …}`` and its fields; see :func:`~cablebot_gym.trajectories.find_trajectory`."""
    policy: str
    """Policy name as on the command line."""
    criterion: str = "task"
    """DLCC criterion: ``task`` or ``paper``."""
    payload_known: bool = True
    """Whether the policy's model includes the payload."""
    model_payload_factor: float = 1.0
    """Ratio of the policy's model payload to the nominal payload."""
    uncertainty: str | None = None
    """Name of an uncertainty; None for none."""
    draws: int = 1
    """Number of sampled episodes per payload."""
    probability: float = 0.95
    """Required success rate over the draws."""
    error_bounds: Mapping[str, float] = field(default_factory=lambda: dict(DEFAULT_ERROR_BOUNDS))
    """Error bounds: ``position`` [m] and ``rotation`` [rad]."""
    control_frequency: float = 500.0
    """Control frequency [Hz]."""
    seed: int = 0
    """Seed of the environments."""
    resolution: float | None = None
    """Payload resolution of the search [kg]; None for the evaluator's default."""
    stiffness: float | None = None
    """Joint stiffness K [N·m/rad]; None for the environment's default."""

    @property
    def key(self) -> str:
        """Canonical JSON of all fields; unique for each cell."""
        return canonical(self.to_dict())

    @property
    def stem(self) -> str:
        """Readable beginning of the name of the cell's file."""
        unknown = (self.uncertainty,) if self.uncertainty else ()
        return _stem(self.env_id, self.trajectory, self.policy, self.payload_model, *unknown, self.criterion)

    @property
    def source(self) -> str:
        """Hash of the code that computes the cell: this package's and the policy's."""
        modules, data = policy_source(self.policy)
        return source_hash("cablebot_gym.evaluation.evaluator", *modules, data=data)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data, the input of :func:`cell_from_dict`."""
        return {"kind": "policy", **asdict(self)}

    @property
    def robot(self) -> Robot:
        """Nominal robot with the stiffness of the cell.

        Raises:
            ValueError: if a stiffness is given for a robot without joint springs.
        """
        return _robot(self.env_id, self.stiffness)

    @property
    def payload_model(self) -> str:
        """Payload model in words: ``payload known``, ``payload unknown`` or ``payload model × 0.9``."""
        return payload_model_text(self.payload_known, self.model_payload_factor)

    def env_options(self) -> dict[str, Any]:
        """JSON-able keyword arguments of the environment."""
        robot = {} if self.stiffness is None else {"robot": self.robot.to_dict()}
        return robot | {
            "trajectory": dict(self.trajectory),
            "error_bounds": dict(self.error_bounds),
            "payload_known": self.payload_known,
            "model_payload_factor": self.model_payload_factor,
            "uncertainty": self.uncertainty,
            "control_frequency": self.control_frequency,
        }

    def options(self) -> dict[str, Any]:
        """JSON-able keyword arguments of :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc`."""
        default = DEFAULT_RESOLUTION if self.draws == 1 else DRAWN_RESOLUTION
        return self.env_options() | {
            "criterion": self.criterion,
            "payload_max": PAYLOAD_MAX["planar" if self.robot.planar else "spatial"],
            "resolution": default if self.resolution is None else self.resolution,
            "draws": self.draws,
            "probability": self.probability,
            "seed": self.seed,
        }

    def compute(self) -> dict[str, Any]:
        """The payload, its limiting violation, and the details of the search.

        The paper criterion applies to policies that declare ``unsaturated_actions``; for others the result says
        ``applicable: False``.
        """
        robot = self.robot
        policy = load_policy(self.policy, robot)
        if self.criterion == "paper" and not getattr(policy, "unsaturated_actions", False):
            return {"applicable": False, "payload": None, "total_mass": None}
        result = evaluate_dlcc(policy, self.env_id, name=self.policy, **self.options())
        return {
            "applicable": True,
            "payload": result.payload,
            "total_mass": result.total_mass,
            "resolution": result.resolution,
            "violation": None if result.violation is None else asdict(result.violation),
            "scan_ended": result.scan_ended,
            "assured_payload": result.assured_payload,
            "feasible": [list(interval) for interval in result.feasible],
            "failures": result.failures,
            "fallbacks": _fallbacks(policy, self.draws),
        }


@dataclass(frozen=True, kw_only=True)
class BestKnownCell:
    """The best known payload: the largest payload for which a motion within all limits is known."""

    env_id: str
    """Environment id."""
    trajectory: Mapping[str, Any]
    """Reference motion, as in :class:`PolicyCell`."""
    error_bounds: Mapping[str, float] = field(default_factory=lambda: dict(DEFAULT_ERROR_BOUNDS))
    """Error bounds: ``position`` [m] and ``rotation`` [rad]."""
    control_frequency: float = 500.0
    """Control frequency [Hz]."""
    stiffness: float | None = None
    """Joint stiffness K [N·m/rad]; None for the environment's default."""

    @property
    def key(self) -> str:
        """Canonical JSON of all fields; unique for each cell."""
        return canonical(self.to_dict())

    @property
    def stem(self) -> str:
        """Readable beginning of the name of the cell's file."""
        return _stem(self.env_id, self.trajectory, "best-known")

    @property
    def source(self) -> str:
        """Hash of the code that computes the cell."""
        return source_hash("cablebot_gym.bounds.best_known")

    @property
    def robot(self) -> Robot:
        """Robot with the stiffness of the cell.

        Raises:
            ValueError: if a stiffness is given for a robot without joint springs.
        """
        return _robot(self.env_id, self.stiffness)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data, the input of :func:`cell_from_dict`."""
        return {"kind": "best-known", **asdict(self)}

    def options(self) -> dict[str, Any]:
        """Keyword arguments of :func:`~cablebot_gym.bounds.best_known.find_best_known`; JSON-able except the robot."""
        robot = {} if self.stiffness is None else {"robot": self.robot}
        return robot | {
            "trajectory": dict(self.trajectory),
            "error_bounds": dict(self.error_bounds),
            "control_frequency": self.control_frequency,
        }

    def compute(self) -> dict[str, Any]:
        """The result of :func:`cablebot_gym.bounds.best_known.find_best_known` as JSON-able data."""
        from cablebot_gym.bounds.best_known import find_best_known

        return dict(find_best_known(self.env_id, **self.options()).to_dict())


Cell = PolicyCell | BestKnownCell


@dataclass(frozen=True, kw_only=True)
class Record:
    """A cell and its result."""

    cell: Cell
    """The cell."""
    source: str
    """Hash of the code that computed the result."""
    versions: Mapping[str, str]
    """Versions of Python and of the packages used."""
    result: Mapping[str, Any]
    """JSON-able result, or an ``error`` message if the computation failed. It is reproducible."""
    seconds: float
    """Wall time of the computation [s]."""
    final: bool = True
    """Whether a retry gives the same result. False if a package, a file or memory was missing or a process died."""

    @property
    def error(self) -> str | None:
        """Error message of a failed computation; None if it succeeded."""
        return self.result.get("error")


def compute(cell: Cell) -> Record:
    """Computes a cell. An exception becomes the error of the record; it does not stop the benchmark."""
    start, final = time.perf_counter(), True
    try:
        result = cell.compute()
    except (ImportError, OSError, MemoryError) as error:
        result, final = {"error": _one_line(error)}, False
    except Exception as error:
        result = {"error": _one_line(error)}
    seconds = time.perf_counter() - start
    return Record(
        cell=cell,
        source=cell.source,
        versions=versions(),
        result=_json_round_trip(result),
        seconds=seconds,
        final=final,
    )


def failed_record(cell: Cell, reason: str) -> Record:
    """A record that is not final, with ``reason`` as its error: the next run computes the cell again."""
    return Record(
        cell=cell, source=cell.source, versions=versions(), result={"error": reason}, seconds=0.0, final=False
    )


def cell_from_dict(data: Mapping[str, Any]) -> Cell:
    """The cell whose ``to_dict`` returned ``data``.

    Raises:
        KeyError, TypeError, ValueError: if ``data`` does not describe a cell.
    """
    kinds: dict[str, type[PolicyCell] | type[BestKnownCell]] = {"policy": PolicyCell, "best-known": BestKnownCell}
    return kinds[data["kind"]](**{name: value for name, value in data.items() if name != "kind"})


def canonical(data: Any) -> str:
    """JSON text that is identical for equal data."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _robot(env_id: str, stiffness: float | None) -> Robot:
    robot = find_robot(env_robot(env_id))
    if stiffness is None:
        return robot
    if not robot.flexible:
        raise ValueError(f"{env_id} has no joint springs; omit the stiffness or choose an id with -Flex")
    return robot.replace(transmission=robot.transmission.replace(stiffness=stiffness))


def _json_round_trip(result: Mapping[str, Any]) -> dict[str, Any]:
    """The data as read back from JSON: lists instead of tuples, string keys."""
    data: dict[str, Any] = json.loads(canonical(result))
    return data


def _fallbacks(policy: Policy, draws: int) -> float | None:
    """Mean number of fallbacks per episode at the DLCC; None for a policy that does not count ``fallbacks``."""
    count = getattr(policy, "fallbacks", None)
    if count is None:
        return None
    episodes = min(SCAN_POINTS, max(1, BATCH // draws)) * draws  # the evaluator's last batch holds one payload only
    return float(count) / episodes


def _one_line(error: Exception) -> str:
    """The message of an exception in one line, with the type where the message alone is unclear."""
    text = " ".join(str(error).split())
    return text if isinstance(error, (ValueError, ImportError, RuntimeError)) else f"{type(error).__name__}: {text}"


def _stem(env_id: str, trajectory: Mapping[str, Any], *words: str) -> str:
    fields = [str(value) for name, value in trajectory.items() if name != "name"]
    text = "-".join([env_id.removeprefix("CableBot-").removesuffix("-v0"), *words, str(trajectory["name"]), *fields])
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.").lower()[:100]
