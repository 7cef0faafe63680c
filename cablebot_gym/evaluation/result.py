"""Result of a DLCC evaluation, as text and as JSON. :mod:`cablebot_gym.plotting` draws it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from cablebot_gym.envs import described
from cablebot_gym.evaluation.batch import versions
from cablebot_gym.evaluation.conditions import Conditions
from cablebot_gym.evaluation.judge import Violation
from cablebot_gym.evaluation.rollout import Rollout
from cablebot_gym.utils.results import Result


@dataclass(frozen=True, kw_only=True, eq=False)
class Details:
    """Details of a search for the payload."""

    payload_max: float
    """End of the scan [kg]."""
    feasible: tuple[tuple[float, float], ...]
    """Intervals of carried payloads on the grid of the scan [kg]. Only the end of the first interval
    is refined and checked with random payloads. With several draws, the others are those of the
    scan's draws."""
    discretisation: float | None
    """Deviation of the payload with ten times as many physics steps from ``payload`` [kg], 0 if it
    is in the same gap; None if it is not checked: with several draws, and by bisection."""
    margins: dict[str, float]
    """Margins at the payload: fractions of the torque, position and rotation limits and of a maximum
    tension (``overload``), and the least tension [N]. With several draws, the least margins over the
    draws that carry it."""
    error_bounds: dict[str, float | None]
    """Bounds of the position error [m] and the rotation error [rad]; None where the criterion or
    the robot has none."""
    probability: float | None
    """Required success probability; None for one draw."""
    confidence: float | None
    """Confidence of the payload; None for one draw."""
    failures: dict[str, int]
    """Number of draws that fail at ``failed_payload``, by kind of violation; empty for one draw,
    and for a payload of the dense check, which a single draw has tried."""
    violation_seed: int | None
    """Seed of the draw with ``violation``, at ``failed_payload``; None without a violation."""
    stochastic: bool
    """Whether the policy declares that its actions are random. Its draws are repeats then, and its
    episodes are not compared with repetitions."""
    shipped: bool
    """Whether the policy has only code of this project: it is given by the name of one of its
    policies, without wrappers."""
    bubblewrap: bool
    """Whether the process of an isolated policy ran behind bubblewrap, without network and without
    writing files."""
    declared: bool
    """Whether only the policy itself says that its actions are not saturated (paper criterion). A
    test holds shipped policies to it."""
    wrappers: tuple[str, ...]
    """Names of the wrappers of the policy, the innermost first."""
    environment: dict[str, Any]
    """Robot, trajectory, control frequency, cable mode and further settings, as JSON-able data."""
    fallbacks: float | None = field(repr=False)
    """Number of the policy's fallbacks in the recorded episode; None for a policy that does not
    count ``fallbacks``."""

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data without ``fallbacks``, and without ``wrappers`` if there are none."""
        data = asdict(self)
        del data["fallbacks"]
        if not self.wrappers:
            del data["wrappers"]
        return data


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DLCCResult(Result):
    """Dynamic load carrying capacity (DLCC) of a policy in an environment. ``print(result)`` shows
    a summary."""

    policy: str
    """Name of the policy."""
    conditions: Conditions
    """Conditions of all episodes."""
    payload: float | None
    """DLCC: largest payload in the feasible interval that contains zero [kg]; None if the policy
    fails unloaded. With several draws: the 95/95 lower tolerance bound for the default
    ``probability`` and ``confidence`` (Clopper and Pearson), if :attr:`assured`. It is exact if
    each draw carries every payload below its own largest one."""
    failed_payload: float | None
    """Least failed payload above ``payload`` [kg]; None if there is none."""
    resolution: float
    """Larger one of the discretisation error and the gap between ``payload`` and
    ``failed_payload`` [kg]."""
    violation: Violation | None
    """Limiting violation: the first violation beyond the payload, or at zero payload if the policy
    fails unloaded. With several draws, the earliest violation of the most frequent kind. None if
    the scan ended while feasible."""
    ranked: bool
    """Whether the payload may be ranked with others: False for ``search="bisection"``, which checks
    few payloads."""
    draw_seeds: tuple[int, ...]
    """Seed of each draw. ``env.reset(seed=…)`` or ``cablebot rollout --seed`` repeats the draw."""
    assured: bool | None
    """Whether the draws are enough for the lower tolerance bound; None if nothing is random."""
    isolated: bool
    """Whether the policy ran in a process of its own. Otherwise it could change the evaluation, and
    every later one of this process."""
    rollout: Rollout = field(repr=False)
    """Episode at the payload, or at zero payload up to the violation if the policy fails unloaded.
    With several draws, the first draw that carries the payload, or the draw of ``violation`` if the
    policy fails unloaded."""
    details: Details = field(repr=False)
    """Details of the search."""

    @property
    def criterion(self) -> str:
        """Criterion, ``task`` or ``paper``."""
        return self.conditions.criterion

    @property
    def draws(self) -> int:
        """Number of draws that confirm the payload."""
        return len(self.draw_seeds)

    @property
    def total_mass(self) -> float | None:
        """Mass of platform and payload [kg]; None if the policy fails unloaded."""
        return None if self.payload is None else self.payload + self.conditions.nominal_robot.mass

    @property
    def scan_ended(self) -> bool:
        """Whether the scan ended while feasible: every payload up to the end of the scan is
        carried, and ``payload`` is a lower bound of the DLCC."""
        return self.failed_payload is None

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
        probability = self.details.probability
        confidence = self.details.confidence
        if not self.assured or probability is None or confidence is None:
            return f"not assured: only {counted}"
        return f"{100 * probability:g}/{100 * confidence:g} lower tolerance bound, {counted}"

    @property
    def violation_text(self) -> str:
        """Text of the limiting violation, or ``none up to … kg`` if the scan ended while
        feasible."""
        if self.violation is None:
            return f"none up to {self.details.payload_max:g} kg"
        return str(self.violation)

    def to_dict(self) -> dict[str, Any]:
        """JSON-able data: the score, the conditions and the details, without the episode."""
        violation = None if self.violation is None else asdict(self.violation)
        return {
            "policy": self.policy,
            **self.conditions.summary(),
            "payload": self.payload,
            "total_mass": self.total_mass,
            "resolution": self.resolution,
            "failed_payload": self.failed_payload,
            "violation": violation,
            "scan_ended": self.scan_ended,
            "ranked": self.ranked,
            "draws": self.draws,
            "draw_seeds": list(self.draw_seeds),
            "assured": self.assured,
            "isolated": self.isolated,
            **self.details.to_dict(),
            "versions": versions(),
        }

    def describe(self, *words: str) -> str:
        """Robot, policy, some words, payload model, uncertainty, and what a reader should know."""
        conditions = self.conditions
        robot = described(conditions.env_id, conditions.nominal_robot.name)
        parts = [robot, self.policy, *words, conditions.payload_model]
        if conditions.uncertainty_name is not None:
            parts.append(conditions.uncertainty_name)
        if self.details.stochastic:
            parts.append("stochastic policy")
        if self.details.wrappers:
            parts.append(f"behind {', '.join(self.details.wrappers)}")
        if not self.ranked:
            parts.append("unranked (bisection)")
        if self.isolated:
            protection = "" if self.details.bubblewrap else " without bubblewrap"
            parts.append(f"isolated{protection}")
        elif not self.details.shipped:
            parts.append("not isolated")
        return ", ".join(parts)

    def __str__(self) -> str:
        criterion = [f"{self.criterion} criterion"]
        if self.details.declared:
            criterion.append("unsaturated actions declared by the policy")
        text = f"{self.describe(*criterion)}: {self._payload_text()}"
        if self.assured is not None:
            text += f" ({self.assurance})"
        return text

    def _payload_text(self) -> str:
        if self.payload is not None:
            mass = f"{self.payload:.3f} kg (total {self.total_mass:.3f} kg)"
            return f"{mass}; limiting violation: {self.violation_text}"
        text = f"fails unloaded: {self.violation_text}"
        if self.details.feasible:
            intervals = [f"{low:.3f} to {high:.3f} kg" for low, high in self.details.feasible]
            text += f"; it carries {', '.join(intervals)}"
        return text
