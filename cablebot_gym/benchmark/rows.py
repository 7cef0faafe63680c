"""Rows of the benchmark. A row has one number with its conditions: the payload of a policy, the time
of its actions, or the payload that a motion allows."""

from __future__ import annotations

import json
import platform
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from cablebot_gym.benchmark.policy_source import policy_source
from cablebot_gym.envs import env_robot
from cablebot_gym.evaluation import evaluate_dlcc
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.survey import survey
from cablebot_gym.evaluation.timing import time_actions
from cablebot_gym.isolation import IsolatedPolicy
from cablebot_gym.policies import PolicySpec, load
from cablebot_gym.robots import ELASTIC, library
from cablebot_gym.utils.checks import choice, number
from cablebot_gym.utils.code_hash import source_hash
from cablebot_gym.utils.files import empty_cache
from cablebot_gym.utils.foreign import foreign_object

Measure = Literal["payload", "time", "optimum", "best-known", "drawn"]
"""What a row has: the DLCC of a policy; the computing time of its actions; the optimum of a motion; its
best known payload, which replays verify; or the optimum of a random robot, and its ratio to that of the
nominal one."""

MEASURES: tuple[Measure, ...] = ("payload", "time", "optimum", "best-known", "drawn")

PLANT = ("cablebot_gym.envs.vector", "cablebot_gym.evaluation.judge")
"""Modules that decide whether a policy carries a payload. Those that search for it have no effect
beyond the resolution."""

BOUNDS = {
    "optimum": "cablebot_gym.bounds.optimum",
    "best-known": "cablebot_gym.bounds.best_known",
    "drawn": "cablebot_gym.bounds.drawn",
}
"""Modules of the measures that no policy changes."""

WITHOUT_EFFECT = ("cablebot_gym.rendering", "cablebot_gym.utils")
"""Packages that compute no number of a row."""

