"""Result of a DLCC evaluation, as text and as JSON. :mod:`cablebot_gym.plotting` draws it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from cablebot_gym.envs import described
from cablebot_gym.evaluation.constraints import Criterion, Violation
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.task import Task, payload_model_text


@dataclass(frozen=True, kw_only=True, eq=False)
class DLCCResult:
    """Dynamic load carrying capacity (DLCC) of a policy in an environment. ``print(result)`` shows
    a summary."""

    env_id: str
    """Id of the environment."""
    policy: str
    """Name of the policy."""
    criterion: Criterion
    """Criterion, ``task`` or ``paper``."""
    payload: float | None
    """DLCC: largest payload in the feasible interval that contains zero [kg]; None if the policy
    fails unloaded. With several draws: the 95/95 lower tolerance bound for the default
    ``probability`` and ``confidence`` (Clopper and Pearson), if :attr:`assured`. It is exact if
    each draw carries every payload below its own largest one."""
    total_mass: float | None
    """Mass of platform and payload [kg]; None if the policy fails unloaded."""
    resolution: float
    """Larger one of ``discretisation`` and the gap between ``payload`` and ``failed_payload``
    [kg]."""
    discretisation: float | None
    """Deviation of the payload with ten times as many physics steps from ``payload`` [kg], 0 if it
    is in the same gap; None if it is not checked: with several draws, and by bisection."""
    failed_payload: float | None
    """Least failed payload above ``payload`` [kg]; None if there is none."""
    violation: Violation | None
    """Limiting violation: the first violation beyond the payload, or at zero payload if the policy
    fails unloaded. With several draws, the earliest violation of the most frequent kind. None if
    the scan ended while feasible."""
    scan_ended: bool
    """Whether the scan ended while feasible: every payload up to ``payload_max`` is carried, and
    ``payload`` is a lower bound of the DLCC."""
    ranked: bool
    """Whether the payload may be ranked with others: False for ``search="bisection"``, which checks
    few payloads."""
    margins: dict[str, float]
    """Margins at the payload: fractions of the torque, position and rotation limits, and the least
    tension [N]. With several draws, the least margins over the draws that carry it."""
    feasible: tuple[tuple[float, float], ...]
    """Intervals of carried payloads on the grid of the scan [kg]. Only the end of the first
    interval is refined and checked with random payloads. With several draws, the others are those
    of the scan's draws."""
    payload_max: float
    """End of the scan [kg]."""
    error_bounds: dict[str, float | None]
    """Bounds of the position error [m] and the rotation error [rad]; None where the criterion or
    the robot has none."""
    payload_known: bool
    """Whether the payload is known to the policy."""
    model_payload_factor: float
    """Ratio of the payload in the policy's model to the nominal payload."""
    uncertainty: str | None
    """Name of the uncertainty, ``custom`` for data; None without uncertainty."""
    stochastic: bool
    """Whether the policy declares that its actions are random. Its draws are repeats then, and its
    episodes are not compared with repetitions."""
    declared: bool
    """Whether only the policy itself says that its actions are not saturated (paper criterion). A
    test of this project holds its own laws to it, if they are given by their names. Objects always
    count as declared."""
    draws: int
    """Number of draws that confirm the payload."""
    assured: bool | None
    """Whether ``draws`` are enough for the lower tolerance bound; None if nothing is random."""
    probability: float | None
    """Required success probability; None for one draw."""
    confidence: float | None
    """Confidence of the payload; None for one draw."""
    failures: dict[str, int]
    """Number of draws that fail at ``failed_payload``, by kind of violation; empty for one draw,
    and for a payload of the dense check, which a single draw has tried."""
    draw_seeds: tuple[int, ...]
    """Seed of each draw. ``env.reset(seed=…)`` or ``cablebot rollout --seed`` repeats the draw."""
    violation_seed: int | None
    """Seed of the draw with ``violation``, at ``failed_payload``; None without a violation."""
    success: tuple[tuple[float, float], ...]
    """Pairs of payload [kg] and fraction of the draws that carry it, from the draws of the scan;
    empty for one draw."""
    seed: int
    """Seed of the environments, which determines the draws."""
    environment: dict[str, Any]
    """Robot, trajectory, control frequency, cable mode and further settings, as JSON-able data."""
    versions: dict[str, str]
    """Versions of Python and of the packages that determine the result."""
    task: Task = field(repr=False)
    """Public task of the episodes."""
    rollout: Rollout = field(repr=False)
    """Episode at the payload, or at zero payload up to the violation if the policy fails unloaded.
    With several draws, the first draw that carries the payload, or the draw of ``violation`` if the
    policy fails unloaded."""
    fallbacks: float | None = field(repr=False)
    """Number of the policy's fallbacks in that episode; None for a policy that does not count
    ``fallbacks``."""
    wrappers: tuple[str, ...] = field(default=(), repr=False)
    """Names of the wrappers of the policy, the innermost first. The data of a result have them if
    there are any."""

    @property
    def score(self) -> float:
        """Score [kg]: the payload, or 0 if the policy fails unloaded."""
        return self.payload or 0.0

    @property
    def assurance(self) -> str:
        """What the draws assure, such as ``95/95 lower tolerance bound, 512 draws``; empty if
        nothing is random."""
        counted = f"{self.draws} draw{'' if self.draws == 1 else 's'}"
        if self.assured is None:
            return ""
        if not self.assured or self.probability is None or self.confidence is None:
            return f"not assured: only {counted}"
        return (
            f"{100 * self.probability:g}/{100 * self.confidence:g} lower tolerance bound, {counted}"
        )

    @property
    def violation_text(self) -> str:
        """Text of the limiting violation, or ``none up to … kg`` if the scan ended while
        feasible."""
        return (
            f"none up to {self.payload_max:g} kg" if self.violation is None else str(self.violation)
        )

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data without task, rollout and fallbacks."""
        data = {item.name: getattr(self, item.name) for item in fields(self) if item.repr}
        pairs = {
            name: [list(pair) for pair in getattr(self, name)] for name in ("feasible", "success")
        }
        seeds = {"draw_seeds": list(self.draw_seeds)} | (
            {"wrappers": list(self.wrappers)} if self.wrappers else {}
        )
        return (
            data
            | {"violation": None if self.violation is None else asdict(self.violation)}
            | pairs
            | seeds
        )

    def to_json(self) -> str:
        """The result as JSON, indented."""
        return json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)

    def __str__(self) -> str:
        head = f"{described(self.env_id, self.task.robot.name)}, {self.policy}, {self.criterion} criterion"
        if self.payload is None:
            others = "; it carries " + ", ".join(
                f"{low:.3f} to {high:.3f} kg" for low, high in self.feasible
            )
            text = f"fails unloaded: {self.violation_text}{others if self.feasible else ''}"
        else:
            text = f"{self.payload:.3f} kg (total {self.total_mass:.3f} kg); limiting violation: {self.violation_text}"
        if self.assured is not None:
            text += f" ({self.assurance})"
        model = payload_model_text(self.payload_known, self.model_payload_factor)
        uncertainty = "" if self.uncertainty is None else f", {self.uncertainty}"
        kind = ", stochastic policy" if self.stochastic else ""
        kind += ", unsaturated actions declared by the policy" if self.declared else ""
        kind += f", behind {', '.join(self.wrappers)}" if self.wrappers else ""
        kind += "" if self.ranked else ", unranked (bisection)"
        return f"{head}, {model}{uncertainty}{kind}: {text}"
