"""Cells of the benchmark. A cell is one number: the DLCC of a policy under given conditions or a
best known payload."""

from __future__ import annotations

import json
import platform
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, get_args

from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.envs import env_robot
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.constraints import Violation
from cablebot_gym.evaluation.survey import motion_seeds, survey
from cablebot_gym.evaluation.timing import time_actions
from cablebot_gym.isolation import IsolatedPolicy
from cablebot_gym.policies import PolicySpec, load
from cablebot_gym.robots import ELASTIC, Robot, find_robot, library
from cablebot_gym.task import ErrorBounds, payload_model_text, to_jsonable
from cablebot_gym.trajectories import find_trajectory
from cablebot_gym.utils.code_hash import source_hash
from cablebot_gym.utils.foreign import foreign_list

DEFAULT_ERROR_BOUNDS = MappingProxyType(to_jsonable(ErrorBounds()))
"""Error bounds of every suite: ``position`` [m] and ``rotation`` [rad]."""

_STORED = (
    *("payload", "total_mass", "resolution", "violation", "scan_ended", "assured", "stochastic"),
    *("draws", "declared", "feasible", "failures", "isolated", "bubblewrap"),
)
"""Data of a :class:`~cablebot_gym.evaluation.result.DLCCResult` in the result of a cell."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Robot, motion and error bounds, which all cells have."""

    kind: ClassVar[str]

    env_id: str
    """Environment id."""
    trajectory: Mapping[str, Any]
    """Reference motion, ``{"name": …}`` and its fields; see
    :func:`~cablebot_gym.trajectories.names.find_trajectory`."""
    error_bounds: Mapping[str, float] = field(default_factory=lambda: dict(DEFAULT_ERROR_BOUNDS))
    """Error bounds: ``position`` [m] and ``rotation`` [rad]."""
    control_frequency: float = 500.0
    """Control frequency [Hz]."""
    robot_name: str | None = None
    """Name of the robot; None for that of the environment id."""

    @property
    def key(self) -> str:
        """Canonical JSON of all fields; unique for each cell."""
        return canonical(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data, the input of :func:`cell_from_dict`."""
        data = {"kind": self.kind, **asdict(self)}
        if self.robot_name is None:
            del data["robot_name"]
        return data

    @property
    def robot_files(self) -> tuple[Path, ...]:
        """File of the robot if it is one of the library, on which the result depends as on code."""
        name = (self.robot_name or env_robot(self.env_id)).removeprefix(ELASTIC)
        path = library().get(name)
        return () if path is None else (path,)

    @property
    def robot(self) -> Robot:
        """Nominal robot."""
        return find_robot(self.robot_name or env_robot(self.env_id))

    @property
    def motion_key(self) -> str:
        """Key of the best known payload: environment, robot, motion, error bounds and control
        frequency."""
        robot = (self.env_id, self.robot_name)
        return canonical([*robot, self.trajectory, self.error_bounds, self.control_frequency])

    def env_options(self) -> dict[str, Any]:
        """JSON-able keyword arguments of the environment."""
        options: dict[str, Any] = {}
        if self.robot_name is not None:
            options["robot"] = self.robot_name
        return options | {
            "trajectory": dict(self.trajectory),
            "error_bounds": dict(self.error_bounds),
            "control_frequency": self.control_frequency,
        }

    def _stem(self, *words: str) -> str:
        fields = [str(value) for name, value in self.trajectory.items() if name != "name"]
        env_id = self.env_id.removeprefix("CableBot-").removesuffix("-v0")
        text = "-".join([self.robot_name or env_id, *words, str(self.trajectory["name"]), *fields])
        return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.").lower()[:100]


@dataclass(frozen=True, kw_only=True)
class PolicyCell(Setting):
    """The DLCC of one policy under one set of conditions."""

    kind: ClassVar[str] = "policy"

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
    """Number of fresh draws that confirm the payload; 1 without uncertainty."""
    probability: float = 0.95
    """Required success rate over the draws."""
    seed: int = 0
    """Evaluation seed."""
    resolution: float | None = None
    """Payload resolution of the search [kg]; None for the evaluator's default."""
    payload_max: float | None = None
    """Upper end of the payload scan [kg]; None for the evaluator's default."""

    @property
    def stem(self) -> str:
        """Readable beginning of the name of the cell's file."""
        words = [self.policy, self.payload_model]
        if self.uncertainty:
            words.append(self.uncertainty)
        return self._stem(*words, self.criterion)

    @property
    def source(self) -> str:
        """Hash of the code that computes the cell: this package's and the policy's."""
        return _policy_hash(self.policy, self.robot_files)

    @property
    def payload_model(self) -> str:
        """Payload model in words: ``payload known``, ``payload unknown`` or ``payload model ×
        0.9``."""
        return payload_model_text(self.payload_known, self.model_payload_factor)

    def env_options(self) -> dict[str, Any]:
        """JSON-able keyword arguments of the environment."""
        names = ("payload_known", "model_payload_factor", "uncertainty")
        return super().env_options() | {name: getattr(self, name) for name in names}

    def options(self) -> dict[str, Any]:
        """JSON-able keyword arguments of
        :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc`."""
        names = ("criterion", "payload_max", "resolution", "probability", "seed")
        # a stochastic policy has draws without uncertainty
        draws = self.draws if self.draws > 1 else None
        search = {name: getattr(self, name) for name in names}
        return self.env_options() | search | {"draws": draws}

    def compute(self) -> dict[str, Any]:
        """The payload, its limiting violation, and the details of the search. A policy that is not
        shipped runs in a process of its own.

        The paper criterion applies to policies that declare ``unsaturated_actions``; for others the
        result says ``applicable: False``. ``declared`` marks policies that this project does not
        hold to their declaration.
        """
        with policy_process(self) as policy:
            loaded = load(policy, self.robot)
            if self.criterion == "paper" and not loaded.declarations.unsaturated_actions:
                return {"applicable": False, "payload": None, "total_mass": None}
            result = evaluate_dlcc(loaded, self.env_id, name=self.policy, **self.options())
        data = result.to_dict()
        return {name: data[name] for name in _STORED} | {
            "applicable": True,
            "fallbacks": result.details.fallbacks,
        }


@dataclass(frozen=True, kw_only=True)
class SurveyCell(PolicyCell):
    """The payloads of one policy on several motions, whose episodes share their batches.

    ``trajectory`` has a list of seeds, one for each motion, and ``draws`` is the number of random
    robots of each motion. ``probability``, ``resolution`` and ``payload_max`` have no effect.
    """

    kind: ClassVar[str] = "survey"

    @property
    def stem(self) -> str:
        """Readable beginning of the name of the cell's file."""
        return f"{self.parts[0].stem}-survey"

    @property
    def parts(self) -> tuple[PolicyCell, ...]:
        """A cell for each motion, with the same robots. It can be computed alone."""
        fields = self.to_dict()
        del fields["kind"], fields["seed"]
        trajectory = fields.pop("trajectory")
        seeds = trajectory["seed"]
        return tuple(
            PolicyCell(trajectory=trajectory | {"seed": seed}, seed=evaluation_seed, **fields)
            for seed, evaluation_seed in zip(
                seeds, motion_seeds(self.seed, len(seeds)), strict=True
            )
        )

    def compute(self) -> dict[str, Any]:
        """The payload and the limiting violation of each motion."""
        kind = self.robot.kind
        motions = [find_trajectory(dict(part.trajectory), kind) for part in self.parts]
        names = ("criterion", "seed")
        options = self.env_options() | {name: getattr(self, name) for name in names}
        del options["trajectory"]
        with policy_process(self) as policy:
            result = survey(
                policy, self.env_id, motions, robots=self.draws, name=self.policy, **options
            )
        return {
            "payloads": [motion.payload for motion in result.motions],
            "failed_payloads": [motion.failed_payload for motion in result.motions],
            "violations": [_brief(motion.violation) for motion in result.motions],
            "resolutions": list(result.resolutions),
            "stochastic": result.stochastic,
        }

    def part_results(self, result: Mapping[str, Any]) -> list[dict[str, Any]]:
        """Results of the :attr:`parts` in the form of those of a :class:`PolicyCell`.

        Raises:
            KeyError, TypeError, ValueError: if ``result`` is not that of this cell.
        """
        seeds = self.trajectory["seed"]
        if "error" in result:
            return [dict(result) for _ in seeds]
        names = ("payloads", "failed_payloads", "violations", "resolutions")
        columns = [foreign_list(name, result[name]) for name in names]
        return [
            {
                "payload": payload,
                "violation": None if violation is None else asdict(Violation(**violation)),
                "resolution": resolution,
                "scan_ended": failed_payload is None,
                "stochastic": result["stochastic"],
                "draws": self.draws,
            }
            for _, payload, failed_payload, violation, resolution in zip(
                seeds, *columns, strict=True
            )
        ]


def _brief(violation: Violation | None) -> dict[str, Any] | None:
    """The fields of a violation that are not at their defaults."""
    if violation is None:
        return None
    data = {}
    for item in fields(violation):
        value = getattr(violation, item.name)
        if value != item.default:
            data[item.name] = value
    return data


@dataclass(frozen=True, kw_only=True)
class TimingCell(Setting):
    """The computing time of a policy per action."""

    kind: ClassVar[str] = "timing"

    policy: str
    """Policy name as on the command line."""

    @property
    def stem(self) -> str:
        """Readable beginning of the name of the cell's file."""
        return self._stem(self.policy, "timing")

    @property
    def source(self) -> str:
        """Hash of the code that computes the cell."""
        return _policy_hash(self.policy, self.robot_files)

    def compute(self) -> dict[str, Any]:
        """The result of :func:`cablebot_gym.evaluation.timing.time_actions`, and the processor of
        this machine.

        ``exchange`` marks policies that are not shipped, whose times include the exchange with
        their process.
        """
        with policy_process(self) as policy:
            times = time_actions(policy, self.env_id, **self.env_options())
        is_shipped = PolicySpec.parse(self.policy).shipped
        return asdict(times) | {"exchange": not is_shipped, "processor": processor()}


@dataclass(frozen=True, kw_only=True)
class BestKnownCell(Setting):
    """The best known payload: the largest payload for which a motion within all limits is known."""

    kind: ClassVar[str] = "best-known"

    @property
    def stem(self) -> str:
        """Readable beginning of the name of the cell's file."""
        return self._stem("best-known")

    @property
    def source(self) -> str:
        """Hash of the code that computes the cell."""
        return source_hash("cablebot_gym.bounds.best_known", data=self.robot_files)

    def compute(self) -> dict[str, Any]:
        """The result of :func:`cablebot_gym.bounds.best_known.find_best_known` as JSON-able
        data."""
        from cablebot_gym.bounds.best_known import find_best_known

        options = self.env_options() | {"robot": self.robot}
        return dict(find_best_known(self.env_id, **options).to_dict())


@dataclass(frozen=True, kw_only=True)
class DrawnCell(Setting):
    """The best known payload of one draw of an uncertainty, and its ratio to the nominal one."""

    kind: ClassVar[str] = "drawn"

    uncertainty: str
    """Name of the uncertainty."""
    seed: int
    """Seed of the draw."""

    @property
    def stem(self) -> str:
        """Readable beginning of the name of the cell's file."""
        return self._stem("best-known", self.uncertainty, str(self.seed))

    @property
    def source(self) -> str:
        """Hash of the code that computes the cell."""
        return source_hash("cablebot_gym.bounds.drawn", data=self.robot_files)

    def compute(self) -> dict[str, Any]:
        """The payload of the draw and its ratio to the nominal one on the same mesh.

        It takes the nominal payload from the disk cache of this machine, or computes it first.
        """
        from cablebot_gym.bounds.drawn import find_drawn_best_known

        options = self.env_options() | {"robot": self.robot}
        result = find_drawn_best_known(
            self.env_id, uncertainty=self.uncertainty, seed=self.seed, **options
        )
        names = ("payload", "verified", "ratio", "intervals", "nominal_payload", "reference")
        return {name: getattr(result, name) for name in names}


Cell = PolicyCell | SurveyCell | BestKnownCell | DrawnCell | TimingCell

_KINDS: Mapping[str, type[Cell]] = {cell.kind: cell for cell in get_args(Cell)}


def cell_from_dict(data: Mapping[str, Any]) -> Cell:
    """The cell whose ``to_dict`` returned ``data``.

    Raises:
        KeyError, TypeError, ValueError: if ``data`` does not describe a cell.
    """
    fields = dict(data)
    kind = _KINDS[fields.pop("kind")]
    return kind(**fields)


@contextmanager
def policy_process(cell: PolicyCell | TimingCell) -> Iterator[str | IsolatedPolicy]:
    """The name of the policy of a cell if it is shipped, else the policy in a process of its own,
    which ends with the context."""
    if PolicySpec.parse(cell.policy).shipped:
        yield cell.policy
        return
    with IsolatedPolicy(cell.policy, cell.robot) as policy:
        yield policy


def processor() -> str:
    """Model of the processor, without the name of the machine."""
    with suppress(OSError):
        model = re.search(
            r"^model name\s*: (.+)$",
            Path("/proc/cpuinfo").read_text(encoding="utf-8"),
            re.MULTILINE,
        )
        if model:
            return model[1].strip()
    return platform.processor() or platform.machine()


def _policy_hash(policy: str, robot_files: tuple[Path, ...]) -> str:
    """Hash of the code that evaluates a policy, this package's and the policy's, and of the files
    of the robot."""
    modules, data = policy_source(policy)
    judge = (
        "cablebot_gym.evaluation.evaluator",
        "cablebot_gym.evaluation.survey",
        "cablebot_gym.evaluation.timing",
        "cablebot_gym.isolation.isolated",
    )
    return source_hash(*judge, *modules, data=(*data, *robot_files))


def canonical(data: Any) -> str:
    """JSON text that is identical for equal data."""
    return json.dumps(
        data, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