_STORED = (
    *("payload", "total_mass", "resolution", "violation", "scan_ended", "assured", "stochastic"),
    *("draws", "declared", "feasible", "failures", "isolated", "bubblewrap"),
)
"""Data of a :class:`~cablebot_gym.evaluation.result.DLCCResult` in the result of a row."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Row:
    """A number with its conditions and its origin."""

    measure: Measure
    """What it is."""
    policy: str = ""
    """Policy name as on the command line; empty for what no policy changes."""
    conditions: Conditions
    """Conditions."""
    search: Mapping[str, Any] = field(default_factory=dict)
    """Further keywords of :func:`~cablebot_gym.evaluation.evaluator.evaluate_dlcc`."""
    result: Mapping[str, Any] = field(default_factory=dict)
    """JSON-able result, or an ``error`` message if the computation failed. It is reproducible. Empty
    before the computation."""
    code: str = ""
    """Hash of the code that computed the result."""
    versions: Mapping[str, str] = field(default_factory=dict)
    """Versions of Python and of the packages used."""
    seconds: float = 0.0
    """Wall time of the computation [s], with that of the rows that were computed together."""
    final: bool = True
    """Whether a retry gives the same result. False if a package, a file or memory was missing or a
    process died."""

    @property
    def key(self) -> str:
        """Text that is unique for each row, whatever its result is."""
        return canonical(self._question())

    @property
    def family(self) -> bool:
        """Whether the motion is one of a family of random motions."""
        trajectory = self.conditions.trajectory
        return isinstance(trajectory, Mapping) and "seed" in trajectory

    @property
    def motion(self) -> str:
        """Name of the motion, or of the family of motions; empty for the robot's own motion."""
        trajectory = self.conditions.trajectory
        return str(trajectory["name"]) if trajectory else ""

    @property
    def motion_key(self) -> str:
        """Key of the optimum: environment, robot, motion, error bounds and control
        frequency."""
        given = self.conditions
        bounds = given.error_bounds
        task = (given.robot, given.trajectory, bounds, given.control_frequency)
        return canonical([given.env_id, *task])

    @property
    def error(self) -> str | None:
        """Error message of a failed computation; None if it succeeded."""
        return self.result.get("error")

    @property
    def present_code(self) -> str:
        """Hash of the code that would compute the result: the plant and the policy."""
        name = (self.conditions.robot or env_robot(self.conditions.env_id)).removeprefix(ELASTIC)
        data = tuple(filter(None, [library().get(name)]))
        modules: tuple[str, ...] = PLANT
        if self.measure in BOUNDS:
            modules += (BOUNDS[self.measure],)
        else:
            own_modules, own_data = policy_source(self.policy)
            modules += own_modules
            data += own_data
        return source_hash(*modules, data=data, without=WITHOUT_EFFECT)

    @property
    def is_due(self) -> bool:
        """Whether it has no result yet, or one of other code."""
        return not self.result or self.code != self.present_code

    def _question(self) -> dict[str, Any]:
        data: dict[str, Any] = {"measure": self.measure, "policy": self.policy}
        data |= {"conditions": self.conditions.to_dict(), "search": dict(self.search)}
        return {name: value for name, value in data.items() if value}

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data, the input of :func:`row_from_dict`."""
        return self._question() | {
            "result": dict(self.result),
            "code": self.code,
            "versions": dict(self.versions),
            "seconds": round(self.seconds, 3),
        }

    def __str__(self) -> str:
        motion = self.motion
        if self.family:
            motion += f" {self.conditions.trajectory['seed']}"
        return ", ".join(filter(None, [self.measure, self.policy, motion, str(self.conditions)]))


def row_from_dict(data: Any) -> Row:
    """A stored row.

    Raises:
        KeyError, TypeError, ValueError: if ``data`` are something else.
    """
    fields = foreign_object("a row", data)
    choice("measure", fields["measure"], MEASURES)
    row = Row(
        measure=fields["measure"],
        policy=str(fields.get("policy", "")),
        conditions=Conditions.from_dict(foreign_object("conditions", fields["conditions"])),
        search=foreign_object("search", fields.get("search", {})),
        result=foreign_object("a result", fields["result"]),
        code=str(fields["code"]),
        versions=foreign_object("versions", fields["versions"]),
        seconds=number("seconds", fields["seconds"], least=0, unit="s"),
    )
    _ = row.motion_key  # raises if the conditions are not those of a row
    return row


def canonical(data: Any) -> str:
    """JSON text that is identical for equal data."""
    return json.dumps(
        data, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )


MOTIONS_OF_A_JOB = 10
"""Largest number of motions whose payloads are computed together: they share batches and the start of
the policy, and workers share the motions."""


def jobs(rows: Sequence[Row]) -> list[tuple[Row, ...]]:
    """The rows in groups that are computed together: payloads of one policy that differ in motion and
    seed alone, on the motions of a family."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        key = row.key
        if row.measure == "payload" and row.family:
            given = replace(row.conditions, trajectory={"name": row.motion}, seed=0)
            key = canonical([row.policy, given.to_dict(), dict(row.search)])
        groups.setdefault(key, []).append(row)
    split = []
    for group in groups.values():
        for start in range(0, len(group), MOTIONS_OF_A_JOB):
            split.append(tuple(group[start : start + MOTIONS_OF_A_JOB]))
    return split


def compute(rows: Sequence[Row]) -> list[Row]:
    """Computes the rows of one of the :func:`jobs`. An exception becomes the error of its rows; it
    does not stop the benchmark."""
    start = time.perf_counter()
    final = True
    try:
        results = json.loads(canonical(_results(rows)))
    except Exception as error:
        results = [{"error": _one_line(error)}] * len(rows)
        final = not isinstance(error, (ImportError, OSError, MemoryError))
    seconds = time.perf_counter() - start
    computed = []
    for row, result in zip(rows, results, strict=True):
        computed.append(_computed(row, result, seconds, final=final))
    return computed


def failed(row: Row, reason: str) -> Row:
    """A row that is not final, with ``reason`` as its error: the next run computes it again."""
    return _computed(row, {"error": reason}, 0.0, final=False)


def _computed(row: Row, result: Mapping[str, Any], seconds: float, *, final: bool) -> Row:
    return replace(
        row,
        result=result,
        code=row.present_code,
        versions=versions(),
        seconds=seconds,
        final=final,
    )


def _results(rows: Sequence[Row]) -> list[dict[str, Any]]:
    (row, *_) = rows
    if row.measure == "payload" and row.family:
        return _surveyed(rows)
    measured = {
        "payload": _payload,
        "time": _time,
        "optimum": _optimum,
        "best-known": _best_known,
        "drawn": _drawn,
    }
    return [measured[row.measure](row)]


def _payload(row: Row) -> dict[str, Any]:
    """The payload, its limiting violation, and the details of the search.

    The paper criterion applies to policies that declare ``unsaturated_actions``; for others the
    result says ``applicable: False``. ``declared`` marks policies that this project does not hold to
    their declaration.
    """
    given = row.conditions
    with policy_process(row) as policy:
        loaded = load(policy, given.nominal_robot)
        if given.criterion == "paper" and not loaded.declarations.unsaturated_actions:
            return {"applicable": False, "payload": None, "total_mass": None}
        result = evaluate_dlcc(
            loaded, given.env_id, name=row.policy, **given.keywords(), **row.search
        )
    data = result.to_dict()
    return {name: data[name] for name in _STORED} | {
        "applicable": True,
        "fallbacks": result.details.fallbacks,
    }


def _surveyed(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """The payload and the limiting violation of each motion."""
    given = rows[0].conditions
    keywords = given.keywords()
    for name in ("trajectory", "draws", "seed"):
        keywords.pop(name, None)
    with policy_process(rows[0]) as policy:
        result = survey(
            policy,
            given.env_id,
            [row.conditions.motion for row in rows],
            seeds=[row.conditions.seed for row in rows],
            robots=given.draws,
            name=rows[0].policy,
            **keywords,
        )
    results = []
    for motion in result.motions:
        violation = motion.violation
        results.append(
            {
                "payload": motion.payload,
                "violation": None if violation is None else asdict(violation),
                "resolution": motion.resolution,
                "scan_ended": motion.failed_payload is None,
                "stochastic": result.stochastic,
                "draws": len(motion.seeds),
            }
        )
    return results


def _time(row: Row) -> dict[str, Any]:
    """The result of :func:`cablebot_gym.evaluation.timing.time_actions`, and the processor of this
    machine. No plan is cached.

    ``exchange`` marks policies that are not shipped, whose times include the exchange with their
    process.
    """
    with empty_cache(), policy_process(row) as policy:
        times = time_actions(policy, row.conditions.env_id, **row.conditions.keywords())
    is_shipped = PolicySpec.parse(row.policy).shipped
    return asdict(times) | {"exchange": not is_shipped, "processor": processor()}


def _optimum(row: Row) -> dict[str, Any]:
    """The result of :func:`cablebot_gym.bounds.optimum.find_optimum`."""
    from cablebot_gym.bounds.optimum import find_optimum

    result = find_optimum(row.conditions.env_id, **row.conditions.keywords())
    return {"payload": result.payload, "meshes": result.meshes}


def _best_known(row: Row) -> dict[str, Any]:
    """The result of :func:`cablebot_gym.bounds.best_known.find_best_known`."""
    from cablebot_gym.bounds.best_known import find_best_known

    data = find_best_known(row.conditions.env_id, **row.conditions.keywords()).to_dict()
    return {name: data[name] for name in ("payload", "total_mass", "verified", "replays")}


def _drawn(row: Row) -> dict[str, Any]:
    """The payload of a random robot and its ratio to the nominal one, whose optimum is taken from the
    disk cache of this machine, or computed first."""
    from cablebot_gym.bounds.drawn import find_drawn_payload

    keywords = {"seed": row.conditions.seed} | row.conditions.keywords()
    result = find_drawn_payload(row.conditions.env_id, **keywords)
    return asdict(result) | {"ratio": result.ratio}


@contextmanager
def policy_process(row: Row) -> Iterator[str | IsolatedPolicy]:
    """The name of the policy of a row if it is shipped, else the policy in a process of its own,
    which ends with the context."""
    if PolicySpec.parse(row.policy).shipped:
        yield row.policy
        return
    with IsolatedPolicy(row.policy, row.conditions.nominal_robot) as policy:
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


def _one_line(error: Exception) -> str:
    """The message of an exception in one line, with the type where the message alone is unclear."""
    text = " ".join(str(error).split())
    if isinstance(error, (ValueError, ImportError, RuntimeError)):
        return text
    return f"{type(error).__name__}: {text}"
